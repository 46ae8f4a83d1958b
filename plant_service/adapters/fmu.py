"""A co-simulation FMU (FMI 2.0 or 3.0) as a plant; needs the extra ``wyner[fmu]``.

An FMU is native code that runs in the plant's process. It is therefore pinned by its SHA-256.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from plant_service.adapters.base import PlantError
from protocol.vectors import Vector
from runtime.errors import needs
from runtime.files import read_regular

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription


PREFIX: Final = "wyner-fmu-"
"""Of the name of a folder that holds an FMU's files, below the temporary one."""


class Fmu:
    """A :class:`~plant_service.adapters.base.Stepped` plant of an FMU.

    Parameters
    ----------
    path : Path
    sha256 : str
        Of the file, in hex; another file is refused before anything in it runs.
    inputs, outputs : sequence of str
        Names of the model's real variables, scalars; the outputs are the state.
    start : dict of str to float, optional
        Values of parameters and start values, set before the initialisation.
    seed : str, optional
        The parameter that takes the seed of a session, for a model with chance of its own.

    Raises
    ------
    PlantError
        When fmpy is missing, or the file, its kind or a name in it is not as expected.
    """

    def __init__(
        self,
        path: Path,
        sha256: str,
        inputs: Sequence[str],
        outputs: Sequence[str],
        start: dict[str, float] | None = None,
        seed: str | None = None,
    ) -> None:
        _check_hash(path, sha256)
        try:
            import fmpy
        except ModuleNotFoundError:
            raise PlantError(needs("fmu", "fmpy")) from None
        try:
            self._description: ModelDescription = fmpy.read_model_description(str(path))
        except Exception as error:
            raise PlantError(f"{path}: {' '.join(str(error).split())}") from error
        if self._description.coSimulation is None:
            raise PlantError(f"{path}: expected an FMU for co-simulation")
        references = {v.name: v for v in self._description.modelVariables}
        self._inputs = _references(path, references, inputs, "input")
        self._outputs = _references(path, references, outputs, None)
        self._start = start or {}
        self._start_references = _references(path, references, list(self._start), None)
        self._seed = _references(path, references, [] if seed is None else [seed], None)
        self.folder, self._held = _folder()
        try:
            fmpy.extract(str(path), str(self.folder))
        except Exception as error:
            self.close()
            raise PlantError(f"{path}: {' '.join(str(error).split())}") from error
        self._path = path
        self._instance: Any = None
        self._k = 0

    def reset(self, seed: int | None) -> Vector:
        """A new instance at time 0."""
        self._free()
        description, folder = self._description, str(self.folder)
        two = description.fmiVersion.startswith("2")
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        instance = (FMU2Slave if two else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="wyner",
        )
        instance.instantiate()
        self._instance = instance
        self._get = instance.getReal if two else instance.getFloat64
        self._set = instance.setReal if two else instance.setFloat64
        if self._start_references:
            self._set(self._start_references, list(self._start.values()))
        if self._seed:
            self._set(self._seed, [float(_fresh_seed() if seed is None else seed)])
        if two:
            instance.setupExperiment(startTime=0.0)
            instance.enterInitializationMode()
        else:
            instance.enterInitializationMode(startTime=0.0)
        instance.exitInitializationMode()
        self._k = 0
        return tuple(self._get(self._outputs))

    def step(self, u: Vector, period_s: float) -> Vector:
        """One communication step, which begins at k periods."""
        self._set(self._inputs, list(u))
        self._instance.doStep(
            currentCommunicationPoint=self._k * period_s, communicationStepSize=period_s
        )
        self._k += 1
        return tuple(self._get(self._outputs))

    def close(self) -> None:
        """Free the instance and the files that were extracted."""
        self._free()
        shutil.rmtree(self.folder, ignore_errors=True)
        if self._held is not None:
            os.close(self._held)
            self._held = None

    def _free(self) -> None:
        instance, self._instance = getattr(self, "_instance", None), None
        if instance is not None:
            instance.terminate()
            instance.freeInstance()


def _folder() -> tuple[Path, int | None]:
    """A new folder for an FMU's files, and the descriptor whose lock says that it is in use.

    The lock goes with the process, however that ends. So what an earlier one has left, killed, is
    known by it, and goes now. An empty folder is one that is only being made.
    """
    import fcntl

    for left in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # in use, or another user's
            its = os.open(left, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(its, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if any(left.iterdir()):
                    shutil.rmtree(left, ignore_errors=True)
            finally:
                os.close(its)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    fcntl.flock(held, fcntl.LOCK_EX)
    return folder, held


def _fresh_seed() -> int:
    """A seed that a float holds exactly."""
    return int.from_bytes(os.urandom(4))


def _check_hash(path: Path, sha256: str) -> None:
    try:
        digest = hashlib.sha256(read_regular(path)).hexdigest()
    except OSError as error:
        raise PlantError(f"{path}: cannot be read: {error.strerror}") from None
    if digest != sha256.lower():
        raise PlantError(f"{path}: its sha256 is {digest}, expected {sha256}")


def _references(
    path: Path, variables: dict[str, Any], names: Sequence[str], causality: str | None
) -> list[int]:
    """The value references of scalar real variables."""
    found = []
    for name in names:
        variable = variables.get(name)
        if variable is None:
            of = sorted(n for n, v in variables.items() if v.causality in ("input", "output"))
            shown = ", ".join(of[:12]) + (", ..." if len(of) > 12 else "")
            raise PlantError(f"{path}: has no variable {name!r}; inputs and outputs: {shown}")
        if variable.type not in ("Real", "Float64") or variable.dimensions:
            raise PlantError(f"{path}: {name!r} is {variable.type}, expected a real scalar")
        if causality is not None and variable.causality != causality:
            raise PlantError(
                f"{path}: {name!r} is a variable of causality {variable.causality}, "
                f"expected {causality}"
            )
        found.append(variable.valueReference)
    return found
