"""Designs on disk, one file each, named by the fingerprint of what they depend on.

A file is NumPy's archive of plain arrays, with nothing that can run code. Its members have
checksums, and it holds the fingerprint; whatever does not fit is computed again, never trusted.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller_service.sets.design import Design, Terminal
from protocol.arrays import Array
from runtime.files import PUBLIC_FILE, cache_folder, write_atomically

VERSION: Final = 7
"""Of what is computed and how it is kept; a file of another is computed again."""

FAMILIES: Final = ("T", "targets")


def design_path(fingerprint: str, folder: Path | None = None) -> Path:
    """The file that holds, or would hold, the design."""
    return (folder or cache_folder("designs")) / f"{fingerprint}.npz"


def load(fingerprint: str, folder: Path | None = None) -> Design | None:
    """Read a design; None when there is none or the file is damaged or foreign."""
    try:
        with (
            design_path(fingerprint, folder).open("rb") as file,
            np.load(file, allow_pickle=False) as archive,
        ):
            arrays = {name: archive[name] for name in archive.files}
        meta = json.loads(str(arrays["meta"]))
        if (meta.pop("version"), meta.pop("fingerprint")) != (VERSION, fingerprint):
            return None
        T, targets = (_family(arrays, name) for name in FAMILIES)
        return Design(
            **meta | {"terminal": Terminal(**meta["terminal"]), "margins": tuple(meta["margins"])},
            A=arrays["A"],
            B=arrays["B"],
            K=arrays["K"],
            T=T,
            targets=targets,
            offsets=arrays.get("offsets"),
            cached=True,
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None


def _family(arrays: dict[str, Array], name: str) -> tuple[tuple[Array, Array], ...]:
    """The sets of a family, whose rows are kept one under the other."""
    ends = np.cumsum(arrays[f"{name}_rows"])[:-1].astype(int)
    rows, bounds = (np.split(arrays[f"{name}_{part}"], ends) for part in "Hh")
    return tuple(zip(rows, bounds, strict=True))


def store(design: Design, fingerprint: str, folder: Path | None = None) -> bool:
    """Write a design, for a reader whole or not at all; False when it cannot be written."""
    meta = {
        "version": VERSION,
        "fingerprint": fingerprint,
        "terminal": vars(design.terminal),
        "gain_given": design.gain_given,
        "margins": design.margins,
        "seconds": design.seconds,
        "stopped": design.stopped,
    }
    arrays: dict[str, Any] = {"meta": json.dumps(meta), "A": design.A, "B": design.B, "K": design.K}
    for name, family in zip(FAMILIES, (design.T, design.targets), strict=True):
        arrays[f"{name}_rows"] = [len(h) for _, h in family]
        arrays[f"{name}_H"] = np.concatenate([H for H, _ in family])
        arrays[f"{name}_h"] = np.concatenate([h for _, h in family])
    if design.offsets is not None:
        arrays["offsets"] = design.offsets
    body = io.BytesIO()
    np.savez(body, **arrays)
    try:
        write_atomically(design_path(fingerprint, folder), body.getvalue(), PUBLIC_FILE)
    except OSError:
        return False
    return True
