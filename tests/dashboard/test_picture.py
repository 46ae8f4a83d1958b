"""The documentation's picture: fresh, the same bytes twice, made from what was really published."""

from pathlib import Path

import pytest

from protocol.messages import PlantModel
from tools.picture import DOCS, PICTURE, RECORDING, SIZE, draw, main, read, thin, write
from tools.rehearsal import Rehearsal
from wyner.dashboard.model import Arrival, State, reduce_all


def rehearsed(steps: int) -> list[Arrival]:
    return [arrival for batch in Rehearsal().arrivals(steps) for arrival in batch]


def test_the_picture_in_the_docs_is_that_of_the_recording(tmp_path: Path) -> None:
    drawn = draw(read(DOCS / RECORDING), *SIZE)
    assert drawn == (DOCS / PICTURE).read_text(encoding="utf-8"), "run python -m tools.picture"
    assert drawn == draw(read(DOCS / RECORDING), *SIZE)


def test_a_recording_is_read_back_as_it_was(tmp_path: Path) -> None:
    arrivals = rehearsed(100)
    write(tmp_path / RECORDING, arrivals)
    assert read(tmp_path / RECORDING) == arrivals


@pytest.mark.parametrize("k", [200, 455, 800])
def test_thinning_keeps_what_the_moment_shows(k: int) -> None:
    arrivals = rehearsed(1000)
    kept = thin(arrivals, k)
    assert len(kept) < 150 < len(arrivals)
    last = kept[-1].t_ns
    state = reduce_all(State(), kept)
    whole = reduce_all(State(), [a for a in arrivals if a.t_ns <= last])
    assert (state.model, state.plant) == (whole.model, whole.plant)
    assert state.plant is not None
    assert state.plant.pictured_symbol >= 0
    assert k - 60 < state.plant.k <= k
    recent = range(max(0, state.plant.k - 150), state.plant.k)
    assert {s: state.truths[s] for s in recent} == {s: whole.truths[s] for s in recent}
    assert state.sent == whole.sent


def test_the_command_draws_and_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--docs", str(tmp_path)]) == 1
    assert "cannot be read" in capsys.readouterr().err
    write(tmp_path / RECORDING, thin(rehearsed(500), 400))
    assert main(["--docs", str(tmp_path)]) == 0
    first = (tmp_path / PICTURE).read_bytes()
    assert main(["--docs", str(tmp_path)]) == 0
    assert (tmp_path / PICTURE).read_bytes() == first


def test_the_recording_is_of_a_seeded_run_and_says_so() -> None:
    models = [a.message for a in read(DOCS / RECORDING) if isinstance(a.message, PlantModel)]
    assert models
    assert all(model.seeded for model in models)
