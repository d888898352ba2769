"""Checks of a fit's answer: what the data determine, and what contradicts them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.covariance import noise_level, weighted_inverse
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.input_checks import Contradiction
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    INERTIA,
    MASS,
    MOMENT,
    STATIC,
    different_masses,
)
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.solve import (
    ROUNDING,
    Problem,
    Solution,
    expand,
    hanging,
    of_unit_length,
    transforms,
)
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "DataRank",
    "added_slope",
    "check_axes",
    "check_factory",
    "check_masses",
    "check_rotation",
    "check_scale",
    "data_rank",
    "limb_warnings",
    "projected",
    "with_factory_scale",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_UNSEEN = 1e-7
"""A direction is unseen if its singular value, for columns of unit length, is this share of the largest."""

_TAKES_PART = 1e-3
"""An unknown takes part in the unseen directions if its share of their square is above this."""

_SOME_TURN = 0.1
"""Rotation vector in rad, along each axis, at which the rank is judged: at zero it may be lower by chance."""

_CURES = {
    "its inertia": "Swing the limb faster about all axes, or leave the angular velocities out.",
    "the temperature's coefficients": "Leave the temperature out, or let it change within a set.",
}
"""For unknowns that masses at other places would not show."""

_PLACES = (
    "Put the masses at places that do not lie on one line, and change how much is added; or give a factory "
    "matrix to lean on."
)

_NO_LOAD = 1e-300
"""What stands for a load of zero in a quotient."""

_ONE_TURN = float(np.cos(np.radians(5.0)))
"""Cosine of the angle below which two rotations are one."""

_AGED = 0.1
"""Share of what hangs there up to which no factory matrix is looked at."""

_CORRUPT, _BETTER = 0.4, 0.7
"""A factory matrix that misses the first share may be meant otherwise: that is named if it leaves less than
the second share of it."""

_ALIKE = 0.02
"""Shares that differ by less are alike."""

_ALONE, _MISPRINT = 0.6, 0.7
"""One of its entries is to blame if another in its place leaves less than the first share, and if it must
change by the second share of the row's largest entry: sensors age by less."""

_FACTORY_SCALE = (0.5, 2.0)
"""The loads that a factory matrix shows over the true ones must lie between these: sensors age by less."""

_CLEARLY = 0.5
"""Another unit is a refusal if it leaves less than this share of that factor's logarithm, else a warning."""

_APART = 3.0
"""Axes whose factors differ by less than this have aged from a common one."""

_LOADED = 0.1
"""Share of the largest load, torques over the lever, from which on an axis shows that scale."""

_FACTORY_STD = 0.1
"""Deviation of a factory matrix's scale, as a share: real sensors were off by 11 and 19 %."""

_LET = 2.0
"""Deviations of the limb's mass by the data alone up to which they let a factory matrix draw it away."""

_SIGMAS = 4.0
"""Deviations between the limb by the readings and as it was given that are worth a warning."""

_STRAINED = 3.0
"""Sets whose squares are below this multiple of what noise explains agree with each other."""

_SLIGHT = 0.15
"""Share of the tolerance up to which no set is looked at by itself."""

_POUND = 0.45359237
"""In kg."""

_UNITS = {
    "": 1.0,
    "masses are in lb, and kg are expected": 1.0 / _POUND,
    "masses in kg were taken for lb and converted": _POUND,
    "masses are in grams": 1e3,
    "units of the factory matrix are kgf": GRAVITY,
}
"""What loads that hang there may be too large by over those that a factory matrix shows."""

_CULPRIT, _WEIGHED = 0.8, 0.3
"""A set is looked at if another mass in it explains the first share of what is left, and is off by more than
the second share of the tolerance."""

_TURNED, _TURNED_SIGMAS = 0.5, 4.0
"""Share of the tolerance, in rad, and deviations by which an IMU may seem turned without a warning."""

_REACH = 0.1
"""Lever in m by which moments of masses that all hang at one place are judged."""


