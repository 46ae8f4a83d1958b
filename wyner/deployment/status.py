"""What the services of a run last said of themselves, and what is wrong with it."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import ValidationError
from pydantic_core import from_json

from protocol.messages import ControllerStatus, PlantStatus, Status
from protocol.messages.adversary import deaf_share
from protocol.scenario import ScenarioError
from protocol.statistics import COUNTED, PROVED
from runtime.errors import UsageError
from runtime.files import read_regular
from runtime.run_folder import CONTROLLER_STATUS, PLANT_STATUS, SCENARIO, loops_below
from runtime.scenario_file import load_scenario
from runtime.services import SERVICES
from wyner.printout import Printout
from wyner.runs.run import Run, RunError
from wyner.runs.score.words import unused_in_words

OLD_S: Final = 5.0
"""A report older than this is of a service that is frozen or gone: it writes one each second (the
tap each two)."""


S = TypeVar("S", bound=Status)


@dataclass(frozen=True, eq=False)
class StatusReport(Printout):
    """What the services of a run, or of each loop of a fleet, last said of themselves.

    Parameters
    ----------
    warnings : list of str
        Its last lines.
    """

    warnings: list[str]


def status_of(run_dir: Path) -> StatusReport:
    """Read the statuses below a run's folder, or below that of a fleet.

    Raises
    ------
    UsageError
        When there is none, or one cannot be read.
    """
    loops = {folder.name: _of_run(folder) for folder in loops_below(run_dir)}
    if not loops:
        return _of_run(run_dir)
    warnings = [f"{name}: {text}" for name, one in loops.items() for text in one.warnings]
    well = sum(not one.warnings for one in loops.values())
    lines = [f"{well} of {len(loops)} loops without a warning", *map(_warned, warnings)]
    return StatusReport({"loops": {n: one.figures for n, one in loops.items()}}, lines, warnings)


def _of_run(run_dir: Path) -> StatusReport:
    paths = {name: run_dir / name / "status.json" for name, row in SERVICES.items() if row.reports}
    written = {name: _written(path) for name, path in paths.items() if path.exists()}
    if not written:
        expected = f"expected a run's folder, with {PLANT_STATUS} or {CONTROLLER_STATUS}"
        raise UsageError(f"{run_dir}: no service has reported there; {expected}")
    plant = _end(run_dir / PLANT_STATUS, written.get("plant"), PlantStatus)
    controller = _end(run_dir / CONTROLLER_STATUS, written.get("controller"), ControllerStatus)
    claim, of_one = _claim(run_dir)
    distance = 0.0 if plant is None else of_one * plant.keys.begun
    lines: list[str] = []
    warnings: list[str] = []
    if not all(end is None or end.phase == "stopped" for end in (plant, controller)):
        warnings += _silences(written)
    if plant is not None:
        lines += _of_plant(plant, claim, distance)
        warnings += _warnings_of_plant(plant)
    if controller is not None:
        lines += _of_controller(controller)
        warnings += _warnings_of_controller(controller, plant)
    others = [name for name in written if name not in ("plant", "controller")]
    lines += [f"{name:<12}{written[name].get('health', 'reports')}" for name in others]
    warnings += _warnings_of_taps(run_dir)
    figures = {
        **written,
        "claim": claim,
        "distance": distance,
        "no_interval": {"rate_hz": COUNTED, "distance": PROVED, "gauge": COUNTED},
        "warnings": warnings,
    }
    return StatusReport(figures, [*lines, *map(_warned, warnings)], warnings)


def _warned(text: str) -> str:
    return f"warning: {text}"


def _end(path: Path, told: dict[str, Any] | None, kind: type[S]) -> S | None:
    """An end's status; None where it has written none."""
    if told is None:
        return None
    try:
        return kind.model_validate({name: v for name, v in told.items() if name != "health"})
    except ValidationError as error:
        wrong = f"{error.error_count()} fields of a status are wrong"
        raise UsageError(f"{path}: {wrong}") from None


def _written(path: Path) -> dict[str, Any]:
    """What a service has written of itself."""
    try:
        found: dict[str, Any] = from_json(read_regular(path))
        found["t_ns"] / 1e9
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path}: expected a status, with t_ns") from None
    return found


