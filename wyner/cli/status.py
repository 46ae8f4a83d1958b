"""``wyner status``: what the services of a run last said of themselves, and what is wrong."""

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.statistics import COUNTED, PROVED
from protocol.text import printable
from runtime.errors import DONE, FAILED, Failure, UsageError
from wyner.cli.healthy import add_options, check_health

if TYPE_CHECKING:
    from protocol.messages import ControllerStatus, PlantStatus

OLD_S = 5.0
"""A status older than this is of a service that is frozen or gone: it writes one each second."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Print what the services of a run last said of themselves. Exit 0 when nothing is wrong, 1 "
        "when something is, with a line for each."
    )
    parser.add_argument(
        "run_dir", nargs="?", type=Path, metavar="RUN_DIR", help="default: the run that goes on"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read both statuses and print them; or check one service's health."""
    if args.service is not None or args.endpoint is not None:
        return check_health(args)
    run_dir = _run_dir(args.run_dir)
    plant, controller = _statuses(run_dir)
    claim, distance = _claim(run_dir)
    distance *= plant.key_blocks_begun
    now_ns = time.time_ns()
    warnings = [
        *_warnings_of_plant(plant),
        *(
            f"{name} last spoke {(now_ns - status.t_ns) / 1e9:.0f} s ago"
            for name, status in (("plant", plant), ("controller", controller))
            if status.phase != "stopped" and now_ns - status.t_ns > OLD_S * 1e9
        ),
    ]
    warnings += _warnings_of_taps(run_dir)
    if alarms := controller.alarm_sentence():
        warnings.append(alarms)
    if controller.unexplained:
        warnings.append(f"{controller.unexplained} transitions that no candidate explains")
    if controller.keys_stopped and not plant.keys_stopped:
        warnings.append(f"keys stopped at the controller: {controller.keys_stopped}")
    if args.json:
        told: dict[str, Any] = {
            "plant": plant.model_dump(),
            "controller": controller.model_dump(),
        }
        told |= {"claim": claim, "distance": distance}
        bare = {"rate_hz": COUNTED, "distance": PROVED, "alarm_gauge": COUNTED}
        print(json.dumps({**told, "no_interval": bare, "warnings": warnings}))
    else:
        lines = (
            *_lines(plant, controller, claim),
            *_lines_of_distance(plant, distance),
        )
        for line in (*lines, *(f"warning: {text}" for text in warnings)):
            print(printable(line))
    return FAILED if warnings else DONE


def _run_dir(given: Path | None) -> Path:
    """The folder given, or that of the one run that goes on."""
    from wyner.deployment.running import names_of, running_loops

    if given is not None:
        return given
    loops = running_loops()
    if len(loops) != 1:
        raise UsageError(f"RUN_DIR: runs that go on: {names_of(loops)}; expected one, or a folder")
    return Path(loops[0].run_dir)


