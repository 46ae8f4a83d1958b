"""``wyner design``: a scenario's sets, gains and settled rate; the list of shipped scenarios."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.errors import DONE, FAILED, Failure, UsageError, writing
from wyner.cli.drawing import add_plot, drawable, plot
from wyner.cli.results import add_json, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wyner.advice.design import DesignReport


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Compute the sets T_0..T_N of SCENARIO (or read them from the cache), check "
        "them, and estimate the rate at which the link settles by seeded simulations of the loop. "
        "Without SCENARIO, list the shipped ones. With --knowledge, write as JSON what the paper's "
        "eavesdropper knows of SCENARIO: f_c and D_e, and neither D_c nor alpha. A tap on a "
        "machine of its own needs this file and no scenario (wyner tap --knowledge FILE)."
    )
    parser.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="a TOML file or a shipped name"
    )
    parser.add_argument(
        "--knowledge",
        nargs="?",
        const="",
        metavar="FILE",
        help="write what Eve knows of SCENARIO, as JSON (default: standard output)",
    )
    add_json(parser)
    add_plot(parser, "SCENARIO.png here")


def run(args: argparse.Namespace) -> int:
    """Show the design, or what else was asked for."""
    if args.scenario is None:
        from wyner.advice.scenarios import shipped_scenarios

        show(shipped_scenarios(), args)
        return DONE
    if args.knowledge is not None:
        return _write_knowledge(args.scenario, args.knowledge)
    if args.plot is not None:
        drawable(args.plot or "sets.png")
    from controller_service.laws.errors import ProgramError
    from controller_service.sets.design import SynthesisError
    from runtime.scenario_file import scenario_of
    from runtime.shipped import scenario_file_of
    from wyner.advice.design import design_report

    folder = scenario_file_of(args.scenario).parent
    try:
        report = design_report(scenario_of(args.scenario), folder)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{args.scenario}: {error}") from None
    show(report, args)
    if args.plot is not None:
        figure = args.plot or f"{report.scenario.name}.png"
        plot(figure, (9.0, 4.2), lambda f: _draw(f, report), silent=args.json)
    return FAILED if report.carries_nothing else DONE


def _write_knowledge(scenario: str, file: str) -> int:
    """Write as JSON what Eve is told of a scenario; to standard output where ``file`` is empty."""
    from runtime.files import PUBLIC_FILE, write_atomically
    from runtime.scenario_file import scenario_of

    text = scenario_of(scenario).knowledge().model_dump_json(indent=2) + "\n"
    if not file:
        print(text, end="")
        return DONE
    with writing(f"--knowledge: {file}"):
        write_atomically(Path(file), text.encode(), PUBLIC_FILE)
    return DONE


def _draw(figure: "Figure", report: "DesignReport") -> str:
    from wyner.drawing.design import draw_design
    from wyner.simulate.engine import SimulationError

    try:
        return draw_design(figure, report.scenario, report.law.design, report.law)
    except SimulationError as error:
        raise Failure(f"--plot: {error}") from None
