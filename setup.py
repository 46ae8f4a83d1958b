"""Besides what pyproject.toml says: the figures' data, which stand in docs/, go into the wheel."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithData(build_py):
    """Copies ``docs/data`` beside the modules that draw it."""

    def run(self) -> None:
        """Build, then copy; an editable installation reads the source tree."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / "wyner" / "studies" / "data"
            shutil.copytree(Path(__file__).parent / "docs" / "data", target, dirs_exist_ok=True)


setup(cmdclass={"build_py": BuildWithData})
