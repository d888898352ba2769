"""Compile the libraries in C where there is a C compiler, and say in the wheel's name what is inside."""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
LIBRARIES = list(runpy.run_path(str(ROOT / "surefoot" / "native" / "build.py"))["sources_below"](ROOT))


class BuildWithLibraries(build_py):
    """Copies the package and compiles its libraries beside it; into the checkout for an editable install."""

    def run(self) -> None:
        """Build the package, and the libraries if that can be."""
        super().run()
        for sources in LIBRARIES:
            target = sources.library
            if not self.editable_mode:
                target = Path(self.build_lib, "surefoot", target.relative_to(ROOT))
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            problem = sources.compile(target)
            print(f"{sources.name} runs in Python alone: {problem}." if problem else f"compiled {target}")


class WheelOfOnePlatform(bdist_wheel):
    """A wheel with libraries serves every Python 3 of one platform; one without serves all platforms."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return what Python, ABI and platform the wheel is for."""
        places = (Path("surefoot", sources.library.relative_to(ROOT)) for sources in LIBRARIES)
        if not any((Path(self.bdist_dir) / place).exists() for place in places):
            return super().get_tag()
        self.root_is_pure = False
        return "py3", "none", super().get_tag()[2]


setup(cmdclass={"build_py": BuildWithLibraries, "bdist_wheel": WheelOfOnePlatform})
