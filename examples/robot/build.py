"""Build ``main.c`` for one robot: writes its constants as ``robot.h`` and calls the system's C compiler.

    python examples/robot/build.py            # a NAO on two four-cell shoes, into out/robot/

Another robot needs another :class:`~surefoot.calibration.OnlineSetup` below.
"""

import subprocess
from pathlib import Path

import numpy as np

from surefoot.calibration import OnlineSetup, Parameters, nao_shoe_layout
from surefoot.calibration.native import NATIVE, c_source
from surefoot.native import compiler

STRICT = ("-std=c99", "-pedantic", "-O3", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")


def build_robot(setup: OnlineSetup, folder: Path, **options: float) -> Path:
    """Return the program for a robot, built into a folder.

    Args:
        setup: The robot.
        folder: Where to.
        options: Fields of :class:`~surefoot.calibration.moment.config.MomentFilterConfig`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.h").write_text(c_source(setup, **options))
    program, main = folder / "robot", Path(__file__).parent / "main.c"
    includes = (f"-I{folder}", f"-I{NATIVE.sources.folder}")
    subprocess.run([*(compiler() or ("cc",)), *STRICT, *includes, "-o", program, main, "-lm"], check=True)
    return program


if __name__ == "__main__":
    nao = OnlineSetup(
        layout=nao_shoe_layout(), mass=5.305, initial=Parameters(np.full(8, 2e-5), np.full(8, -160.0))
    )
    print(f"Built {build_robot(nao, Path('out/robot'))}.")
