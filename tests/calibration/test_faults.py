"""Channels that break under a walking robot: what the estimator says of them, and what it goes on with.

Faults are put into the readings of eight robots at 14 s; every robot breaks another channel.
"""

from itertools import product

import numpy as np
import pytest
from _moment import Errors, move
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, believed_mass, walk

from surefoot.calibration import (
    GRAVITY,
    Estimate,
    Flag,
    FootCalibrator,
    OnlineSetup,
    Parameters,
    Reference,
    replay,
)
from surefoot.calibration.moment.faults import ChannelFaults

ROBOTS = 8
AT = round(14.0 / DT)
EARLY = round(8.0 / DT)
IN_TIME = round(1.2 / DT)
SETTLED = round(1.5 / DT)
BAD = Faults.bad()
IDENTITY = Parameters(np.ones(8), np.zeros(8))
SETUP = OnlineSetup(layout=LAYOUT, mass=5.3, initial=IDENTITY)
WHO = np.arange(ROBOTS)
CHANNEL = WHO % 8
SAME_FOOT = (CHANNEL + 2) % 4 + CHANNEL // 4 * 4
OTHER_FOOT = (CHANNEL + 5) % 8
WRONG = Flag.SPIKE | Flag.STUCK | Flag.DEAD | Flag.FLIPPED | Flag.SWAPPED | Flag.LOST | Flag.SATURATED

OUT = Flag.DEAD | Flag.STUCK | Flag.SATURATED | Flag.MISSING
"""What may be said of a channel that reads nothing of the load: of some, two of these are true."""

RECONSTRUCTED, PUT_RIGHT, LEARNT_AGAIN = 10.0, 2.6, 4.5
"""Bounds on the error of the centre of pressure in mm once a channel is out, and once nothing is lost."""


def silent_but_for_noise(own, rng):
    return 0.05 * rng.normal(size=own.shape)


def stuck(own, rng):
    return np.repeat(own[:1], len(own), axis=0)


def with_spikes(own, rng):
    return own + np.where(rng.random(own.shape) < 0.03, rng.choice([-60.0, 60.0], own.shape), 0.0)


BROKEN = {
    "healthy": lambda own, rng: own,
    "dead": lambda own, rng: np.full_like(own, 0.3),
    "dead, with noise": silent_but_for_noise,
    "stuck": stuck,
    "dropped": lambda own, rng: np.full_like(own, np.nan),
    "dropped in bursts": lambda own, rng: np.where((np.arange(len(own)) % 80 < 40)[:, None], np.nan, own),
    "at its rail": lambda own, rng: np.full_like(own, 150.0),
    "spikes": with_spikes,
    "flipped": lambda own, rng: -own,
}
EXCHANGED = {
    "swapped": (SAME_FOOT, 1.0),
    "swapped between bridges of opposite polarity": (SAME_FOOT, -1.0),
    "swapped across the feet": (OTHER_FOOT, 1.0),
}
KINDS = [*BROKEN, *EXCHANGED]


