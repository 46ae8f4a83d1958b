"""A scheme of one's own, defined here, through everything that asks for one.

Nothing is edited anywhere else: what is shipped does not know that it exists.
"""

import tomllib
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from protocol.agreement import NO_SYMBOL
from protocol.plugins import UnknownError
from protocol.scenario import Scenario, ScenarioError, parse_scenario
from protocol.schemes.base import COVER, Carry, Scheme
from protocol.schemes.registry import SCHEMES, make_scheme, scheme_named
from protocol.schemes.table import advance_many
from tests.support.recorded_pair import RecordedPair
from tests.support.safety import violations
from tests.support.scenarios import text_of
from wyner.cli.main import main
from wyner.simulate.engine import follow, simulate_runs, transfer
from wyner.simulate.network import Simulation


class Hoard(NamedTuple):
    s: int
    first: int
    second: int


class Hoarding(Scheme[Hoard]):
    """Gathers two keys (s = 1, 2), then spends them one after the other (s = 3, 4)."""

    name: ClassVar[str] = "hoarding"
    version: ClassVar[int] = 3
    initial = Hoard(1, NO_SYMBOL, NO_SYMBOL)

    def advance(self, state: Hoard, verdict: int) -> tuple[Hoard, Carry]:
        s, first, second = state
        if s >= 3:
            after = Hoard(4, second, NO_SYMBOL) if s == 3 else self.initial
            return after, Carry(NO_SYMBOL, first)
        if verdict == NO_SYMBOL:
            return state, COVER
        after = Hoard(2, verdict, NO_SYMBOL) if s == 1 else Hoard(3, first, verdict)
        return after, Carry(verdict, NO_SYMBOL)

    def pad(self, state: Hoard) -> int:
        return state.first if state.s >= 3 else NO_SYMBOL

    def tests(self, state: Hoard) -> bool:
        return state.s < 3


class Summed(Hoarding):
    """Makes one pad of two keys."""

    name: ClassVar[str] = "summed"

    def advance(self, state: Hoard, verdict: int) -> tuple[Hoard, Carry]:
        s, first, _ = state
        if s == 3:
            return self.initial, Carry(NO_SYMBOL, first)
        if verdict == NO_SYMBOL:
            return state, COVER
        both = (first + verdict) % self.alphabet
        after = Hoard(2, verdict, NO_SYMBOL) if s == 1 else Hoard(3, both, NO_SYMBOL)
        return after, Carry(verdict, NO_SYMBOL)


@pytest.fixture(autouse=True)
def shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SCHEMES, Hoarding.name, f"{__name__}:Hoarding")


def under(scenario: Scenario, scheme: str) -> Scenario:
    return scenario.model_copy(
        update={"secrecy": scenario.secrecy.model_copy(update={"scheme": scheme})}
    )


def changed(scheme: str) -> tuple[tuple[str, str], ...]:
    """Of the shipped scenario's text."""
    return (("[secrecy]\n", f'[secrecy]\nscheme = "{scheme}"\n'),)


# --- the scheme -----------------------------------------------------------------------------------


