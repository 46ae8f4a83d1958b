"""Sweeps: the grid, additive rows, resuming, and every executor alike."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import pytest

from runtime.shipped import scenario_file_of
from tests.support.patience import PATIENCE_S
from tests.support.programs import python
from wyner import api
from wyner.cli.main import main
from wyner.sweeps.code import loop_version
from wyner.sweeps.grid import (
    SweepError,
    groups_of,
    load_sweep,
    points_of,
)
from wyner.sweeps.results import Results, read_rows, summarise
from wyner.sweeps.running import run_sweep, run_task
from wyner.sweeps.workers import SerialExecutor

ROOT = Path(__file__).resolve().parents[2]
TEXT = """
name = "small"
scenario = "sustained"
runs = 30
steps = 40
seed = 3
batch = 10

[grid]
"plant.initial_state" = [[1.0, -0.5], [4.0, -2.0]]
"secrecy.alpha" = [1.0, 3.0, 8.0]
"""


def small(tmp_path: Path, extra: str = "", text: str = TEXT) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(text + extra, encoding="utf-8")
    return path


def rows_of(
    path: Path, output: Path, executor: Executor | None = None, resume: bool = False
) -> Any:
    sweep = load_sweep(path)
    points = points_of(sweep, path.parent)
    results = Results(output, sweep.columns, resume)
    try:
        failures = run_sweep(sweep, points, results, executor or SerialExecutor())
    finally:
        results.close()
    assert failures == []
    return read_rows(output)


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "wyner", "sweep", *arguments]


def without_progress(error: str) -> list[str]:
    """The lines of standard error but those of the progress, which a busy machine shows."""
    return [line for line in error.splitlines() if not line.startswith("wyner: small, runs: ")]


# --- the file and the grid -----------------------------------------------------------------------


def test_the_grid_is_the_product_and_alpha_shares_trajectories(tmp_path: Path) -> None:
    path = small(tmp_path)
    points = points_of(load_sweep(path), tmp_path)
    assert [(p.fields["plant.initial_state"][0], p.scenario.secrecy.alpha) for p in points] == [
        (x, a) for x in (1.0, 4.0) for a in (1.0, 3.0, 8.0)
    ]
    assert len({p.task for p in points}) == 6
    assert [len(g.points) for g in groups_of(points)] == [3, 3]


def test_the_task_names_all_that_the_numbers_depend_on_and_nothing_else(tmp_path: Path) -> None:
    def task(text: str) -> str:
        return points_of(load_sweep(small(tmp_path, text=text)), tmp_path)[0].task

    first = task(TEXT)
    assert task(TEXT.replace('"small"', '"other"')) == first
    assert task(TEXT.replace("runs = 30", "runs = 50")) == first
    for change in (("steps = 40", "steps = 41"), ("seed = 3", "seed = 4"), ("[1.0,", "[1.25,")):
        assert task(TEXT.replace(*change)) != first, change


def test_what_the_tap_loses_makes_points_where_somebody_goes_for_keys(tmp_path: Path) -> None:
    text = (
        'name = "k"\nscenario = "keys"\nruns = 1\nsteps = 40\nseed = 3\n'
        'eavesdroppers = ["key-solver"]\n[grid]\n"tap.loss" = [0.0, 0.3]\n'
    )
    points = points_of(load_sweep(small(tmp_path, text=text)), tmp_path)
    assert len({point.task for point in points}) == len(groups_of(points)) == 2
    with pytest.raises(SweepError, match=r"tap\.loss: changes none of the numbers"):
        load_sweep(small(tmp_path, text=text.replace("key-solver", "oracle")))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("runs = 30", "runs = 0"), "runs: got 0, expected greater than or equal to 1"),
        (("runs = 30", "rums = 30"), "rums: got 30, no such field"),
        (("[1.0, 3.0, 8.0]", "[0.5]"), "secrecy.alpha: got 0.5, expected greater than"),
        (("[1.0, 3.0, 8.0]", "[]"), "grid.secrecy.alpha"),
        (("[1.0, 3.0, 8.0]", "[3, 3.0]"), "stands there twice"),
        (('"secrecy.alpha"', '"secrecy.beta"'), "secrecy.beta: got 1.0, no such field"),
        (('"secrecy.alpha"', '"control.law.x"'), "law.x: expected the path of a scenario's field"),
        (('"secrecy.alpha"', '"link.repeats_per_period"'), "repeats_per_period: changes none of"),
        (('"secrecy.alpha"', '"name"'), "grid: name: changes none of the numbers"),
        (('"secrecy.alpha"', '"attack.onset"'), "grid: attack.onset: changes none of"),
        (('"secrecy.alpha"', '"defence.kind"'), "grid: defence.kind: changes none of"),
        (('"sustained"', "[]"), "scenario: got none, expected at least one"),
        (('"sustained"', '"nowhere"'), "nowhere: cannot be read"),
        (('"sustained"', '"sealed"'), "travel under distilled keys, and these loops make none"),
        (("[grid]", "[grid"), "not TOML"),
    ],
)
def test_a_bad_file_gets_one_line_a_field_and_exit_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], line: str
) -> None:
    path = small(tmp_path, text=TEXT.replace(*change))
    assert main(["sweep", str(path), "--output", str(tmp_path / "x.csv")]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert all(text.startswith("wyner: ") for text in error.splitlines())
    assert not (tmp_path / "x.csv").exists()


def test_an_attack_that_would_be_left_out_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    attacked = scenario_file_of("sustained").read_text() + '[attack]\nkind = "bias"\nonset = 5\n'
    (tmp_path / "attacked.toml").write_text(attacked)
    path = small(tmp_path, text=TEXT.replace('"sustained"', '"attacked.toml"'))
    assert main(["sweep", str(path), "--output", str(tmp_path / "x.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("wyner: ")
    assert "attack: expected none" in line
    for scenario, said in ((tmp_path / "attacked.toml", "attack"), ("sealed", "distilled keys")):
        with pytest.raises(ValueError, match=said):
            api.run(str(scenario), steps=2, message=b"Hi")


def test_every_shipped_sweep_can_be_read() -> None:
    paths = sorted((ROOT / "wyner" / "sweeps").glob("*.toml"))
    assert paths
    for path in paths:
        sweep = load_sweep(path)
        assert sweep.name == path.stem
        assert points_of(sweep, path.parent)


# --- rows ----------------------------------------------------------------------------------------


def test_rows_add_up_to_the_same_whatever_the_batch(tmp_path: Path) -> None:
    one = summarise(
        rows_of(small(tmp_path, text=TEXT.replace("batch = 10", "batch = 30")), tmp_path / "a.csv")
    )
    three = summarise(rows_of(small(tmp_path), tmp_path / "b.csv"))
    for a, b in zip(one, three, strict=True):
        assert (a.runs, a.counts) == (30, b.counts)
        assert (a.rate, a.shares) == (b.rate, b.shares)
        for name in a.sums:
            assert a.sums[name] == pytest.approx(b.sums[name], rel=1e-12)


def test_a_run_that_stands_there_twice_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = small(tmp_path), tmp_path / "a.csv"
    rows = rows_of(path, output)
    with pytest.raises(SweepError, match=r"^sustained, \w+: run 0 stands there twice$"):
        summarise([*rows, rows[0]])
    with pytest.raises(SweepError, match="run 5 stands there twice"):
        summarise([*rows, rows[0] | {"first_run": 5, "runs": 1}])
    lines = output.read_bytes().splitlines(keepends=True)
    output.write_bytes(b"".join([*lines, lines[1]]))
    before = output.read_bytes()
    assert main(["sweep", str(path), "--resume", "--output", str(output)]) == 2
    assert f"{output}: sustained, " in capsys.readouterr().err
    assert output.read_bytes() == before


def test_the_rate_is_bits_over_plant_time(tmp_path: Path) -> None:
    summary = summarise(rows_of(small(tmp_path), tmp_path / "a.csv"))[2]
    symbols = summary.counts["message_symbols"]
    assert summary.rate.value == pytest.approx(symbols / (30 * 40 * 0.1))
    assert summary.rate.low < summary.rate.value < summary.rate.high


@pytest.mark.slow
def test_the_same_rows_from_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = small(tmp_path)
    rows_of(path, tmp_path / "a.csv")
    assert main(["sweep", str(path), "--jobs", "2", "--output", str(tmp_path / "b.csv")]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert "18 rows, " in capsys.readouterr().out


@pytest.mark.long
def test_the_same_rows_from_two_dask_workers(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    path = small(tmp_path)
    rows_of(path, tmp_path / "a.csv")
    output = tmp_path / "b.csv"
    done = subprocess.run(
        command(str(path), "--dask", "--jobs", "2", "--output", str(output), "--json"),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["new_rows"] == 18
    assert (tmp_path / "a.csv").read_bytes() == output.read_bytes()


def test_a_point_that_cannot_be_simulated_is_told_and_the_others_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = small(tmp_path, text=TEXT.replace("[[1.0, -0.5], ", "[[1e9, 0.0], "))
    output = tmp_path / "a.csv"
    assert main(["sweep", str(path), "--jobs", "1", "--output", str(output), "--json"]) == 1
    out, error = capsys.readouterr()
    assert json.loads(out)["new_rows"] == 9
    (told,) = without_progress(error)
    assert "[1000000000.0,0.0]" in told
    assert "outside T_250" in told


def of_another_version(*arguments: Any) -> Any:
    return "0.0.9+cafecafe", run_task(*arguments)[1]


def test_a_worker_with_other_code_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("wyner.sweeps.running.run_task", of_another_version)
    output = tmp_path / "a.csv"
    assert main(["sweep", str(small(tmp_path)), "--jobs", "1", "--output", str(output)]) == 1
    assert without_progress(capsys.readouterr().err) == [
        f"wyner: a worker has code version 0.0.9+cafecafe, this is {loop_version()}"
    ]
    assert output.read_bytes().count(b"\n") == 1, "the header alone"


# --- stopping and going on -----------------------------------------------------------------------


def test_resuming_adds_what_is_missing_and_nothing_twice(tmp_path: Path) -> None:
    path = small(tmp_path)
    rows_of(path, tmp_path / "whole.csv")
    whole = (tmp_path / "whole.csv").read_bytes()
    lines = whole.splitlines(keepends=True)
    for cut in (0, 20, len(lines[0]), len(lines[0]) + 5, sum(map(len, lines[:6])) + 30):
        output = tmp_path / f"cut{cut}.csv"
        output.write_bytes(whole[:cut])
        rows_of(path, output, resume=True)
        assert output.read_bytes() == whole
        rows_of(path, output, resume=True)
        assert output.read_bytes() == whole


@pytest.mark.parametrize(("before", "after", "batch"), [(25, 50, "batch = 10\n"), (100, 500, "")])
def test_a_short_batch_is_completed(tmp_path: Path, before: int, after: int, batch: str) -> None:
    text = TEXT.replace("batch = 10\n", batch)

    def rows(runs: int, name: str, resume: bool = False) -> Any:
        path = small(tmp_path, text=text.replace("runs = 30", f"runs = {runs}"))
        return rows_of(path, tmp_path / name, resume=resume)

    few = rows(before, "a.csv")
    more = summarise(rows(after, "a.csv", resume=True))
    assert {s.runs for s in summarise(few)} == {before}
    for s, whole in zip(more, summarise(rows(after, "b.csv")), strict=True):
        assert s.runs == whole.runs == after
        assert (s.counts, s.rate, s.shares) == (whole.counts, whole.rate, whole.shares)
        for name in s.sums:
            assert s.sums[name] == pytest.approx(whole.sums[name], rel=1e-12)
    kept = (tmp_path / "a.csv").read_bytes()
    rows(after, "a.csv", resume=True)
    assert (tmp_path / "a.csv").read_bytes() == kept


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"my notes, without a line's end", "its columns are not this sweep's"),
        (b"a,b\n1,2\n3", "its columns are not this sweep's"),
        (b"\x89PNG\xff\xfe", "its columns are not this sweep's"),
        (b"HEADER\n\xff\xfe\n", "is not CSV text"),
        (b"HEADER\na,b\ntorn", "line 2: expected as many cells as the header has"),
    ],
)
def test_a_file_that_is_no_sweeps_is_left_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, line: str
) -> None:
    path, output = small(tmp_path), tmp_path / "a.csv"
    rows_of(path, output)
    header = output.read_bytes().splitlines()[0]
    output.write_bytes(content.replace(b"HEADER", header))
    assert main(["sweep", str(path), "--resume", "--jobs", "1", "--output", str(output)]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert error.startswith(f"wyner: {output}: {line}")
    assert output.read_bytes() == content.replace(b"HEADER", header)


def test_one_process_writes_a_file_at_a_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = small(tmp_path), tmp_path / "a.csv"
    sweep = load_sweep(path)
    results = Results(output, sweep.columns, resume=False)
    before = output.read_bytes()
    arguments = ["sweep", str(path), "--resume", "--jobs", "1", "--output", str(output)]
    assert main(arguments) == 2
    assert capsys.readouterr().err == f"wyner: {output}: another process is writing it\n"
    assert output.read_bytes() == before
    results.close()
    assert main(arguments) == 0


def test_a_file_in_the_way_is_never_spoilt(tmp_path: Path) -> None:
    path = small(tmp_path)
    output = tmp_path / "a.csv"
    rows_of(path, output)
    before = output.read_bytes()
    with pytest.raises(SweepError, match="exists; --resume"):
        rows_of(path, output)
    other = small(
        tmp_path,
        text=TEXT.replace('"plant.initial_state"', '"control.law"').replace(
            "[[1.0, -0.5], [4.0, -2.0]]", '["paper"]'
        ),
    )
    with pytest.raises(SweepError, match="columns are not this sweep's"):
        rows_of(other, output, resume=True)
    output.write_bytes(before.replace(loop_version().encode(), b"0.0.9+cafecafe"))
    with pytest.raises(SweepError, match=r"rows of code version 0\.0\.9\+cafecafe"):
        rows_of(small(tmp_path), output, resume=True)
    torn = before.replace(loop_version().encode(), b"0.0.9+cafecafe") + b"torn"
    output.write_bytes(torn)
    with pytest.raises(SweepError, match="rows of code version"):
        rows_of(small(tmp_path), output, resume=True)
    assert output.read_bytes() == torn


LONG = (
    TEXT.replace("runs = 30", "runs = 400000")
    .replace("steps = 40", "steps = 200")
    .replace("batch = 10", "batch = 500")
)


def started(tmp_path: Path, output: Path, *options: str) -> subprocess.Popen[bytes]:
    path = small(tmp_path, text=LONG)
    process = subprocess.Popen(
        command(str(path), *options, "--output", str(output)),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and process.poll() is None:
        if output.exists() and output.read_bytes().count(b"\n") > 6:
            return process
        time.sleep(0.02)
    process.kill()
    _, error = process.communicate()
    raise AssertionError(f"no rows came: {error.decode()}")


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        ("--jobs", "1"),
        ("--jobs", "2"),
        ("--jobs", "2", "--dask"),
    ],
)
def test_ctrl_c_keeps_what_there_is_and_exits_130(tmp_path: Path, options: tuple[str, ...]) -> None:
    output = tmp_path / "a.csv"
    process = started(tmp_path, output, *options)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers hear it too
    _, error = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    rows = read_rows(output)
    said = [line for line in without_progress(error.decode()) if line.startswith("wyner: ")]
    assert said == [f"wyner: stopped: {len(rows)} rows kept in {output}; --resume goes on"]
    assert b"Traceback" not in error


CAUGHT = """
import contextlib, signal, sys
from runtime.command import entered
from wyner.sweeps.workers import SerialExecutor, in_order

