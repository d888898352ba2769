"""Refusals of in-situ calibration, and their words."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import (
    ADDED_COM_LEG,
    ADDED_MASS,
    NOISE,
    hip_gravity,
    make_set,
    moving_sets,
    noisy_sets,
    random_gravity,
    swept_gravity,
)
from _in_situ_leg import COM, MASS, MATRIX, RESPONSE, leg_sets, read_at, read_more, sound_fit
from scipy.signal import lfilter

from surefoot.calibration.in_situ import InSituOptions, KnownLimb, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused, FitResult


def planar(sets):
    planar = []
    for one in sets:
        g = one.gravity * [1.0, 0.0, 1.0]
        planar.append(replace(one, gravity=9.81 * g / np.linalg.norm(g, axis=1, keepdims=True)))
    return planar


def two_orientations(sets):
    return [replace(one, raw=one.raw[::20], gravity=one.gravity[[0, 30] * 15], time=None) for one in sets]


def bending(sets):
    bent = []
    for one in sets:
        shift = MASS * one.gravity[:, :1] / 9.81 * np.array([0.01, 0.0, 0.0])
        torque = np.cross(shift, one.gravity)
        bent.append(replace(one, raw=one.raw + torque @ RESPONSE.T[3:]))
    return bent


def touching(sets):
    touched = np.where(sets[2].gravity[:, 0] > 5.0, 3.0 * (sets[2].gravity[:, 0] - 5.0), 0.0)
    push = np.outer(touched, [-0.5, 0.0, -1.0, 0.3, 0.0, 0.1])
    return [*sets[:2], replace(sets[2], raw=sets[2].raw + push @ RESPONSE.T), sets[3]]


bumped = read_more(0, [15.0, -20.0, 10.0, 1.0, 0.0, 0.0], 200, 260)


def heavier(sets):
    return [*sets[:2], replace(sets[2], added_mass=0.62), sets[3]]


def misplaced(sets):
    return [*sets[:3], replace(sets[3], added_com=np.add(sets[3].added_com, [0.0, 0.04, 0.0]))]


def clipped(sets):
    top = float(np.quantile(sets[0].raw[:, 4], 0.9))
    return read_at(0, 4, lambda x: np.minimum(x, top))(sets), InSituOptions(code_range=(-40000.0, top))


empty = read_at(0, 1, lambda x: np.append(x[:3], np.full(len(x) - 3, np.nan)))


REFUSALS = {
    "planar motion": (planar, "Gravity was seen to turn in one plane only"),
    "two orientations": (two_orientations, "Gravity was seen to turn along one line only"),
    "one mass": (
        lambda s: s[:1],
        "Different added masses: 1, and three are needed to determine a matrix (Lemma 2)",
    ),
    "two masses": (lambda s: [*s[:2], s[1]], "Different added masses: 2, and three are needed"),
    "no set without": (lambda s: s[1:], "The 3 different added masses determine 36 of 40 unknowns"),
    "a limb that bends": (bending, "of the readings' spread goes with gravity's squares: the limb bends"),
    "a mass that is not as given": (
        heavier,
        "The likeliest cause: the added mass of 'data set 3' is 0.703 kg, and 0.620 kg was given (prob",
    ),
    "a place that is not as given": (
        misplaced,
        "cause: the added mass of 'data set 4' hangs at (0.259, 0.025, 0.270) m, and (0.259, 0.065",
    ),
    "a dead channel": (
        read_at(1, 3, lambda x: 12.0 + 0.0 * x),
        "'data set 2': channel 3 reads 12 throughout.",
    ),
    "a clipped channel": (clipped, "'data set 1': channel 4 is saturated in 10"),
    "no sample": (empty, "'data set 1': 3 of 600 samples are whole, and four are the least."),
    "units of g": (
        lambda s: [replace(one, gravity=one.gravity / 9.81) for one in s],
        "'data set 1': gravity is 1 m/s^2 long, where 9.81 is expected. Give it in m/s^2",
    ),
}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(*row, id=name, marks=pytest.mark.slow if name.startswith("a place") else ())
        for name, row in REFUSALS.items()
    ],
)
def test_refuses_with_the_reason_and_the_cure(make, message):
    made = make(leg_sets())
    sets, options = made if isinstance(made, tuple) else (made, None)
    fit = calibrate_in_situ(sets, options=options, refuse=False)
    assert fit.result is FitResult.REFUSED
    assert message in str(fit.refusals[0])
    assert fit.refusals[0].cure.endswith(".")
    for value in (fit.matrix, fit.offset, fit.covariance, fit.limb.mass):
        assert np.isnan(value).all()


def test_a_foot_in_contact_is_refused():
    # Where it pushes is seen as well as that it does; which of the checks sees it first depends on where.
    with pytest.raises(CalibrationRefused, match="'data set 3'"):
        calibrate_in_situ(touching(leg_sets()))


@pytest.mark.parametrize(("share", "out"), [(0.01, False), (0.1, True)])
def test_samples_that_are_off_by_a_little_stay(share, out):
    # Hysteresis leaves as much at the turns of a limb; more was a touch.
    sets, _ = noisy_sets("leg", np.random.default_rng(96), noise=0.01)
    raw = sets[2].raw.copy()
    raw[200:220] += share * raw.std(axis=0)
    fit = calibrate_in_situ([*sets[:2], replace(sets[2], raw=raw), sets[3]])
    assert any("'data set 3': 20 samples that disagree" in warning for warning in fit.warnings) == out
    assert fit.limb.mass == pytest.approx(MASS, rel=0.002)


def test_postures_that_a_filter_settles_in_are_answered():
    rng, share = np.random.default_rng(1), np.exp(-1.0)
    sets = []
    for added, place in zip(ADDED_MASS, ADDED_COM_LEG, strict=True):
        held = np.repeat(random_gravity(rng, 24), 25, axis=0)
        one = make_set(MATRIX, 500.0, (MASS, COM), (added, place), held)
        raw = lfilter([1.0 - share], [1.0, -share], one.raw, axis=0, zi=share * one.raw[:1])[0]
        raw = raw + (NOISE * rng.standard_normal((600, 6))) @ RESPONSE.T
        sets.append(replace(one, raw=raw, time=np.arange(600) / 10.0))
    fit = calibrate_in_situ(sets)
    assert abs(fit.limb.mass - MASS) < 4.0 * fit.limb_mass_std < 0.1 * MASS


def test_takes_the_same_sets_unhurt():
    fit = sound_fit()
    # What was not refused needs no reason, and keeps none.
    assert (fit.result, fit.accepted, fit.refusals) == (FitResult.DETERMINED, "", ())
    assert abs(fit.limb.mass - MASS) < 4.0 * fit.limb_mass_std


def test_a_scale_that_is_not_known_is_refused():
    # Masses of 20 g beside a limb of 4.9 kg.
    rng = np.random.default_rng(2)
    gravity = swept_gravity(600)
    sets = [
        make_set(MATRIX, 0.0, (MASS, COM), (0.03 * added, place), gravity, noise=0.01, rng=rng)
        for added, place in zip(ADDED_MASS, ADDED_COM_LEG, strict=True)
    ]
    with pytest.raises(
        CalibrationRefused, match=r"The limb's mass comes out as .* kg with a standard deviation of"
    ):
        calibrate_in_situ(sets)


def test_a_driver_that_takes_the_limbs_weight_off_is_named():
    """The bare limb's set then reads noise and a little wave, no large share of what the others read."""
    weight = np.concatenate([MASS * np.eye(3), np.cross(MASS * COM, np.eye(3))], axis=1)
    wave = 0.1 * np.sin(2.0 * leg_sets()[0].time)[:, None] * RESPONSE[:, 0]
    less = [replace(one, raw=one.raw + wave - one.gravity @ weight @ RESPONSE.T) for one in leg_sets()]
    with pytest.raises(CalibrationRefused, match="cause: the driver takes the limb's weight off already"):
        calibrate_in_situ(less)