class Broken:
    """Estimates of all robots with all faults: samples first, then robots."""

    def __init__(self):
        self.logs = logs = [walk(seed, 0.1, 17.0, 2.0, BAD) for seed in WHO]
        self.true_cop = np.stack([log.cop for log in logs], axis=1)
        self.healthy = healthy = np.stack([forces(log) for log in logs], axis=1)
        rng = np.random.default_rng(3)
        parts = []
        for kind in KINDS:
            force = healthy.copy()
            after = force[AT:]
            own = after[:, WHO, CHANNEL].copy()
            if kind in BROKEN:
                after[:, WHO, CHANNEL] = BROKEN[kind](own, rng)
            else:
                other, sign = EXCHANGED[kind]
                after[:, WHO, CHANNEL] = sign * after[:, WHO, other]
                after[:, WHO, other] = sign * own
            parts.append(force)
        self.raw = dict(zip(KINDS, parts, strict=True))
        self.calibrators = [FootCalibrator(LAYOUT, "moment", mass=believed_mass(BAD)) for _ in WHO]
        self.before = self._played(healthy[:AT], 0)
        self.states = [calibrator.state for calibrator in self.calibrators]
        estimates = {kind: self.goes_on(part) for kind, part in self.raw.items()}
        self.flags = {kind: estimate.flags for kind, estimate in estimates.items()}
        self.cop = {kind: estimate.cop for kind, estimate in estimates.items()}

    def _played(self, raw, first):
        robots = []
        for i, (calibrator, log) in enumerate(zip(self.calibrators, self.logs, strict=True)):
            found = [
                calibrator.update(readings, Reference(*(part[k] for part in log.reference)), DT)
                for k, readings in enumerate(raw[:, i], first)
            ]
            robots.append([None if part[0] is None else np.stack(part) for part in zip(*found, strict=True)])
        parts = zip(*robots, strict=True)
        return Estimate(*(None if part[0] is None else np.stack(part, axis=1) for part in parts))

    def goes_on(self, raw):
        """Estimates from AT on of readings (N, robots, 8), which were healthy before."""
        for calibrator, state in zip(self.calibrators, self.states, strict=True):
            calibrator.state = state
        return self._played(raw[AT:], AT)

    def named_in_time(self, kind, bits, channel=CHANNEL):
        """Of which robots the channel has all bits soon, and keeps them, shape (robots,)."""
        there = self.flags[kind][:, WHO, channel] & int(bits)
        return (there[IN_TIME:] == int(bits)).all(axis=0)

    def named_at_last(self, kind, bits, channel=CHANNEL):
        """Of which robots the channel has all bits at the end, shape (robots,)."""
        return (self.flags[kind][-1, WHO, channel] & int(bits)) == int(bits)

    def blamed(self, kind, *channels):
        """Robots of which any channel but those that broke is flagged, shape (robots,)."""
        wrong = (self.flags[kind] & int(WRONG)).any(axis=0)
        for channel in channels:
            wrong[WHO, channel] = False
        return wrong.any(axis=1)

    def wrong_cop(self, kind):
        """Root mean square errors in mm once all has settled, shape (robots,)."""
        away = self.cop[kind][SETTLED:] - self.true_cop[AT + SETTLED :]
        return 1e3 * np.sqrt((away**2).sum(axis=-1).mean(axis=0))


def added_load(log, share, ahead):
    """What a load of a share of the weight, some m ahead of the centre of mass, adds to each cell in N."""
    place = np.concatenate([foot.position_cell_sole[:, 0] for foot in LAYOUT.feet])
    arm = np.repeat(np.ptp(place.reshape(2, 4), axis=1) / 2.0, 4)
    front = np.where(place > np.repeat(place.reshape(2, 4).mean(axis=1), 4), 1.0, -1.0)
    carried = np.repeat(log.force.reshape(-1, 2, 4).sum(axis=-1), 4, axis=1)
    return share * (log.force + carried * front * ahead / (4.0 * arm))


def forces(log):
    """A log's readings in newtons: the starting map is then the identity."""
    return NOMINAL.force(log.raw)


def calibrated(force, reference):
    return replay(LAYOUT, "moment", force, reference, DT, mass=believed_mass(BAD), initial=IDENTITY)


@pytest.fixture(scope="module")
def broken():
    return Broken()


@pytest.mark.slow
def test_sound_channels_are_never_blamed(broken):
    assert not broken.before.flags.any()
    assert not broken.flags["healthy"].any()
    assert broken.wrong_cop("healthy").max() < PUT_RIGHT


@pytest.mark.parametrize("kind", ["dead", "stuck", "dropped", "at its rail"])
def test_a_channel_that_says_nothing_is_found_and_replaced(broken, kind):
    assert broken.named_in_time(kind, Flag.LOST).all()
    assert (broken.flags[kind][IN_TIME:, WHO, CHANNEL] & int(OUT)).all()
    assert not broken.blamed(kind, CHANNEL).any()
    assert broken.wrong_cop(kind).max() < RECONSTRUCTED


def test_what_a_silent_channel_is_called_follows_its_reading(broken):
    flags = {kind: broken.flags[kind][-1, WHO, CHANNEL] for kind in BROKEN}
    assert (flags["dead"] & int(Flag.DEAD)).all()
    assert (flags["dropped"] & int(Flag.MISSING)).all()
    # A foot in the air tells neither a stuck cell nor one at its rail from others that rest, but the
    # motion tells that they do not follow the load; and what stuck near zero is dead.
    loaded = np.abs(broken.raw["stuck"][AT, WHO, CHANNEL]) > 0.1 * believed_mass(BAD) * GRAVITY
    assert loaded.any()
    assert (flags["stuck"][loaded] & int(Flag.STUCK)).all()
    assert (flags["at its rail"] & int(Flag.SATURATED)).astype(bool).sum() >= ROBOTS // 2


