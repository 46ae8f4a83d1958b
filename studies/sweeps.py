"""The shipped sweeps whose rows the figures are of: studies with a runner of their own."""

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from runtime.files import PUBLIC_FILE, replacing
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
        say: Callable[[str], None] = lambda _: None,  # noqa: ARG002
    ) -> None:
        """Make the file anew."""
        file = SWEEPS / f"{self.name}.toml"
        sweep = load_sweep(file)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, PUBLIC_FILE) as partial:
            partial.unlink()  # a sweep makes its file itself
            results = Results(partial, sweep.columns, resume=False)
            try:
                points = points_of(sweep, file.parent)
                failures = run_sweep(sweep, points, results, executor or SerialExecutor())
            finally:
                results.close()
            if failures:
                raise RuntimeError("; ".join(failures))


for name in (
    "fig7-paper-20", "fig7-paper", "fig7-sustained", "sustained-long", "disturbances", "price",
):  # fmt: skip
    add(SweepStudy(name, (), tuple, list, __name__))
