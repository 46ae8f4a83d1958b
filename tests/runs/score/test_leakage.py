"""A second opinion on P_g from rows of secrets and views, which knows nothing of centres."""

import csv
from pathlib import Path

import numpy as np
import pytest

from protocol.statistics import wilson
from runtime.run_folder import CAPTURE
from runtime.scenario_file import scenario_of
from tap_service.capture.channel import View
from tests.support.small_run import SmallRun, read_lines, write_lines
from wyner.cli.main import main
from wyner.runs.run import Run
from wyner.runs.score.leakage import FEWEST, LeakedKey, leakage_line, neighbours_right
from wyner.runs.score.replay import Replay
from wyner.runs.score.score import read_truth, score


def run_of(folder: Path, name: str, steps: int) -> Path:
    run = SmallRun(folder, name=name)
    run.steps(steps)
    run.close()
    capture = folder / CAPTURE
    lines = read_lines(capture)
    told = scenario_of(name).knowledge().model_dump(mode="json")
    lines[0] |= {"knowledge": told, "view": View().model_dump(mode="json")}
    write_lines(capture, lines)
    return folder


def rows_of(path: Path) -> list[LeakedKey]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(next(iter(row)) == "secret" for row in rows)
    return [
        LeakedKey(int(row.pop("secret")), tuple(float(v) for v in row.values())) for row in rows
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps"), [("packed", 600), ("sustained", 2500)])
def test_neighbours_without_a_model_come_to_nearest_centre(
    name: str, steps: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run_of(tmp_path / "run", name, steps)
    out = tmp_path / "leakage.csv"
    assert main(["export", str(folder), "--to", "csv", "--leakage", "--output", str(out)]) == 0
    said = capsys.readouterr().err.splitlines()
    keys = rows_of(out)
    assert said[0] == f"{len(keys)} agreed steps"
    replay = Replay(folder, ("nearest-centre",))
    replay.run()
    (nearest,) = (score(read_truth(Run.load(folder)), x).keys_reviewed for x in replay.outputs())
    assert nearest.share == 1.0
    found = neighbours_right(keys)
    assert found is not None
    assert found.share is not None
    # its interval meets that of nearest-centre: what she gets of a key is in the rows
    assert wilson(found.right, found.of).high >= wilson(nearest.right, nearest.of).low
    assert found.share > 0.97
    assert said[1] == leakage_line(keys)
    assert len({len(key.view) for key in keys}) == 1
    # the view alone says it: the nearest prediction is the secret in every row
    for key in keys:
        residuals = np.abs(np.array(key.view).reshape(-1, 2)).max(axis=1)
        assert residuals.argmin() == key.secret


def test_secrets_that_the_view_does_not_show_are_a_coin_to_it() -> None:
    rng = np.random.default_rng(4)
    keys = [
        LeakedKey(int(rng.integers(4)), tuple(rng.normal(size=3).tolist())) for _ in range(3000)
    ]
    found = neighbours_right(keys)
    assert found is not None
    _, low, high = wilson(found.right, found.of)
    assert low < 0.25 < high


def test_a_known_channel_is_estimated_from_below() -> None:
    """Two secrets, each with Gaussian noise of deviation 1 about -1 and 1: P_g = 0.841."""
    rng = np.random.default_rng(5)
    secrets = rng.integers(2, size=6000)
    seen = 2.0 * secrets - 1 + rng.normal(size=6000)
    keys = [LeakedKey(int(s), (float(v), 7.0)) for s, v in zip(secrets, seen, strict=True)]
    found = neighbours_right(keys)
    assert found is not None
    assert found.share is not None
    assert 0.79 < found.share < 0.8413 + 0.015


def test_equal_views_and_too_few_rows() -> None:
    assert neighbours_right([LeakedKey(0, (1.0,))] * (FEWEST - 1)) is None
    assert "not estimated" in leakage_line([])
    same = [LeakedKey(i % 2, (1.0, 2.0)) for i in range(60)]
    assert neighbours_right(same) is None
    apart = [LeakedKey(i % 2, (float(i % 2), 2.0)) for i in range(60)]
    found = neighbours_right(apart)
    assert found is not None
    assert found.share == 1.0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--to", "csv", "--leakage", "--steps"], "--leakage: expected neither --steps nor"),
        (["--to", "mcap", "--leakage"], "--leakage: expected --to csv or --to parquet"),
    ],
)
def test_wrong_arguments_are_one_line(
    arguments: list[str], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(tmp_path), *arguments]) == 2
    err = capsys.readouterr().err
    assert line in err
    assert err.count("\n") == 1
