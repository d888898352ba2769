"""Build ``main.c`` and ``main.cpp`` for one robot: writes its constants as ``robot.h`` and compiles.

    python examples/robot/build.py            # a NAO on two four-cell shoes, into out/robot/

Another robot needs another :class:`~surefoot.calibration.OnlineSetup` below.
"""

import shutil
import subprocess
from pathlib import Path

import numpy as np

from surefoot.calibration import OnlineSetup, Parameters, nao_shoe_layout
from surefoot.calibration.native import c_source
from surefoot.native import FOLDER, compiler

STRICT = ("-pedantic", "-O3", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")


def build_robot(setup: OnlineSetup, folder: Path, **options: float) -> list[Path]:
    """Return the programs for a robot, built into a folder: in C, and in C++ where there is a compiler.

    Args:
        setup: The robot.
        folder: Where to.
        options: Fields of :class:`~surefoot.calibration.moment.config.Moment`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.h").write_text(c_source(setup, **options))
    includes = (f"-I{folder}", f"-I{FOLDER}")
    ways = {"main.c": [*(compiler() or ("cc",)), "-std=c99"]}
    if plus := shutil.which("c++"):
        ways["main.cpp"] = [plus, "-std=c++20"]
    programs = []
    for main, command in ways.items():
        programs.append(folder / main.replace("main.", "robot_"))
        source = Path(__file__).parent / main
        subprocess.run([*command, *STRICT, *includes, "-o", programs[-1], source, "-lm"], check=True)
    return programs


if __name__ == "__main__":
    nao = OnlineSetup(
        layout=nao_shoe_layout(), mass=5.305, initial=Parameters(np.full(8, 2e-5), np.full(8, -160.0))
    )
    print("Built", *build_robot(nao, Path("out/robot")))