@dataclass(frozen=True)
class DataRank:
    """What the data, and what is known of the limb, determine without a factory matrix.

    Attributes:
        found: Number of directions that they determine.
        missing: Number that they leave open.
        open_unknowns: What takes part in those, in words.
    """

    found: int
    missing: int
    open_unknowns: tuple[str, ...]

    def refusal(self, problem: Problem) -> CalibrationRefused:
        """Return what is missing and what would bring it (in-situ paper, Lemma 2)."""
        masses = different_masses(problem.added[:, :STATIC])
        unknowns = self.found + self.missing
        if masses < ENOUGH_MASSES:
            return CalibrationRefused(
                f"Different added masses: {masses}, and three are needed to determine a matrix (Lemma 2); "
                f"{self.found} of {unknowns} unknowns follow from {len(problem.sets)} set(s).",
                "Add sets with other masses at other places, or give a factory matrix to lean on.",
            )
        cures = [cure for name, cure in _CURES.items() if name in self.open_unknowns]
        return CalibrationRefused(
            f"The {masses} different added masses determine {self.found} of {unknowns} unknowns; what stays "
            f"open: {', '.join(self.open_unknowns)}.",
            (cures or [_PLACES])[0],
        )

    def warning(self) -> str:
        """Return what leans on the factory matrix."""
        return (
            f"The data determine {self.found} of {self.found + self.missing} unknowns; the rest of "
            f"{', '.join(self.open_unknowns)} leans on the factory matrix."
        )


def data_rank(problem: Problem, limb: Vector) -> DataRank:
    """Return the rank of the fit's Jacobian at a limb, without the factory matrix."""
    outer = np.concatenate([limb[: problem.parameters], np.full(3 * problem.rotation, _SOME_TURN)])
    J = expand(replace(problem, prior_response=None), outer).jacobian
    _, singular, right = np.linalg.svd(of_unit_length(J)[0], full_matrices=True)
    found = int(np.sum(singular > _UNSEEN * singular[0]))
    part = np.sum(right[found:] ** 2, axis=0) > _TAKES_PART
    channels = len(problem.whitening)
    response = part[: channels * problem.inputs].reshape(channels, problem.inputs)
    limb_part = part[channels * problem.inputs :]
    named = {
        "the matrix": response[:, :AXES],
        "the temperature's coefficients": response[:, AXES:],
        "the limb's mass": limb_part[MASS],
        "its centre of mass": limb_part[MOMENT],
        "its inertia": limb_part[INERTIA] if problem.moving else part[:0],
        "the hysteresis": limb_part[problem.loops],
        "the accelerometer's rotation": limb_part[problem.parameters :],
    }
    return DataRank(found, J.shape[1] - found, tuple(name for name, taking in named.items() if taking.any()))


def check_rotation(found: Sequence[Solution]) -> None:
    """Raise CalibrationRefused if two rotations fit equally well, as for masses that hang in one plane."""
    best = found[0].rotation
    for other in found[1:]:
        cosine = (np.trace(best.T @ other.rotation) - 1.0) / 2.0
        if cosine < _ONE_TURN:
            CalibrationRefused(
                "Two rotations of the accelerometer, "
                f"{np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees apart, fit the readings "
                "equally well: added masses in one plane do not tell a sensor from its mirror image.",
                "Hang a mass off the plane of the others, or give a factory matrix.",
            ).unless_accepted()


def check_scale(fit: InSituFit, options: InSituOptions) -> None:
    """Raise CalibrationRefused if the limb's mass, and with it the scale of all forces, is unknown."""
    mass, deviation = fit.limb.mass, fit.limb_mass_std
    if not (mass > 0.0 and deviation <= options.scale_tolerance * mass):
        Contradiction(
            f"The limb's mass comes out as {mass:.3g} kg with a standard deviation of {deviation:.2g} kg, so "
            "the scale of all forces is as unsure.",
            "Add larger masses or at places further apart, record for longer, or give the limb's mass.",
        ).unless_accepted()