def noise_channel(sets):
    rng = np.random.default_rng(3)
    return [replace(one, raw=np.column_stack([one.raw[:, :5], rng.standard_normal(600)])) for one in sets]


def twin_channels(sets):
    rng = np.random.default_rng(4)
    return [
        replace(one, raw=np.column_stack([one.raw[:, :5], one.raw[:, 0] + rng.standard_normal(600)]))
        for one in sets
    ]


@pytest.mark.parametrize("spoil", [pytest.param(noise_channel, marks=pytest.mark.slow), twin_channels])
def test_an_axis_that_nobody_saw_is_refused(spoil):
    with pytest.raises(CalibrationRefused):
        calibrate_in_situ(spoil(leg_sets()))


@pytest.mark.slow  # at rest they are above
def test_masses_are_checked_while_the_limb_moves():
    sets, _ = moving_sets(np.random.default_rng(5), noise=1.0)
    with pytest.raises(CalibrationRefused, match="added mass"):
        calibrate_in_situ(heavier(sets))


def test_a_temperature_that_stays_is_left_out():
    plain = sound_fit()
    fit = calibrate_in_situ([replace(one, temperature=np.full(600, 25.0)) for one in leg_sets()])
    assert "too little to show its effect" in fit.warnings[0]
    np.testing.assert_allclose(fit.offset, plain.offset)
    some = [replace(one, temperature=np.linspace(20, 30, 600)) for one in leg_sets()[:3]]
    fit = calibrate_in_situ([*some, leg_sets()[3]])
    assert "'data set 4' has no temperature" in fit.warnings[0]


