"""Python programs in processes of their own, in the checkout."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from tests.support.patience import PATIENCE_S

ROOT: Final = Path(__file__).resolve().parents[2]


def python(*words: str | Path, **more: Any) -> subprocess.CompletedProcess[Any]:
    """Run Python with these words and wait; what it says on both streams is kept, as text."""
    usual: dict[str, Any] = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "timeout": PATIENCE_S,
        "cwd": ROOT,
    }
    return subprocess.run([sys.executable, *words], check=False, **usual | more)


def wyner(*words: str | Path, **more: Any) -> subprocess.CompletedProcess[Any]:
    """Run the command and wait."""
    return python("-m", "wyner", *words, **more)


@contextmanager
def started(*words: str | Path, **more: Any) -> Iterator[Any]:
    """Python with these words, which goes on; its `Popen` is given, and it is killed in the end."""
    usual: dict[str, Any] = {"text": True, "cwd": ROOT}
    with subprocess.Popen([sys.executable, *words], **usual | more) as process:
        try:
            yield process
        finally:
            process.kill()