def check_axes(fit: InSituFit, problem: Problem, solution: Solution, options: InSituOptions) -> None:
    """Raise CalibrationRefused if some axis was never seen, however well the limb's mass is known."""
    T = transforms(problem, solution)[:, :AXES]
    load = np.zeros(AXES)
    for part, t in zip(problem.sets, T, strict=True):
        mean = t @ part.mean
        load += np.sum((part.uu @ t.T) ** 2, axis=0) + part.samples * mean**2
    load = np.sqrt(load)
    channels = fit.matrix.shape[1]
    for axis, name in enumerate(FORCE_TORQUE_NAMES):
        row = fit.columns.row(axis)
        spread = fit.response.T @ fit.covariance[row, row] @ fit.response
        doubt = float(np.sqrt(np.sum(np.diag(spread) * load**2))) / max(float(load[axis]), _NO_LOAD)
        if not doubt < options.axis_tolerance:
            CalibrationRefused(
                f"The axis {name} is known to {doubt:.0%} of its load only.",
                f"Hang masses where they load {name} differently, check that all {channels} channels are "
                "connected, each once, or give a factory matrix.",
            ).unless_accepted()


def check_factory(factory: Matrix, problem: Problem, solution: Solution, determined: bool) -> tuple[str, ...]:
    """Raise CalibrationRefused if a factory matrix contradicts the readings, and name how it is to be read.

    Return a warning if its scale is nearer to another unit of the masses than to what is expected.

    Forces and torques (over the largest lever) that it shows of all sets, while gravity turned, are held
    against what hangs there: by a solution that does without it if the limb is determined or known, else by
    the limb that it shows itself.
    """
    limb_known = determined or len(problem.limb_root) == STATIC
    expected = _loads(problem, solution) if limb_known else _hangs(factory, problem, solution)
    measured = np.concatenate([part.response[:, DIRECT] @ part.turned.T for part in problem.sets], axis=1)
    masses = problem.added[:, MASS]
    levers = np.linalg.norm(problem.added[masses > 0.0, MOMENT], axis=1) / masses[masses > 0.0]
    lever = max(float(np.max(levers, initial=0.0)), _REACH)
    weight = np.repeat([1.0, 1.0 / lever], 3)[:, None]

    def missed(matrix: Matrix) -> float:
        hangs = expected if limb_known else _hangs(matrix, problem, solution)
        if hangs is None:
            return np.inf
        return float(np.linalg.norm(weight * (hangs - matrix @ measured)) / np.linalg.norm(weight * hangs))

    now = missed(factory)
    if now < _AGED:
        return ()
    at_odds = f"misses {now:.0%} of what hangs there" if now < 1.0 else "contradicts what hangs there"
    readings = [(missed(matrix), words) for words, matrix in _other_readings(factory)]
    least = min(share for share, _ in readings)
    best, words = next(one for one in readings if one[0] < least + _ALIKE)
    others = [] if expected is None else _other_entries(factory, measured, expected, missed)
    (entry, changed), (second, _) = sorted([*others, (np.inf, ""), (np.inf, "")])[:2]
    if now > _CORRUPT and best < min(_BETTER * now, entry):
        CalibrationRefused(
            f"The factory matrix {at_odds}. Likeliest: {words}, which leaves {best:.0%}.",
            "Correct that, or compare the matrix with the maker's sheet.",
        ).unless_accepted()
    # One set shows so little of an aged matrix that many an entry seems to explain it.
    elif entry < _ALONE * (now if determined else min(now, second)):
        CalibrationRefused(
            f"{changed} leaves {entry:.0%} of what hangs there, and the matrix as it is {at_odds}.",
            "Compare the matrix with the maker's sheet, its signs and exponents first.",
        ).unless_accepted()
    if expected is None:
        return ()
    scale, common = _scale(factory @ measured, expected, weight)
    left = {words: abs(float(np.log(max(scale, _NO_LOAD) * factor))) for words, factor in _UNITS.items()}
    unit = min(left, key=left.__getitem__) if common else ""
    shows = f"By the factory matrix the readings show {scale:.3g} times the loads that hang there."
    if unit:
        shows += f" Likeliest: {unit}, which leaves {scale * _UNITS[unit]:.3g} times."
    check = (
        "Check that it is this sensor's, the order of its channels, its units (N and N m per count) and "
        "those of the masses (kg)."
    )
    if unit and left[unit] < _CLEARLY * left[""]:
        CalibrationRefused(shows, check).unless_accepted()
    elif not _FACTORY_SCALE[0] < scale < _FACTORY_SCALE[1]:
        Contradiction(shows, check).unless_accepted()
    if not unit:
        return ()
    return (f"{shows} {check}",)


