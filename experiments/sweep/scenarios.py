"""What a swept robot does and what happens to it, by name.

Most are the arena's (:mod:`surefoot.experiments.arena.scenarios`): the same walks, faults and errors of the
robot about itself, here with the loop closed. A sweep may name others of its own, based on these.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from types import MappingProxyType
from typing import Any

from gymnasium.envs.registration import registry

from surefoot.experiments.arena import scenarios
from surefoot.experiments.arena.walks import INSTANT, Walk
from surefoot.experiments.policy.env import EXPECTED_LOADS
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME

__all__ = ["SCENARIOS", "SWEEP_FEEDS", "SweepScenario", "scenario_named"]

SWEEP_FEEDS: Mapping[str, Mapping[str, Any] | None] = MappingProxyType(
    {
        "true": None,
        "none": {"method": "none"},
        "bench": {"method": "none", "initial": "calibrated"},
        **{name: {"method": name} for name in FEEDS if name not in ("true", "none")},
    }
)
"""What may be fed back as the centre of pressure, and how it is calibrated: the walkers' feeds, and drifting
readings by the map that a bench found just before the episode."""

_WALK, _STAND = "surefoot/NaoWalk-v0", "surefoot/NaoStand-v0"
_BALANCE, _CARRY = "surefoot/NaoBalance-v0", "surefoot/NaoCarry-v0"

_TWO_STEPS = 2.0
"""Shortest walk in s that a pattern is planned for."""


@dataclass(frozen=True)
class SweepScenario:
    """A task and its circumstances.

    Attributes:
        name: Short name, for files and the command.
        title: What to call it.
        environment: Id of the environment.
        options: Options of the environment.
        sensors: IMU, encoders and link, as options of :class:`~surefoot.wrappers.FootSensors`.
        beliefs: Errors of the robot about itself, as options of :class:`~surefoot.wrappers.SelfCalibration`.
        methods: Options of single feeds' calibration: what a robot in this scenario is told.
        fault_of: Scenario of the arena that says which fault a seed draws, or ``None``.
    """

    name: str
    title: str
    environment: str = _WALK
    options: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    beliefs: Mapping[str, Any] = field(default_factory=dict)
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    fault_of: str | None = None

    def options_for(self, duration: float) -> dict[str, Any]:
        """Complete the environment's options for an episode of some length in s.

        A plan goes on beyond the episode's end: what is scored is standing first and then the task.
        """
        around: dict[str, dict[str, Any]] = {
            _WALK: {"duration": max(duration, _TWO_STEPS) + 2 * STAND_TIME, "stand_time": STAND_TIME},
            _STAND: {"duration": None},
        }
        return around.get(self.environment, {}) | dict(self.options)

    def calibration_for(self, feed: str) -> dict[str, Any]:
        """Complete the options of the calibration for a feed; there are none for the true one."""
        method = SWEEP_FEEDS[feed]
        return {} if method is None else {**method, **self.beliefs, **self.methods.get(feed, {})}

    def sensors_for(self, seed: int) -> dict[str, Any]:
        """Complete the sensors' options by the fault that a seed draws, if any, within a stride of 14 s."""
        drawn = dict(self.sensors)
        if self.fault_of is not None:
            faults = scenarios.SCENARIOS[self.fault_of].faults_of(seed, STAND_TIME + 10.0)
            drawn["faults"] = [asdict(fault) for fault in faults]
        return {name: asdict(v) if is_dataclass(v) else v for name, v in drawn.items()}  # type: ignore[arg-type]


def _from_arena(scenario: scenarios.Scenario, walk: Walk) -> SweepScenario:
    return SweepScenario(
        scenario.name,
        scenario.title,
        options={"speed": walk.speed, **walk.env},
        sensors=walk.sensors,
        beliefs=walk.beliefs,
        fault_of=scenario.name if scenario.faults else None,
    )


def _table() -> dict[str, SweepScenario]:
    """Take over what the arena walks on load cells; a clock's error has no place in a closed loop."""
    walked = [
        _from_arena(scenario, scenario.walk)
        for scenario in scenarios.SCENARIOS.values()
        if scenario.walk is not None
        and scenario.condition == INSTANT.name
        and not (scenario.long or scenario.walk.clock_error)
    ]
    own = (
        SweepScenario(
            "hard-pushes",
            "walking, pushed hard",
            options={"speed": 0.04, "push_impulse": (1.0, 2.5), "push_interval": 3.0},
        ),
        SweepScenario("stand", "standing", _STAND),
        SweepScenario(
            "stand-pushes",
            "standing, pushed",
            _STAND,
            {"push_impulse": (1.0, 2.5), "push_interval": 3.0},
        ),
        SweepScenario(
            "balance",
            "balance under a payload and pushes",
            _BALANCE,
            methods={"moment": dict(EXPECTED_LOADS)},
        ),
        SweepScenario(
            "carry",
            "walking under a payload and pushes",
            _CARRY,
            methods={"moment": dict(EXPECTED_LOADS)},
        ),
    )
    return {scenario.name: scenario for scenario in (*walked, *own)}


SCENARIOS: Mapping[str, SweepScenario] = MappingProxyType(_table())
"""All scenarios by name, in the order of the report; :func:`scenario_named` knows which can be run here."""


def scenario_named(name: str, others: Mapping[str, SweepScenario] = MappingProxyType({})) -> SweepScenario:
    """Look a scenario up.

    Args:
        name: Its name.
        others: Scenarios besides :data:`SCENARIOS`, which come first.

    Raises:
        ValueError: If there is none of the name, or its environment is not registered; the message lists
            what there is.
    """
    known = {n: s for n, s in {**SCENARIOS, **others}.items() if s.environment in registry or n in others}
    if name not in known:
        raise ValueError(f"There is no scenario '{name}'. Available: {', '.join(known)}.")
    found = known[name]
    if found.environment not in registry:
        raise ValueError(
            f"Scenario '{name}' asks for the environment '{found.environment}', which is not registered; "
            "import the package that registers it, as in 'package:Name-v0'."
        )
    return found
