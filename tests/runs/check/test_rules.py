"""No rule is one that never fails: of each there is a change that it alone names.

That of ``paper`` is a program that is wrong at both ends alike: tests/runs/check/test_paper.py.
"""

import base64
import json
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from protocol.link.session import rules_of
from runtime.run_folder import (
    CAPTURE,
    CONTROLLER_TRACE,
    MANIFEST,
    PLANT_TRACE,
    SCENARIO,
    TAP_STATUS,
)
from runtime.scenario_file import load_scenario
from tests.support.checked_runs import failed
from tests.support.lines import unmarked
from tests.support.recorded_pair import Lines, RecordedPair, edit, read_lines
from wyner.runs.check import RULES


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that has made keys, and used some."""
    loop = RecordedPair(tmp_path_factory.mktemp("runs") / "keyed", name="watched")
    loop.run(lambda: loop.controller.state.keys.stream.left > 100 and loop.transitions > 80)
    loop.stop()
    return unmarked(loop.folder)


def made(lines: Lines) -> Lines:
    return [line for line in lines if line["event"] == "transition"]


def on_the_bus(lines: Lines, topic: str) -> Lines:
    return [line["message"] for line in lines if line.get("topic") == topic]


def traces(folder: Path) -> None:
    edit(folder / PLANT_TRACE, lambda lines: lines.append({"event": "unheard of"}))


def whole(folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_bytes())
    (folder / MANIFEST).write_text(json.dumps(manifest | {"fingerprint": "0" * 16}))


def replay(folder: Path) -> None:
    def change(lines: Lines) -> None:
        next(t for t in made(lines) if t["j"] == 40)["gauges"][0] *= 1 + 1e-15

    for name in (PLANT_TRACE, CONTROLLER_TRACE):
        edit(folder / name, change)


def plant(folder: Path) -> None:
    edit(folder / PLANT_TRACE, lambda lines: made(lines)[40].update(u=[0.123]))


def admissible(folder: Path) -> None:
    """A candidate beyond U that was not applied, with the verdict and gauges that follow."""
    rules = rules_of(load_scenario(folder / SCENARIO))
    coins = {(t["session"], t["j"]): t["coin"] for t in made(read_lines(folder / PLANT_TRACE))}
    (folder / CAPTURE).unlink()
    (folder / TAP_STATUS).unlink()

    def change(lines: Lines) -> None:
        t = next(
            t for t in made(lines) if t["j"] >= 40 and t["symbol"] == -1 and t["role"] == "test"
        )
        t["candidates"][1 - coins[t["session"], t["j"]]] = [7.0]
        candidates = tuple(map(tuple, t["candidates"]))
        verdict = rules.judge(tuple(t["x"]), candidates, (), tuple(t["x_next"]))
        assert verdict.symbol == -1
        t["gauges"] = list(verdict.gauges)

    for name in (PLANT_TRACE, CONTROLLER_TRACE):
        edit(folder / name, change)


def messages(folder: Path) -> None:
    invented = base64.b64encode(b"ho").decode()

    def change(lines: Lines) -> None:
        next(line for line in lines if line["event"] == "recovered")["payload"] = invented

    edit(folder / PLANT_TRACE, change)


def alarms(folder: Path) -> None:
    def change(lines: Lines) -> None:
        t = made(lines)[40]
        alarm = {name: t[name] for name in ("session", "j", "k")} | {"reading": t["x_next"]}
        alarm |= {"event": "alarm", "reason": "unexplained", "candidate": 0}
        alarm |= {"expected": t["x_next"], "gauge": t["gauges"][0]}
        lines.insert(lines.index(t) + 1, alarm)

    edit(folder / CONTROLLER_TRACE, change)


def bus(folder: Path) -> None:
    shouted = {"event": "malformed", "t_ns": 1, "key": "wyner/v2/loop/offer", "base64": "aGk="}
    edit(folder / CAPTURE, lambda lines: lines.insert(50, shouted))


def wire(folder: Path) -> None:
    edit(folder / CAPTURE, lambda lines: on_the_bus(lines, "measurement")[40]["x"].reverse())


def in_step(folder: Path) -> None:
    def change(lines: Lines) -> None:
        made(lines)[-1]["k"] += 1

    edit(folder / CONTROLLER_TRACE, change)


def once(folder: Path) -> None:
    def change(lines: Lines) -> None:
        first, second = on_the_bus(lines, "offer")[40:42]
        second["nonce"] = first["nonce"]

    edit(folder / CAPTURE, change)


def same_keys(folder: Path) -> None:
    def change(lines: Lines) -> None:
        shown = [m for m in on_the_bus(lines, "offer") if m["block"] >= 0]
        next(b for a, b in pairwise(shown) if a["block"] == b["block"])["tag"] = "0" * 32

    edit(folder / CAPTURE, change)


def blocks(folder: Path) -> None:
    def change(lines: Lines) -> None:
        block = [line for line in lines if line.get("what") == "confirmed"][-1]
        block["keys"] += 1

    edit(folder / CONTROLLER_TRACE, change)


OF_PLAIN = (
    traces, whole, replay, plant, admissible, messages, alarms, bus, wire, in_step,
)  # fmt: skip
OF_KEYED = (once, same_keys, blocks)


def name_of(change: Callable[[Path], None]) -> str:
    return change.__name__.replace("_", "-")


def test_every_rule_has_one() -> None:
    assert {*map(name_of, (*OF_PLAIN, *OF_KEYED)), "paper"} == {rule.name for rule in RULES}


@pytest.mark.parametrize("change", (*OF_PLAIN, *OF_KEYED), ids=name_of)
def test_a_change_that_one_rule_alone_names(
    request: pytest.FixtureRequest, tmp_path: Path, change: Callable[[Path], None]
) -> None:
    run: Path = request.getfixturevalue("keyed" if change in OF_KEYED else "killed")
    folder = Path(shutil.copytree(run, tmp_path / "run"))
    assert failed(folder) == set()
    change(folder)
    assert failed(folder) == {name_of(change)}