def _scale(shown: Matrix, expected: Matrix, weight: Matrix) -> tuple[float, bool]:
    """Return the factor between loads that a matrix shows and those that hang there, and if axes share it.

    Axes age each by itself, and units change all alike: it is the geometric mean of the axes that are loaded
    (shape (6, n) each), or that of the forces where these axes differ by more than age.
    """
    load = np.sqrt(np.sum((weight * expected) ** 2, axis=1))
    loaded = load > _LOADED * np.max(load)
    of_axis = np.sum(shown * expected, axis=1)[loaded] / np.sum(expected**2, axis=1)[loaded]
    if np.min(of_axis) > np.max(of_axis) / _APART:
        return float(np.exp(np.mean(np.log(of_axis)))), True
    return float(np.sum(shown[:3] * expected[:3]) / np.sum(expected[:3] ** 2)), False


def _hangs(matrix: Matrix, problem: Problem, solution: Solution) -> Matrix | None:
    """Return T of all sets side by side with the limb that a matrix shows; None if its mass is negative."""
    seen = np.array([hanging(matrix, part, solution.rotation) for part in problem.sets])
    limb = solution.limb.copy()
    limb[:STATIC] = np.mean(seen - problem.added[:, :STATIC], axis=0)
    return None if limb[MASS] <= 0.0 else _loads(problem, replace(solution, limb=limb))


def _loads(problem: Problem, solution: Solution) -> Matrix:
    """Return the loads of all sets side by side, by as much as gravity turned in each, shape (6, 3 J)."""
    T = transforms(problem, solution)[:, :AXES, DIRECT]
    return np.concatenate([t @ part.turned.T for part, t in zip(problem.sets, T, strict=True)], axis=1)


def _other_readings(factory: Matrix) -> list[tuple[str, Matrix]]:
    """Return what may be wrong with a whole matrix, or with units, and the matrix as it then is."""
    forces, torques = np.repeat([1.0, 0.0], 3)[:, None], np.repeat([0.0, 1.0], 3)[:, None]
    found = [
        (words, (force * forces + torque * torques) * factory)
        for words, force, torque in (
            ("the sign of gravity or of the factory matrix is turned", -1.0, -1.0),
            ("all places of the masses, or the factory's torques, are negated", 1.0, -1.0),
            ("the factory's forces are negated", -1.0, 1.0),
            ("masses are in grams", 1e3, 1e3),
            ("masses are in lb, and kg are expected", 1.0 / _POUND, 1.0 / _POUND),
            ("places are in mm, and m are expected", 1.0, 1e3),
            ("places are in cm, and m are expected", 1.0, 1e2),
            ("units of the factory's torques are N mm", 1.0, 1e-3),
            ("units of the factory matrix are kgf", GRAVITY, GRAVITY),
        )
    ]
    found.append(("rows of the factory matrix are torques first", np.roll(factory, 3, axis=0)))
    if factory.shape[0] == factory.shape[1]:
        inverse = np.asarray(np.linalg.inv(factory), dtype=np.float64)
        found.append(("the factory matrix is transposed", factory.T))
        found.append(("the factory matrix is inverted: counts per N", inverse))
        found.append(("the factory matrix is inverted and transposed", inverse.T))
    return found


