"""Play a calibration motion: joint targets over time, until the calibrator is certain."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.excitation.certainty import ENOUGH, Certainty
from surefoot.files import AnyPath, read_columns


class CalibrationMotion:
    """Play a file of ``surefoot calibrate motion``, one row per call, and stop at a rest when certain.

    It reads ``"cop_std"`` from the observation, as :class:`~surefoot.wrappers.SelfCalibration` adds it; on a
    robot it is the square root of the diagonal of ``estimate.cop_covariance``. Without it the motion is
    played to its end. Continue to call it afterwards: :attr:`wanted` becomes true when the robot should
    calibrate again, and :meth:`start` begins the motion again.

    Args:
        targets: Targets of the M motors in rad, shape (N, M).
        rest: Whether the robot is in its first posture and may stop, shape (N,).
        motors: Names of the motors.
        dt: Time between rows in s.
        stance: Whether each foot (left, right) is planned to bear weight, shape (N, 2).
        swing: Whether each foot is planned to be in the air, shape (N, 2).
        enough: Standard deviation of the centre of pressure in m at which the motion stops; 0 never stops it.
        again: Standard deviation in m above which :attr:`wanted` is true; 1.5 times ``enough`` by default.

    Attributes:
        done: Whether the motion is over.
        stance: Whether each foot is planned to bear weight now, for the robot's reference, shape (2,).
        swing: Whether each foot is planned to be in the air now, shape (2,).

    Raises:
        ValueError: If a shape does not fit, or the robot may not stop at the last row.

    >>> motion = CalibrationMotion([[0.1], [0.2], [0.1]], [False, False, True], ["knee"], dt=0.1)
    >>> [motion({}).item() for _ in range(4)], motion.done
    ([0.1, 0.2, 0.1, 0.1], True)
    """

    def __init__(
        self,
        targets: ArrayLike,
        rest: ArrayLike,
        motors: Sequence[str],
        *,
        dt: float,
        stance: ArrayLike | None = None,
        swing: ArrayLike | None = None,
        enough: float = ENOUGH,
        again: float | None = None,
    ) -> None:
        self.targets: NDArray[np.float64] = np.array(targets, dtype=np.float64)
        self.motors, self.dt = tuple(motors), float(dt)
        self._rest = np.array(rest, dtype=bool)
        rows = len(self._rest)
        if self.targets.shape != (rows, len(self.motors)) or not np.isfinite(self.targets).all():
            raise ValueError(
                f"'targets' must be finite, shape ({rows}, {len(self.motors)}) for {rows} rows of 'rest' and "
                f"the motors {list(self.motors)}, got shape {self.targets.shape}."
            )
        if not rows or not self._rest[-1]:
            raise ValueError("The last row of 'rest' must be true: a motion ends where the robot may stand.")
        self._stance = np.ones((rows, 2), dtype=bool) if stance is None else np.array(stance, dtype=bool)
        self._swing = np.zeros((rows, 2), dtype=bool) if swing is None else np.array(swing, dtype=bool)
        self._stops = enough > 0.0
        self._certainty = Certainty(enough if self._stops else ENOUGH, again, dt=self.dt)
        self.start()

    @classmethod
    def read(cls, path: AnyPath, **options: Any) -> "CalibrationMotion":
        """Read a file of ``surefoot calibrate motion``.

        Args:
            path: The CSV.
            **options: ``enough`` and ``again``.

        Raises:
            ValueError: If the file is not such a table, a column is missing, or a number is not finite.
        """
        feet = [f"{phase}_{foot}_1" for phase in ("stance", "swing") for foot in ("left", "right")]
        table = read_columns(path, ("time_s", "rest_1", *feet), "write it with surefoot calibrate motion")
        joints = [name for name in table if name.startswith("target_") and name.endswith("_rad")]
        time, columns = table["time_s"], np.stack([table[name] for name in (*feet, *joints)], axis=1)
        return cls(
            columns[:, len(feet) :],
            table["rest_1"] > 0.5,
            [name.removeprefix("target_").removesuffix("_rad") for name in joints],
            dt=float(time[-1]) / len(time) if len(time) else np.nan,
            stance=columns[:, :2] > 0.5,
            swing=columns[:, 2:4] > 0.5,
            **options,
        )

    @property
    def certain(self) -> bool:
        """Whether the calibrator is certain enough."""
        return self._certainty.certain

    @property
    def wanted(self) -> bool:
        """Whether the motion is over and the robot is no longer certain: it should calibrate again."""
        return self.done and not self.certain

    def start(self) -> None:
        """Start at the first row."""
        self._next, self.done = 0, False
        self.stance, self.swing = self._stance[0], self._swing[0]

    def __call__(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the next targets in rad, shape (M,); after the end, the last ones."""
        if "cop_std" in observation:
            self._certainty.update(observation["cop_std"])
        if not self.done:
            row, self._next = self._next, self._next + 1
            self.stance, self.swing = self._stance[row], self._swing[row]
            over = row == len(self._rest) - 1
            self.done = over or bool(self._rest[row] and self._stops and self.certain)
        return np.array(self.targets[self._next - 1])
