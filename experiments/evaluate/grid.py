"""The grid of an evaluation: its episodes, the processes that run them, and the folder of their rows."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import count, product
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from surefoot.experiments.evaluate.episode import OUTCOME, VERSIONS, Stage, outcome_of_failure, versions
from surefoot.experiments.evaluate.feet import method_of
from surefoot.experiments.evaluate.policies import fingerprint, portable
from surefoot.experiments.evaluate.setup import Setup
from surefoot.experiments.evaluate.statistics import NOBODY, RAW, TRUE
from surefoot.experiments.policy.controllers import short_name
from surefoot.experiments.policy.tasks import TRAINING_SEEDS
from surefoot.experiments.study.page import save_frames
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.runner import attempt, runner
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.store import PLAN, Case, Store
from surefoot.experiments.study.tables import Frame

TABLE = "episodes"  # name of the table that holds the rows

FEEDS = ("true", "raw", "tare", "moment")
SEVERITIES = (0.5, 1.0, 2.0, 3.0)
FIRST_SEED = (
    20_000  # where seeds begin if only their number is given: far from those that trainings begin with
)

Tables = dict[str, list[dict[str, Any]]]

_MOST_STAGES = 64  # environments that a process keeps: feeds times severities of one policy, and some more
_STAGES: dict[str, Stage] = {}  # those that this process has made for the run under way


class Episode(NamedTuple):
    """One episode of the grid."""

    number: int  # its case
    policy: str  # name of the arm
    training: int  # which of the arm's trainings acts
    feed: str
    severity: float
    seed: int


@dataclass(frozen=True, eq=False)
class Plan:
    """A grid of episodes: who acts, in which environment, on which feet."""

    setup: Setup
    policies: Mapping[str, tuple[Any, ...]]  # the trainings of each arm
    episodes: tuple[Episode, ...]

    @classmethod
    def of(
        cls,
        make_env: Any,
        policy: Any,
        *,
        feeds: Sequence[str] = FEEDS,
        severities: Sequence[float] = SEVERITIES,
        seeds: int | Sequence[int] = 50,
        statistics: Any = None,
        trusted: bool = False,
        **setup: Any,
    ) -> "Plan":
        """Return the plan of :func:`evaluate`; ValueError if something is refused."""
        arms = arms_of(policy, statistics=statistics, trusted=trusted)
        episodes = tuple(_grid(arms, feeds, severities, _seeds(seeds, policy)))
        return cls(Setup(make_env, **setup), arms, episodes)

    def describe(self) -> dict[str, Any]:
        """Return plain data that differ from those of any other plan."""
        axes = {"feeds": "feed", "severities": "severity", "seeds": "seed"}
        found = {name: sorted({getattr(one, of) for one in self.episodes}) for name, of in axes.items()}
        return {"setup": self.setup.describe(), "policies": self._hashes, **found}

    def cases(self) -> list[Case]:
        """Return the episodes as cases of a study, seed by seed: a stopped study is paired as well."""
        worn, hashes, cases = repr(self.setup.describe()), self._hashes, []
        for one in sorted(self.episodes, key=lambda episode: episode.seed):
            policy = self.policies[one.policy][one.training]
            who = hashes[one.policy][one.training]
            depends = (worn, who, one[1:], *own_code(one.feed, str(self.setup.cells)))
            key = sha256(repr((worn, who, one.feed, one.severity)).encode()).hexdigest()
            arguments = self.setup, policy, one, key, who
            cases.append(Case(f"episode {one.number}", run_case, arguments, depends=depends))
        return cases

    def stage(self, episode: Episode, **drawing: Any) -> Stage:
        """Make the environment and the policy of an episode."""
        policy = self.policies[episode.policy][episode.training]
        return Stage.make(self.setup, policy, episode.feed, episode.severity, episode.policy, **drawing)

    def try_out(self) -> None:
        """Raise an error at a policy or a feed that cannot even begin: here, and not one by one.

        Each feed is tried at its largest severity, and each policy on one of them.
        """
        hardest = sorted(self.episodes, key=lambda episode: episode.severity)
        kinds = {(of, value): one for one in hardest for of, value in (("feed", one.feed), ("who", one[1:3]))}
        for one in {episode.number: episode for episode in kinds.values()}.values():
            stage = self.stage(one)
            try:
                stage.check(one.seed)
            finally:
                stage.env.close()

    @cached_property
    def _hashes(self) -> dict[str, list[str]]:
        return {
            name: [_identity(one, self.setup.env_id) for one in arm] for name, arm in self.policies.items()
        }


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The results of an evaluation.

    Attributes:
        plan: The grid.
        folder: Where everything is kept; ``None`` if nothing is.
        rows: One row per episode, see :mod:`surefoot.experiments.evaluate.episode`.
        computed: How many episodes this call ran; the others were there.
    """

    plan: Plan
    folder: Path | None
    rows: Frame
    computed: int

    @property
    def failed(self) -> Frame:
        """The rows of episodes that could not be run through."""
        return self.rows[self.rows["error"] != ""]

    @property
    def finished(self) -> Frame:
        """The rows of all others."""
        return self.rows[self.rows["error"] == ""]

    @property
    def answer(self) -> str:
        """What drift costs, and what a calibrator wins back, in words with intervals."""
        from surefoot.experiments.evaluate.page import answer

        return answer(self.finished)

    def page(self, folder: Path | str | None = None) -> Path:
        """Write the page into a folder, by default that of the evaluation, and return its path."""
        from surefoot.experiments.evaluate.page import write_page

        where = self.folder if folder is None else Path(folder)
        if where is None:
            raise ValueError("Nothing was kept: give a folder to page(...), or 'out' to evaluate(...).")
        return write_page(self, where).page

    def again(self, case: int) -> "Repeated":
        """Run one episode again, and compare it with its row; ValueError if there is none."""
        return repeat(self, case)


