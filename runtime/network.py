"""A scenario's network, ready to be passed: its channels, with the delays that files hold."""

from math import isfinite
from pathlib import Path
from typing import Final, Literal

from protocol.link.channel import Channel
from protocol.scenario import ChannelTable, Scenario
from runtime.errors import UsageError
from runtime.files import open_regular

Direction = Literal["to_plant", "to_controller"]

MOST_DELAYS: Final = 1_000_000
"""Lines of a file of measured delays at most."""

MOST_BYTES: Final = 64 * MOST_DELAYS
"""Of such a file."""

SHOWN: Final = 40
"""Characters of a wrong line that are told."""

MOST_PERIODS: Final = 40
"""Periods for which a message under way is waited for; a later one counts as never."""


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
        with open_regular(path) as file:
            raw = file.read(MOST_BYTES + 1)
        lines = raw.decode("utf-8-sig").split()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"network: {path}: cannot be read: {reason}") from None
    if len(raw) > MOST_BYTES or not 1 <= len(lines) <= MOST_DELAYS:
        count = f"more than {MOST_BYTES} bytes" if len(raw) > MOST_BYTES else f"{len(lines)} delays"
        raise UsageError(f"network: {path}: got {count}, expected 1 to {MOST_DELAYS} delays")
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            value = float(line)
        except ValueError:
            value = -1.0
        if value < 0 or not isfinite(value):
            got = line if len(line) <= SHOWN else f"{line[:SHOWN]}..."
            raise UsageError(
                f"network: {path}: delay {number}: got {got}, expected seconds, 0 or more"
            )
        found.append(value)
    return tuple(found)


def check_delays(scenario: Scenario, folder: Path) -> None:
    """Read the files of measured delays before anything is started.

    Raises
    ------
    UsageError
        As :func:`measured_delays`.
    """
    if scenario.network is not None:
        for way in (scenario.network.to_controller, scenario.network.to_plant):
            measured_delays(way, folder)


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
    """Seconds of the plant's clock within which a measurement is answered, but very rarely.

    At most `MOST_PERIODS` periods.
    """
    network = scenario.network
    if network is None:
        return 0.0
    ways = (network.to_plant, network.to_controller)
    longest = sum(way.longest_s(measured_delays(way, folder)) for way in ways)
    return min(longest, MOST_PERIODS * scenario.plant.period_s)
