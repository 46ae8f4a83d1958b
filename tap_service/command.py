"""``wyner tap``, and ``python -m tap_service``: the tap, told what it may know."""

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from runtime.bus_options import (
    ServiceOptions,
    add_endpoint_arguments,
    add_metrics_argument,
    check_addresses,
    endpoints_of,
    fleet_of,
    loop_of,
    noted,
)
from runtime.options import (
    add_bounds_arguments,
    add_check_argument,
    add_fleet_arguments,
    alone_in,
    at_least,
    checked,
    fine,
    picked,
    run_dir_of,
)

if TYPE_CHECKING:
    from protocol.knowledge import Knowledge
    from runtime.fleet import FleetLoop
    from tap_service.capture.channel import View


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the knobs of what the tap sees; each overrides the scenario's."""
    group = parser.add_argument_group("what the tap sees (default: as the scenario says)")
    group.add_argument("--view", choices=("both", "measurements", "offers"), help="direction")
    group.add_argument("--loss", type=float, metavar="P", help="probability to miss a message")
    group.add_argument(
        "--loss-bad", type=float, metavar="P", help="the same in the bad one of two states"
    )
    group.add_argument(
        "--to-bad", type=float, metavar="P", help="probability, a step, of turning bad"
    )
    group.add_argument(
        "--to-good", type=float, metavar="P", help="probability, a step, of turning good again"
    )
    group.add_argument("--noise", type=float, metavar="SD", help="noise on every state and input")
    group.add_argument("--quantise", type=float, metavar="STEP", help="round every state and input")
    group.add_argument("--delay", type=int, metavar="N", help="hear everything N messages late")
    group.add_argument(
        "--model-error", type=float, metavar="E", help="relative error of each entry of A and B"
    )
    group.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the knobs' draws (default 0)"
    )


@dataclass(frozen=True, kw_only=True)
class TapOptions(ServiceOptions):
    """The service's options, but for what the tap is told of the plant."""

    run_dir: str
    seed: int = 0
    eavesdropper: Sequence[str] = ()
    view: str | None = None
    loss: float | None = None
    loss_bad: float | None = None
    to_bad: float | None = None
    to_good: float | None = None
    noise: float | None = None
    quantise: float | None = None
    delay: int | None = None
    model_error: float | None = None
    part_seconds: float | None = None
    free_bytes: int | None = None
    finish: float | None = None


