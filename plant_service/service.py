"""The plant service: its configuration, its endpoint, and the host that runs it."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from plant_service.from_journal import plant_endpoint
from plant_service.status import News
from protocol.runtime.bus import Bus
from protocol.runtime.host import Files, Host
from protocol.runtime.journal import JournalError, PlantJournal
from protocol.runtime.process import Pace, UsageError, logger, new_id, spoken
from protocol.runtime.run_folder import PLANT_JOURNAL, PLANT_KEYS, PLANT_STATUS, PLANT_TRACE
from protocol.runtime.trace import TraceWriter
from protocol.scenario import Scenario
from protocol.secret.opening import open_keeper
from protocol.streams import COIN, noise, symbols
from protocol.text import readable


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """What the plant service is started with.

    ``steps`` ends it when k reaches that number; ``seed`` is for experiments only;
    ``secret`` is a file that both ends share, by which key blocks are signed.
    """

    scenario: Scenario
    run_dir: Path
    loop: str
    pace: Pace
    steps: int | None = None
    seed: int | None = None
    secret: Path | None = None


class PlantService:
    """Runs the plant until it is told to stop, or has made its steps.

    Parameters
    ----------
    config : PlantConfig
    field, ops : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    clock : callable
        Monotonic seconds.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """

    def __init__(
        self,
        config: PlantConfig,
        field: Bus,
        ops: Bus,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        scenario, seeded = config.scenario, config.seed is not None
        log = logger("plant")
        try:
            journal = PlantJournal(config.run_dir / PLANT_JOURNAL, scenario.fingerprint())
            news = News(scenario, config.pace.text, seeded=seeded)
            keeper = open_keeper(
                config.run_dir / PLANT_KEYS, "plant", scenario, config.seed, config.secret
            )
            for payload in journal.inbox(1):
                news.last_message = readable(payload)
            self.endpoint = plant_endpoint(
                scenario,
                journal,
                symbols(config.seed, COIN),
                noise(config.seed, scenario.n),
                new_id,
                clock(),
                config.pace.step_s(scenario.plant.period_s),
                steps=config.steps,
                news=news,
            )
        except JournalError as error:
            raise UsageError(str(error)) from None
        self.trace = TraceWriter(config.run_dir / PLANT_TRACE, "plant", scenario.identity())
        self._host = Host(field, ops, stopping, clock)
        files = Files(journal, self.trace, config.run_dir / PLANT_STATUS, keeper)
        self._host.add(config.loop, self.endpoint, files, log)
        record = self.endpoint.plant.receiver.record
        if seeded:
            log.warning("seed %d: symbols are predictable, for experiments only", config.seed)
        log.info(
            "session %s, model %s, step %d, pace %s",
            record.session,
            spoken(scenario.fingerprint()),
            record.k,
            config.pace.text,
        )

    def run(self) -> int:
        """Step until stopped; returns the exit code."""
        return self._host.run()


def run_plant(config: PlantConfig, field: Bus, ops: Bus, stopping: threading.Event) -> int:
    """Run the plant service on open buses; returns the exit code."""
    return PlantService(config, field, ops, stopping).run()
