"""A plant of the user's own in a process of its own (:mod:`runtime.sandbox`).

Whatever it does, it stops itself alone, within its time and memory: the plant service says why in a
line, and goes to the end that a failed plant has. One process serves the plants that are opened one
after the other, such as a sweep's, and is made anew when it had to be ended.
"""

import sys
from functools import partial
from pathlib import Path
from typing import Any, Final

from plant_service.adapters.base import PlantAdapter, PlantError, Sample, SimulatedPlant, floats
from protocol.vectors import Vector
from runtime.sandbox import START_S, SandboxError, acquire, give_back, serve
from runtime.user_code import UserCodeError

PLANT: Final = "plant"

ABILITIES: Final = ("resume", "displace", "safe")
"""Optional methods of a plant."""


class RemotePlant:
    """The plant's process, and what was said to it."""

    def __init__(self, table: Any, start: Vector, folder: Path) -> None:
        self._within_s = table.answer_s
        self.process = acquire(__name__, memory=table.memory_mib << 20)
        self._open = True
        self._unsaid: list[tuple[str, tuple[Any, ...]]] = []
        try:
            self._ask("path", sys.path, START_S)  # first: the table's class may be found there
            self.told = self._ask("open", (table, start, folder.resolve()), START_S)
        except PlantError:
            self.process.close()
            raise

    def start(self, seed: int | None) -> Any:
        """The first reading; a device may take its time to be found."""
        return self._ask("call", [("start", (seed,))], START_S)

    def call(self, method: str, *arguments: Any) -> Any:
        """What a method returns."""
        calls, self._unsaid = [*self._unsaid, (method, arguments)], []
        return self._ask("call", calls, self._within_s)

    def later(self, method: str, *arguments: Any) -> None:
        """Call a method with the next that is called: it has nothing to return."""
        self._unsaid.append((method, arguments))

    def close(self) -> None:
        """Let go of the plant, once; its process waits for another, or ends."""
        if not self._open:  # another's plant may be open there by now
            return
        self._open = False
        try:
            self._ask("close", None, self._within_s)
        except PlantError:
            self.process.close()
        give_back(self.process)

    def _ask(self, what: str, argument: Any, within_s: float) -> Any:
        try:
            return self.process.ask(what, argument, within_s)
        except SandboxError as error:
            raise PlantError(str(error)) from None


class _Device:
    """A device that is somewhere else."""

    def __init__(self, far: RemotePlant) -> None:
        self.far = far

    def start(self, seed: int | None) -> Sample:
        return _sample(self.far.start(seed))

    def apply(self, u: Vector) -> None:
        self.far.call("apply", u)

    def sample(self) -> Sample:
        return _sample(self.far.call("sample"))

    def safe(self) -> None:
        self.far.call("safe")

    def close(self) -> None:
        self.far.close()


class _Plant:
    """A stepped plant that is somewhere else."""

    def __init__(self, far: RemotePlant) -> None:
        self.far = far
        self.close = far.close
        self.actions: tuple[tuple[float, float], ...] | None = None

    def reset(self, seed: int | None) -> Vector:
        return tuple(self.far.start(seed)[0])

    def step(self, u: Vector, period_s: float) -> Vector:  # noqa: ARG002
        self.far.later("apply", u)
        return tuple(self.far.call("sample")[0])


def isolated(table: Any, start: Vector, folder: Path) -> PlantAdapter:
    """The adapter of a kind's ``table``, made and run in a process of its own.

    Raises
    ------
    PlantError
        When it cannot be made there.
    """
    far = RemotePlant(table, start, folder)
    if far.told["device"]:
        return _Device(far)
    plant = _Plant(far)
    given = {
        "resume": partial(far.later, "resume"),
        "displace": lambda d: tuple(far.call("displace", d)),
        "safe": partial(far.call, "safe"),
    }
    for name in far.told["abilities"]:
        setattr(plant, name, given[name])
    plant.actions = far.told["actions"]
    return SimulatedPlant(plant, table.period_s)


def _sample(told: Any) -> Sample:
    y, t_ns = told
    return Sample(tuple(y), t_ns)


# --- its side -------------------------------------------------------------------------------------


class PlantServer:
    """The plant that is open."""

    def __init__(self) -> None:
        self._adapter: PlantAdapter | None = None

    def answer(self, what: str, argument: Any) -> object:
        """What the plant's code says when it is asked."""
        if what == "path":
            sys.path[:] = argument
            return None
        if what == "open":
            table, start, folder = argument
            self._adapter = adapter = table.adapter(start, folder)
            core = adapter.plant if isinstance(adapter, SimulatedPlant) else adapter
            return {
                "device": not isinstance(adapter, SimulatedPlant),
                "abilities": [name for name in ABILITIES if hasattr(core, name)],
                "actions": getattr(core, "actions", None),
            }
        adapter = self._adapter
        assert adapter is not None
        if what == "close":
            self._adapter = None
            adapter.close()
            return None
        result: object = None
        for method, arguments in argument:
            result = _call(adapter, method, arguments)
        return result


def _call(adapter: PlantAdapter, method: str, arguments: tuple[Any, ...]) -> object:
    core: Any = adapter.plant if isinstance(adapter, SimulatedPlant) else adapter
    if method == "displace":
        return floats(core.displace(*arguments))
    found = getattr(core if method == "resume" else adapter, method)(*arguments)
    if method not in ("start", "sample"):
        return None
    y, t_ns = found
    return floats(y), int(t_ns)


if __name__ == "__main__":
    serve(PlantServer().answer, ((PlantError, PLANT), (UserCodeError, PLANT)))