def test_a_channel_with_nothing_but_noise_is_mostly_found_from_the_motion(broken):
    kind = "dead, with noise"
    found = broken.named_in_time(kind, Flag.DEAD | Flag.LOST)
    late = (broken.flags[kind][-1, WHO, CHANNEL] & int(Flag.LOST)) > 0
    assert found.sum() >= ROBOTS // 2
    assert late.sum() >= 3 * ROBOTS // 4
    assert not broken.blamed(kind, CHANNEL).any()
    assert broken.wrong_cop(kind)[found].max() < RECONSTRUCTED


def test_readings_that_come_in_bursts_are_reconstructed_between(broken):
    kind = "dropped in bursts"
    flags = broken.flags[kind][:, WHO, CHANNEL]
    missing = np.isnan(broken.raw[kind][AT:, WHO, CHANNEL])
    assert (flags[missing] & int(Flag.MISSING)).all()
    assert not broken.blamed(kind, CHANNEL).any()
    assert broken.wrong_cop(kind).max() < RECONSTRUCTED


def test_spikes_are_held_and_flagged_and_nothing_is_lost(broken):
    kind = "spikes"
    flags = broken.flags[kind][:, WHO, CHANNEL]
    hit = broken.raw[kind][AT:, WHO, CHANNEL] != broken.healthy[AT:, WHO, CHANNEL]
    held, back = ((flags & int(flag)) > 0 for flag in (Flag.OUT_OF_RANGE, Flag.SPIKE))
    after = np.roll(hit, 1, axis=0) & ~hit
    assert held[hit].mean() > 0.9
    assert back[after].mean() > 0.9
    assert max(held[~hit].mean(), back[~after].mean()) < 0.02
    assert not (flags & int(Flag.LOST)).any()
    assert not broken.blamed(kind, CHANNEL).any()
    assert broken.wrong_cop(kind).max() < PUT_RIGHT


def test_a_flipped_channel_is_turned_round(broken):
    assert broken.named_in_time("flipped", Flag.FLIPPED).all()
    assert not broken.blamed("flipped", CHANNEL).any()
    assert broken.wrong_cop("flipped").max() < PUT_RIGHT


@pytest.mark.parametrize("kind", EXCHANGED)
def test_exchanged_channels_are_put_right(broken, kind):
    other, _ = EXCHANGED[kind]
    found = broken.named_at_last(kind, Flag.SWAPPED) & broken.named_at_last(kind, Flag.SWAPPED, other)
    assert found.sum() >= 5 * ROBOTS // 8
    lost = (broken.flags[kind] & int(Flag.LOST | Flag.FLIPPED | Flag.DEAD)) > 0
    assert not lost.any()
    soon = broken.named_in_time(kind, Flag.SWAPPED)
    assert soon.sum() >= ROBOTS // 4
    assert broken.wrong_cop(kind)[soon].max() < PUT_RIGHT


@pytest.mark.parametrize(
    ("scale", "leap", "held"),
    [
        (1.0, 0.3, True),
        (1.0, -0.3, True),
        (1.0, 0.2, False),
        # It reads twice what it bears, and half.
        (0.5, 0.4, False),
        (0.5, 0.6, True),
        (2.0, 0.15, True),
        # A scale that cannot be does not blind the search, and does not make it see leaps in noise.
        (0.0, 0.9, True),
        (-1.0, 0.3, True),
        (50.0, 0.05, False),
        (50.0, 0.1, True),
    ],
)
def test_leaps_are_those_of_calibrated_forces(scale, leap, held):
    weight = SETUP.weight
    faults = ChannelFaults(SETUP, 0.25, 0.15, 100.0)
    resting, read = np.full(8, 5.0), np.ones(8, dtype=bool)
    air = np.zeros(2, dtype=bool)
    state, *_ = faults.sample(faults.init(resting), resting, read, np.ones(8), air)
    force, scales = resting.copy(), np.ones(8)
    force[3] += leap * weight
    scales[3] = scale
    _, used, sure, flags = faults.sample(state, force, read, scales, air)
    assert bool(flags[3] & int(Flag.OUT_OF_RANGE)) == held
    assert sure[3] != held
    assert used[3] == (5.0 if held else force[3])
    assert not np.delete(flags, 3).any()


