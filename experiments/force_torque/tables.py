"""Tables of one in-situ calibration: semi-axes, added masses and their places, the limb, offsets, sets."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.calibration.in_situ import InSituFit, InSituSet
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.experiments.force_torque.log import InSituLog
from surefoot.experiments.force_torque.validation import (
    added_mass,
    as_seen,
    force_ellipsoid,
    motion_wrench,
    offset_of_set,
    predict_wrench,
    spans_space,
)
from surefoot.experiments.study.tables import Table, decimal, number, round_to, with_deviation


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A log and the calibration that was made of it."""

    log: InSituLog
    fit: InSituFit

    @cached_property
    def sets(self) -> tuple[InSituSet, ...]:
        """The sets with gravity in the sensor's frame, and without the effect of temperature."""
        return tuple(as_seen(data, self.fit) for data in self.log.sets)

    @cached_property
    def numbers(self) -> tuple[int | None, ...]:
        """Number of each set in the fit; ``None`` for those that are kept aside."""
        order = {name: i for i, name in enumerate(one.name for one in self.fit.sets)}
        return tuple(order.get(data.name) for data in self.log.sets)

    @cached_property
    def offsets(self) -> Floats:
        """Offset of each set in counts, (J, k), fitted to each alike: the fit's own follow drift."""
        fit, found = self.fit, []
        for data in self.sets:
            still = data.raw - motion_wrench(data, fit.limb) @ fit.response_in_air.T
            found.append(offset_of_set(still, data.gravity, fit.response_in_air, fit.noise))
        return np.array(found)

    @cached_property
    def affine_residual(self) -> Floats:
        """Share of each set's spread that leaves the three-space of Lemma 1, shape (J,)."""
        return np.array(
            [
                _leave_three_space(data.raw) if place is None else self.fit.sets[place].affine_residual
                for data, place in zip(self.sets, self.numbers, strict=True)
            ]
        )

    @property
    def notices(self) -> tuple[str, ...]:
        """Refusals and why they were accepted, warnings of the fit, and gaps of the log."""
        fit = self.fit
        passed = [f"Refused: {refusal}" for refusal in fit.refusals]
        passed += [f"Accepted all the same, with this reason: {fit.accepted}"] if passed else []
        scope = (f"Found: {fit.scope}.",) if fit.scope else ()
        return (*scope, *passed, *fit.warnings, *self.log.notices)

    @property
    def matrices(self) -> dict[str, Floats]:
        """The calibrated matrix, and the factory's or the driver's if any, in N and N m per count, (6, k).

        They weigh what hangs on the sensor as it turns.
        """
        config = self.log.config
        other = {} if config.factory.matrix is None else {"factory": config.factory.matrix}
        if config.of_driver:
            other = {"driver's": np.eye(6)}
        return {"calibrated": self.fit.matrix_in_air} | other

    def label(self, index: int) -> str:
        """Name of a set in tables."""
        name = self.log.sets[index].name
        return name if self.numbers[index] is not None else f"{name} (kept aside)"

    def wrench(self, index: int, matrix: Floats) -> Floats:
        """Return a set's wrench by a matrix, (6, k), brought to rest, in N and N m, (n, 6); NaN: missing."""
        data = self.sets[index]
        wrench = (data.raw - self.offsets[index]) @ matrix.T
        return np.asarray(wrench - motion_wrench(data, self.fit.limb))

    def residual(self, index: int) -> Floats:
        """Compute a set's residual in counts with a constant offset, shape (n, k)."""
        data = self.sets[index]
        expected = predict_wrench(data, self.fit.limb) @ self.fit.response_in_air.T
        return np.asarray(data.raw - self.offsets[index] - expected)


def _leave_three_space(raw: Floats) -> float:
    """Return the share of the spread of readings, shape (n, k), outside the three-space of Lemma 1."""
    whole = raw[np.isfinite(raw).all(axis=1)]
    singular = np.linalg.svd(whole - whole.mean(axis=0), compute_uv=False)
    return float(np.linalg.norm(singular[3:]) / np.linalg.norm(singular))


def make_tables(found: Calibrated) -> tuple[Table, ...]:
    """Make the tables that a terminal shows."""
    return (set_table(found), limb_table(found), semi_axes_table(found), *weighing_tables(found))


def semi_axes_table(found: Calibrated) -> Table:
    """Return the semi-axes of each set's force ellipsoid beside the weight (in-situ paper, Table I)."""
    rows = []
    for i, data in enumerate(found.sets):
        weight = (found.fit.limb.mass + data.added_mass) * GRAVITY
        cells = [found.label(i), decimal(data.added_mass, ".3f"), number(weight)]
        for matrix in found.matrices.values():
            if not spans_space(data.gravity):
                cells += ["–"] * 4
                continue
            ellipsoid = force_ellipsoid(found.wrench(i, matrix)[:, :3], data.gravity)
            cells += [*map(number, ellipsoid.semi_axes), decimal(ellipsoid.ratio, ".3f")]
        rows.append(tuple(cells))
    columns = ["set", "added mass (kg)", "weight (N)"]
    for name in found.matrices:
        columns += [f"{name}, longest (N)", "middle", "shortest", "longest / shortest"]
    note = "A sensor that measures true forces draws a sphere whose radius is the weight. "
    note += (
        "Sets kept aside took no part in the fit of matrix and limb."
        if None in found.numbers
        else "Sets that made the fit prove no more than that it holds together; keep some aside (fit.sets)."
    )
    return Table("semi_axes", "Semi-axes of the force ellipsoid", tuple(columns), tuple(rows), note)


