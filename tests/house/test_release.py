"""A release has one version and one date, wherever they are written."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def found(file: str, pattern: str) -> str:
    match = re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert match is not None, file
    return match[1]


def test_every_file_that_names_the_version_names_the_same() -> None:
    assert found("CITATION.cff", r"^version: (.+)$") == VERSION
    assert found("Dockerfile", r"^ARG VERSION=(.+)$") == VERSION
    assert found("CHANGELOG.md", r"^## (\S+), ") == VERSION


def test_the_changes_and_the_citation_name_the_same_day() -> None:
    assert found("CHANGELOG.md", r"^## \S+, (.+)$") == found(
        "CITATION.cff", r"^date-released: (.+)$"
    )