@pytest.mark.parametrize(
    "factory",
    [
        pytest.param(None, id="by the masses"),
        pytest.param(MATRIX, id="by the matrix", marks=pytest.mark.slow),
    ],
)
def test_a_limb_that_is_not_as_given_is_refused(factory):
    sets = leg_sets() if factory is None else leg_sets()[:1]
    sound = calibrate_in_situ(sets, factory_matrix=factory, limb=KnownLimb(MASS, 0.05))
    assert not any("deviations apart" in warning for warning in sound.warnings)
    with pytest.raises(CalibrationRefused, match=r"the limb weighs 4\.\d+ kg, and 7\.350 kg were given"):
        calibrate_in_situ(sets, factory_matrix=factory, limb=KnownLimb(1.5 * MASS, 0.01))


def test_an_accelerometers_bias_is_taken_off():
    biased = [replace(one, gravity=np.add(one.gravity, [0.1, 0.0, 0.3])) for one in leg_sets()]
    fit, sound = calibrate_in_situ(biased), sound_fit()
    assert "it has a bias of about (0.10, 0.00, 0.30) m/s^2" in fit.warnings[0]
    np.testing.assert_allclose(fit.imu.bias, [0.1, 0.0, 0.3], atol=1e-3)
    off = (fit.offset - sound.offset) @ MATRIX.T
    assert np.abs(off[:3]).max() < 0.02  # N; 0.3 m/s^2 of the leg's 4.9 kg are 1.5 N


@pytest.mark.parametrize("seed", [8, pytest.param(9, marks=pytest.mark.slow)])
def test_noise_of_an_accelerometer_is_no_limb_that_bends_or_lags(seed):
    rng = np.random.default_rng(seed)
    noisy = [replace(one, gravity=one.gravity + 0.1 * rng.standard_normal((600, 3))) for one in leg_sets()]
    fit = calibrate_in_situ(noisy)
    assert fit.result is FitResult.DETERMINED
    assert abs(fit.limb.mass - MASS) < 3.0 * fit.limb_mass_std
    assert fit.hysteresis is None
    assert fit.imu.delay < 0.005  # s; a twentieth of the time between samples


