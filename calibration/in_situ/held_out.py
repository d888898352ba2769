r"""Whether a polynomial is worth having: fitted to some readings, held against others.

What the linear map leaves of the wrench that limb and added mass exert is regressed, axis by axis, on
products of the reading's components (:mod:`~surefoot.calibration.in_situ.nonlinear`), each set with an offset
of its own, by ridge regression: with the mean square of products of a standard reading near one, directions
of less than the ridge's weight show too little to be believed.

Degree and weight of each axis are those that predict best what took no part: each set in stretches of time,
and every whole set by the others. A row of a stream is no evidence on its neighbour, and a polynomial that
knows each set by heart errs on the next mass. An axis stays linear unless that is a clear gain.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.nonlinear import (
    NonlinearMap,
    Products,
    count_of_products,
    enclosing,
)
from surefoot.calibration.in_situ.options import DEGREES, InSituOptions
from surefoot.calibration.in_situ.outcome import with_bending
from surefoot.calibration.in_situ.validation import as_seen, expected_wrench
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.calibration.results import CalibrationRefused, FitResult

__all__ = ["choose_nonlinear", "with_nonlinear"]

Matrix = NDArray[np.float64]

_ROWS = 500
"""Means over windows of a set that are regressed, about."""

_STRAY = 10.0
"""Median absolute deviations of a set beyond which a row is something else, such as a touch."""

_STRETCHES = 5
"""Of time, into which a set is cut."""

_WEIGHTS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Of the ridge, to choose from."""

_GAIN = 0.9
"""Mean square error, over that of the linear map, below which a polynomial is worth having ..."""

_SURE = 2.0
"""... if it is by so many standard errors less than one."""

_BENT = {"residual_tolerance": 0.5, "mass_tolerance": 0.3}
"""Tolerances of the linear fit that a polynomial may still mend."""

_STILL_BENT = 0.01
"""Share of the readings' spread that may go with gravity's squares when the polynomial was taken off."""

_STAYS = (
    "No polynomial predicted what took no part clearly better than the linear map, or made the sets agree: "
    "the sensor counts as linear."
)
_SCALE = (
    "Added masses do not show the scale of a sensor that is not linear, as its slope is another one under a "
    "heavier load: weigh the limb."
)


def with_nonlinear(
    sets: tuple[InSituSet, ...], options: InSituOptions, answer: Callable[..., InSituFit], weighed: bool
) -> InSituFit:
    """Return the linear fit with a polynomial on top, where that predicts better; else the linear fit.

    Whether the sets agree with each other is judged by readings from which the polynomial was taken off;
    where they still do not, it does not count.

    Args:
        sets: The sets.
        options: Of the fit.
        answer: Returns the linear fit of sets with options, or the refusal.
        weighed: Whether the limb's mass was given.
    """
    plain = replace(options, nonlinear=None)
    wide = {name: max(least, getattr(options, name)) for name, least in _BENT.items()}
    linear = _answered(answer, sets, replace(plain, **wide))
    assert options.nonlinear is not None
    among = DEGREES if options.nonlinear == "auto" else [int(options.nonlinear)]
    found = None if linear is None else choose_nonlinear(sets, linear, among)
    checked = None
    if linear is not None and found is not None:
        checked = _straight(sets, linear, found, plain, answer)
    if linear is None or found is None or checked is None:
        # With its own tolerances the linear fit refuses earlier, and nearer to the cause.
        fit = answer(sets, plain)
        return replace(fit, warnings=(*fit.warnings, _STAYS))
    load = np.nanmean(linear.wrench(as_seen(sets[-1], linear).raw), axis=0)
    return replace(
        with_bending(linear, checked.bending, load, weighed=weighed),
        nonlinear=found,
        result=checked.result,
        refusals=checked.refusals,
        accepted=checked.accepted,
        warnings=(*checked.warnings, _said(found), *(() if weighed else (_SCALE,))),
    )


