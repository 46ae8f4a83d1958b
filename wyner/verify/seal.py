"""A run's seal: in its manifest, what every file held when the run was over.

Recordings carry marks of their own, which also a lone service writes. The seal covers the rest:
statuses, journals, beliefs, the summary, and the manifest itself. Nobody signs it: it tells what
was changed by chance or by hand, and not by somebody who makes it anew.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from protocol.files import write_atomically
from protocol.runtime.run_folder import CONTROLLER_KEYS, MANIFEST, PLANT_KEYS, SUMMARY

FILES: Final = "files"
ITSELF: Final = "manifest"
"""In the seal: a digest of each file, by name; and one of the manifest without it."""

GOES_ON: Final = (CONTROLLER_KEYS.name, PLANT_KEYS.name, MANIFEST.name)
"""What may change after a run: keys are taken out of their stores."""


def seal(run_dir: Path) -> None:
    """Write the seal into the manifest of a run that is over.

    Raises
    ------
    OSError
        When a file cannot be read, or the manifest not be written.
    """
    manifest = json.loads((run_dir / MANIFEST).read_bytes())
    manifest[FILES] = {str(f.relative_to(run_dir)): _digest(f) for f in _files(run_dir)}
    manifest[ITSELF] = _digest_of(manifest)
    write_atomically(run_dir / MANIFEST, json.dumps(manifest, indent=2).encode() + b"\n")


def broken(run_dir: Path, manifest: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    """Each file that the seal names: its name, and what is wrong with it (empty: nothing).

    A run that was killed as a whole has neither summary nor seal, and nothing is given.
    """
    manifest = manifest or {}
    files = manifest.get(FILES)
    if not isinstance(files, dict) or ITSELF not in manifest:
        if (run_dir / SUMMARY).exists() or FILES in manifest or ITSELF in manifest:
            yield MANIFEST.name, "the run was summed up, and its seal is gone"
        return
    same = manifest[ITSELF] == _digest_of(manifest)
    yield MANIFEST.name, "" if same else "it is not as the run left it"
    for name, digest in files.items():
        path = run_dir / name
        if not path.is_file():
            yield name, "it was there when the run was over"
        else:
            yield name, "" if _digest(path) == digest else "it is not as the run left it"


def _files(run_dir: Path) -> Iterator[Path]:
    for path in sorted(run_dir.rglob("*")):
        if path.is_file() and not path.is_symlink() and not path.name.startswith(GOES_ON):
            yield path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest_of(manifest: dict[str, Any]) -> str:
    without = {name: value for name, value in manifest.items() if name != ITSELF}
    return hashlib.sha256(json.dumps(without, sort_keys=True).encode()).hexdigest()
