"""What a robot does in an episode and what happens to it: mostly the arena's, with the loop closed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from types import MappingProxyType
from typing import Any

from gymnasium.envs.registration import registry

from surefoot.experiments.arena import scenarios
from surefoot.experiments.arena.walks import INSTANT
from surefoot.experiments.policy.tasks import task_named
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME

_WALK, _STAND = "surefoot/NaoWalk-v0", "surefoot/NaoStand-v0"
_BALANCE, _CARRY = "surefoot/NaoBalance-v0", "surefoot/NaoCarry-v0"

_SHORTEST_WALK = 2.0  # shortest walk in s that a pattern is planned for
FAULT_AFTER = STAND_TIME + 10.0
"""Time in s from which on a fault that a seed draws may come, within a stride."""


@dataclass(frozen=True)
class LoopScenario:
    """A task and its circumstances, with the loop closed."""

    name: str  # for files and the command
    title: str
    environment: str = _WALK  # id
    options: Mapping[str, Any] = field(default_factory=dict)  # of the environment
    sensors: Mapping[str, Any] = field(default_factory=dict)  # of FootSensors: IMU, encoders, link
    beliefs: Mapping[str, Any] = field(default_factory=dict)  # of SelfCalibration
    fault_of: str | None = None  # scenario of the arena that says which fault a seed draws
    of_task: bool = False  # a policy's: joints and tilt are measured on true feet as well

    def options_for(self, duration: float | None) -> dict[str, Any]:
        """Return the environment's options for s; its plan goes on beyond the episode's end."""
        around: dict[str, dict[str, Any]] = {
            _WALK: {
                "duration": max(duration or 0.0, _SHORTEST_WALK) + 2 * STAND_TIME,
                "stand_time": STAND_TIME,
            },
            _STAND: {"duration": None},
        }
        return around.get(self.environment, {}) | dict(self.options)

    def calibration_for(self, feed: str) -> dict[str, Any] | None:
        """Return the options of a feed's calibration; ``None`` for the true one."""
        method = FEEDS[feed]
        return None if method is None else {**method, **self.beliefs}

    def sensors_for(self, feed: str, severity: float, seed: int) -> dict[str, Any] | None:
        """Return the sensors' options for a feed, with a seed's fault; ``None`` for no sensors at all."""
        if FEEDS[feed] is None:
            return {} if self.of_task else None
        drawn = {"severity": severity, **self.sensors}
        if self.fault_of is not None:
            faults = scenarios.SCENARIOS[self.fault_of].faults_of(seed, FAULT_AFTER)
            drawn["faults"] = [asdict(fault) for fault in faults]
        return {k: asdict(v) if is_dataclass(v) else v for k, v in drawn.items()}  # type: ignore[arg-type]


def scenario_of_task(name: str) -> LoopScenario:
    """Return the scenario in which policies for a task are evaluated."""
    task = task_named(name)
    return LoopScenario(task.name, task.name, task.env_id, of_task=True)


def _from_arena(scenario: scenarios.Scenario) -> LoopScenario:
    walk = scenario.walk
    return LoopScenario(
        scenario.name,
        scenario.title,
        options={"speed": walk.speed, **walk.env},
        sensors=walk.sensors,
        beliefs=walk.beliefs,
        fault_of=scenario.name if scenario.faults else None,
    )


def _table() -> dict[str, LoopScenario]:
    """Return what the arena walks on load cells, and more; a clock's error has no place in a closed loop."""
    walked = [
        _from_arena(scenario)
        for scenario in scenarios.SCENARIOS.values()
        if scenario.condition == INSTANT.name and not (scenario.long or scenario.walk.clock_error)
    ]
    hard = {"push_impulse": (1.0, 2.5), "push_interval": 3.0}
    own = (
        LoopScenario("hard-pushes", "walking, pushed hard", options={"speed": 0.04, **hard}),
        LoopScenario("stand", "standing", _STAND),
        LoopScenario("stand-pushes", "standing, pushed", _STAND, hard),
        LoopScenario("balance", "balance under a payload and pushes", _BALANCE),
        LoopScenario("carry", "walking under a payload and pushes", _CARRY),
    )
    return {scenario.name: scenario for scenario in (*walked, *own)}


SCENARIOS: Mapping[str, LoopScenario] = MappingProxyType(_table())
"""All scenarios by name, in the order of the report; :func:`scenario_named` knows which can be run here."""


def scenario_named(name: str, others: Mapping[str, LoopScenario] = MappingProxyType({})) -> LoopScenario:
    """Return the scenario of a name, of others or of :data:`SCENARIOS`; ValueError lists what there is."""
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