def test_a_gyroscope_does_not_hide_the_accelerometer():
    sets, _ = moving_sets(np.random.default_rng(5), noise=1.0)
    sound = calibrate_in_situ(sets)
    assert sound.result is FitResult.DETERMINED
    assert sound.warnings == ()
    fit = calibrate_in_situ([replace(one, gravity=np.add(one.gravity, [0.0, 0.6, -0.8])) for one in sets])
    assert "it has a bias of about (0.00, 0.60, -0.80) m/s^2" in fit.warnings[0].replace("-0.00", "0.00")
    with pytest.raises(CalibrationRefused, match="the accelerometer's scale is off by"):
        calibrate_in_situ([replace(one, gravity=1.12 * one.gravity) for one in sets])


def test_a_channel_that_is_clipped_below_its_rail_is_named():
    clip = read_at(1, 4, lambda x: np.minimum(x, np.quantile(x, 0.95)))
    with pytest.raises(CalibrationRefused, match="'data set 2': channel 4 is clipped: 30 samples"):
        calibrate_in_situ(clip(leg_sets()))


@pytest.mark.parametrize("dwell", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_a_limb_that_rests_at_its_turns_is_not_clipped(dwell):
    # Counts without noise, the same for as long as the limb rests at the end of its sweep.
    turn = np.clip(np.linspace(-1.0 - dwell, 1.0 + dwell, 1500), -1.0, 1.0)
    angles = np.radians([[30.0 * a, 25.0 * np.sin(7.0 * a)] for a in turn])
    gravity = 9.81 * np.stack(
        [np.sin(angles[:, 0]), np.sin(angles[:, 1]), np.cos(angles[:, 0]) * np.cos(angles[:, 1])], axis=1
    )
    gravity *= 9.81 / np.linalg.norm(gravity, axis=1, keepdims=True)
    sets = [
        make_set(MATRIX, 0.0, (MASS, COM), (added, place), gravity)
        for added, place in zip(ADDED_MASS, ADDED_COM_LEG, strict=True)
    ]
    fit = calibrate_in_situ([replace(one, raw=np.round(one.raw)) for one in sets])
    assert fit.result is FitResult.DETERMINED


def test_masses_in_newtons_are_refused():
    masses = zip(leg_sets(), (0.0, 9.81, 14.715, 7.848), strict=True)
    with pytest.raises(CalibrationRefused, match=r"multiples of 0\.981 \(9\.81, 14\.715, 7\.848\)"):
        calibrate_in_situ([replace(one, added_mass=mass) for one, mass in masses])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"added_mass": 703.0}, "likely in grams"),
        ({"added_com": [-21.5, 108.3, 367.4]}, "likely in mm, cm or inches"),
    ],
)
def test_masses_and_places_that_nobody_hangs_are_refused(change, message):
    sets = leg_sets()
    with pytest.raises(CalibrationRefused, match=message):
        calibrate_in_situ([sets[0], replace(sets[1], **change), *sets[2:]])


def test_a_refusal_can_be_passed_with_a_reason():
    """All checks go on, so that one that was passed hides no other."""
    plain, options = clipped(heavier(leg_sets()))
    reason = "the maker knows of the clipping"
    fit = calibrate_in_situ(plain, options=options, accept=reason)
    assert fit.result is FitResult.ACCEPTED
    assert fit.accepted == reason
    assert np.isfinite(fit.matrix).all()
    said = [refusal.reason for refusal in fit.refusals]
    assert said[0].startswith("'data set 1': channel 4 is saturated")
    assert any("'data set 3': channel 4 is saturated" in one for one in said)
    assert any("The added masses contradict each other" in one for one in said)
    assert len(set(said)) == len(said)


