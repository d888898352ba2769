"""One environment on the feet of one feed: sensors and a calibrator, or the truth in the place of both.

=============  =========================================================================================
feed           what the policy reads for its feet
=============  =========================================================================================
``true``       the simulator's forces and centres of pressure
``raw``        readings by the data sheet's map, without calibration (``none`` is the same)
``weights``    readings by a map that known weights gave just before the episode
a method       readings calibrated by ``tare``, ``quasi-static``, ``window``, ``moment`` or one of the user's
=============  =========================================================================================

Severity scales all errors of the feet's sensors. At severity 0 there are none, and every feed is the truth.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.experiments.walks.walkers import FEEDS, TruthTap, check_feed
from surefoot.robot.foot_view import DEFAULT
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration
from surefoot.wrappers.source import warning_of_true_forces, with_source

TRUE_PARTS = (*DEFAULT, "foot_load", "wrench", "vgrf")
"""Parts of an observation that exist on every feed, the true one included."""

_PLACES = ("feet", "cells", "soles")  # options of InstrumentedEnv among those of the sensors


def method_of(feed: str) -> Mapping[str, Any] | None:
    """Return the options of SelfCalibration for a feed; ``None`` for true feet, ValueError for no feed."""
    return FEEDS[check_feed("none" if feed == "raw" else feed)]


class FedFeet(gym.Wrapper[Any, Any, Any, Any]):
    """Records what was fed, outside of the sensors and calibrators; on true feet replaces it by the truth.

    Attributes:
        source: The environment or wrapper that records the truth.
        feet: Names of the feet.
        seen: The last observation.
        fed: One array per control step since the reset: the centres of pressure that were fed, the true
            ones, all feet together first, and which of the true ones are defined.
    """

    def __init__(self, env: SelfCalibration, tap: TruthTap, source: Any, *, true: bool) -> None:
        gym.Wrapper.__init__(self, env)
        self._tap, self._true, self.source = tap, true, source
        self.feet = tuple(foot.name for foot in env.layout.feet)
        assert isinstance(env.observation_space, spaces.Dict)
        self._spaces: dict[str, Any] = env.observation_space.spaces
        self._parts = [part for part in TRUE_PARTS if part in self._spaces]
        # Environments of this package observe their true feet; of others the measurements know them.
        observed: Any = getattr(tap.observation_space, "spaces", {})
        self._observed = {part for part in self._parts if part in observed}
        self._centres = [part for part in ("cop", "cop_foot") if part in self._parts]
        self.seen: dict[str, Any] = {}
        self.fed: list[Floats] = []
        self._held: dict[str, Floats] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset, and forget what was fed."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._held = {part: np.zeros(self._spaces[part].shape) for part in self._centres}
        observation = self._feed(observation, info)
        self.fed = []
        return observation, info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step, and record what was fed."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._feed(observation, info), reward, terminated, truncated, info

    def errors(self) -> dict[str, float]:
        """Return the rms distance of the fed from the true centre of pressure in m since the reset.

        ``cop_error`` is that of all feet together, ``cop_error_NAME`` that of a foot in its sole's frame;
        steps in which the true one is not defined are left out, and NaN means that there is no other step.
        """
        feet = self.feet if "cop_foot" in self._centres else ()
        names = ("cop_error", *(f"cop_error_{name}" for name in feet))
        if not self.fed:
            return dict.fromkeys(names, float("nan"))
        table = np.array(self.fed)
        size = 2 * len(names)
        fed, true, valid = table[:, :size], table[:, size : 2 * size], table[:, 2 * size :] > 0.5
        squares = ((fed - true) ** 2).reshape(len(table), len(names), 2).sum(axis=2)
        return {
            name: float(np.sqrt(squares[valid[:, i], i].mean())) if valid[:, i].any() else float("nan")
            for i, name in enumerate(names)
        }

    def _feed(self, observation: dict[str, Any], info: Mapping[str, Any]) -> dict[str, Any]:
        truth = info["surefoot"]["truth"]
        true = {part: self._truth_of(part, truth) for part in (*self._centres, "cop_valid")}
        if self._true:
            others = [part for part in self._parts if part not in true]
            observation = {**observation, **true, **{part: self._truth_of(part, truth) for part in others}}
        centres = [one[part].ravel() for one in (observation, true) for part in self._centres]
        self.fed.append(np.concatenate([*centres, true["cop_valid"]]))
        self.seen = observation
        return observation

    def _truth_of(self, part: str, truth: Mapping[str, Any]) -> NDArray[Any]:
        """Return the truth of a part of the observation; an undefined centre of pressure is held."""
        if part in self._observed:
            found: NDArray[Any] = self._tap.seen[part]
            return found
        space = self._spaces[part]
        if part in self._held:
            valid = np.asarray(truth["cop_valid"], dtype=bool)
            valid = valid[0] if part == "cop" else valid[1:, None]
            self._held[part] = np.where(valid, truth[part], self._held[part])
            value = self._held[part]
        elif part in ("foot_force", "foot_load"):
            value = _true_force(truth, space.shape)
            value = value / self.source.drawing.weight if part == "foot_load" else value
        else:
            value = truth["wrench_sole" if part == "wrench" else part]
        return np.clip(value, space.low, space.high).astype(space.dtype)


def _true_force(truth: Mapping[str, Any], shape: tuple[int, ...]) -> Floats:
    """Return the true forces of channels: of cells, of ankle sensors or of one cell per foot."""
    cells, ankles = np.ravel(truth["force_cell"]), np.ravel(truth["wrench_ankle"])
    for found in (cells, ankles, np.ravel(truth["vgrf"]), np.concatenate([cells, ankles])):
        if found.shape == shape:
            force: Floats = found
            return force
    raise ValueError(
        f"The true forces of feet with {shape[0]} channels are not known; observe 'cop', 'vgrf' or 'wrench' "
        "in the place of 'foot_force'."
    )


def put_on(
    bare: gym.Env[Any, Any],
    feed: str,
    severity: float,
    *,
    cells: Any = None,
    sensors: Mapping[str, Any] | None = None,
    calibration: Mapping[str, Any] | None = None,
    faults: Any = (),
    show: Sequence[str] | None = None,
    scenario: Any = None,
) -> FedFeet:
    """Put the sensors of a feed, and its calibrator, around a bare environment.

    Args:
        bare: Any environment built on MuJoCo.
        feed: See the module; or ``"module:name"`` of a registered method.
        severity: Factor of all errors of the feet's sensors.
        cells: The instruments under the feet, ``config`` of :class:`~surefoot.wrappers.FootSensors`.
        sensors: Further options of :class:`~surefoot.wrappers.FootSensors`, such as ``imu`` or ``soles``.
        calibration: Options of :class:`~surefoot.wrappers.SelfCalibration`, such as ``errors``.
        faults: What breaks when, or how likely; nothing breaks on true feet.
        show: Parts of the observation, by default those of :class:`~surefoot.wrappers.SelfCalibration`.
        scenario: Function that wraps the environment below the sensors, such as
            :class:`~surefoot.experiments.evaluate.scenarios.Payload`.

    Raises:
        TypeError: If the environment is not built on MuJoCo.
        ValueError: If the environment observes true contact forces beside the feet, an option is refused, or
            the feet have no place for the sensors.
    """
    method, given = method_of(feed), dict(sensors or {})
    if warning := warning_of_true_forces(bare):
        raise ValueError(warning)
    true = method is None or severity == 0.0
    try:
        source = with_source(bare, **{name: given.pop(name) for name in _PLACES if name in given})
        tap = TruthTap(source if scenario is None else scenario(source))
        condition: Any = {"severity": 1.0, "faults": ()} if true else {"severity": severity, "faults": faults}
        worn = FootSensors(tap, cells, **condition, **given)
    except ValueError as error:
        raise ValueError(
            f"{error} In an evaluation 'sensors' takes options of InstrumentedEnv and FootSensors, such as "
            "sensors={'soles': True} (--soles), and 'cells' (--cells) the instruments."
        ) from error
    options = {**(method or {"method": "none"}), **(calibration or {}), "show": show}
    return FedFeet(SelfCalibration(worn, **options), tap, worn.source, true=true)
