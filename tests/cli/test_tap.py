"""`wyner score`, `export` and the options of `wyner tap`, as a user calls them."""

import csv
import errno
import itertools
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime.recording import Bounds
from runtime.run_folder import CAPTURE
from tap_service.capture.reading import CaptureReader
from tests.support.recorded_pair import RecordedPair
from wyner.cli.main import main

MESSAGE = b"Lower the bridge now"
STEPS = 1000


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder; its capture has some parts."""
    folder = tmp_path_factory.mktemp("run")
    captured = Bounds(part_bytes=100_000, free_bytes=0)
    loop = RecordedPair(folder, MESSAGE, pace="fast", seed=2, captured=captured)
    loop.steps(STEPS)
    loop.stop()
    return folder


def call(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    code = main([str(a) for a in args])
    out, err = capsys.readouterr()
    return code, out, err


def test_replay_decodes_and_scores(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = run_dir / CAPTURE
    code, out, _ = call(capsys, "score", capture, "--eavesdropper", "list-decoder", "--json")
    assert code == 0
    report = json.loads(out)
    assert report["transitions"] == STEPS
    assert report["taps"]["list-decoder"]["message"] == MESSAGE.decode()


def test_the_oracle_in_a_replay_needs_the_runs_folder(
    run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = call(capsys, "score", run_dir / CAPTURE, "--eavesdropper", "oracle")
    assert code == 2
    assert err == "wyner: --eavesdropper: oracle: expected a run's folder, for its alpha\n"
    report = json.loads(call(capsys, "score", run_dir, "--eavesdropper", "oracle", "--json")[1])
    assert report["taps"]["oracle"]["exact_message_rate"]["value"] == 1.0


@pytest.mark.long
def test_secrecy_report(run_dir: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "report.svg"
    args = ("--eavesdropper", "set-membership,list-decoder", "--plot", figure)
    code, out, _ = call(capsys, "score", run_dir, *args)
    assert code == 0
    assert "PAPER'S RULE EXCEEDS TRUE" in out
    assert figure.read_bytes().startswith(b"<?xml")
    code, out, _ = call(capsys, "score", run_dir, *args[:2], "--json")
    report = json.loads(out)
    assert report["strongest"] == "list-decoder"
    assert report["claimed_exceeds_true"] is True
    assert report["taps"]["list-decoder"]["exact_message_rate"]["value"] == 1.0


def test_secrecy_takes_a_folder_of_runs_and_counts_each_once(
    run_dir: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """``check`` takes the folder of a demo, and so does this."""
    for name in ("one", "two"):
        shutil.copytree(run_dir, tmp_path / name)
        (tmp_path / name / "scenario.toml").touch()
    args = ("--eavesdropper", "set-membership", "--json")
    code, out, _ = call(capsys, "score", tmp_path, *args)
    assert code == 0
    report = json.loads(out)
    assert report["runs"] == ["one", "two"]
    hers = report["taps"]["set-membership"]
    assert hers["symbol_error_rate"]["value"] == pytest.approx(0.5, abs=0.1)
    assert hers["symbol_error_rate"]["low"] is None  # two runs have no interval
    assert hers["left_bits"]["high"] == report["claimed_bits"]  # a blind one leaves all
    code, _, err = call(capsys, "score", tmp_path, tmp_path / "one", *args)
    assert code == 2
    assert err.endswith("one: given 2 times, expected each run once\n")


FAILS = """
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
class Mine(Eavesdropper):
    name = "mine"
    def observe(self, transition):
        if transition.k == 21:
            raise ValueError("no idea")
        return Guess(transition.k, (1.0, 0.0), 1.0)
    def belief(self):
        return Belief()