def _other_entries(
    factory: Matrix, measured: Matrix, expected: Matrix, missed: Callable[[Matrix], float]
) -> list[tuple[float, str]]:
    """Return what another value of each entry misses, and that value, in words."""
    wrong, found = expected - factory @ measured, []
    steps = wrong @ measured.T / np.maximum(np.sum(measured**2, axis=1), _NO_LOAD)
    misprint = np.abs(steps) >= _MISPRINT * np.max(np.abs(factory), axis=1, keepdims=True)
    for row, column in np.argwhere(misprint):
        matrix = factory.copy()
        matrix[row, column] += steps[row, column]
        words = (
            f"Entry [{row}, {column}] of the factory matrix, {factory[row, column]:.4g}, contradicts the "
            f"readings: {matrix[row, column]:.4g} in its place"
        )
        found.append((missed(matrix), words))
    return found


def check_masses(
    problem: Problem, solution: Solution, noise: Matrix, options: InSituOptions
) -> tuple[str, ...]:
    """Raise Contradiction if the readings contradict what was added; return warnings if they doubt it."""
    freedom = solution.residual.size - solution.jacobian.shape[1]
    left = float(np.sum(solution.residual**2))
    if not (freedom > 0 and left >= _STRAINED * freedom) or not np.any(problem.added[:, MASS] > 0.0):
        return ()
    off = _disagreement(problem, _seen_masses(problem, solution, noise))
    contradiction = Contradiction(
        "The added masses contradict each other or the readings.",
        "Weigh what was added and measure where it hung, or leave the set out.",
    )
    if np.max(off) > options.mass_tolerance:
        contradiction.unless_accepted()
    added = problem.added[:, :STATIC]
    for j in range(len(added)) if np.max(off) > _SLIGHT * options.mass_tolerance else ():
        changes = np.zeros((STATIC, *problem.added.shape))
        changes[:, j, :STATIC] = np.eye(STATIC)
        step, explained = _explained(problem, solution, changes)
        changed = added.copy()
        changed[j] += step
        amount = float(np.max(_disagreement(problem, changed)))
        if explained > _CULPRIT * left and amount > _WEIGHED * options.mass_tolerance:
            contradiction.unless_accepted()
    if problem.rotation:
        return ()
    turn, explained = _explained(problem, solution, np.stack([_turn(problem.added, e) for e in np.eye(3)]))
    angle = float(np.linalg.norm(turn))
    spread = max(left / freedom, noise_level(problem.sets))
    if angle < _TURNED * options.mass_tolerance or explained < _TURNED_SIGMAS**2 * spread:
        return ()
    if angle > options.mass_tolerance:
        contradiction.unless_accepted()
    return (
        f"The IMU seems to be turned by {np.degrees(angle):.1f} degrees against the sensor's frame, and the "
        "wrench with it: give its rotation (R_sensor_accelerometer), or let the fit find it "
        "('estimate_rotation', with the limb at rest).",
    )


def _turn(added: Matrix, axis: Vector) -> Matrix:
    """Return the change of what was added by turning all places about an axis, shape (J, p)."""
    change = np.zeros_like(added)
    change[:, MOMENT] = np.cross(axis, added[:, MOMENT])
    return change


def _explained(problem: Problem, solution: Solution, changes: NDArray[np.float64]) -> tuple[Vector, float]:
    """Return the step along changes of what was added, (q, J, p), that fits best, and what it explains."""
    slopes = np.stack([added_slope(problem, solution, change) for change in changes], axis=1)
    rows = solution.residual.ravel()
    free = projected(solution, slopes)
    step = -np.linalg.lstsq(free, np.pad(rows, (0, len(free) - len(rows))), rcond=None)[0]
    return np.asarray(step), float(np.sum((free @ step) ** 2))


