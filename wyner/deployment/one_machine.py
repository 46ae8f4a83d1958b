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
from runtime.services import SERVICES, Service
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
    json: bool = option("print the summary as one JSON object", default=False)
    attack: str | None = option(
        "attack the plant from a step on, such as ghost@200, or path/to/file.py:Name@200",
        "KIND@STEP",
    )
    run_dir: str | None = option("default: a new folder below runs/", "D")
    seed: int | None = option(
        "seed of all random numbers, for experiments: nothing is secret then", "N", least=0
    )


ATTACKER: Final = Service("attacker", package="attacker_service")
"""Who stands between the ends where an attack is on the bus; no service that anybody starts."""

KEYED_COIN: Final = """
[defence]                        # of --attack, where keys are made
coin = "keys"
"""


def text_of(options: RunOptions) -> str:
    """The text of the run's scenario: an attack is watched where keys are made for it.

    Raises
    ------
    UsageError, ScenarioError
        As :func:`runtime.scenario_file.scenario_of`.
    """
    scenario = scenario_of(options.scenario)
    text = read_regular(scenario_file_of(options.scenario)).decode()
    makes_keys = scenario.keys is not None and scenario.keys.refusal() is None
    implied = options.attack is not None and makes_keys and options.seed is None
    stated = "defence" in scenario.model_fields_set
    return f"{text.rstrip()}\n{KEYED_COIN}" if implied and not stated else text


def said(**values: object) -> list[str]:
    """Options of a child, each in one word, as a value may begin with a dash; None is left out."""
    return [f"--{name.replace('_', '-')}={v}" for name, v in values.items() if v is not None]


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
    knowledge = scenario.oracle_knowledge() if "oracle" in eavesdroppers else scenario.knowledge()
    view = scenario.tap.model_dump_json(exclude={"eavesdroppers"}, exclude_none=True)
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
    write_atomically(run_dir / SCENARIO, text_of(options).encode())
    write_atomically(run_dir / MESSAGE, payload)
    write_atomically(run_dir / KNOWLEDGE, knowledge.model_dump_json(indent=2).encode())
    write_atomically(run_dir / VIEW, view.encode())
    write_atomically(run_dir / MANIFEST, json.dumps(manifest, indent=2).encode() + b"\n")
    on_bus = attack is not None and attack.attack["at"] == "bus"
    return _processes(options, scenario.name, eavesdroppers, run_dir, on_bus=on_bus)


def _processes(
    options: RunOptions, name: str, eavesdroppers: tuple[str, ...], run_dir: Path, *, on_bus: bool
) -> tuple[Supervisor, RunningLoop]:
    """The services, each with its options, and how others join them.

    Where an attack is on the bus, its process stands between the two ends.
    """
    plant_field, controller_field, tap_field, plant_management, *ends = free_endpoints(8)
    controller_management, adversary, plant_side, controller_side = ends
    seeded = said(seed=options.seed)
    system = said(scenario=run_dir / SCENARIO)
    folder = scenario_file_of(options.scenario).parent.resolve()
    both = [*said(run_dir=run_dir, pace=options.pace, folder=folder), *seeded, *system]
    plant = [
        *both,
        *said(steps=options.steps, attack=options.attack),
        f"--listen=field={plant_field}",
        f"--connect=field={tap_field}",
        f"--listen=management={plant_management}",
    ]
    controller = [
        *both,
        *said(message=f"@{run_dir / MESSAGE}"),
        f"--listen=field={controller_field}",
        f"--connect=field={controller_side if on_bus else plant_field}",
        f"--connect=field={tap_field}",
        f"--listen=management={controller_management}",
        f"--connect=management={plant_management}",
    ]
    tap = [
        *said(run_dir=run_dir, eavesdropper=",".join(eavesdroppers) or None),
        *said(knowledge=run_dir / KNOWLEDGE, view=run_dir / VIEW),
        f"--listen=adversary={adversary}",
        f"--listen=field={tap_field}",
    ]
    logs = {name: run_dir / name / "log" for name in ("plant", "controller", "tap", "attacker")}
    children = [
        Child(SERVICES["plant"], plant, logs["plant"], run_dir / PLANT_TRACE),
        Child(SERVICES["controller"], controller, logs["controller"], run_dir / CONTROLLER_TRACE),
        Child(SERVICES["tap"], tap, logs["tap"]),
    ]
    if on_bus:
        plant.append(f"--connect=field={plant_side}")
        relay = [*seeded, *system, *said(attack=options.attack)]
        relay += said(plant_side=plant_side, controller_side=controller_side)
        children.append(Child(ATTACKER, relay, logs["attacker"]))
    return (
        Supervisor(children, tap_field),
        RunningLoop(
            run_dir=str(run_dir.absolute()),
            scenario=name,
            plant_management=plant_management,
            controller_management=controller_management,
            adversary=adversary,
        ),
    )
