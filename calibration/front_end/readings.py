"""The way of one sample before and after learning, the same for every online method.

* **Checks.** Wrong shapes and dtypes raise: they are errors of the program. A *reading* never raises:
  NaN (no sample arrived) and impossible forces are replaced by the last good reading and flagged; a
  reference that is not finite or not physical is held and flagged, and nothing is learnt from that sample.
* **Relative forces.** Everything works on F0 = c0 raw + d0, the force by the starting map, and F = a F0 +
  b, so that a is near 1 and b near 0 N.
* **Lag.** The reference given now describes the foot sample of ``lag`` samples ago, so forces wait that
  long before they are compared. The map that is learnt applies to the newest reading.
* **Age.** Readings are interpolated to one moment, and extrapolated to now for the centre of pressure of all
  feet together (:mod:`surefoot.calibration.front_end.ages`).
* **Repeats.** A sample whose readings all equal those before it, which had just changed by more than
  :data:`MOVING`, is a repeat. It counts as one that did not arrive, but for a flag, until the readings have
  been constant for :data:`LONGEST_SILENCE`.
* **Silence.** The load may have changed since a held reading. After :data:`LONGEST_SILENCE` without a reading
  of a channel its foot has no centre of pressure, and neither have all feet together.
* **Linear rows.** The level wrench of the feet is linear in the channels: (Fz, Fz px, Fz py) = rows @ F.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.ages import (
    SLOPE_SAMPLES,
    alignment_lag,
    change_since_reading,
    extrapolation_time,
    force_at,
    mean_age,
    with_total_kept,
)
from surefoot.calibration.front_end.motion import LARGEST_REFERENCE, Motions
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineSetup

LONGEST_GAP = 5.0  # time between samples, in nominal ones, beyond which they no longer belong together
LONGEST_SILENCE = 0.25
"""Time in s without a reading of a channel after which its last one is not of now: within a step's single
support of 0.3 s a foot is loaded or lifted, and a serial bus has gaps of up to 0.125 s. Of slow samples it is
:data:`LONGEST_GAP` of them."""

MOVING = 0.02
"""Change of a reading from one sample to the next in body weights after which equal readings are no sign of a
robot that stands still: more than the noise and the steps of converters."""

MOST_SILENCE = 3600.0  # time in s up to which silence is counted

Repair = Callable[[Array, Array], tuple[Array, Array]]
"""Takes the newest forces and whether they were read, and hands back those to go on with."""


class FrontState(NamedTuple):
    """The state of the front end."""

    raw: Array  # last good reading of each channel, shape (K,)
    history: Array
    """The last samples, oldest first: F0, whether it was read, and by how much it was older than usual in s,
    shape (kept + 1, 3K)."""
    motion: Array  # the last good reference, flat, shape (R,)
    known: bool  # whether any reference was good so far
    clean: int  # good samples since the last bad one
    silent: Array  # time in s since each channel was last read, at most an hour, shape (K,)
    constant: float
    """Time in s since any reading last changed, at most an hour, and more by :data:`LONGEST_SILENCE` if it
    changed by little."""
    late: Array
    """By how much the coming sample's readings are older than their mean age in s, shape (K,): 0 unless the
    device reports when it converted."""


class Sample(NamedTuple):
    """One sample, checked and aligned; F feet."""

    force: Array  # newest force by the starting map, F0, in N, shape (K,)
    ahead: Array | None  # the same extrapolated to now; ``None`` where readings have no age
    aligned: Array  # F0 of all channels at the moment ``aligned_lag`` samples ago, shape (K,)
    rows: Array  # rows of (Fz, Fz px, Fz py) of each foot by channel in the level frame, shape (F, 3, K)
    past: Array  # F0 at the time that the reference describes, shape (K,)
    read: Array  # whether ``past`` was read and not held (bool), shape (K,)
    sound: bool  # whether the reference is good and the clock did not jump
    good: bool  # whether the sample may be learnt from: sound, and every channel read
    clean: int  # good samples since the last bad one, this one included
    motion: Array  # the reference, flat; the last good one where this one was not, shape (R,)
    stance: Array  # feet surely on the ground by a reference that is good (bool), shape (F,)
    swing: Array  # feet surely in the air by a reference that is good (bool), shape (F,)
    known: bool  # whether any reference was good so far
    flags: Array  # flaws of the newest readings and the reference, shape (K,)
    gap: bool  # whether the clock jumped, so that the last sample and this one do not belong together
    silent: Array  # time in s since each channel was last read, shape (K,)


class FrontEnd:
    """The way of a sample for one setup: pure functions that share constants.

    Further arguments are those of :class:`~surefoot.calibration.front_end.motion.Motions`.

    Args:
        setup: The robot.
        extrapolates: Whether the centre of pressure of all feet together is extrapolated to now.

    Attributes:
        plausible: Least and greatest reading of each channel that does not count as an error, (K,) each.
        carried: By how many s each channel is extrapolated to now, (K,).
        age: Mean age of readings in s, (K,).
        aligned_lag: How many samples ago the moment of aligned forces was.
        kept: How many samples before the newest one are stored.
        limits: The bounds of the leaves of a :class:`FrontState`.
        longest_silence: Time in s for which a last reading counts.
    """

    def __init__(
        self,
        setup: OnlineSetup,
        *,
        quasi_static: bool = False,
        imu: bool = True,
        momentum: bool = False,
        extrapolates: bool = True,
    ) -> None:
        self.setup = setup
        self.motions = Motions(setup, quasi_static=quasi_static, imu=imu, momentum=momentum)
        self._channels, self._wrench_map = setup.layout.channels, setup.layout.wrench_map
        self._threshold = setup.force_threshold
        self._scale, self._offset = (np.asarray(part, dtype=np.float64) for part in setup.initial)
        limit = setup.plausible_weights * setup.weight
        ends = (np.array([[-limit], [limit]]) - self._offset) / self._scale
        self.plausible = ends.min(axis=0), ends.max(axis=0)
        # Twice the range, as a saved starting map may differ a little; a lost channel is made of others.
        span, made = self.plausible[1] - self.plausible[0], limit * self._channels
        self.limits: dict[str, tuple[Array | float, Array | float]] = {
            "raw": (self.plausible[0] - 0.5 * span, self.plausible[1] + 0.5 * span),
            "history": (-made, made),
            "late": (-MOST_SILENCE, MOST_SILENCE),
            "motion": (-LARGEST_REFERENCE, LARGEST_REFERENCE),
            "silent": (0.0, MOST_SILENCE),
            "constant": (0.0, MOST_SILENCE),
        }
        self.longest_silence = max(LONGEST_SILENCE, LONGEST_GAP * setup.dt)
        feet = np.arange(len(setup.layout.feet))[:, None]
        self._of_foot = setup.layout.foot_of_channel == feet
        self.age, self.aligned_lag = mean_age(setup), alignment_lag(setup)
        self.carried = extrapolation_time(setup) if extrapolates else np.zeros(self._channels)
        self._aged = bool(self.carried.any())
        self.kept = max(setup.lag, SLOPE_SAMPLES * self._aged, self.aligned_lag + 1)

    def init(self, raw: Array) -> FrontState:
        """Return the state before any sample, of a reading, (K,), whose values do not matter."""
        self.setup.layout.check_reading(raw)
        return FrontState(
            raw=-self._offset / self._scale,
            history=np.zeros((self.kept + 1, 3 * self._channels)),
            motion=self.motions.resting.copy(),
            known=False,
            clean=0,
            silent=np.zeros(self._channels),
            constant=0.0,
            late=np.zeros(self._channels),
        )

    def check(self, raw: Array, reference: Reference | MomentumReference) -> None:
        """Raise ValueError if a shape is not that of one sample of one robot, or readings are no float64."""
        if getattr(raw, "shape", None) != (self._channels,):
            self.setup.layout.check_reading(raw)
        if getattr(raw, "dtype", None) != np.float64:
            found = getattr(raw, "dtype", type(raw).__name__)
            raise ValueError(f"'raw' must hold float64 numbers, got dtype {found}.")
        self.motions.check(reference)

    def observe(
        self,
        state: FrontState,
        raw: Array,
        reference: Reference | MomentumReference,
        dt: float,
        repair: Repair | None = None,
    ) -> tuple[FrontState, Sample]:
        """Check one sample, align it with its reference and write its rows; ValueError if one does not fit.

        Readings, (K,), are of now, the reference of ``lag`` samples ago, ``dt`` in s. ``repair`` takes the
        newest forces and whether they were read, and hands back those to go on with.
        """
        self.check(raw, reference)
        gap = not 0.0 < dt <= LONGEST_GAP * self.setup.dt
        read, held, force, sure = self._read(state, raw, repair)
        passed = dt if 0.0 < dt < MOST_SILENCE else self.setup.dt
        silent = np.where(read, 0.0, np.minimum(state.silent + passed, MOST_SILENCE))
        change = float(np.abs(self._scale * (held - state.raw)).max())
        moves = change > MOVING * self.setup.weight
        constant = state.constant + passed if change == 0.0 else 0.0 if moves else self.longest_silence
        constant = min(constant, MOST_SILENCE)
        if change == 0.0 and constant < self.longest_silence:
            sure = np.zeros_like(sure)
        history = np.vstack([state.history[1:], np.concatenate([force, sure, state.late])])
        lag, nominal, zero = self.setup.lag, self.setup.dt, np.zeros(self._channels)
        past = force_at(history, lag, zero, nominal)
        past_read = history[self.kept - lag, self._channels : 2 * self._channels] > 0.5

        flat = self.motions.flatten(reference)
        sound = self.motions.is_sound(flat)
        motion, known = flat if sound else state.motion, state.known or sound
        good = sound and not gap and bool(past_read.all())
        clean = state.clean + 1 if good else 0
        ahead = None
        if self._aged:
            # Samples that come late are further apart than they should be.
            ahead = force + change_since_reading(history, clean, self.carried, max(dt, nominal))

        flags = np.where(read, 0, np.where(np.isnan(raw), int(Flag.MISSING), int(Flag.OUT_OF_RANGE)))
        flags = flags | (0 if sound else int(Flag.REFERENCE)) | (int(Flag.GAP) if gap else 0)
        sample = Sample(
            force=force,
            ahead=ahead,
            aligned=force_at(history, self.aligned_lag, self.age, nominal),
            rows=self.motions.rows(motion),
            past=past,
            read=past_read,
            sound=sound and not gap,
            good=good,
            clean=clean,
            motion=motion,
            stance=reference.stance & sound,
            swing=reference.swing & sound,
            known=known,
            flags=flags,
            gap=gap,
            silent=silent,
        )
        return FrontState(held, history, motion, known, clean, silent, constant, zero), sample

    def _read(
        self, state: FrontState, raw: Array, repair: Repair | None
    ) -> tuple[Array, Array, Array, Array]:
        """Return which readings are plausible, the last ones that were, and the forces and which are sure."""
        low, high = self.plausible
        read = (raw >= low) & (raw <= high)
        held = np.where(read, raw, state.raw)
        force = self._scale * held + self._offset
        return read, held, *((force, read) if repair is None else repair(force, read))

    def estimate(
        self,
        sample: Sample,
        correction_scale: Array,
        correction_offset: Array,
        status: int = 0,
        covariance: Array | None = None,
    ) -> Estimate:
        """Apply a correction, a and b in N, shape (K,) each, to the newest forces.

        All channels share the flags ``status``; the covariance is of (a, b), shape (2K, 2K), if one is
        claimed.
        """
        force, ahead, aligned = (
            None if part is None else correction_scale * part + correction_offset
            for part in (sample.force, sample.ahead, sample.aligned)
        )
        return self.report(
            sample,
            force,
            correction_scale * self._scale,
            correction_scale * self._offset + correction_offset,
            status,
            covariance,
            ahead,
            aligned,
        )

    def report(
        self,
        sample: Sample,
        force: Array,
        scale: Array,
        offset: Array,
        status: Array | int = 0,
        covariance: Array | None = None,
        ahead: Array | None = None,
        aligned: Array | None = None,
    ) -> Estimate:
        """Make an estimate of calibrated forces: wrenches and centres of pressure.

        Forces are in N as they were read, (K,), scale in N per unit of the reading and offset in N at a
        reading of zero; flags of each channel, or of all alike; a covariance of (a, b), (2K, 2K), if the
        method claims one. ``ahead`` is the same extrapolated to now, each by itself; ``None`` where readings
        have no age. ``aligned`` is the same at the moment ``aligned_lag`` samples ago.
        """
        wrench, moments, cop, loaded = self._centres(sample, force)
        total = cop[-1]
        if ahead is not None:
            up = sample.rows[:, 0].sum(axis=0)
            total = self._centres(sample, force + with_total_kept(ahead - force, up))[2][-1]
        aligned = force if aligned is None else aligned
        cop_aligned = self._centres(sample, aligned)[2]
        return Estimate(
            force=force,
            wrench=wrench,
            vgrf=moments[:, 0],
            cop=total,
            cop_foot=cop[:-1],
            cop_valid=loaded[-1],
            cop_foot_valid=loaded[:-1],
            scale=scale,
            offset=offset,
            covariance=covariance,
            flags=sample.flags | status,
            cop_measured=cop[-1],
            force_aligned=aligned,
            cop_aligned=cop_aligned[-1],
            cop_foot_aligned=cop_aligned[:-1],
        )

    def _centres(self, sample: Sample, force: Array) -> tuple[Array, Array, Array, Array]:
        """Return wrenches, (Fz, Fz px, Fz py) of the feet, and centres with where they are, of forces."""
        wrench, moments = self._wrench_map @ force, sample.rows @ force
        cop, loaded = centres(wrench, moments, sample.known, self._threshold)
        stale = sample.silent > self.longest_silence
        if stale.any():
            there = np.append(~(self._of_foot & stale).any(axis=1), False)
            loaded &= there
            cop[~loaded] = np.nan
        return wrench, moments, cop, loaded


def centres(wrench: Array, moments: Array, known: bool, threshold: float) -> tuple[Array, Array]:
    """Return centres of pressure in m, shape (F + 1, 2), and whether they exist (bool), shape (F + 1,).

    Those of the feet are in their sole frames, of wrenches in N and N m, shape (F, 6); the one of all
    together comes last, in the level frame if that is known, of (Fz, Fz px, Fz py) of each foot there, shape
    (F, 3). Without more load than the threshold in N they are NaN.
    """
    # Plain floats: a control loop divides at every sample, and these are several times faster.
    parts = [[fz, -ty, tx] for _, _, fz, tx, ty, _ in wrench.tolist()]
    parts.append(moments.sum(axis=0).tolist())
    loaded = [fz > threshold for fz, _, _ in parts]
    loaded[-1] = loaded[-1] and known
    cop = [
        (x / fz, y / fz) if there else (np.nan, np.nan)
        for there, (fz, x, y) in zip(loaded, parts, strict=True)
    ]
    # Adding zero makes -0.0, which a negation leaves, the 0.0 of a sum.
    return np.array(cop) + 0.0, np.array(loaded)
