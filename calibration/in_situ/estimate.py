"""The fit of a task: one solution for every likely size of the maker's errors.

The way is the same for one set or a hundred, at rest or moving: data that the accelerometer's own errors are
taken off (:mod:`~surefoot.calibration.in_situ.imu`), sets compressed to a few rows each
(:mod:`~surefoot.calibration.in_situ.solver.compress`), the fit, then temperature and hysteresis where they
are worth their unknowns, and last the delay of the IMU.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.check import measure_residual
from surefoot.calibration.in_situ.covariance import OpenErrors, law_doubts
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, Task, Vector, shift
from surefoot.calibration.in_situ.hysteresis import Loops, fit_hysteresis, shows_loops
from surefoot.calibration.in_situ.imu import Sphere, delay_left, errors_of_imu, fit_sphere, level
from surefoot.calibration.in_situ.judge import check_rotation, data_rank
from surefoot.calibration.in_situ.solver.compress import compress
from surefoot.calibration.in_situ.solver.maker import KEPT, Leaning, lean, prior_of
from surefoot.calibration.in_situ.solver.problem import Problem, problem_of, starts
from surefoot.calibration.in_situ.solver.solve import Solution, minima
from surefoot.calibration.in_situ.temperature import add_gains, centre_temperatures
from surefoot.calibration.results import Finding

_DELAYS, _SETTLED = 6, 1e-4  # steps at most until the delay of an IMU has settled, and its last step in s


class Fits(NamedTuple):
    """The fits of sets as they are."""

    members: list[Leaning]  # by the likely sizes of the maker's errors, the likeliest first
    lagging: Solution  # with hysteresis, worth it or not
    plain: Problem  # without hysteresis, gains by temperature and the maker's prior
    determined: bool  # whether the sets determine all unknowns without the maker's prior
    findings: list[Finding]


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved task, on its way to the answer."""

    task: Task  # the input
    sets: tuple[InSituSet, ...]  # its sets with a levelled gravity, in step with the readings
    sphere: Sphere  # errors of the accelerometer by gravity's length
    delay: float  # by which gravity was late in s
    delay_std: float  # its deviation
    fits: Fits  # of these sets
    reference: float | None  # mean of the temperatures; None where they take no part

    @cached_property
    def hidden(self) -> float:
        """Share of hysteresis that the readings may hide.

        Loops leave about their own share of the spread: where less is left, they are no larger.
        """
        problem, options = self.fits.members[0].solution.problem, self.task.options
        if not options.hysteresis or problem.hysteresis or (self.task.timed and shows_loops(problem)):
            return 0.0
        return min(float(limits.HYSTERESIS), measure_residual(problem.sets))

    def open_errors(self, solution: Solution) -> OpenErrors:
        """Errors of a solution by those of the IMU and by hysteresis that the fit does not contain."""
        of_imu = errors_of_imu(self.sets, solution, self.sphere, self.delay_std)
        pairs = zip(of_imu, law_doubts(solution, self.hidden), strict=True)
        return OpenErrors(*(np.concatenate(pair, axis=1) for pair in pairs))


def solve_task(task: Task) -> tuple[Solved, list[Finding]]:
    """Return the solutions of a task with all that they are to explain, and findings."""
    sphere = fit_sphere(task.sets)
    sets, reference, said = centre_temperatures(level(task.sets, sphere))
    fitted, late, delay, std = _fit(task, sets, reference is not None), sets, 0.0, 0.0
    for _ in range(_DELAYS if task.timed else 0):
        left = delay_left(late, fitted.lagging)
        worth = left.nats > 0.5 * np.log(sum(part.rows for part in fitted.lagging.problem.sets))
        std, then = left.std, max(delay + left.delay, 0.0)
        step = max(std, _SETTLED if delay else limits.LATE)
        if not worth or abs(then - delay) < step or then > limits.LATEST:
            break
        delay, late = then, tuple(shift(data, then) for data in sets)
        fitted = _fit(task, late, reference is not None)
    if delay:
        words = f"The IMU is late by {1e3 * delay:.1f} ms against the readings: it was shifted by that."
        said = [*said, Finding("clock", words, value=delay, limit=limits.LATE, refuses=False)]
    findings = [*sphere.findings, *said, *fitted.findings]
    return Solved(task, late, sphere, delay, std, fitted, reference), findings


def _fit(task: Task, sets: tuple[InSituSet, ...], warms: bool) -> Fits:
    """Fit sets by the likely sizes of the maker's errors, with temperature and hysteresis where worth it."""
    problem, first = pose(task, sets, task.options, warms)
    if task.mode != "free":
        problem = replace(problem, maker=prior_of(task, problem.noise))
    rank = data_rank(problem, first[0])
    determined = not rank.missing
    if not determined and problem.maker is None:
        raise rank.refusal(problem)
    members, findings = _lean(task, problem, first)
    plain = members[0].solution
    chosen = add_gains(plain) if warms and determined else plain
    loops = Loops(chosen, chosen)
    if task.options.hysteresis and task.timed:
        loops = fit_hysteresis(sets, chosen)
    if loops.best is not plain:
        members, findings = _lean(task, replace(loops.best.problem, maker=problem.maker), [loops.best.outer])
    if not determined:
        findings = [*findings, Finding("rank", rank.warning(task.owner), refuses=False)]
    return Fits(members, loops.lagging, replace(problem, maker=None), determined, findings)


def pose(
    task: Task, sets: tuple[InSituSet, ...], options: InSituOptions, warms: bool
) -> tuple[Problem, list[Vector]]:
    """Return the problem of sets without a maker's prior, and outer unknowns to start from."""
    problem = problem_of(task, compress(sets, options, task.moving, warms), warms)
    return problem, starts(problem, task.factory, problem.limb if task.limb is not None else None)


def _lean(task: Task, problem: Problem, first: list[Vector]) -> tuple[list[Leaning], list[Finding]]:
    """Return the fits by the likely sizes of the maker's errors, and findings."""
    if task.mode == "keep":
        assert problem.maker is not None
        held = replace(problem, maker=problem.maker._replace(std=KEPT * problem.maker.std))
        return lean(held, first, stated=True), []
    found = minima(problem, first)
    members = lean(problem, [found[0].outer], stated=task.options.factory_std is not None)
    return members, check_rotation(found)
