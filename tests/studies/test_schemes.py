"""The table of schemes takes a file of one's own; what is left of a corrected word is bounded."""

from pathlib import Path

import numpy as np
import pytest

from protocol.schemes.reconciled import Reconciled
from studies import schemes, stochastic, yardstick
from studies.__main__ import main
from wyner.api import design, run

OWN = "examples/own/pairs.py:Pairs"


@pytest.mark.long
def test_a_file_of_ones_own_appears_in_the_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(Path(OWN.partition(":")[0]).read_text(encoding="utf-8").splitlines()) < 120
    monkeypatch.setattr(schemes, "RUNS", 2)
    monkeypatch.setattr(schemes, "STEPS", 300)
    monkeypatch.setattr(schemes, "SETTLED", 100)
    assert main(["scheme", OWN, "--seed", "5"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("| a file of one's own, `pairs.py:Pairs` | `packed` |")
    assert "`nearest-centre`: 300 of 300 keys" in line
    assert main(["scheme", "examples/own/nothing.py:Pairs"]) == 2


def test_keys_of_the_key_stream_are_measured_through_the_cores(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(schemes, "RUNS", 1)
    monkeypatch.setattr(schemes, "STEPS", 320)
    monkeypatch.setattr(schemes, "SETTLED", 100)
    (case,) = (case for case in schemes.CASES if case.scheme == "sealed")
    found = schemes.by_cores(case)
    assert found.bits[0] > 0
    assert (found.result.key_bits, found.kept, found.wrong) == (0, 1.0, 0.0)


def test_bits_left_of_a_word() -> None:
    scheme = Reconciled(2)
    assert [stochastic.left(scheme, e) for e in range(7)] == [0.0] * 7
    more = [stochastic.left(scheme, e) for e in range(7, 64)]
    assert more == sorted(more)
    assert more[-1] == scheme.key_bits


def test_who_learns_has_the_controllers_word_and_who_is_wrong_has_not() -> None:
    runs = run(design("stochastic"), steps=600, runs=1, seed=9).record
    assert runs.x is not None
    assert runs.candidates is not None
    scenario = runs.scenario
    true = stochastic.NoisyModel(
        *map(np.array, (scenario.A, scenario.B, scenario.defender.deviations))
    )
    late = {
        name: stochastic.her_errors(runs, 0, true, hears)[400:].mean()
        for name, hears in stochastic.EVES.items()
    }
    assert late["the same model"] == 0
    assert late["told nothing, learns"] < 0.05
    assert late["a deviation 10 times too small"] > 0.2


def test_the_last_fit_that_is_too_far_off_counts() -> None:
    above = np.zeros((len(yardstick.FITS), 3), dtype=bool)
    above[:2, 1] = above[-1, 2] = True
    steps = yardstick.had_from(above).tolist()
    assert steps == [yardstick.FITS[0], yardstick.FITS[2], yardstick.STEPS + 1]
