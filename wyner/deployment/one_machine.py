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
from runtime.run_folder import (
    CONTROLLER_TRACE,
    KNOWLEDGE,
    MANIFEST,
    MESSAGE,
    PLANT_TRACE,
    SCENARIO,
)
from runtime.scenario_file import scenario_of
from runtime.shipped import scenario_file_of
from wyner.deployment.running import RunningLoop
from wyner.deployment.supervisor import Child, Supervisor


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What a run on this machine is asked to be: the options of ``wyner up``.

    Parameters
    ----------
    scenario : str
        A file or a shipped name.
    message, message_file, eavesdropper, attack, run_dir : str, optional
        As they are typed.
    pace : str
        ``realtime``, ``xN`` or ``fast``.
    steps, seed : int, optional
    until_delivered : bool
        End when the plant has the message.
    headless, json, story : bool
        Lines in place of a screen; one object at the end; pauses with captions.
    """

    scenario: str = "sustained"
    message: str | None = None
    message_file: str | None = None
    eavesdropper: str | None = None
    attack: str | None = None
    run_dir: str | None = None
    pace: str = "realtime"
    steps: int | None = None
    seed: int | None = None
    until_delivered: bool = False
    headless: bool = False
    json: bool = False
    story: bool = False


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


def option(name: str, value: object) -> str:
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
    write_atomically(scenario_file, text_of(options).encode())
    write_atomically(message_file, payload)
    knowledge = scenario.oracle_knowledge() if "oracle" in eavesdroppers else scenario.knowledge()
    write_atomically(knowledge_file, knowledge.model_dump_json(indent=2).encode())
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
    common = [option("run-dir", run_dir)]
    seed = [] if options.seed is None else [option("seed", options.seed)]
    steps = [] if options.steps is None else [option("steps", options.steps)]
    attacked = [] if options.attack is None else [option("attack", options.attack)]
    tap = [option("eavesdropper", ",".join(eavesdroppers))] if eavesdroppers else []
    knobs = scenario.tap.model_dump(exclude={"eavesdroppers"}, exclude_none=True)
    for name, value in knobs.items():
        tap.append(option(name.replace("_", "-"), value))
    scenario_folder = scenario_file_of(options.scenario).parent.resolve()
    children = [
        Child(
            "plant",
            [
                *common,
                *seed,
                *steps,
                *attacked,
                option("scenario", scenario_file),
                option("pace", options.pace),
                option("plant-folder", scenario_folder),
                option("listen", f"field={plant_field}"),
                option("connect", f"field={tap_field}"),
                *([option("connect", f"field={plant_side}")] if on_bus else []),
                option("listen", f"management={plant_management}"),
            ],
            run_dir / "plant" / "log",
            trace=run_dir / PLANT_TRACE,
        ),
        Child(
            "controller",
            [
                *common,
                *seed,
                option("scenario", scenario_file),
                option("pace", options.pace),
                option("message-file", message_file),
                option("model-folder", scenario_folder),
                option("listen", f"field={controller_field}"),
                option("connect", f"field={controller_side if on_bus else plant_field}"),
                option("connect", f"field={tap_field}"),
                option("listen", f"management={controller_management}"),
                option("connect", f"management={plant_management}"),
            ],
            run_dir / "controller" / "log",
            trace=run_dir / CONTROLLER_TRACE,
        ),
        Child(
            "tap",
            [
                *common,
                *tap,
                option("knowledge", knowledge_file),
                option("listen", f"adversary={adversary}"),
                option("listen", f"field={tap_field}"),
            ],
            run_dir / "tap" / "log",
        ),
    ]
    if on_bus:
        relay = [*seed, *attacked, option("scenario", scenario_file)]
        relay += [option("plant-side", plant_side), option("controller-side", controller_side)]
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