@pytest.mark.parametrize(
    ("channels", "leap", "held"), [([3], 0.2, True), ([3], 0.1, False), ([3, 2], 0.2, False)]
)
def test_a_cell_alone_leaps_only_on_a_foot_that_stands(channels, leap, held):
    faults = ChannelFaults(SETUP, 0.25, 0.15, 100.0)
    resting, read, stance = np.full(8, 5.0), np.ones(8, dtype=bool), np.array([True, False])
    rested, *_ = faults.sample(faults.init(resting), resting, read, np.ones(8), stance)
    for foot in (0, 1):
        force = resting.copy()
        force[np.array(channels) + 4 * foot] += leap * SETUP.weight
        away, *_, flags = faults.sample(rested, force, read, np.ones(8), stance)
        expected = held and foot == 0
        assert ((flags & int(Flag.OUT_OF_RANGE)) > 0).any() == expected
        # One that comes back was a spike, and one that stays away a load.
        *_, flags = faults.sample(away, resting, read, np.ones(8), stance)
        assert ((flags & int(Flag.SPIKE)) > 0).any() == expected
        *_, flags = faults.sample(away, 0.5 * (force + resting), read, np.ones(8), stance)
        assert not (flags & int(Flag.SPIKE)).any()


@pytest.mark.parametrize(
    ("changed", "by", "smoothed"),
    [
        ([3], 0.04, True),
        ([3], -0.04, True),
        ([3], 0.01, False),  # less than is worth it
        ([0, 1, 2, 3], 0.3, False),  # a foot that lands
        ([3, 2], 0.04, False),
        ([3, 5], 0.04, True),  # of two plates
    ],
)
def test_a_reading_that_is_wrong_once_goes_between_its_neighbours(changed, by, smoothed):
    faults = ChannelFaults(SETUP, 0.25, 0.15, 100.0)
    before, after = (np.concatenate([np.full(8, force), np.ones(8)]) for force in (0.2, 0.22))
    row = np.concatenate([np.full(8, 0.21), np.ones(8)])
    row[changed] += by
    found = faults.smooth(before, row, after, 1.0)
    expected = np.array(row)
    if smoothed:
        expected[changed] = 0.21
    np.testing.assert_allclose(found, expected, atol=1e-12)
    # A step that stays is none.
    np.testing.assert_array_equal(faults.smooth(before, row, row, 1.0), row)


@pytest.mark.slow
def test_a_load_that_is_put_on_is_no_fault(broken):
    loads = [(0.06, 0.03, AT), (0.12, 0.06, AT), (0.12, -0.06, AT), (0.12, 0.03, EARLY)]
    for (share, ahead, at), log in product(loads, broken.logs):
        raw, cop = forces(log), log.cop.copy()
        raw[at:] += (added_load(log, share, ahead) / log.correction.scale)[at:]
        cop[at:, 0] += share / (1.0 + share) * ahead
        estimate = calibrated(raw, log.reference)
        assert not (estimate.flags & int(WRONG)).any()
        away = (estimate.cop - cop)[at + SETTLED :]
        assert 1e3 * np.sqrt((away**2).sum(axis=1).mean()) < LEARNT_AGAIN, (share, ahead)


def test_a_channel_that_comes_back_is_taken_in_again(broken):
    away = round(2.0 / DT)
    raw = broken.healthy.copy()
    raw[AT : AT + away, WHO, CHANNEL] = np.nan
    estimate = broken.goes_on(raw)
    flags = estimate.flags[:, WHO, CHANNEL]
    assert (flags[away - 1] & int(Flag.LOST)).all()
    back = away + round(1.0 / DT)
    assert not estimate.flags[back:].any()
    wrong = np.linalg.norm(estimate.cop[back:] - broken.true_cop[AT + back :], axis=-1)
    assert 1e3 * np.sqrt((wrong**2).mean(axis=0)).max() < LEARNT_AGAIN


def test_a_single_spike_changes_nothing_but_its_own_sample(broken):
    raw, at = broken.healthy[: AT + 77].copy(), 37
    raw[AT + at, WHO, CHANNEL] += 80.0
    clean, spoilt = broken.goes_on(broken.healthy[: AT + 77]), broken.goes_on(raw)
    for flag, when in ((Flag.OUT_OF_RANGE, at), (Flag.SPIKE, at + 1)):
        flagged = np.argwhere(spoilt.flags & int(flag))
        np.testing.assert_array_equal(flagged, np.stack([np.full(ROBOTS, when), WHO, CHANNEL], axis=1))
    # The sample before is held in its place, on its own channel alone.
    moved = np.abs(spoilt.force[at] - clean.force[at])
    expected = np.abs(clean.force[at, WHO, CHANNEL] - clean.force[at - 1, WHO, CHANNEL])
    np.testing.assert_allclose(moved[WHO, CHANNEL], expected, atol=1e-9)
    moved[WHO, CHANNEL] = 0.0
    np.testing.assert_allclose(moved, 0.0, atol=1e-9)
    np.testing.assert_allclose(spoilt.cop[-1], clean.cop[-1], atol=2e-4)


