"""The shipped sweeps whose rows the figures are of: studies with a runner of their own."""

from concurrent.futures import Executor
from pathlib import Path

from runtime.progress import shown
from studies.registry import Study, add
from wyner.sweeps import SWEEPS
from wyner.sweeps.code import loop_version
from wyner.sweeps.grid import load_sweep, points_of
from wyner.sweeps.results import Results
from wyner.sweeps.running import run_sweep
from wyner.sweeps.workers import SerialExecutor


class SweepStudy(Study):
    """A shipped sweep."""

    @property
    def version(self) -> str:
        """Of today's code."""
        return loop_version()

    def measure(
        self,
        path: Path,
        executor: Executor | None = None,
        only: str = "",  # noqa: ARG002
    ) -> None:
        """Make the file anew; what a measurement that was stopped has left is gone on with."""
        file = SWEEPS / f"{self.name}.toml"
        sweep = load_sweep(file)
        partial = path.with_suffix(".partial.csv")
        results = Results(partial, sweep.columns, resume=True)
        try:
            with shown(f"{self.name}, runs") as advance:
                points = points_of(sweep, file.parent)
                failures = run_sweep(sweep, points, results, executor or SerialExecutor(), advance)
        finally:
            results.close()
        if failures:
            raise RuntimeError("; ".join(failures))
        partial.replace(path)


for name in (
    "fig7-paper-20", "fig7-paper", "fig7-sustained", "sustained-long", "disturbances", "price",
):  # fmt: skip
    add(SweepStudy(name, (), tuple, list, __name__))
