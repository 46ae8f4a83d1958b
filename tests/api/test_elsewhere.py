"""The library works where the services do not: Windows, macOS, a browser's Python."""

import os
from pathlib import Path

from tests.support.programs import ROOT, python

PROGRAM = """
import os, signal, sys

ABSENT = {"zenoh", "osqp", "daqp", "fcntl", "resource", "termios", "tty", "pwd", "grp"}


class Refuse:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ABSENT:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Refuse())
POSIX = {
    os: "O_NOFOLLOW O_NONBLOCK O_CLOEXEC O_DIRECTORY fchmod mkfifo killpg getpgid getuid geteuid "
    "setsid fork nice posix_fallocate fdatasync statvfs chown fchown",
    signal: "SIGHUP SIGKILL SIGUSR1 SIGSTOP SIGCONT pthread_sigmask alarm setitimer",
}
for module, names in POSIX.items():
    for name in names.split():
        delattr(module, name)

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from wyner import design, draw_agreement, draw_rate, draw_sets, draw_states, eavesdrop, run

system = design("packed")
runs = run(system, steps=200, runs=2, seed=1, message=b"Hi")
print(runs.messages, eavesdrop(runs, ["nearest-centre"])[0].read)
paper = design("paper")
short = run(paper, steps=50, runs=2, seed=1)
figure, axes = plt.subplots()
draw_sets(paper, axes)
draw_states(short, axes)
draw_agreement(short, axes)
draw_rate(short, axes, [1.0, 8.0])
"""


def test_the_library_and_its_figures_need_neither_zenoh_nor_posix(tmp_path: Path) -> None:
    """A third of the modules could not be imported without `fcntl` and `resource`."""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    done = python("-c", PROGRAM, cwd=tmp_path, env=env)
    assert done.stderr == ""
    assert done.stdout == "[[b'Hi'], [b'Hi']] 2\n"
