"""Where designs are cached."""

from pathlib import Path

import pytest

from runtime.files import cache_folder


def test_who_has_no_home_is_given_a_folder_that_cannot_be_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(OSError, match="Not a directory"):
        cache_folder("designs").mkdir(parents=True)