def evaluate(
    make_env: Any,
    policy: Any,
    *,
    feeds: Sequence[str] = FEEDS,
    severities: Sequence[float] = SEVERITIES,
    seeds: int | Sequence[int] = 50,
    out: Path | str | None = None,
    jobs: int | None = None,
    statistics: Any = None,
    trusted: bool = False,
    any_version: bool = False,
    **setup: Any,
) -> Evaluation:
    """Run a policy on true, drifting and calibrated feet, on the same episodes; return one row per episode.

    ``joblib.parallel_config`` chooses another backend than processes of this machine, such as dask.

    Args:
        make_env: An id of Gymnasium, a function that makes an environment, or ``"module:function"``. The
            environment is bare: sensors and calibrators are put around it.
        policy: A policy, see :mod:`surefoot.experiments.evaluate.policies`; a list of policies that differ by
            their training seed; or a mapping from names to either, to compare them.
        feeds: See :mod:`surefoot.experiments.evaluate.feet`.
        severities: Factors of all errors of the feet's sensors. True feet have none and are run once per
            seed; at severity 0 every feed is the truth.
        seeds: How many, from 20000 on, or which.
        out: Folder for rows and pages; the same call goes on where it was stopped.
        jobs: Processes of this machine; ``None`` for what ``joblib.parallel_config`` says, else one.
        statistics: ``VecNormalize`` or its file, of a Stable-Baselines3 policy that was trained with it.
        trusted: Whether zips of Stable-Baselines3, which run pickled code, may be opened.
        any_version: Whether to go on with rows that other versions made.
        **setup: Fields of :class:`~surefoot.experiments.evaluate.setup.Setup`: how the environment is made,
            worn and observed.

    Raises:
        TypeError: If the environment is not built on MuJoCo.
        ValueError: If something is refused; nothing was run then.
        StudyError: If the folder holds another study, is in use, or its disk is full.
    """
    given: dict[str, Any] = {"feeds": feeds, "severities": severities, "seeds": seeds, **setup}
    plan = Plan.of(make_env, policy, statistics=statistics, trusted=trusted, **given)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()) if out is None else out)
        rows, computed = run_plan(plan, folder, jobs=jobs, any_version=any_version)
    return Evaluation(plan, None if out is None else folder, rows, computed)