def test_a_reading_that_stays_away_is_believed_after_three_samples(broken):
    raw = broken.healthy[: AT + 8].copy()
    raw[AT:, WHO, CHANNEL] += 80.0
    flags = broken.goes_on(raw).flags[:, WHO, CHANNEL]
    assert (flags[:3] == int(Flag.OUT_OF_RANGE)).all()
    assert not flags[3:].any()


def test_blows_to_a_robot_that_bounces_are_no_spikes(broken):
    """Cells of both feet leap one after the other: after the first of them nothing is held any more."""
    raw, leap = broken.healthy[: AT + 160].copy(), 1.2 * believed_mass(BAD) * GRAVITY
    blows = range(0, 160, 5)
    for i, at in enumerate(blows):
        raw[AT + at, :, (3 * i) % 8] += leap
    flags = broken.goes_on(raw).flags
    held = [(flags[at, :, (3 * i) % 8] & int(Flag.OUT_OF_RANGE)) > 0 for i, at in enumerate(blows)]
    assert np.all(held[0])
    assert np.mean(held[2:]) < 0.05


def test_a_foot_that_lands_on_all_its_cells_does_not_spike(broken):
    raw, leap = broken.healthy[: AT + 8].copy(), 0.4 * believed_mass(BAD) * GRAVITY
    raw[AT:, :, :4] += leap * np.array([1.0, 0.9, 0.6, 0.8])
    assert np.abs(np.diff(raw[AT - 1 : AT + 1, :, :4], axis=0)).min() > 0.2 * leap
    assert not broken.goes_on(raw).flags.any()


@pytest.mark.parametrize("share", [0.8, 0.95])
def test_nobody_is_accused_on_a_robot_that_hangs(share):
    """The weight that is missing stays missing: no noise, and no cell's fault."""
    hung = move(1, 60.0, Errors.stated(), walking=False, lifted=np.full(round(60.0 / DT), share))
    found = replay(LAYOUT, "moment", hung.raw, hung.reference, DT, mass=MASS, initial=NOMINAL, lag=0)
    assert not (found.flags & int(WRONG)).any()


def test_nothing_is_kept_that_is_learnt_while_readings_are_suspected():
    """It takes seconds of walking to be sure of exchanged cells; the filter goes back to before they were."""
    at, channels = round(8.03 / DT), [0, 2, 1, *range(3, 8)]
    log = move(7, 20.0, Errors.stated())
    spoilt = log.raw.copy()
    spoilt[at:] = (NOMINAL.force(spoilt[at:])[:, channels] - NOMINAL.offset) / NOMINAL.scale
    sound, found = (
        replay(LAYOUT, "moment", raw, log.reference, DT, mass=MASS, initial=NOMINAL, lag=0)
        for raw in (log.raw, spoilt)
    )
    sure = np.flatnonzero(found.flags[:, 1] & int(Flag.SWAPPED))[0]
    assert sure > at + 3.0 / DT
    after = slice(sure + round(0.2 / DT), sure + round(2.2 / DT))
    errors = [np.sqrt(np.mean((one.force[after] - log.force[after]) ** 2)) for one in (sound, found)]
    assert errors[1] < 2.0 * errors[0]


@pytest.mark.parametrize(("seed", "heavier", "apart"), [(0, 1.1, 0.0), (4, 1.0, 0.01)], ids=["mass", "soles"])
def test_nobody_is_accused_of_what_the_model_gets_wrong(seed, heavier, apart):
    """A model's error lasts as well, but within what noise explains: it makes rows less sure."""
    log = move(seed, 60.0, Errors.stated(), walking=False)
    moved = log.reference.position_sole + apart * np.array([[1.0, 0.5, 0.0], [-1.0, 0.5, 0.0]])
    believed = log.reference._replace(position_sole=moved)
    found = replay(LAYOUT, "moment", log.raw, believed, DT, mass=heavier * MASS, initial=NOMINAL, lag=0)
    assert not (found.flags & int(WRONG)).any()
