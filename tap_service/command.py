"""``wyner tap``, and ``python -m tap_service``: the tap, told what it may know."""

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from runtime.bus_options import ServiceOptions, add_service_arguments, endpoints_of
from runtime.errors import UsageError
from runtime.fleet import FleetLoop, loops_of
from runtime.locks import alone_in
from runtime.options import fine, option, picked, run_dir_of

if TYPE_CHECKING:
    from protocol.knowledge import Knowledge


@dataclass(frozen=True, kw_only=True)
class TapOptions(ServiceOptions):
    """The service's options, but for what the tap is told of the plant."""

    scenario: str | None = option("derive what Eve knows from this scenario", "S", either="source")
    knowledge: str | None = option("what Eve knows, as JSON", "FILE", either="source")
    run_dir: str = option("write below D/tap", "D", ...)
    eavesdropper: Sequence[str] = option(
        "eavesdroppers to run, by name or as path/to/file.py:Name (default: the strongest)",
        "NAME[,NAME...]",
        (),
        many=True,
    )
    view: str | None = option(
        "what reaches the tap, as JSON with the fields of [tap] (default: the scenario's)",
        "FILE",
    )


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
    add_service_arguments(parser, "tap", TapOptions)


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
    from tap_service.eavesdroppers import KnowledgeError

    problems = []
    for name in names:
        try:
            find(name)
        except KnowledgeError as error:
            problems.append(f"{where}{error}")
    if problems:
        raise UsageError(problems)


M = TypeVar("M", bound=BaseModel)


def read_json(option: str, path: str, kind: type[M]) -> M:
    """Read the model that an option's JSON file holds.

    Raises
    ------
    UsageError
        With one line for each wrong field.
    """
    from pathlib import Path

    from protocol.wrong_fields import wrong_fields
    from runtime.files import read_regular

    try:
        text = read_regular(Path(path))
    except OSError as error:
        raise UsageError(f"{option}: {path}: cannot be read: {error.strerror}") from None
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise UsageError([f"{path}: {line}" for line in wrong_fields(error)]) from None


def run(args: argparse.Namespace) -> int:
    """Run the service until it is told to stop."""
    options = picked(TapOptions, vars(args))
    if options.knowledge is None:
        raise UsageError("--knowledge: got none, expected a file (wyner tap reads a scenario)")
    given = knowledge_in(options.knowledge)
    return run_with_knowledge(options, lambda _loop: given)


def knowledge_in(path: str) -> GivenKnowledge:
    """What a file of knowledge tells; the oracle is told where the file has alpha.

    Raises
    ------
    UsageError
        As :func:`read_json`.
    """
    from protocol.knowledge import Knowledge

    knowledge = read_json("--knowledge", path, Knowledge)
    return GivenKnowledge(knowledge, knowledge if knowledge.alpha is not None else None)


def run_with_knowledge(
    options: TapOptions, knowledge_of: Callable[[FleetLoop], GivenKnowledge]
) -> int:
    """Run the service until it is told to stop; ``knowledge_of`` says what each loop's tap is told.

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    from pathlib import Path

    from runtime.recording import Bounds
    from tap_service.capture.channel import View
    from tap_service.config import TapConfig, runs_beside
    from tap_service.eavesdroppers import KnowledgeError, default_names
    from tap_service.fleet import TapFleet, run_tap
    from tap_service.service import TapService

    own_view = None if options.view is None else read_json("--view", options.view, View)
    ends = endpoints_of(options, "tap")
    loops, many = loops_of(options), options.fleet is not None

    def config_of(loop: FleetLoop) -> TapConfig:
        told = knowledge_of(loop)
        names = names_of(options.eavesdropper)
        names, where = (names, "--eavesdropper: ") if names else (told.names, told.where)
        view = own_view or View.model_validate(told.view)
        if options.seed is not None:
            view = view.model_copy(update={"seed": options.seed})
        folder = Path(options.run_dir)
        config = TapConfig(
            run_dir=folder / loop.id if many else folder,
            knowledge=told.knowledge.without_secrets(),
            oracle_knowledge=told.oracle,
            names=names or default_names(told.knowledge),
            view=view,
            loop=loop.id,
            limits=Bounds(total_bytes=options.total_bytes),
        )
        find_each(config.names, config.knowledge_of, where)
        for name in config.names:
            if many and runs_beside(name):
                raise UsageError(
                    f"--eavesdropper: {name} needs a process of its own; in a fleet expected "
                    "set-membership, nearest-centre, oracle or key-solver"
                )
        return config

    try:
        for loop in loops:
            config = config_of(loop)
            if not options.check:
                break
        if options.check and many:
            return fine(f"{len(loops)} loops")
        if options.check:
            return fine(f"eavesdroppers {', '.join(config.names)}")
        make = partial(TapFleet, loops, config_of) if many else partial(TapService, config)
        with alone_in(run_dir_of(options.run_dir) / "tap"):
            return run_tap(make, ends, options.metrics)
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None
