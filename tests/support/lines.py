"""Files of JSON lines as a kill leaves them."""

from pathlib import Path

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE


def unmark(path: Path) -> None:
    """Take the end mark off."""
    lines = path.read_bytes().splitlines(keepends=True)
    assert lines.pop().startswith(b'{"event":"end"')
    path.write_bytes(b"".join(lines))


def unmarked(run_dir: Path) -> Path:
    """A run as if all processes had been killed: no end mark counts the lines."""
    for name in (PLANT_TRACE, CONTROLLER_TRACE, CAPTURE):
        unmark(run_dir / name)
    return run_dir
