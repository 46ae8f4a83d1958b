"""Scenarios as a command line names them, and the copy that a run keeps."""

import tomllib
from pathlib import Path

from protocol.scenario.attack import AttackTable, attack_of
from protocol.scenario.reading import ScenarioError, parse_scenario
from protocol.scenario.system import Scenario
from runtime.errors import UsageError, writing
from runtime.files import read_regular, read_toml, write_atomically
from runtime.run_folder import SCENARIO
from runtime.shipped import SCENARIOS, scenario_file_of


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Raises
    ------
    ScenarioError
        When the file cannot be read, is not TOML, or has a wrong field.
    """
    try:
        tables = read_toml(Path(path))
    except UsageError as error:
        raise ScenarioError(error.problems) from None
    return parse_scenario(tables, str(path))


def scenario_of(text: str) -> Scenario:
    """The scenario of a file, or of a name that stands for a shipped one.

    Raises
    ------
    UsageError
        When there is no such file.
    ScenarioError
        As :func:`load_scenario`.
    """
    path = scenario_file_of(text)
    if not path.exists():
        raise UsageError(f"{text}: no such file{others_than(text)}")
    return load_scenario(path)


def scenario_in(text: str, source: str) -> Scenario:
    """The scenario that a text states; ``source`` is what it is called in a line.

    Raises
    ------
    ScenarioError
        When it has a wrong field.
    """
    return parse_scenario(tomllib.loads(text), source)


def attack_option(
    text: str | None, stated: AttackTable | None, steps: int | None
) -> AttackTable | None:
    """The attack that ``--attack`` names, else the scenario's own.

    Raises
    ------
    UsageError
        When it is none, or begins after the last step.
    """
    attack = stated
    if text is not None:
        try:
            attack = attack_of(text, stated)
        except ValueError as error:
            raise UsageError(f"--attack: {error}") from None
    if attack is not None and steps is not None and attack.onset >= steps:
        where = "attack.onset" if text is None else "--attack"
        raise UsageError(f"{where}: got onset {attack.onset}, expected one below --steps {steps}")
    return attack


def others_than(text: str, shipped: Path = SCENARIOS, what: str = "scenario") -> str:
    """What there is instead: beside a path with a folder the files there, else what is shipped.

    A file that lacks no more than its suffix is named alone.
    """
    path = Path(text)
    if (meant := path.with_name(f"{path.name}.toml")).is_file():
        return f"; did you mean {meant}?"
    beside = path.parent != Path()
    names = ", ".join(sorted(p.stem for p in (path.parent if beside else shipped).glob("*.toml")))
    if not names:
        return ""
    if beside:
        return f"; {path.parent} has {names}"
    return f", and no shipped {what}; shipped are {names}"


def keep_scenario(run_dir: Path, text: str) -> None:
    """Put the scenario's file into a run's folder that has none yet: ``wyner check`` reads it.

    Raises
    ------
    UsageError
        When the folder cannot be written to, or has a scenario under which the loop runs otherwise.
    Failure
        When the disk is full or broken.
    """
    kept = run_dir / SCENARIO
    with writing(f"--run-dir: {kept}"):
        if not kept.exists():
            write_atomically(kept, read_regular(scenario_file_of(text)))
    there = scenario_of(str(kept))
    if there.loop_fingerprint() != scenario_of(text).loop_fingerprint():
        raise UsageError(
            f"--run-dir: {run_dir}: holds a run of another scenario ({there.name}), "
            f"expected a new folder, or --scenario {kept}"
        )
