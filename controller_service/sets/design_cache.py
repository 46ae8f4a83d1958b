"""Designs on disk, one file each, named by the fingerprint of what they depend on.

A file holds one NumPy array of bytes and nothing that can run code. It carries a checksum and the
fingerprint; whatever does not fit is computed again, never trusted.
"""

import hashlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from controller_service.sets.design import Design, Terminal
from runtime.cache_folder import cache_folder
from runtime.files import PUBLIC_FILE, write_atomically

MAGIC = b"wyner-design-6\n"


def design_path(fingerprint: str, folder: Path | None = None) -> Path:
    """The file that holds, or would hold, the design."""
    return (folder or cache_folder("designs")) / f"{fingerprint}.design"


def _pack(design: Design, fingerprint: str) -> bytes:
    meta = {
        "fingerprint": fingerprint,
        "terminal": vars(design.terminal),
        "gain_given": design.gain_given,
        "margins": design.margins,
        "seconds": design.seconds,
        "stopped": design.stopped,
        "offsets": None if design.offsets is None else design.offsets.tolist(),
        "n": design.A.shape[0],
        "m": design.B.shape[1],
        "rows": [[len(h) for _, h in family] for family in (design.T, design.targets)],
    }
    header = json.dumps(meta).encode()
    out = io.BytesIO()
    out.write(len(header).to_bytes(8, "little") + header)
    arrays = [design.A, design.B, design.K]
    arrays += [a for family in (design.T, design.targets) for pair in family for a in pair]
    for a in arrays:
        out.write(np.ascontiguousarray(a, dtype="<f8").tobytes())
    return out.getvalue()


def _unpack(body: bytes, fingerprint: str) -> Design:
    size = int.from_bytes(body[:8], "little")
    meta: dict[str, Any] = json.loads(body[8 : 8 + size])
    if meta["fingerprint"] != fingerprint:
        raise ValueError("another scenario's design")
    n, m = meta["n"], meta["m"]
    # A fresh array: aligned, and writable as a computed design's arrays are.
    numbers = np.frombuffer(body[8 + size :], dtype="<f8").astype(float)
    position = 0

    def take(*shape: int) -> Any:
        nonlocal position
        count = math.prod(shape)
        piece = numbers[position : position + count].reshape(shape)
        position += count
        return piece

    A, B, K = take(n, n), take(n, m), take(m, n)
    T, targets = (tuple((take(r, n), take(r)) for r in rows) for rows in meta["rows"])
    if position != len(numbers):
        raise ValueError("wrong length")
    return Design(
        A=A,
        B=B,
        K=K,
        T=T,
        targets=targets,
        terminal=Terminal(**meta["terminal"]),
        gain_given=meta["gain_given"],
        margins=tuple(meta["margins"]),
        seconds=meta["seconds"],
        cached=True,
        stopped=meta["stopped"],
        offsets=None if meta["offsets"] is None else np.array(meta["offsets"], dtype=float),
    )


def load(fingerprint: str, folder: Path | None = None) -> Design | None:
    """Read a design; None when there is none or the file is damaged or foreign."""
    try:
        data = design_path(fingerprint, folder).read_bytes()
    except OSError:
        return None
    start = len(MAGIC) + 32
    magic, digest, body = data[: len(MAGIC)], data[len(MAGIC) : start], data[start:]
    if magic != MAGIC or hashlib.sha256(body).digest() != digest:
        return None
    try:
        return _unpack(body, fingerprint)
    except (ValueError, KeyError, TypeError):
        return None


def store(design: Design, fingerprint: str, folder: Path | None = None) -> bool:
    """Write a design, for a reader whole or not at all; False when it cannot be written."""
    path = design_path(fingerprint, folder)
    body = _pack(design, fingerprint)
    try:
        write_atomically(path, MAGIC + hashlib.sha256(body).digest() + body, PUBLIC_FILE)
    except OSError:
        return False
    return True
