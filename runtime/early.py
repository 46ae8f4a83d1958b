"""Ctrl-C while a program is being loaded: the first thing that a program's package imports.

Loading takes a while. Until :func:`runtime.command.entered` looks after signals there is nothing
to give back, and Ctrl-C ends the process without a traceback of an import. A notebook or a script
that imports the library keeps Ctrl-C as it has it.
"""

import sys

PROGRAMS = ("wyner", "controller_service", "plant_service", "tap_service")
"""What runs as a process of its own: ``python -m NAME``, and the command ``wyner``."""


def _starts_a_program() -> bool:
    """Whether this process is one of the programs, and not one that imports the library."""
    name = sys.argv[0] if getattr(sys, "argv", None) else ""
    if name == "-m":
        after = sys.orig_argv[sys.orig_argv.index("-m") + 1 :] if "-m" in sys.orig_argv else []
        return after[:1] != [] and after[0] in PROGRAMS
    return name.replace("\\", "/").rpartition("/")[2].removesuffix(".exe") == "wyner"


if _starts_a_program():
    import _signal  # type: ignore[import-not-found]

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
