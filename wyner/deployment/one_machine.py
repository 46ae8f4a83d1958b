"""The three services of a run on this machine: its folder, and the processes with their options."""

import json
import sys
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

from protocol.link.events import AttackBegan
from protocol.scenario import Scenario
from protocol.topics import DEFAULT_LOOP
from runtime.addresses import free_endpoints
from runtime.files import read_regular, write_atomically
from runtime.options import MessageOptions, option
from runtime.run_folder import (
    CONTROLLER_TRACE,
    KNOWLEDGE,
    MANIFEST,
    MESSAGE,
    PLANT_TRACE,
    SCENARIO,
    VIEW,
)
from runtime.scenario_file import scenario_of
from runtime.shipped import scenario_file_of
from wyner.deployment.running import RunningLoop
from wyner.deployment.supervisor import Child, Supervisor


@dataclass(frozen=True, kw_only=True)
class RunOptions(MessageOptions):
    """What a run on this machine is asked to be: the options of ``wyner up``."""

    scenario: str = option("file or shipped name", "S", "sustained")
    pace: str = option("realtime, xN, or fast (lock-step)", "P", "realtime")
    steps: int | None = option("end at step N", "N", least=1)
    until_delivered: bool = option(
        "end when the plant has the message, and each that was sent during the run", default=False
    )
    eavesdropper: str | None = option(
        "eavesdroppers besides those of the scenario, by name or as path/to/file.py:Name",
        "NAME[,NAME...]",
    )
    story: bool = option("pause at what matters, with a caption each time", default=False)
    headless: bool = option("print lines instead of a screen", default=False)
    json: bool = option("print the summary as one JSON object", default=False)
    attack: str | None = option(
        "attack the plant from a step on, such as ghost@200, or path/to/file.py:Name@200",
        "KIND@STEP",
    )
    run_dir: str | None = option("default: a new folder below runs/", "D")
    seed: int | None = option(
        "seed of all random numbers, for experiments: nothing is secret then", "N", least=0
    )


KEYED_COIN: Final = """
[defence]                        # of --attack, where keys are made
coin = "keys"
"""


def text_of(options: RunOptions) -> str:
    """The text of the run's scenario: an attack is watched where keys are made for it.

    Raises
    ------
    UsageError
        As :func:`runtime.scenario_file.scenario_of`.
    """
    scenario = scenario_of(options.scenario)
    text = read_regular(scenario_file_of(options.scenario)).decode()
    makes_keys = scenario.keys is not None and scenario.keys.refusal() is None
    implied = options.attack is not None and makes_keys and options.seed is None
    stated = "defence" in scenario.model_fields_set
    return f"{text.rstrip()}\n{KEYED_COIN}" if implied and not stated else text


def said(name: str, value: object) -> str:
    """An option of a child in one word: a value may begin with a dash, as a folder's name may."""
    return f"--{name}={value}"


def lay_out(
    options: RunOptions,
    scenario: Scenario,
    eavesdroppers: tuple[str, ...],
    run_dir: Path,
    payload: bytes,
    attack: AttackBegan | None = None,
) -> tuple[Supervisor, RunningLoop]:
    """Write what a run's folder begins with, and name its processes; nothing is started yet.

    Parameters
    ----------
    options : RunOptions
    scenario : Scenario
    eavesdroppers : tuple of str
    run_dir : Path
    payload : bytes
        The message.
    attack : AttackBegan, optional
        What is written down of an attack.

    Raises
    ------
    OSError
        When the folder cannot be written.
    """
    scenario_file = run_dir / SCENARIO
    message_file = run_dir / MESSAGE
    knowledge_file = run_dir / KNOWLEDGE
    view_file = run_dir / VIEW
    write_atomically(scenario_file, text_of(options).encode())
    write_atomically(message_file, payload)
    knowledge = scenario.oracle_knowledge() if "oracle" in eavesdroppers else scenario.knowledge()
    write_atomically(knowledge_file, knowledge.model_dump_json(indent=2).encode())
    view = scenario.tap.model_dump_json(exclude={"eavesdroppers"}, exclude_none=True)
    write_atomically(view_file, view.encode())
    manifest = {
        "wyner": version("wyner"),
        "zenoh": version("eclipse-zenoh"),
        "numpy": version("numpy"),
        "python": sys.version.split()[0],
        **scenario.identity(),
        "seed": options.seed,
        "pace": options.pace,
        **({} if attack is None else {"attack": attack.attack}),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    write_atomically(run_dir / MANIFEST, json.dumps(manifest, indent=2).encode() + b"\n")
    ends = free_endpoints(8)
    plant_field, controller_field, tap_field, plant_management, controller_management, adversary = (
        ends[:6]
    )
    plant_side, controller_side = ends[6:]
    on_bus = attack is not None and attack.attack["at"] == "bus"
    common = [said("run-dir", run_dir)]
    seed = [] if options.seed is None else [said("seed", options.seed)]
    steps = [] if options.steps is None else [said("steps", options.steps)]
    attacked = [] if options.attack is None else [said("attack", options.attack)]
    tap = [said("eavesdropper", ",".join(eavesdroppers))] if eavesdroppers else []
    scenario_folder = scenario_file_of(options.scenario).parent.resolve()
    children = [
        Child(
            "plant",
            [
                *common,
                *seed,
                *steps,
                *attacked,
                said("scenario", scenario_file),
                said("pace", options.pace),
                said("folder", scenario_folder),
                said("listen", f"field={plant_field}"),
                said("connect", f"field={tap_field}"),
                *([said("connect", f"field={plant_side}")] if on_bus else []),
                said("listen", f"management={plant_management}"),
            ],
            run_dir / "plant" / "log",
            trace=run_dir / PLANT_TRACE,
        ),
        Child(
            "controller",
            [
                *common,
                *seed,
                said("scenario", scenario_file),
                said("pace", options.pace),
                said("message", f"@{message_file}"),
                said("folder", scenario_folder),
                said("listen", f"field={controller_field}"),
                said("connect", f"field={controller_side if on_bus else plant_field}"),
                said("connect", f"field={tap_field}"),
                said("listen", f"management={controller_management}"),
                said("connect", f"management={plant_management}"),
            ],
            run_dir / "controller" / "log",
            trace=run_dir / CONTROLLER_TRACE,
        ),
        Child(
            "tap",
            [
                *common,
                *tap,
                said("knowledge", knowledge_file),
                said("view", view_file),
                said("listen", f"adversary={adversary}"),
                said("listen", f"field={tap_field}"),
            ],
            run_dir / "tap" / "log",
        ),
    ]
    if on_bus:
        relay = [*seed, *attacked, said("scenario", scenario_file)]
        relay += [said("plant-side", plant_side), said("controller-side", controller_side)]
        log = run_dir / "attacker" / "log"
        children.append(Child("attacker", relay, log, package="attacker_service"))
    return (
        Supervisor(children, first="tap", first_endpoint=tap_field),
        RunningLoop(
            run_dir=str(run_dir.absolute()),
            scenario=scenario.name,
            loop=DEFAULT_LOOP,
            plant_management=plant_management,
            controller_management=controller_management,
            adversary=adversary,
        ),
    )
