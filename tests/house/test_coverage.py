"""`make coverage` with programs that pretend: its figures stand there whatever the tests say."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

COVERAGE = """#!/bin/sh
case "$*" in
run*) exit {tests} ;;
*--fail-under*) echo 97; exit {under} ;;
report*) echo 90.0 ;;
esac
"""


@pytest.mark.parametrize(("tests", "under"), [(0, 0), (1, 0), (0, 2), (1, 2)])
def test_the_figures_stand_there_also_where_a_test_failed(
    tests: int, under: int, tmp_path: Path
) -> None:
    for name, text in {
        "coverage": COVERAGE.format(tests=tests, under=under),
        "pip": "#!/bin/sh\n",
    }.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    command = [
        "make",
        "--no-print-directory",
        "coverage",
        f"BIN={tmp_path}",
        f"STAMPS={tmp_path}",
        "-o",
        f"{tmp_path}/dev",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    rooms = [line for line in done.stdout.splitlines() if line.endswith(" 90.0 %")]
    assert "protocol/link 90.0 %" in rooms
    assert len(rooms) > 6
    assert done.stdout.splitlines()[-1] == "97"
    assert (done.returncode == 0) == (tests == under == 0)