def test_the_likeliest_cause_stays_with_a_fit_past_a_refusal():
    fit = calibrate_in_situ(bumped(leg_sets()), accept="the bump was left out")
    said = fit.refusals[0].reason
    assert "'data set 1': 10% of the samples disagree with all others, most of them between 20." in said
    assert "The likeliest cause: something touched the limb in 'data set 1'" in said
    assert fit.limb.mass == pytest.approx(MASS, rel=0.01)


@pytest.mark.parametrize("make", [planar, lambda sets: sets[:1], empty], ids=["plane", "one mass", "empty"])
def test_what_has_no_answer_cannot_be_accepted(make):
    with pytest.raises(CalibrationRefused, match=r"It cannot be accepted: there is no answer without that\."):
        calibrate_in_situ(make(leg_sets()), accept="I know better")


def test_a_limb_that_bends_a_little_is_answered_if_it_may_and_is_as_unsure():
    sets, _ = noisy_sets("leg", np.random.default_rng(90))
    soft = []
    for one in sets:
        torque = 0.002 * one.gravity * one.gravity[:, [1, 2, 0]]
        soft.append(replace(one, raw=one.raw + torque @ RESPONSE.T[3:]))
    fit = calibrate_in_situ(soft, accept="its joints give")
    assert any("goes with gravity's squares" in refusal.reason for refusal in fit.refusals)
    assert (fit.matrix_std > 0.003 * np.abs(fit.matrix)).all()
    assert 0.003 < fit.limb_mass_std / fit.limb.mass < 0.02


def pose_sets(walk, settle, rows):
    """Sets in 24 postures of equal gravity each, of a zero that walks (counts a sample) and a filter (s)."""
    rng, sets = np.random.default_rng(0), []
    for added, place in zip(ADDED_MASS, ADDED_COM_LEG, strict=True):
        gravity = np.repeat(hip_gravity(*rng.uniform(-40.0, 40.0, (2, 24))), rows, axis=0)
        one = make_set(MATRIX, 0.0, (MASS, COM), (added, place), gravity)
        kept = np.exp(-0.1 / settle) if settle else 0.0
        raw = lfilter([1.0 - kept], [1.0, -kept], one.raw, axis=0, zi=kept * one.raw[:1])[0]
        raw = raw + rng.standard_normal(raw.shape) + walk * np.cumsum(rng.standard_normal(raw.shape), axis=0)
        sets.append(replace(one, raw=raw, time=np.arange(len(raw)) / 10.0))
    return sets


@pytest.mark.parametrize(
    ("walk", "settle", "rows"),
    [pytest.param(5.0, 0.0, 25, id="a slow zero"), pytest.param(0.0, 0.1, 75, id="a filter")],
)
def test_gravity_that_repeats_while_a_limb_rests_is_not_held(walk, settle, rows):
    fit = calibrate_in_situ(pose_sets(walk, settle, rows))
    assert fit.result is FitResult.DETERMINED
    assert abs(fit.limb.mass - MASS) < 4.0 * fit.limb_mass_std
    assert fit.limb.mass == pytest.approx(MASS, rel=0.03)


@pytest.mark.parametrize("step", [0.1, 0.5])
def test_gravity_that_is_rounded_is_not_held(step):
    rounded = [replace(one, gravity=step * np.round(one.gravity / step)) for one in leg_sets()]
    assert calibrate_in_situ(rounded).limb.mass == pytest.approx(MASS, rel=0.01)


@pytest.mark.parametrize(("rows", "sets"), [(10, range(4)), (400, [2])], ids=["held", "stuck"])
def test_gravity_that_is_held_while_a_limb_turns_is_refused(rows, sets):
    held = [
        replace(one, gravity=one.gravity[np.arange(600) // rows * rows]) if j in sets else one
        for j, one in enumerate(leg_sets())
    ]
    with pytest.raises(CalibrationRefused, match=f"'data set {sets[0] + 1}': gravity repeats"):
        calibrate_in_situ(held)