def _straight(
    sets: tuple[InSituSet, ...],
    linear: InSituFit,
    found: NonlinearMap,
    options: InSituOptions,
    answer: Callable[..., InSituFit],
) -> InSituFit | None:
    """Return the fit of readings from which the polynomial was taken off; None if that is refused."""
    straight = tuple(
        replace(data, raw=data.raw + found.wrench(as_seen(data, linear).raw - offset) @ linear.response.T)
        for data, offset in zip(sets, linear.offsets, strict=True)
    )
    if options.bending_tolerance is None:
        options = replace(options, bending_tolerance=_STILL_BENT)
    return _answered(answer, straight, options)


def _answered(
    answer: Callable[..., InSituFit], sets: tuple[InSituSet, ...], options: InSituOptions
) -> InSituFit | None:
    """Return the fit of sets; None if that is refused."""
    try:
        fit = answer(sets, options)
    except CalibrationRefused:
        return None
    return None if fit.result is FitResult.REFUSED else fit


def _said(found: NonlinearMap) -> str:
    bent = [f"{name} ({d})" for name, d in zip(FORCE_TORQUE_NAMES, found.degrees, strict=True) if d > 1]
    before, after = (
        f"{np.linalg.norm(rms[:3]):.3g} N and {np.linalg.norm(rms[3:]):.3g} N m" for rms in found.held_out_rms
    )
    return (
        f"The sensor is not linear: a polynomial corrects {', '.join(bent)}. Of what took no part it leaves "
        f"{after} rms, the linear map {before}."
    )


class _Rows(NamedTuple):
    above: Matrix
    """Readings less their offset, shape (m, k)."""
    left: Matrix
    """What the linear map leaves of the wrench, shape (m, 6)."""


class _Fold(NamedTuple):
    square: Matrix
    """Mean square of the products that are fitted, about the mean of each set, shape (q, q)."""
    product: Matrix
    """Of these with what is left, shape (q, 6)."""
    products: Matrix
    """Of the rows that take no part, about the set's mean, shape (t, q)."""
    left: Matrix
    """Of these, about the set's mean, shape (t, 6)."""

    def missed(self, coefficients: Matrix) -> Matrix:
        """Return what coefficients, shape (6, q), leave of rows that take no part, shape (t, 6)."""
        return np.asarray(self.left - self.products @ coefficients.T)


def choose_nonlinear(sets: Sequence[InSituSet], fit: InSituFit, among: Sequence[int]) -> NonlinearMap | None:
    """Return the polynomial that predicts best, or None if the linear map of a fit predicts as well.

    Args:
        sets: The fitted sets, in the order of the fit.
        fit: The linear fit.
        among: Degrees of the polynomials to choose from.
    """
    rows = [_rows(data, fit, offset) for data, offset in zip(sets, fit.offsets, strict=True)]
    products = Products.of(np.concatenate([one.above for one in rows]), fit.matrix, max(among))
    folds = list(_folds(rows, products))
    of_sets = len(rows) if len(rows) > 1 else 0
    tried = [(degree, weight) for degree in among for weight in _WEIGHTS]
    linear = np.array([np.mean(fold.left**2, axis=0) for fold in folds])
    found = [[np.mean(f.missed(_ridge(f, *one)) ** 2, axis=0) for one in tried] for f in folds]
    ratio = np.array(found) / linear[:, None]
    chosen = [_chosen(tried, ratio[:, :, axis], of_sets) for axis in range(AXES)]
    if all(degree == 1 for degree, _ in chosen):
        return None
    missed = np.concatenate(
        [np.stack([fold.left, fold.missed(_by_axis(fold, chosen))]) for fold in folds], axis=1
    )
    whole = _fold(rows, [products.of_components(products.components(one.above)) for one in rows])
    degrees = tuple(degree for degree, _ in chosen)
    count = count_of_products(max(degrees))
    return NonlinearMap(
        replace(products, affine=products.affine[:, :count]),
        _by_axis(whole, chosen)[:, :count],
        degrees,
        np.sqrt(np.mean(missed**2, axis=1)),
        np.max(np.abs(missed), axis=1),
    )