def test_a_scenario_names_it_and_its_version_is_in_the_fingerprint(
    sustained: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = under(sustained, "hoarding")
    assert own.fingerprint() != sustained.fingerprint()
    assert own.design_fingerprint() == sustained.design_fingerprint()
    assert own.knowledge().scheme == "hoarding"
    before = own.fingerprint()
    monkeypatch.setattr(Hoarding, "version", 4)
    assert own.fingerprint() != before
    assert isinstance(make_scheme(f"{__file__}:Hoarding", 2), Scheme)


def test_two_ends_whose_files_differ_do_not_share_a_fingerprint(
    sustained: Scenario, tmp_path: Path
) -> None:
    """The same name and version, and another arrow: verdicts would differ unseen."""
    prints = {}
    for end, role in (("mine", "agreed"), ("theirs", "agreed"), ("changed", "refused")):
        (tmp_path / end).mkdir()
        file = tmp_path / end / "own.py"
        text = "from protocol.schemes.switched import Switched\n"
        file.write_text(f"{text}class Own(Switched):\n    name = 'own'  # {role}\n")
        own = under(sustained, f"{file}:Own")
        prints[end] = own.fingerprint()
        file.write_text("")  # what was loaded is what counts
        assert own.fingerprint() == prints[end]
    assert prints["mine"] == prints["theirs"] != prints["changed"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("hording", "expected switched"),
        ("no/such/file.py:Name", f"no/such/file.py: no such file in {Path.cwd()}"),
        (f"{__file__}:Nobody", "expected a class Nobody that extends protocol.schemes.base.Scheme"),
        (f"{__file__}:Hoard", "expected a class Hoard that extends protocol.schemes.base.Scheme"),
    ],
)
def test_a_name_that_is_none_is_one_line(name: str, expected: str) -> None:
    text = text_of("sustained", *changed(name))
    with pytest.raises(ScenarioError) as error:
        parse_scenario(tomllib.loads(text), "own.toml")
    (line,) = error.value.problems
    assert line.startswith("own.toml: secrecy.scheme: got ")
    assert expected in line


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("advance = Scheme.advance", "expected the methods that it lacks: advance"),
        ("def advance(self, state, verdict): return state", "expected a state and a Carry"),
        ("def advance(self, state, verdict): return state.t, 0", "advance: AttributeError: 'S'"),
        ("def pad(self, state): return 2", "pad: got 2 in S(s=1), expected -1 to 1"),
        ("def pad(self, state): return 1", "expected pad 1, as pad() says"),
        ("def pad(self, state): return 1 / 0", "pad: ZeroDivisionError"),
        ("def tests(self, state): return None", "tests: got None in S(s=1), expected True or"),
        (
            "def advance(self, state, verdict): return S(verdict), COVER\n"
            "    def tests(self, state): return False",
            "tests: got False in S(s=1), expected True, since a verdict makes a difference",
        ),
        (
            "def advance(self, state, verdict): return state, COVER._replace(agreed=1)",
            "expected agreed to be the verdict, or -1",
        ),
        (
            "def advance(self, state, verdict): return S(0.5), COVER",
            "advance: got (S(s=0.5), Carry(agreed=-1, pad=-1)) in S(s=1) at -1, expected a st",
        ),
        (
            "def advance(self, state, verdict): return S(2 + verdict), COVER\n"
            "    def pad(self, state): return 7 if state.s == 3 else -1",
            "pad: got 7 in S(s=3)",
        ),
        (
            "def advance(self, state, verdict): return S(state.s + 1), COVER\n"
            "    def pad(self, state): return 7 if state.s == 60 else -1",
            "pad: got 7 in S(s=60)",
        ),
        ("version = '1'", "expected a class attribute version, a whole number, got '1'"),
        ("initial = {'s': 1}", "expected a class attribute initial, a NamedTuple of whole"),
    ],
)
def test_a_scheme_that_nobody_could_follow_is_one_line(
    tmp_path: Path, changed: str, expected: str
) -> None:
    path = tmp_path / "odd.py"
    path.write_text(
        "from typing import NamedTuple\n\nfrom protocol.schemes.base import COVER, Scheme\n\n\n"
        "class S(NamedTuple):\n    s: int\n\n\n"
        "class Odd(Scheme):\n    name, version, initial = 'odd', 1, S(1)\n"
        "    def advance(self, state, verdict): return state, COVER\n"
        "    def pad(self, state): return -1\n"
        "    def tests(self, state): return True\n"
        f"    {changed}\n"
    )
    with pytest.raises(UnknownError) as told:
        scheme_named(f"{path}:Odd")
    assert expected in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("size", [2, 3, 20])
def test_many_runs_are_so_many_single_ones(size: int) -> None:
    scheme = Hoarding(size)
    verdicts = np.random.default_rng(1).integers(-1, size, (60, 3, 2)).astype(np.int8)
    many = advance_many(scheme, verdicts)
    for at in np.ndindex(3, 2):
        state = scheme.initial
        for j, verdict in enumerate(verdicts[:, *at].tolist()):
            assert many.tested[j][at] == scheme.tests(state)
            state, carry = scheme.advance(state, verdict)
            assert (many.agreed[j][at], many.pad[j][at]) == carry


# --- simulated ------------------------------------------------------------------------------------


def test_engine_and_simulation_make_the_same_transitions(
    sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    scenario = under(sustained, "hoarding")
    runs = simulate_runs(scenario, sustained_law, seed=4, runs=range(1), steps=700)
    t = transfer(runs, payloads=[b"ours"])
    history = Simulation(scenario, sustained_law, seed=4, payloads=(b"ours",)).run(steps=700)
    assert list(violations(history, (b"ours",))) == []
    for (_, j), counted in history.plant.items():
        expected = (t.agreed[j, 0], t.pad[j, 0], t.cipher[j, 0], t.message_symbol[j, 0], t.p[j, 0])
        got = counted.symbol, counted.key, counted.cipher, counted.message_symbol, counted.p
        assert got == expected
    assert history.inbox == [b"ours"]
    link = follow(runs, [scenario.secrecy.alpha])
    assert link.message_symbols[0, 0] == (t.pad[:, 0] != NO_SYMBOL).sum() > 90
    assert link.tested[0, 0] < 700
    assert link.mistaken[0, 0] == 0


def test_a_pad_that_is_made_of_several_keys_passes_the_check(tmp_path: Path) -> None:
    """`once` wanted every pad to be one of the keys."""
    run = RecordedPair(tmp_path, b"sum", changes=changed(f"{__file__}:Summed"))
    run.until_received(1)
    run.stop()
    assert main(["check", str(tmp_path)]) == 0
