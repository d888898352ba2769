"""Score a policy on feet of different kinds, on the same episodes.

Seeds are paired: the same seed gives the same command, payload, pushes, ground and sensors whatever is fed
back. What is scored begins after the quiet stand, in which nobody acts.
"""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.policy.controllers import check_task, load_controller
from surefoot.experiments.policy.env import make_feed
from surefoot.experiments.policy.options import TRAINING_SEEDS

__all__ = [
    "COP_INPUTS",
    "EpisodeResult",
    "check_seeds",
    "count_episodes",
    "episode_cells",
    "run_episode",
    "run_episodes",
]

COP_INPUTS = ("felt", "frozen", "swapped", "shuffled")
"""What is done to the centre of pressure that a controller is given: nothing; held at what it was at the end
of the quiet stand; another episode's at the same time; that of another episode at times drawn at random."""

DONOR = 500_000
"""What is added to an episode's seed to get that of the episode whose centre of pressure it is given."""

_DONATED = ("swapped", "shuffled")
"""What takes another episode."""


@dataclass(frozen=True)
class EpisodeResult:
    """How one episode went, from the end of the quiet stand on.

    Attributes:
        feed: What was fed back, see :data:`surefoot.experiments.policy.env.FEEDS`.
        cop_input: What was done to it, one of :data:`COP_INPUTS`.
        severity: Factor of the sensors' errors.
        seed: Of the episode and of its sensors.
        total: Return: sum of the rewards, not discounted.
        fell: Whether it ended in a fall.
        time: Time on its feet in s; 0 if it ended within the quiet stand.
        cop_error: RMSE of the centre of pressure fed back against the true one in m.
        tracking: RMSE of the true centre of pressure against the commanded one in m.
        controller: Name of what acted, if it was given by name.
        task: What was to be done, one of :data:`surefoot.experiments.policy.tasks.TASKS`.
    """

    feed: str
    cop_input: str
    severity: float
    seed: int
    total: float
    fell: bool
    time: float
    cop_error: float
    tracking: float
    controller: str = ""
    task: str = "balance"


def run_episode(
    policy: Callable[[Mapping[str, Any]], NDArray[np.float32]] | str,
    feed: str,
    seed: int,
    severity: float = 1.0,
    *,
    cop_input: str = "felt",
    task: str = "balance",
    **env_options: Any,
) -> EpisodeResult:
    """Run one episode and say how it went.

    Args:
        policy: A :class:`~surefoot.controllers.PolicyNetwork`, a stabiliser, or any function of observations,
            or the name of one (:mod:`surefoot.experiments.policy.controllers`);
            if it has a ``reset``, it is called when the quiet stand is over, so that what a controller
            integrates begins there.
        feed: What is fed back, see :data:`surefoot.experiments.policy.env.FEEDS`.
        seed: Of the episode and its sensors, see :func:`check_seeds`.
        severity: Factor of all errors of the feet's sensors.
        cop_input: One of :data:`COP_INPUTS`.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        **env_options: Of the task's environment.

    Raises:
        ValueError: If a name does not exist, a seed is one of training's, or the policy does not fit or was
            made for another task.
    """
    check_seeds(seed, seed, (cop_input,))
    donor: list[tuple[NDArray[Any], NDArray[Any]]] = []
    if cop_input in _DONATED:
        donor = [
            (moment.observation["cop"], moment.observation["cop_valid"])
            for moment in _moments(policy, feed, seed + DONOR, severity, None, task, env_options)
            if moment.asked
        ]
        if cop_input == "shuffled":
            order = np.random.default_rng([DONOR, seed]).permutation(len(donor))
            donor = [donor[i] for i in order]
    change = None if cop_input == "felt" else _changed(cop_input, donor)
    total, steps, fell = 0.0, 0, False
    error: list[float] = []
    tracking: list[float] = []
    dt = 0.0
    for moment in _moments(policy, feed, seed, severity, change, task, env_options):
        fell = moment.fell
        if not moment.asked:
            break
        total += moment.reward
        steps, dt = steps + 1, moment.dt
        if moment.truth["cop_valid"][0]:
            true = moment.truth["cop"].astype(np.float64)
            error.append(float(np.sum((moment.observation["cop"] - true) ** 2)))
            tracking.append(float(np.sum((true - moment.reference) ** 2)))
    return EpisodeResult(
        feed,
        cop_input,
        severity,
        seed,
        total,
        fell,
        steps * dt,
        _root_mean(error),
        _root_mean(tracking),
        policy if isinstance(policy, str) else "",
        task,
    )


def check_seeds(first: int, last: int, cop_inputs: Sequence[str] = COP_INPUTS[:1]) -> None:
    """Refuse seeds that reach those of training, also by the episodes whose centre of pressure is taken.

    Args:
        first: The smallest.
        last: The largest.
        cop_inputs: What is done to the centre of pressure, of :data:`COP_INPUTS`.

    Raises:
        ValueError: If one is below 0 or reaches
            :data:`~surefoot.experiments.policy.options.TRAINING_SEEDS`, or there is no such input.
    """
    if unknown := [name for name in cop_inputs if name not in COP_INPUTS]:
        raise ValueError(f"'cop_input' must be one of {COP_INPUTS}, got {unknown[0]!r}.")
    taken = [name for name in cop_inputs if name in _DONATED]
    end = TRAINING_SEEDS - (DONOR if taken else 0)
    if not 0 <= first <= last < end:
        why = f", and '{taken[0]}' takes an episode {DONOR} further on" if taken else ""
        given = str(first) if first == last else f"{first} to {last}"
        raise ValueError(
            f"'seed' must lie in 0 to {end - 1}, got {given}: seeds from {TRAINING_SEEDS} on are "
            f"training's{why}."
        )