def catches(number):
    if number == 3:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    return number

def command():
    for number, _ in in_order(SerialExecutor(), catches, range(9), lambda one: (one,)):
        print(number)
    return 0

sys.exit(entered(command))
"""


def test_ctrl_c_that_a_library_caught_ends_the_tasks() -> None:
    """The models' serialiser catches what is raised while it asks Python for a field."""
    done = python("-c", CAUGHT)
    assert (done.returncode, done.stdout.split(), done.stderr) == (130, ["0", "1", "2"], "")


def living(session: int) -> list[str]:
    """The processes of a session, but for those that have ended and wait to be collected."""
    lines = subprocess.check_output(["ps", "-A", "-o", "sid=,pid=,stat="], text=True).splitlines()
    found = (line.split() for line in lines)
    return [pid for sid, pid, state in found if sid == str(session) and state[0] != "Z"]


@pytest.mark.slow
def test_the_workers_of_a_killed_sweep_end(tmp_path: Path) -> None:
    process = started(tmp_path, tmp_path / "a.csv", "--jobs", "2")
    assert len(living(process.pid)) >= 3
    process.kill()
    process.wait(timeout=PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while (left := living(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.05)
    for pid in left:
        os.kill(int(pid), signal.SIGKILL)
    process.communicate(timeout=PATIENCE_S)
    assert not left


# --- what a user sees ----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_law_that_knows_alpha_is_simulated_at_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "packed-alphas.toml"
    path.write_text(
        'name = "packed-alphas"\nscenario = "packed"\nruns = 4\nsteps = 40\nseed = 7\n'
        '[[variant]]\nlabel = "short"\nset = { "control.horizon" = 10 }\n'
        '[grid]\n"secrecy.alpha" = [7.5, 8.0]\n'
    )
    points = points_of(load_sweep(path), tmp_path)
    assert len(groups_of(points)) == 2
    out = tmp_path / "rows.csv"
    assert main(["sweep", str(path), "--output", str(out)]) == 0
    capsys.readouterr()
    rows = read_rows(out)
    assert [row["agreements"] for row in rows] == [row["tested"] for row in rows]
    assert len(rows) == 2
