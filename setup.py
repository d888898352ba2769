"""Compile calibration/native where there is a C compiler, and say in the wheel's name what is inside."""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

NATIVE = runpy.run_path(str(Path(__file__).parent / "calibration" / "native" / "build.py"))
LIBRARY, compile_library = NATIVE["LIBRARY"], NATIVE["compile_library"]
PLACE = Path("surefoot", "calibration", "native", LIBRARY.name)


class BuildWithLibrary(build_py):
    """Copies the package and compiles its library beside it; into the checkout for an editable install."""

    def run(self) -> None:
        """Build the package, and the library if that can be."""
        super().run()
        target = LIBRARY if self.editable_mode else Path(self.build_lib) / PLACE
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        problem = compile_library(target)
        print(f"surefoot calibrates in Python alone: {problem}." if problem else f"compiled {target}")


class WheelOfOnePlatform(bdist_wheel):
    """A wheel with the library serves every Python 3 of one platform; one without serves all platforms."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return what Python, ABI and platform the wheel is for."""
        if not (Path(self.bdist_dir) / PLACE).exists():
            return super().get_tag()
        self.root_is_pure = False
        return "py3", "none", super().get_tag()[2]


setup(cmdclass={"build_py": BuildWithLibrary, "bdist_wheel": WheelOfOnePlatform})