def run_plan(
    plan: Plan, folder: Path, *, jobs: int | None = None, any_version: bool = False
) -> tuple[Frame, int]:
    """Run the episodes that a folder lacks; return all rows, and how many were run."""
    cases, store = plan.cases(), Store(folder)
    if (folder / PLAN).is_file():
        store.read()
        # What is whole is not run again, whatever made it.
        any_version |= all(store.holds(case, any_version=True) for case in cases)
    if not all(store.holds(case, any_version=any_version) for case in cases):
        with working("trying out policies and feet"):
            plan.try_out()
    with store.open_for(plan.describe(), versions(), any_version=any_version), runner(jobs) as crew:
        computed = crew.run(
            "Episodes",
            cases,
            store,
            failed=lambda case, error: _rows(case.arguments[2], outcome_of_failure(error), plan.setup),
            count={"fell": lambda outcome: any(row["fell"] for row in outcome.tables.get(TABLE, ()))},
            any_version=any_version,
        )
        rows = store.rows(TABLE, cases).sort_values("case", ignore_index=True)
        save_frames(folder, {TABLE: rows})
    _STAGES.clear()
    return rows, computed


def load_evaluation(plan: Plan, folder: Path) -> Evaluation:
    """Return the rows in a folder as an evaluation, also of one under way; ValueError if there are none."""
    store, cases = Store(folder), plan.cases()
    if not (folder / PLAN).is_file():
        raise ValueError(f"'{folder}' holds no evaluation; give its folder with --out.")
    store.read()
    rows = store.rows(TABLE, cases)
    if not len(rows):
        raise ValueError(f"'{folder}' holds no episode of this evaluation: it was made by other options.")
    return Evaluation(plan, folder, rows.sort_values("case", ignore_index=True), 0)


def arms_of(policy: Any, *, statistics: Any = None, trusted: bool = False) -> dict[str, tuple[Any, ...]]:
    """Return the trainings of each arm of a comparison, ready for other processes; ValueError for none."""
    given = policy if isinstance(policy, Mapping) else {_name_of(policy): policy}
    arms = {}
    for name, members in given.items():
        listed = members if isinstance(members, list | tuple) else [members]
        arms[str(name)] = tuple(portable(one, statistics=statistics, trusted=trusted) for one in listed)
    if not arms or not all(arms.values()):
        raise ValueError("'policy' names no policy, so that there is nothing to run.")
    return arms


def _name_of(policy: Any) -> str:
    return short_name(str(policy)) if isinstance(policy, str | Path) else "policy"


def _identity(policy: Any, env_id: str) -> str:
    """Return a policy for the plan: its name, if it has one, and its hash."""
    own = fingerprint(policy, env_id)
    return own if not isinstance(policy, str) or own == policy else f"{policy} {own}"


def _seeds(seeds: int | Sequence[int], policy: Any) -> tuple[int, ...]:
    """Return the seeds; ValueError at those that a training has used."""
    if isinstance(seeds, bool | float | str):
        raise ValueError(f"'seeds' must be a whole number of seeds or a list of seeds, got {seeds!r}.")
    if isinstance(seeds, int | np.integer):
        seeds = range(FIRST_SEED, FIRST_SEED + seeds)
    if not len(seeds):
        raise ValueError("'seeds' is empty, so that there is nothing to run; name at least one.")
    seeds = [int(seed) if isinstance(seed, np.integer) else seed for seed in seeds]
    for seed in seeds:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < TRAINING_SEEDS:
            raise ValueError(
                f"A seed must be a whole number from 0 to {TRAINING_SEEDS - 1}, got {seed!r}: seeds from "
                f"{TRAINING_SEEDS} on are training's."
            )
    arms = policy.values() if isinstance(policy, Mapping) else [policy]
    for one in (one for arm in arms for one in (arm if isinstance(arm, list | tuple) else [arm])):
        first = getattr(one, "seed", None)
        used = range(first, first + getattr(one, "n_envs", 1)) if isinstance(first, int) else range(0)
        if both := sorted(set(seeds) & set(used)):
            raise ValueError(
                f"Seed {both[0]} was used in training (the model's seed is {first}, with {len(used)} "
                f"environments): evaluate on other seeds, for example seeds=50, which begin at {FIRST_SEED}."
            )
    return tuple(seeds)