def run_episodes(
    policy: Any,
    feeds: Sequence[str],
    seeds: Sequence[int],
    severities: Sequence[float] = (1.0,),
    *,
    cop_inputs: Sequence[str] = ("felt",),
    task: str = "balance",
    jobs: int = 1,
    done: Container[tuple[str, int, float, str]] = (),
    **env_options: Any,
) -> Iterator[EpisodeResult]:
    """Run every combination, seed by seed; results come as they are ready, in order.

    Args:
        policy: As in :func:`run_episode`; with several jobs it must be picklable.
        feeds: What is fed back. On the true one severities make no difference: it is run at the first.
        seeds: Of the episodes.
        severities: Factors of the sensors' errors.
        cop_inputs: What is done to the centre of pressure, on the true feet; others are fed as felt.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        jobs: Processes that work at the same time.
        done: Feed, seed, severity and what was done to it, of episodes that are not run; see
            :func:`episode_cells`.
        **env_options: Of the task's environment.
    """
    from joblib import Parallel, delayed

    cells = [cell for cell in episode_cells(feeds, seeds, severities, cop_inputs) if cell not in done]
    yield from Parallel(n_jobs=jobs, return_as="generator")(
        delayed(run_episode)(policy, feed, seed, severity, cop_input=cop_input, task=task, **env_options)
        for feed, seed, severity, cop_input in cells
    )


def count_episodes(
    feeds: Sequence[str], seeds: Sequence[int], severities: Sequence[float], cop_inputs: Sequence[str]
) -> int:
    """Count what :func:`run_episodes` runs."""
    return len(episode_cells(feeds, seeds, severities, cop_inputs))


def episode_cells(
    feeds: Sequence[str], seeds: Sequence[int], severities: Sequence[float], cop_inputs: Sequence[str]
) -> list[tuple[str, int, float, str]]:
    """Name what :func:`run_episodes` runs, in order: feed, seed, severity and what was done to it."""
    return [
        (feed, seed, severity, cop_input)
        for seed in seeds
        for feed in feeds
        for severity in (severities[:1] if feed == "true" else severities)
        for cop_input in (cop_inputs if feed == "true" else ("felt",))
    ]


@dataclass(frozen=True)
class _Moment:
    """One step after the quiet stand, or the one in the quiet stand with which the episode ended.

    Attributes:
        asked: Whether the policy was asked: the quiet stand was over.
    """

    observation: dict[str, Any]
    truth: dict[str, Any]
    reference: NDArray[np.float64]
    reward: float
    fell: bool
    dt: float
    asked: bool = True


_Change = Callable[[dict[str, Any], int], dict[str, Any]]


def _moments(
    policy: Any,
    feed: str,
    seed: int,
    severity: float,
    change: _Change | None,
    task: str,
    env_options: dict[str, Any],
) -> Iterator[_Moment]:
    env, tap = make_feed(feed, severity=severity, task=task, **env_options)
    try:
        bare: Any = env.unwrapped
        if isinstance(policy, str):
            policy = load_controller(policy, env, same_task=True)
        else:
            check_task(policy, env)
            fits = getattr(policy, "fits", None)
            if fits is not None:
                fits(env.observation_space, env.action_space)
        reference = bare.state_layout["cop_reference"]
        still = np.zeros(env.action_space.shape or (), dtype=np.float32)
        stand = round(bare.stand_time / bare.dt)

        def moment(reward: Any, fell: bool, asked: bool = True) -> _Moment:
            planned = tap.seen["state"][reference].astype(np.float64)
            return _Moment(observation, tap.seen, planned, float(reward), fell, bare.dt, asked)

        observation, _ = env.reset(seed=seed)
        for _ in range(stand):
            observation, reward, terminated, truncated, _ = env.step(still)
            if terminated or truncated:
                yield moment(reward, terminated, asked=False)
                return
        forget = getattr(policy, "reset", None)
        if forget is not None:
            forget()
        done, step = False, 0
        while not done:
            given = observation if change is None else change(observation, step)
            observation, reward, terminated, truncated, _ = env.step(policy(given))
            done, step = terminated or truncated, step + 1
            yield moment(reward, terminated)
    finally:
        env.close()


def _changed(cop_input: str, donor: list[tuple[NDArray[Any], NDArray[Any]]]) -> _Change:
    held: list[tuple[NDArray[Any], NDArray[Any]]] = list(donor)

    def change(observation: dict[str, Any], step: int) -> dict[str, Any]:
        if not held:
            held.append((observation["cop"], observation["cop_valid"]))
        cop, valid = held[0] if cop_input == "frozen" else held[step % len(held)]
        return observation | {"cop": cop, "cop_valid": valid}

    return change


def _root_mean(squares: list[float]) -> float:
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")