class GivenKnowledge(NamedTuple):
    """What the tap is started with besides its options.

    Parameters
    ----------
    knowledge : Knowledge
    oracle : Knowledge, optional
        What the oracle is told, who knows what the defender knows.
    view : mapping
        The view's defaults.
    names : tuple of str
        Eavesdroppers to run where no option names one.
    where : str
        Where those names stand, for a message about them.
    """

    knowledge: "Knowledge"
    oracle: "Knowledge | None"
    view: Mapping[str, Any] = MappingProxyType({})
    names: tuple[str, ...] = ()
    where: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.add_argument(
        "--knowledge", required=True, metavar="FILE", help="what the tap knows, as JSON"
    )
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add all options but the one that says what the tap knows."""
    parser.add_argument(
        "--eavesdropper",
        action="append",
        default=[],
        metavar="NAME[,NAME...]",
        help="which to run in place of the strongest, by name or as path/to/file.py:Name",
    )
    add_view_arguments(parser)
    parser.add_argument("--run-dir", required=True, metavar="D", help="write below D/tap")
    limits = parser.add_argument_group("bounds of the recording")
    add_bounds_arguments(limits)
    limits.add_argument("--part-seconds", type=float, metavar="S", help="age at which a part ends")
    limits.add_argument(
        "--free-bytes",
        type=int,
        metavar="N",
        help="room to leave on the disk; recording pauses while there is less",
    )
    parser.add_argument(
        "--finish",
        type=float,
        metavar="S",
        help="seconds for the heavy eavesdroppers' last thoughts at the end (default 20)",
    )
    add_check_argument(parser)
    add_fleet_arguments(parser)
    add_metrics_argument(parser)
    add_endpoint_arguments(parser, "tap")


def names_of(values: Iterable[str]) -> tuple[str, ...]:
    """The names in repeated and comma-separated options."""
    return tuple(n.strip() for value in values for n in value.split(",") if n.strip())


def find_each(names: Iterable[str], find: Callable[[str], object], where: str) -> None:
    """Find every eavesdropper, before anything starts.

    Raises
    ------
    UsageError
        With one line for each that ``find`` has not; ``where`` tells where the names stand.
    """
    from runtime.errors import UsageError
    from tap_service.eavesdroppers import KnowledgeError

    problems = []
    for name in names:
        try:
            find(name)
        except KnowledgeError as error:
            problems.append(f"{where}{error}")
    if problems:
        raise UsageError(problems)


def view_of(options: TapOptions, defaults: Mapping[str, object]) -> "View":
    """The view that the options ask for, over ``defaults``.

    Raises
    ------
    UsageError
        With one line for each wrong value.
    """
    from tap_service.capture.channel import View

    at_least("--seed", options.seed, 0)
    values = dict(defaults, seed=options.seed)
    given = {
        "view": options.view,
        "loss": options.loss,
        "loss_bad": options.loss_bad,
        "to_bad": options.to_bad,
        "to_good": options.to_good,
        "noise": options.noise,
        "quantise": options.quantise,
        "delay": options.delay,
        "model_error": options.model_error,
    }
    return checked(View, **values | {k: v for k, v in given.items() if v is not None})


def read_knowledge(path: str) -> "Knowledge":
    """Read what an eavesdropper knows from a JSON file.

    Raises
    ------
    UsageError
        With one line for each wrong field.
    """
    from pathlib import Path

    from pydantic import ValidationError

    from protocol.knowledge import Knowledge
    from protocol.wrong_fields import expected_of
    from runtime.errors import UsageError
    from runtime.files import read_regular

    try:
        text = read_regular(Path(path))
    except OSError as error:
        raise UsageError(f"--knowledge: {path}: cannot be read: {error.strerror}") from None
    try:
        return Knowledge.model_validate_json(text)
    except ValidationError as error:
        raise UsageError(
            [
                f"{path}: {'.'.join(map(str, e['loc'])) or 'file'}: {expected_of(e)}"
                for e in error.errors(include_url=False)
            ]
        ) from None


def run(args: argparse.Namespace) -> int:
    """Run the service until it is told to stop."""
    return run_with_knowledge(picked(TapOptions, vars(args)), knowledge_in(args.knowledge))


def knowledge_in(path: str) -> GivenKnowledge:
    """What a file of knowledge tells; the oracle is told where the file has alpha.

    Raises
    ------
    UsageError
        As :func:`read_knowledge`.
    """
    knowledge = read_knowledge(path)
    return GivenKnowledge(knowledge, knowledge if knowledge.alpha is not None else None)


def run_with_knowledge(
    options: TapOptions,
    told: GivenKnowledge | None,
    knowledge_of: "Callable[[FleetLoop], GivenKnowledge] | None" = None,
) -> int:
    """Run the service with what it was told, until it is told to stop.

    In a fleet ``knowledge_of`` says what each loop's tap is told; without it all are told alike.
    """
    from pathlib import Path

    from runtime.bus import TransportError
    from runtime.errors import UsageError
    from tap_service.capture.recording import Limits
    from tap_service.config import FINISH_S, TapConfig
    from tap_service.eavesdroppers import KnowledgeError, default_names
    from tap_service.fleet import run_taps
    from tap_service.sandboxed import sandboxed
    from tap_service.service import run_tap

    limits = checked(
        Limits,
        part_bytes=options.part_bytes,
        part_s=options.part_seconds,
        total_bytes=options.total_bytes,
        free_bytes=options.free_bytes,
    )
    if options.finish is not None and not 0 <= options.finish <= 3600:
        raise UsageError(f"--finish: got {options.finish}, expected 0 to 3600 seconds")
    check_addresses(options, "tap")
    field, adversary = (
        endpoints_of(options, "tap", "field"),
        endpoints_of(options, "tap", "adversary"),
    )
    fleet = fleet_of(options)
    with_metrics = partial(noted, options.metrics)

    def config_of(told: GivenKnowledge | None, loop: str, folder: Path) -> TapConfig:
        assert told is not None, "a fleet's taps are told by loop"
        names = names_of(options.eavesdropper)
        names, where = (names, "--eavesdropper: ") if names else (told.names, told.where)
        view = view_of(options, told.view)
        config = TapConfig(
            run_dir=folder,
            knowledge=told.knowledge.without_secrets(),
            field=field,
            adversary=adversary,
            oracle_knowledge=told.oracle,
            names=names or default_names(told.knowledge, clear=view.clear),
            view=view,
            loop=loop,
            limits=limits,
            finish_s=FINISH_S if options.finish is None else options.finish,
        )
        find_each(config.names, config.knowledge_of, where)
        return config

    def config_in_fleet(loop: "FleetLoop") -> TapConfig:
        told_here = told if knowledge_of is None else knowledge_of(loop)
        config = config_of(told_here, loop.id, Path(options.run_dir) / loop.id)
        for name in config.names:
            if sandboxed(name).heavy:
                raise UsageError(f"--eavesdropper: {name} is heavy; in a fleet expected light ones")
        return config

    try:
        if fleet is not None:
            for loop in fleet.loops.values():
                config_in_fleet(loop)
                if not options.check:
                    break
            if options.check:
                return fine(f"{len(fleet.loops)} loops")
            with alone_in(run_dir_of(options.run_dir) / "tap"):
                return run_taps(
                    fleet, config_in_fleet, field, adversary, partial(noted, options.metrics)
                )
        config = config_of(told, loop_of(options), Path(options.run_dir))
        if options.check:
            return fine(f"eavesdroppers {', '.join(config.names)}")
        with alone_in(run_dir_of(options.run_dir) / "tap"):
            return run_tap(config, with_metrics)
    except TransportError as error:
        raise UsageError(str(error)) from None
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None
