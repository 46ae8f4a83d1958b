"""The compose file itself, as both generations of Compose read it."""

import subprocess

from tests.compose.composition import PATIENCE_S, ROOT


def test_compose_v2_reads_the_file_and_starts_the_direct_system_by_default(engine: str) -> None:
    shown = subprocess.run(
        ["docker", "compose", "-f", "compose.yaml", "config", "--services"],
        cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=True,
    )  # fmt: skip
    assert sorted(shown.stdout.split()) == ["controller", "knowledge", "plant", "settings", "tap"]
