"""A run's seal: in its manifest, what every file of evidence held when the run was over.

Recordings carry marks of their own, which also a lone service writes. The seal covers the rest:
statuses, logs, journals, beliefs, the summary, and the manifest itself. Nobody
signs it: it tells what was changed by chance or by hand, and
not by somebody who makes it anew.

A file that matches none of the patterns is no evidence: a page, a table or a copy that somebody put
there, a lock, what is on its way to its name.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from runtime.files import open_regular, read_regular, write_atomically
from runtime.run_folder import MANIFEST, SUMMARY

READ: Final = (
    "manifest.json",
    "scenario.toml",
    "plant/trace*.jsonl",
    "controller/trace*.jsonl",
    "plant/journal.sqlite3*",
    "controller/journal.sqlite3*",
    "tap/capture*.jsonl",
    "tap/guesses*.jsonl",
    "tap/analysis*.jsonl",
    "tap/status.json",
)
"""Files that rules read, so that a change of one fails the check of a run without a seal, too."""

SEAL_ALONE: Final = (
    "summary.json",
    "controller/message",
    "tap/beliefs.json",
    "tap/knowledge.json",
    "tap/view.json",
    *(f"{side}/status.json" for side in ("controller", "plant")),
    *(f"{side}/log" for side in ("controller", "plant", "tap")),
)
"""Files that the seal alone holds to what they were."""

FILES: Final = "files"
ITSELF: Final = "manifest"
"""In the seal: what each file held, by its name; and a digest of the manifest without it."""

COMING: Final = Path(".summary.json")
"""The summary before its seal is written. Where a run is killed between the two, it is no lack."""

CHANGED: Final = "it is not as the run left it"

Held = dict[str, Any]


def seal(run_dir: Path, summary: bytes | None = None) -> None:
    """Write the summary of a run that is over, and the seal into its manifest.

    Wherever this is killed, the folder is one that was sealed, or one that never was.

    Parameters
    ----------
    run_dir : Path
    summary : bytes, optional
        What the summary will hold; the one that is there if not given.

    Raises
    ------
    OSError
        When a file cannot be read, or the manifest not be written.
    """
    manifest = json.loads(read_regular(run_dir / MANIFEST))
    manifest[FILES] = _all_held(run_dir)
    if summary is not None:
        write_atomically(run_dir / COMING, summary)
        manifest[FILES][str(SUMMARY)] = _held(run_dir / COMING)
    manifest[ITSELF] = _digest_of(manifest)
    write_atomically(run_dir / MANIFEST, json.dumps(manifest, indent=2).encode() + b"\n")
    if summary is not None:
        (run_dir / COMING).replace(run_dir / SUMMARY)


def is_sealed(manifest: dict[str, Any] | None) -> bool:
    """Whether a manifest has a seal."""
    return isinstance((manifest or {}).get(FILES), dict) and ITSELF in (manifest or {})


def broken(run_dir: Path, manifest: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    """Each file that is not as the seal says: its name, and what is wrong with it.

    A run that was killed as a whole has neither summary nor seal, and nothing is given. Of a
    service that was started again since, so that a recording of its went on, only what it appends
    to can be held to the seal. The recording's marks say whether another life begins there.
    """
    manifest = manifest or {}
    if not is_sealed(manifest):
        if (run_dir / SUMMARY).exists() or FILES in manifest or ITSELF in manifest:
            yield MANIFEST.name, "the run was summed up, and its seal is gone"
        return
    if manifest[ITSELF] != _digest_of(manifest):
        yield MANIFEST.name, CHANGED
    files = {name: held for name, held in manifest[FILES].items() if isinstance(held, dict)}
    went_on = {Path(name).parent for name, held in files.items() if _longer(run_dir / name, held)}
    for name, held in files.items():
        path = run_dir / name
        if name == str(SUMMARY) and not path.exists():
            path = run_dir / COMING
        if Path(name).parent in went_on:
            appended = path.suffix == ".jsonl" and path.is_file()
            if appended and _digest(path, held.get("bytes")) != held.get("sha256"):
                yield name, CHANGED
        elif not path.is_file():
            yield name, "it was there when the run was over"
        elif _held(path) != held:
            yield name, CHANGED


def _longer(path: Path, held: Held) -> bool:
    """Whether a recording went on after it was sealed."""
    size = held.get("bytes")
    recorded = path.suffix == ".jsonl" and path.is_file()
    return recorded and isinstance(size, int) and path.stat().st_size > size


def evidence_below(run_dir: Path) -> list[Path]:
    """The files of a run's folder that carry evidence, by name; links are left out.

    Others may come and go meanwhile.
    """
    found = {path for pattern in (*READ, *SEAL_ALONE) for path in run_dir.glob(pattern)}
    return sorted(path for path in found if path.is_file() and not path.is_symlink())


def _all_held(run_dir: Path) -> dict[str, Held]:
    names = (str(path.relative_to(run_dir)) for path in evidence_below(run_dir))
    return {name: _held(run_dir / name) for name in names if name != MANIFEST.name}


def _held(path: Path) -> Held:
    size = path.stat().st_size
    return {"bytes": size, "sha256": _digest(path, size)}


def _digest(path: Path, size: object) -> str:
    """SHA-256 of a file's first ``size`` bytes."""
    digest = hashlib.sha256()
    left = size if isinstance(size, int) else 0
    with open_regular(path) as file:
        while left > 0 and (chunk := file.read(min(left, 1 << 20))):
            digest.update(chunk)
            left -= len(chunk)
    return digest.hexdigest()


def _digest_of(manifest: dict[str, Any]) -> str:
    without = {name: value for name, value in manifest.items() if name != ITSELF}
    return hashlib.sha256(json.dumps(without, sort_keys=True).encode()).hexdigest()