def _silences(written: dict[str, dict[str, Any]]) -> Iterator[str]:
    """The services that do not report any more, and those that say that they are not well."""
    for name, found in written.items():
        age_s = time.time() - found["t_ns"] / 1e9
        health = str(found.get("health", ""))
        if found.get("phase") == "stopped":
            continue
        if age_s > OLD_S:
            yield f"{name} last reported {age_s:.0f} s ago"
        elif health.startswith("bad"):
            yield f"{name}: {health.removeprefix('bad: ')}"


def _claim(run_dir: Path) -> tuple[str, float]:
    """The claim of the run's keys, and the distance from perfect keys of one block."""
    path = run_dir / SCENARIO
    try:
        keys = load_scenario(path).keys if path.exists() else None
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    return ("", 0.0) if keys is None else (keys.assumption().sentence(), keys.eps_sec)


def _of_plant(plant: PlantStatus, claim: str, distance: float) -> Iterator[str]:
    step, keys = plant.step, plant.keys
    lost = f", blocks lost: {keys.lost}" if keys.lost else ""
    why = keys.refused or claim
    yield (
        f"plant       {plant.phase}, step {step.k}, {step.missed} missed, {plant.frame.messages} "
        f"messages, {step.agreements} keys agreed"
    )
    yield f"keys        {keys.made} distilled{lost}{f'; {why}' if why else ''}"
    if keys.begun and not keys.refused:
        yield (
            f"blocks      {keys.begun} begun, void and aborted ones too: together "
            f"{distance:.2g} from perfect keys at most"
        )


def _of_controller(controller: ControllerStatus) -> Iterator[str]:
    frame, keys, alarms = controller.frame, controller.keys, controller.alarms
    yield (
        f"controller  {controller.phase}, {controller.step.transitions} transitions counted, "
        f"{frame.delivered} delivered, {frame.queue} queued, {keys.made} keys distilled"
    )
    if alarms.watched + alarms.unwatched:
        yield (
            f"keyed coin  {alarms.watched} steps watched, {alarms.unwatched} not, "
            f"{keys.digits_left} digits left"
        )


def _warnings_of_plant(plant: PlantStatus) -> list[str]:
    step, keys = plant.step, plant.keys
    found = {
        plant.detail: plant.detail,
        f"d was outside D_c in {step.outside} steps": step.outside,
        f"{step.symbol_errors} agreed keys are not the input that was applied": step.symbol_errors,
        f"keys stopped: {keys.stopped}": keys.stopped,
        f"keys: {keys.refused}": keys.refused,
    }
    return [text for text, is_so in found.items() if is_so]


def _warnings_of_controller(controller: ControllerStatus, plant: PlantStatus | None) -> list[str]:
    unexplained, stopped = controller.step.unexplained, controller.keys.stopped
    alarms = controller.alarms.sentence()
    alone = stopped and (plant is None or not plant.keys.stopped)
    found = {
        alarms: alarms,
        f"{unexplained} transitions that no candidate explains": unexplained,
        f"keys stopped at the controller: {stopped}": alone,
    }
    return [text for text, is_so in found.items() if is_so]


def _warnings_of_taps(run_dir: Path) -> list[str]:
    """What is wrong with the eavesdroppers; nothing where there is no tap."""
    try:
        told = Run.load(run_dir).beliefs()
        return [text for name, one in told.items() for text in _warnings_of_tap(name, one)]
    except (RunError, OSError, ValueError, LookupError, TypeError, AttributeError):
        return []


def _warnings_of_tap(name: str, told: dict[str, Any]) -> Iterator[str]:
    """Whether it failed or could not use what it heard, and what of the claim it refutes."""
    if told.get("failed"):
        yield f"eavesdropper {name} failed: {told['failed']}"
    if "unused" in told and deaf_share(told["unused"], told["steps"]):
        unused = unused_in_words(told["unused"])
        yield f"eavesdropper {name}: not used of what the tap heard: {unused}"
    if keys := told.get("keys"):
        share = f"{keys['at_most']:.2g} of the {keys['direction']}"
        found = {
            f"the tap holds {keys['bits']} bits of keys": keys["bits"],
            f"the tap misses {share} at most: the operator's claim is refuted": keys["refuted"],
            "the tap's misses come in bursts": keys["bursts"],
        }
        yield from (text for text, is_so in found.items() if is_so)
