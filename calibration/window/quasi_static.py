"""Han's self-calibration: the sliding window against a robot that is thought to stand still.

Han, Jiang and Chirikjian (IROS 2022) calibrate force-sensing shoes on the assumption that the robot is
quasi-static: the ground carries M g below the centre of mass. The CoP paper compares itself with that by
putting

    Fz_ref = M g,    p_ref = (x, y)

in place of its Eqs. 9-11 and leaving everything else as it is. The faster a robot walks, the more of its own
acceleration flows into the cells.
"""

from surefoot.calibration._setup import OnlineMethod, OnlineSetup
from surefoot.calibration.window.config import WindowConfig
from surefoot.calibration.window.stream import sliding_window


def quasi_static(setup: OnlineSetup, config: WindowConfig | None = None) -> OnlineMethod:
    """Build Han's method as a pair of pure functions.

    Args:
        setup: What the method must be told about the robot.
        config: Options, the same as the sliding window's.
    """
    return sliding_window(setup, config or WindowConfig(), quasi_static=True)