"""


def test_an_eavesdropper_who_fails_ends_with_1_and_is_not_scored(
    run_dir: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(FAILS)
    name = f"{tmp_path}/mine.py:Mine"
    code, out, _ = call(capsys, "score", run_dir, "--eavesdropper", name)
    assert code == 1
    assert "mine: not scored: it failed: step 21: ValueError: no idea" in out
    assert "so they stand untested" in " ".join(out.split())
    code, out, _ = call(capsys, "score", run_dir / CAPTURE, "--eavesdropper", name)
    assert code == 1
    assert "mine: it failed: step 21: ValueError: no idea" in out


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_export_to_mcap_is_read_by_the_public_reader(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reader_module = pytest.importorskip("mcap.reader")
    path = tmp_path / "c.mcap"
    assert call(capsys, "report", run_dir, "--output", path)[0] == 0
    with path.open("rb") as file:
        reader = reader_module.make_reader(file)
        summary = reader.get_summary()
        got = [
            (schema.name, channel.topic, message.log_time, json.loads(message.data))
            for schema, channel, message in reader.iter_messages()
        ]
    assert {s.name for s in summary.schemas.values()} == {"Measurement", "Offer"}
    assert all(s.encoding == "jsonschema" for s in summary.schemas.values())
    captured = CaptureReader(run_dir).records()
    for (name, topic, t_ns, data), (heard_ns, message) in zip(got, captured, strict=True):
        assert name == type(message).__name__
        assert topic == f"wyner/v2/loop/{message.topic}"
        assert t_ns == heard_ns
        assert type(message).model_validate(data) == message


def test_export_refuses_to_write_over_the_capture(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tap = run_dir / "tap"
    before = {p: p.read_bytes() for p in tap.iterdir()}
    link = tmp_path / "link.csv"
    link.symlink_to(tap / "capture.0001.jsonl")
    for output, told in (
        (tap / "capture.jsonl", "expected a name that ends in .html, .csv, .parquet, .mcap"),
        (link, "is a part of the capture itself"),
    ):
        code, out, err = call(capsys, "report", tap / "capture.jsonl", "--output", output)
        assert (code, out) == (2, "")
        assert told in err
    assert {p: p.read_bytes() for p in tap.iterdir()} == before


@pytest.mark.parametrize("to", ["csv", "mcap", "parquet"])
def test_a_failed_export_leaves_what_was_there(
    run_dir: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    to: str,
) -> None:
    pytest.importorskip("pyarrow" if to == "parquet" else to)
    output = tmp_path / f"c.{to}"
    output.write_text("mine")
    records = CaptureReader.records

    def breaks(self: CaptureReader) -> Iterator[object]:
        yield from itertools.islice(records(self), 10)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(CaptureReader, "records", breaks)
    code, _, err = call(capsys, "report", run_dir, "--output", output)
    assert (code, err) == (
        1,
        f"wyner: --output: {output}: cannot be written: No space left on device\n",
    )
    assert [p.name for p in tmp_path.iterdir()] == [output.name]
    assert output.read_text() == "mine"
    monkeypatch.undo()
    assert call(capsys, "report", run_dir, "--output", output)[0] == 0
    assert [p.name for p in tmp_path.iterdir()] == [output.name]
    assert len(output.read_bytes()) > 1000


def test_a_capture_of_two_taps_is_refused_in_one_line(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = (run_dir / CAPTURE).read_bytes()
    (tmp_path / "tap").mkdir()
    (tmp_path / CAPTURE).write_bytes(first)
    header = first.splitlines()[0].replace(b'"loss":0.0', b'"loss":0.5')
    first_part, later = tmp_path / CAPTURE, tmp_path / "tap" / "capture.0001.jsonl"
    later.write_bytes(header + b"\n")
    for args in (("report", tmp_path, "-o", tmp_path / "c.csv"), ("score", first_part)):
        code, out, err = call(capsys, *args)
        assert (code, out) == (2, "")
        assert err.startswith(f"wyner: {later}: line 1: view: differs from the first part's")
        assert len(err.splitlines()) == 1


def test_export_of_steps_has_one_column_a_number(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capture = run_dir / CAPTURE
    code, _, err = call(capsys, "report", capture, "-o", tmp_path / "steps.csv", "--steps")
    assert code == 0
    rows = read_csv(tmp_path / "steps.csv")
    assert [int(row["k"]) for row in rows] == list(range(STEPS))
    assert f"{STEPS} steps" in err
    numbers = set(rows[0]) - {"session"}
    assert numbers == {"k", "x_1", "x_2", "u0_1", "u1_1", "cipher", "x_next_1", "x_next_2"}
    assert all(float(row[name]) is not None for row in rows for name in numbers)
    for row, after in itertools.pairwise(rows):
        assert (row["x_next_1"], row["x_next_2"]) == (after["x_1"], after["x_2"])
    table = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "steps.parquet"
    assert call(capsys, "report", capture, "--steps", "--output", path)[0] == 0
    assert table.read_table(path).column("x_1").to_pylist() == [float(r["x_1"]) for r in rows]


def test_export_puts_the_truth_beside_the_steps(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "steps.csv"
    assert call(capsys, "report", run_dir, "--output", path, "--steps")[0] == 0
    rows = read_csv(path)
    agreed = [row for row in rows if row["key"] not in ("", "-1")]
    assert agreed
    for row in agreed:
        assert row["role"] == "test"
        assert row["key"] == row["coin"]
        assert row["u_1"] == row[f"u{row['coin']}_1"]
        assert float(row[f"gauge_{row['key']}"]) <= 1
    assert call(capsys, "report", run_dir / CAPTURE, "--output", path, "--steps")[0] == 0
    assert "key" not in read_csv(path)[0]
