"""A scenario's network, ready to be passed: its channels, with the delays that files hold."""

from math import isfinite
from pathlib import Path
from typing import Final, Literal

from protocol.link.channel import Channel
from protocol.scenario import ChannelTable, Scenario
from runtime.errors import UsageError

Direction = Literal["to_plant", "to_controller"]

MOST_DELAYS: Final = 1_000_000
"""Lines of a file of measured delays at most."""


def measured_delays(table: ChannelTable, folder: Path) -> tuple[float, ...]:
    """The delays of a direction's file, in seconds; none where it has no file.

    Raises
    ------
    UsageError
        When the file cannot be read, or a line is no delay.
    """
    if table.file is None:
        return ()
    path = folder / table.file
    try:
        lines = path.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"network: {path}: cannot be read: {reason}") from None
    if not 1 <= len(lines) <= MOST_DELAYS:
        raise UsageError(f"network: {path}: got {len(lines)} delays, expected 1 to {MOST_DELAYS}")
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            value = float(line)
        except ValueError:
            value = -1.0
        if value < 0 or not isfinite(value):
            raise UsageError(f"network: {path}: delay {number}: got {line}, expected seconds")
        found.append(value)
    return tuple(found)


def channel_of(
    scenario: Scenario,
    to: Direction,
    folder: Path,
    *,
    scale: float = 1.0,
    seed: int | None = None,
    run: int = 0,
) -> Channel | None:
    """The channel of one direction; None where the scenario has no network.

    Parameters
    ----------
    scenario : Scenario
    to : {"to_plant", "to_controller"}
    folder : Path
        Where the file of measured delays is looked for.
    scale : float
        Seconds of the end's clock in a second of the plant's.
    seed, run : int
        Of the experiment, beside the network's own seed.

    Raises
    ------
    UsageError
        As :func:`measured_delays`.
    """
    network = scenario.network
    if network is None:
        return None
    table = network.to_plant if to == "to_plant" else network.to_controller
    draws = f"network {network.seed} {0 if seed is None else seed} {run} {to}"
    return Channel(table, draws, measured_delays(table, folder), scale)


def round_trip_s(scenario: Scenario, folder: Path) -> float:
    """Seconds of the plant's clock within which a measurement is answered, but very rarely."""
    network = scenario.network
    if network is None:
        return 0.0
    ways = (network.to_plant, network.to_controller)
    return sum(way.longest_s(measured_delays(way, folder)) for way in ways)