def _rows(data: InSituSet, fit: InSituFit, offset: NDArray[np.float64]) -> _Rows:
    seen = as_seen(data, fit)
    above = seen.raw - offset
    columns = np.concatenate([above, expected_wrench(seen, fit.limb) - above @ fit.matrix.T], axis=1)
    columns = columns[np.isfinite(columns).all(axis=1)]
    width = max(len(columns) // _ROWS, 1)
    columns = columns[: len(columns) // width * width].reshape(-1, width, columns.shape[1]).mean(axis=1)
    above, left = np.split(columns, [data.channels], axis=1)
    off = np.abs(left - np.median(left, axis=0))
    near = (off <= _STRAY * np.median(off, axis=0)).all(axis=1)
    return _Rows(above[near], left[near])


def _folds(rows: Sequence[_Rows], products: Products) -> Iterator[_Fold]:
    """Yield one fold a stretch of time, of all sets, and then one a set, where there are others."""
    z = [products.components(one.above) for one in rows]
    whole = [products.of_components(one) for one in z]
    for stretch in range(_STRETCHES):
        out = [np.arange(len(one.left)) * _STRETCHES // len(one.left) == stretch for one in rows]
        kept = [_Rows(one.above[~o], one.left[~o]) for one, o in zip(rows, out, strict=True)]
        fitted = _fold(kept, [p[~o] for p, o in zip(whole, out, strict=True)])
        # The offset is not known of a stretch that was not seen.
        yield fitted._replace(
            products=np.concatenate([p[o] - p[~o].mean(axis=0) for p, o in zip(whole, out, strict=True)]),
            left=np.concatenate(
                [one.left[o] - one.left[~o].mean(axis=0) for one, o in zip(rows, out, strict=True)]
            ),
        )
    for j, one in enumerate(rows):
        rest = [i for i in range(len(rows)) if i != j]
        if rest:
            fitted = _fold([rows[i] for i in rest], [whole[i] for i in rest])
            known = replace(products, ellipsoid=enclosing(np.concatenate([z[i] for i in rest])))
            guarded = known.of_components(z[j])
            yield fitted._replace(
                products=guarded - guarded.mean(axis=0), left=one.left - one.left.mean(axis=0)
            )


def _fold(rows: Sequence[_Rows], products: Sequence[Matrix]) -> _Fold:
    """Return what is fitted, with no row left out."""
    P = np.concatenate([one - one.mean(axis=0) for one in products])
    E = np.concatenate([one.left - one.left.mean(axis=0) for one in rows])
    return _Fold(P.T @ P / len(P), P.T @ E / len(P), P, E)


def _ridge(fold: _Fold, degree: int, weight: float) -> Matrix:
    """Return coefficients of products up to a degree, shape (6, q); zero for all others."""
    count = count_of_products(degree)
    found = np.zeros_like(fold.product)
    square = fold.square[:count, :count] + weight * np.eye(count)
    found[:count] = np.linalg.solve(square, fold.product[:count])
    return np.asarray(found.T)


def _by_axis(fold: _Fold, chosen: Sequence[tuple[int, float]]) -> Matrix:
    """Return the coefficients of each axis by its own degree and weight, shape (6, q)."""
    return np.stack([_ridge(fold, *one)[axis] for axis, one in enumerate(chosen)])


def _chosen(tried: Sequence[tuple[int, float]], ratio: Matrix, of_sets: int) -> tuple[int, float]:
    """Return the degree and weight of an axis, (1, 0) for none.

    ``ratio`` holds mean squares over those of the linear map, shape (folds, tried), the last ``of_sets`` rows
    of whole sets.
    """
    best = int(np.argmin(ratio.mean(axis=0)))
    left = ratio[:, best]
    error = float(np.std(left, ddof=1)) / np.sqrt(len(left))
    good = np.mean(left) < _GAIN and np.mean(left) + _SURE * error < 1.0
    by_sets = left[len(left) - of_sets :]
    return tried[best] if good and (not of_sets or np.mean(by_sets) < 1.0) else (1, 0.0)
