"""The software bill of materials of the image: what ``requirements/runtime.txt`` pins.

``python -m tools.sbom`` prints CycloneDX 1.5 as JSON, the same bytes for the same pins.
"""

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parent.parent
PINS: Final = ROOT / "requirements" / "runtime.txt"

_PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;\\]+)(?:\s*;\s*(?P<when>[^\\]+))?")


def components(text: str) -> list[dict[str, Any]]:
    """One entry a pinned package, with the hashes of its files."""
    found: list[dict[str, Any]] = []
    for line in text.splitlines():
        pin = _PIN.match(line)
        if pin is not None:
            name, version = pin["name"].lower(), pin["version"]
            entry: dict[str, Any] = {
                "type": "library",
                "name": name,
                "version": version,
                "purl": f"pkg:pypi/{name}@{version}",
                "hashes": [],
            }
            if pin["when"]:
                entry["properties"] = [{"name": "marker", "value": pin["when"].strip()}]
            found.append(entry)
        elif found and (digest := re.search(r"--hash=sha256:([0-9a-f]{64})", line)):
            found[-1]["hashes"].append({"alg": "SHA-256", "content": digest[1]})
    return found


def sbom(text: str, version: str) -> dict[str, Any]:
    """The whole document."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "name": "wyner",
                "version": version,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
            }
        },
        "components": components(text),
    }


def main() -> int:
    """Print it; nothing has to be installed for it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    json.dump(sbom(PINS.read_text(encoding="utf-8"), project["version"]), sys.stdout, indent=2)
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