def _grid(
    arms: Mapping[str, tuple[Any, ...]],
    feeds: Sequence[str],
    severities: Sequence[float],
    seeds: Sequence[int],
) -> Iterator[Episode]:
    """Yield all episodes, numbered; seeds vary fastest, and true feet have no severity."""
    for name, values in (("feeds", feeds), ("severities", severities), ("seeds", seeds)):
        if isinstance(values, str) or not len(values):
            raise ValueError(f"'{name}' must be a list with at least one element, got {values!r}.")
        if twice := [value for i, value in enumerate(values) if value in values[:i]]:
            raise ValueError(f"'{name}' holds {twice[0]!r} twice: the same episodes would be run again.")
    for severity in severities:
        if isinstance(severity, str | bool) or not (isfinite(severity) and severity >= 0.0):
            raise ValueError(f"A severity must be finite and not negative, got {severity!r}.")
    numbers = count()
    feeds = [RAW if feed == "none" else feed for feed in feeds]
    for arm, members in arms.items():
        # Who does nothing looks at no feed, and is run on true feet alone.
        looked_at = (TRUE,) if members == (NOBODY,) else feeds
        for training, feed in product(range(len(members)), looked_at):
            for severity, seed in product((0.0,) if method_of(feed) is None else severities, seeds):
                yield Episode(next(numbers), arm, training, feed, float(severity), seed)


def run_case(setup: Setup, policy: Any, episode: Episode, key: str, who: str = "") -> Tables:
    """Run one episode in an environment that this process may have made before, and return its row.

    ValueError if the file behind a policy is no longer the one whose hash ``who`` has.
    """
    if who and isinstance(policy, str) and _identity(policy, setup.env_id) != who:
        raise ValueError(
            f"The file behind the policy '{policy}' is another one than the study began with; put the old "
            "one back, or begin in another folder."
        )
    if len(_STAGES) >= _MOST_STAGES:
        _STAGES.clear()
    if key not in _STAGES:
        _STAGES[key] = Stage.make(setup, policy, episode.feed, episode.severity, episode.policy)
    return _rows(episode, _STAGES[key].row(episode.seed), setup)


def _rows(episode: Episode, outcome: Mapping[str, Any], setup: Setup) -> Tables:
    number, *what = episode
    grid = dict(zip(Episode._fields[1:], what, strict=True))
    fault = "" if method_of(episode.feed) is None or not setup.faults else str(setup.faults)
    return {TABLE: [{"case": number, **grid, "fault": fault, **outcome, **versions()}]}


@dataclass(frozen=True)
class Repeated:
    """An episode, its row in the results, and the row of its repetition."""

    episode: Episode
    then: Mapping[str, Any]
    now: Mapping[str, Any]

    @property
    def different(self) -> tuple[str, ...]:
        """Names of the outcomes that came out otherwise, in any digit; of errors the last line counts."""
        changed = [name for name in OUTCOME if not _same(self.then[name], self.now[name])]
        last = {str(row["error"]).strip().rpartition("\n")[2] for row in (self.then, self.now)}
        return (*changed, *(["error"] if len(last) > 1 else []))

    @property
    def other_versions(self) -> tuple[str, ...]:
        """Versions that differ between then and now, in words."""
        changed = [name for name in VERSIONS if self.then[name] != self.now[name]]
        return tuple(f"{name} {self.then[name]} -> {self.now[name]}" for name in changed)


def repeat(results: Evaluation, number: int) -> Repeated:
    """Run an episode of an evaluation again, and compare it with its row; ValueError if there is none."""
    found = results.rows[results.rows["case"] == number]
    if not len(found):
        raise ValueError(
            f"There is no row of case {number}; this evaluation has {len(results.plan.episodes)}, from 0 on, "
            f"of which {len(results.rows)} were run."
        )
    plan, one = results.plan, results.plan.episodes[number]
    policy = plan.policies[one.policy][one.training]
    outcome = attempt(Case("repeated", run_case, (plan.setup, policy, one, f"repeated {number}"), depends=()))
    _STAGES.clear()
    failed = _rows(one, outcome_of_failure(outcome.error), plan.setup)
    (now,) = (failed if outcome.error else outcome.tables)[TABLE]
    return Repeated(one, found.iloc[0].to_dict(), now)


def _same(one: Any, other: Any) -> bool:
    both_nan: bool = one != one and other != other
    return both_nan or bool(one == other)