def _statuses(run_dir: Path) -> "tuple[PlantStatus, ControllerStatus]":
    from pydantic import ValidationError

    from protocol.messages import ControllerStatus, PlantStatus
    from runtime.health import read_status
    from runtime.run_folder import CONTROLLER_STATUS, PLANT_STATUS

    files = (PLANT_STATUS, CONTROLLER_STATUS)
    there = [path for path in files if (run_dir / path).exists()]
    if len(there) == 1:
        (lacks,) = (path.parent for path in files if path not in there)
        raise Failure(
            f"{run_dir}: has the status of the {there[0].parent} alone, expected that of the "
            f"{lacks} beside it; `wyner status {run_dir} --healthy {there[0].parent}` looks at one"
        )
    try:
        plant = read_status(run_dir / PLANT_STATUS, PlantStatus)
        controller = read_status(run_dir / CONTROLLER_STATUS, ControllerStatus)
    except OSError as error:
        raise Failure(f"{error.filename}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        raise Failure(f"{run_dir}: {error.error_count()} fields of a status are wrong") from None
    return plant, controller


def _claim(run_dir: Path) -> tuple[str, float]:
    """Under which claim the run's keys are secret, and the distance from perfect keys that one
    block may have; empty and 0 where it makes none.
    """
    from protocol.scenario import ScenarioError
    from runtime.run_folder import SCENARIO
    from runtime.scenario_file import load_scenario

    path = run_dir / SCENARIO
    try:
        keys = load_scenario(path).keys if path.exists() else None
    except ScenarioError as error:
        raise Failure(error.problems[0]) from None
    return ("", 0.0) if keys is None else (keys.assumption().sentence(), keys.eps_sec)


def _lines_of_distance(plant: "PlantStatus", distance: float) -> list[str]:
    """What all blocks that were begun may cost."""
    if not plant.key_blocks_begun or plant.keys_refused:
        return []
    return [
        f"blocks      {plant.key_blocks_begun} begun, void and aborted ones too: together "
        f"{distance:.2g} from perfect keys at most",
    ]


def _lines(plant: "PlantStatus", controller: "ControllerStatus", claim: str) -> list[str]:
    late = max(plant.sampled_late_s, default=0.0)
    acted = max(plant.actuated_after_s, default=0.0)
    keys = plant.keys_refused or claim
    return [
        f"plant       {plant.phase}, step {plant.k}, {plant.missed} missed, {plant.messages} "
        f"messages, {plant.agreements} keys agreed",
        f"controller  {controller.phase}, {controller.transitions} transitions counted, "
        f"{controller.delivered} delivered, {controller.queue} queued",
        f"timing      sampled {1e3 * late:.1f} ms late, actuated {1e3 * acted:.1f} ms after the "
        f"measurement at most, {plant.overruns} overruns",
        f"keys        {plant.keys_made} made at the plant, {controller.keys_made} at the controller"
        + (f", blocks lost: {plant.key_blocks_lost}" if plant.key_blocks_lost else "")
        + (f"; {keys}" if keys else ""),
        *_lines_of_coin(controller),
        *_lines_of_appearances(plant, controller, claim),
    ]


def _lines_of_coin(controller: "ControllerStatus") -> list[str]:
    """How many steps a key watched, where the coin is keyed."""
    if not controller.watched + controller.unwatched:
        return []
    left = f"{controller.digits_left} digits left"
    return [f"keyed coin  {controller.watched} steps watched, {controller.unwatched} not, {left}"]


def _lines_of_appearances(
    plant: "PlantStatus", controller: "ControllerStatus", claim: str
) -> list[str]:
    """How often a message leaves each end, where keys rest on it."""
    if not claim:
        return []
    ends = (("plant", plant), ("controller", controller))
    times = (f"{one.appearances} at the {name}" for name, one in ends)
    return [f"appearances of a message: {', '.join(times)}"]


def _warnings_of_taps(run_dir: Path) -> list[str]:
    """Who of a tap in the same folder failed or was deaf, and what speaks against the claim."""
    from protocol.messages.adversary import deaf_share
    from wyner.runs.run import Run, RunError
    from wyner.runs.score.report import unused_in_words

    try:
        told = Run.load(run_dir).beliefs()
        found = [
            f"eavesdropper {name} failed: {one['failed']}"
            for name, one in told.items()
            if one.get("failed")
        ]
        found += [
            f"eavesdropper {name}: not used of what the tap heard: {unused_in_words(one['unused'])}"
            for name, one in told.items()
            if "unused" in one and deaf_share(one["unused"], one["steps"])
        ]
        keys = [one["keys"] for one in told.values() if one.get("keys")]
        found += [f"the tap holds {k['bits']} bits of keys" for k in keys if k["bits"]]
        found += [
            f"the tap misses {k['at_most']:.2g} of the {k['direction']} at most: "
            "the operator's claim is refuted"
            for k in keys
            if k["refuted"]
        ]
        return found + ["the tap's misses come in bursts" for k in keys if k["bursts"]]
    except (RunError, OSError, ValueError, LookupError, TypeError, AttributeError):
        return []  # no tap here


def _warnings_of_plant(plant: "PlantStatus") -> list[str]:
    found = [plant.detail] if plant.detail else []
    if plant.outside:
        found.append(f"d was outside D_c in {plant.outside} steps")
    if plant.symbol_errors:
        found.append(f"{plant.symbol_errors} agreed keys are not the selection bit")
    if plant.keys_stopped:
        found.append(f"keys stopped: {plant.keys_stopped}")
    if plant.keys_refused:
        found.append(f"keys: {plant.keys_refused}")
    return found