def added_slope(problem: Problem, solution: Solution, change: Matrix) -> Vector:
    """Return the slope of the rows of the sets, whitened, by a change of what was added, shape (J, p)."""
    dT = np.einsum("jp,pws->jws", change, problem.basis)
    if problem.rotation:
        dT[..., DIRECT] = dT[..., DIRECT] @ solution.rotation
    white = problem.whitening @ solution.A
    rows = [part.uu[:, : d.shape[1]] @ d.T @ white.T for part, d in zip(problem.sets, dT, strict=True)]
    return np.stack(rows).ravel()


def projected(solution: Solution, slopes: Matrix) -> Matrix:
    """Return what the unknowns of a solution leave of slopes of the rows of the sets, shape (rows, q)."""
    left, singular, _ = np.linalg.svd(solution.jacobian, full_matrices=False)
    basis = left[:, singular > ROUNDING * singular[0]]
    slopes = np.pad(slopes, ((0, len(basis) - len(slopes)), (0, 0)))
    return np.asarray(slopes - basis @ (basis.T @ slopes))


def _seen_masses(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Return (m, m c) that was added to each set by the readings, in kg and kg m, shape (J, 4)."""
    matrix = weighted_inverse(solution.A, noise)
    beside = (solution.response @ transforms(problem, solution))[..., DIRECT.stop :]
    total = [
        hanging(matrix, part, solution.rotation, rest)
        for part, rest in zip(problem.sets, beside, strict=True)
    ]
    return np.asarray(np.array(total) - solution.limb[:STATIC])


def _disagreement(problem: Problem, seen: Matrix) -> Vector:
    """Return how far each set's (m, m c) is off, as shares of the largest mass and its lever, shape (J,)."""
    added = problem.added[:, :STATIC]
    off = np.abs(seen - added)
    mass = added[:, MASS]
    heaviest = np.max(mass)
    moments = added[:, MOMENT] - np.mean(added[mass > 0.0, MOMENT], axis=0) * (mass > 0.0)[:, None]
    reach = max(float(np.max(np.linalg.norm(moments, axis=1))), _REACH * heaviest)
    return np.asarray(np.maximum(off[:, MASS] / heaviest, np.max(off[:, MOMENT], axis=1) / reach))


def limb_warnings(known: KnownLimb, fit: InSituFit, alone: tuple[float, float] | None) -> tuple[str, ...]:
    """Return a warning if the readings alone give the limb another mass than was given.

    ``alone`` is the limb's mass and its deviation in kg by the readings; None if they do not determine it.
    """
    mass, deviation = (fit.limb.mass, 0.0) if alone is None else alone
    off = abs(mass - known.mass) / float(np.hypot(deviation, known.mass_std))
    if off < _SIGMAS:
        return ()
    return (
        f"By the readings the limb weighs {mass:.3f} kg, and {known.mass:.3f} kg were given, {off:.0f} "
        "deviations apart: the added masses, their places or the limb's mass are not as given.",
    )


def with_factory_scale(fit: InSituFit, of_data: float = 0.0) -> InSituFit:
    """Return a fit whose scale is the factory's with a covariance that doubts it, and a warning.

    ``of_data`` is the share of the information on the scale that the data give. What is off in the factory
    matrix by a common factor goes into the fit by the rest, but no further than the data let it.
    """
    covariance, columns = fit.covariance.copy(), fit.columns
    doubt = _FACTORY_STD * (1.0 - of_data)
    if of_data > 0.0:
        doubt = min(doubt, _LET * fit.limb_mass_std / (fit.limb.mass * float(np.sqrt(of_data))))
    scale = doubt * fit.matrix.ravel()
    covariance[columns.matrix, columns.matrix] += np.outer(scale, scale)
    weight = doubt * fit.limb.parameters[:STATIC]
    covariance[columns.limb, columns.limb] += np.outer(weight, weight)
    if of_data > 0.0:
        return replace(fit, covariance=covariance)
    warning = "The scale of all forces is the factory matrix's; weigh the limb to know it."
    return replace(fit, covariance=covariance, warnings=(*fit.warnings, warning))