def weighing_tables(found: Calibrated) -> tuple[Table, ...]:
    """Return the added masses and their places as the sensor weighs them (in-situ paper, Tables II, III)."""
    if not any(data.added_mass > 0.0 for data in found.sets):
        return ()
    masses, places = [], []
    for i, data in enumerate(found.sets):
        weighed = [
            added_mass(found.wrench(i, matrix), data.gravity, found.fit.limb)
            for matrix in found.matrices.values()
        ]
        mass = [one.mass for one in weighed]
        error = decimal(mass[0] - data.added_mass, "+.3f")
        masses.append(
            (found.label(i), decimal(data.added_mass, ".3f"), *(decimal(m, ".3f") for m in mass), error)
        )
        for a, axis in enumerate("xyz" if data.added_mass > 0.0 else ""):
            given, place = 100 * data.added_com[a], [100 * one.position[a] for one in weighed]
            error = decimal(place[0] - given, "+.2f")
            places.append(
                (found.label(i), axis, decimal(given, ".2f"), *(decimal(x, ".2f") for x in place), error)
            )
    columns = ("given", *found.matrices, "error, calibrated")
    note = "What the sensor weighs less the calibrated limb, with an offset that is fitted to each set."
    title = "Place of the added mass (cm, in the sensor's frame)"
    return (
        Table("added_mass", "Added mass (kg)", ("set", *columns), tuple(masses), note),
        Table("added_com", title, ("set", "axis", *columns), tuple(places)),
    )


def limb_table(found: Calibrated) -> Table:
    """Return the limb, and its mass against the known one where the log gives it."""
    fit, known = found.fit, found.log.config.limb
    rows = [("mass (kg)", *round_to(fit.limb.mass, fit.limb_mass_std))]
    note = "No known mass of the limb (limb.mass_kg) was given to hold the scale against."
    if known.mass_kg is not None:
        off = 100 * (fit.limb.mass / known.mass_kg - 1.0)
        rows += [
            ("known mass (kg)", *round_to(known.mass_kg, known.mass_std_kg or np.nan)),
            ("fitted / known - 1 (%)", decimal(off, "+.2f"), "–"),
        ]
        note = (
            "The known mass did not enter the fit: it is a check of the absolute scale."
            if known.mass_std_kg is None
            else "The known mass entered the fit (limb.mass_std_kg): it is no independent check of the scale."
        )
    limb = fit.covariance[fit.columns.limb, fit.columns.limb]
    slope = np.column_stack([-fit.limb.com, np.eye(3)]) / fit.limb.mass
    com_std = np.sqrt(np.diag(slope @ limb @ slope.T))
    rows += [
        (f"centre of mass, {axis} (cm)", *round_to(100 * fit.limb.com[a], 100 * com_std[a]))
        for a, axis in enumerate("xyz")
    ]
    return Table("limb", "The limb beyond the sensor", ("what", "value", "± (one sigma)"), tuple(rows), note)


def matrix_table(found: Calibrated) -> Table:
    """Return C with its standard deviations."""
    fit, std = found.fit, found.fit.matrix_std
    milli, of_what, factor = (
        ("m", "count", 1e3) if found.log.config.units.raw == "count" else ("", "N and N m", 1.0)
    )
    rows = tuple(
        (
            f"{name} ({milli}N{' m' * name.startswith('t')})",
            *(with_deviation(factor * c, factor * s) for c, s in zip(fit.matrix[i], std[i], strict=True)),
        )
        for i, name in enumerate(FORCE_TORQUE_NAMES)
    )
    note = "With one standard deviation, each to the decimal that it lets be known."
    return Table("matrix", f"The matrix, per {of_what}", ("axis", *found.log.channels), rows, note)


def offset_table(found: Calibrated) -> Table:
    """Return the offset of each channel, by set."""
    fit = found.fit
    rows = [
        (name, *(round_to(value, std)[0] for value in fit.offsets[:, i]), *round_to(fit.offset[i], std))
        for i, (name, std) in enumerate(zip(found.log.channels, fit.offset_std, strict=True))
    ]
    columns = ("channel", *(f"set {one.name}" for one in fit.sets), "at the end", "± (one sigma)")
    return Table("offset", f"Offsets ({found.log.config.units.of_raw})", columns, tuple(rows))


def set_table(found: Calibrated) -> Table:
    """Make the table of sets."""
    rows = []
    for i, (data, place) in enumerate(zip(found.sets, found.numbers, strict=True)):
        stats = None if place is None else found.fit.sets[place].stats
        rows.append(
            (
                found.label(i),
                decimal(data.added_mass, ".3f"),
                "–" if data.time is None else decimal(data.time[-1] - data.time[0], ".1f"),
                "–" if stats is None else decimal(stats.samples, "d"),
                "–" if stats is None else decimal(stats.dropped + stats.gated, "d"),
                "–" if stats is None else number(stats.residual_rms),
                number(float(np.sqrt(np.nanmean(found.residual(i) ** 2)))),
                decimal(100 * found.affine_residual[i], ".2f"),
            )
        )
    unit = found.log.config.units.of_raw
    columns = (
        "set", "added mass (kg)", "duration (s)", "samples used", "left out", f"residual of the fit ({unit})",
        f"residual with one offset ({unit})", "off the three-space of Lemma 1 (%)",
    )  # fmt: skip
    note = (
        "Root mean squares. What the fit leaves is less what it ascribes to drift and hysteresis; a reading "
        "of the calibrated sensor has both, as with one offset for the whole set."
    )
    return Table("sets", "What was calibrated", columns, tuple(rows), note)
