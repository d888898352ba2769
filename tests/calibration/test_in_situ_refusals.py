"""Refusals of in-situ calibration, and their words."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from _in_situ import ADDED_COM_LEG, ADDED_MASS, SENSORS, make_set, moving_sets, noisy_sets, swept_gravity
from _in_situ_stacked import wrench_of_gravity
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb, calibrate_in_situ, limits
from surefoot.calibration.results import CalibrationRefused, FitResult

MATRIX, MASS, COM, _ = SENSORS["leg"]
RESPONSE = np.linalg.inv(MATRIX)
NOISE = np.array([0.05, 0.05, 0.05, 0.001, 0.001, 0.001])


@cache
def leg_sets():
    return noisy_sets("leg", np.random.default_rng(0), noise=0.5)[0]


@cache
def sound_fit():
    return calibrate_in_situ(leg_sets(), accept="for all cases")


def with_raw(one, change):
    raw = one.raw.copy()
    change(raw)
    return replace(one, raw=raw)


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


def bumped(sets):
    def bump(raw):
        raw[200:260] += RESPONSE @ [15.0, -20.0, 10.0, 1.0, 0.0, 0.0]

    return [with_raw(sets[0], bump), *sets[1:]]


def heavier(sets):
    return [*sets[:2], replace(sets[2], added_mass=0.62), sets[3]]


def misplaced(sets):
    return [*sets[:3], replace(sets[3], added_com=np.add(sets[3].added_com, [0.0, 0.04, 0.0]))]


def dead(sets):
    def constant(raw):
        raw[:, 3] = 12.0

    return [sets[0], with_raw(sets[1], constant), *sets[2:]]


def clipped(sets):
    top = np.quantile(sets[0].raw[:, 4], 0.9)

    def clip(raw):
        raw[:, 4] = np.minimum(raw[:, 4], top)

    return [with_raw(sets[0], clip), *sets[1:]], InSituOptions(code_range=(-40000.0, float(top)))


def empty(sets):
    def lose(raw):
        raw[3:, 1] = np.nan

    return [with_raw(sets[0], lose), *sets[1:]]


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
        "Likeliest: the added mass of 'data set 3' is 0.703 kg, and 0.620 kg was given (> 99 %)",
    ),
    "a place that is not as given": (
        misplaced,
        "Likeliest: the added mass of 'data set 4' hangs at (0.258, 0.025, 0.270) m, and (0.259, 0.065",
    ),
    "a dead channel": (dead, "'data set 2': channel 3 reads 12 throughout."),
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


def stepped(sets):
    def leap(raw):
        raw[350:] += RESPONSE @ [6.0, -4.0, 8.0, 0.3, 0.0, 0.1]

    return [sets[0], with_raw(sets[1], leap), *sets[2:]]


def pushed(sets):
    def push(raw):
        raw[300:420] += RESPONSE @ [-5.0, 3.0, -5.5, 1.0, 0.4, 0.2]

    return [*sets[:3], with_raw(sets[3], push)]


def rotated(sets):
    R = Rotation.from_euler("xyz", [6.0, 4.0, -7.0], degrees=True).as_matrix()
    return [replace(one, gravity=one.gravity @ R) for one in sets]


def exchanged(sets):
    return [
        replace(sets[0], added_mass=sets[3].added_mass, added_com=sets[3].added_com),
        *sets[1:3],
        replace(sets[3], added_mass=0.0, added_com=sets[0].added_com),
    ]


LEVERS = np.repeat([1.0, 0.15], 3)
AGED = (
    np.eye(6) + 0.15 * np.random.default_rng(4).standard_normal((6, 6)) * np.outer(LEVERS, 1.0 / LEVERS)
) @ MATRIX
"""With the masses where they did not hang, this one seems to be in other units."""

CAUSES = {
    "a step": (None, stepped, "the zero of 'data set 2' leaps at 35.0 s (> 99 %)", "Cut the set there"),
    "a push": (
        MATRIX,
        pushed,
        "something touched the limb in 'data set 4' from 30.0 s to 41.9 s",
        "Leave that",
    ),
    "an IMU that is turned": (MATRIX, rotated, "the IMU is turned by 10 degrees", "'estimate_rotation'"),
    "sets exchanged": (
        None,
        exchanged,
        "what was added in 'data set 1' and 'data set 4' is exchanged",
        "Weigh",
    ),
    "sets exchanged, aged matrix": (
        AGED,
        exchanged,
        "what was added in 'data set 1' and 'data set 4' is exchanged",
        "Weigh",
    ),
}


@pytest.mark.parametrize(
    ("factory", "make", "cause", "cure"),
    [
        pytest.param(*row, id=name, marks=() if name == "sets exchanged" else pytest.mark.slow)
        for name, row in CAUSES.items()
    ],
)
def test_the_likeliest_cause_is_named_first(factory, make, cause, cure):
    with pytest.raises(CalibrationRefused, match=re.escape(f"Likeliest: {cause}")) as raised:
        calibrate_in_situ(make(leg_sets()), factory_matrix=factory)
    assert cure in raised.value.cure


@pytest.mark.slow  # a turned IMU at rest is among the causes above
@pytest.mark.parametrize("slower", [1.0, 15.0], ids=["known", "felt"])
def test_a_turned_imu_that_moves_is_named(slower):
    """Slow turning that nobody gave is felt: it explains more of the readings, and is not to blame."""
    sets, _ = moving_sets(np.random.default_rng(5), noise=1.0 if slower == 1.0 else 0.5, slower=slower)
    R = Rotation.from_euler("xyz", [6.0, 4.0, -7.0], degrees=True).as_matrix()
    turned = [
        replace(
            one,
            gravity=one.gravity @ R,
            angular_velocity=one.angular_velocity @ R if slower == 1.0 else None,
            angular_acceleration=one.angular_acceleration @ R if slower == 1.0 else None,
        )
        for one in sets
    ]
    with pytest.raises(CalibrationRefused, match="Likeliest: the IMU is turned by 10 degrees"):
        calibrate_in_situ(turned)


TRANSFORMS = {
    "transposed": (lambda F: F.T, "the factory matrix is transposed"),
    "inverted": (np.linalg.inv, "the factory matrix is inverted"),
    "torques first": (lambda F: np.roll(F, 3, axis=0), "rows of the factory matrix are torques first"),
    "N mm": (lambda F: np.concatenate([F[:3], 1e3 * F[3:]]), "units of the factory's torques are N mm"),
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(*row, id=name, marks=() if name == "torques first" else pytest.mark.slow)
        for name, row in TRANSFORMS.items()
    ],
)
def test_a_factory_matrix_that_is_read_wrongly_is_named(change, words):
    with pytest.raises(CalibrationRefused, match=f"Likeliest: {words}"):
        calibrate_in_situ(leg_sets(), factory_matrix=change(MATRIX))


@pytest.mark.parametrize(
    ("mass", "place", "words"),
    [
        (1.0 / 0.45359237, 1.0, "masses are in lb"),
        pytest.param(1.0, -1.0, "all places of the masses", marks=pytest.mark.slow),
    ],
)
def test_units_and_signs_of_masses_contradict_a_factory_matrix(mass, place, words):
    sets = [
        replace(one, added_mass=mass * one.added_mass, added_com=place * one.added_com) for one in leg_sets()
    ]
    with pytest.raises(CalibrationRefused, match=f"Likeliest: {words}"):
        calibrate_in_situ(sets, factory_matrix=MATRIX)


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


def test_takes_the_same_sets_unhurt():
    fit = sound_fit()
    # What was not refused needs no reason, and keeps none.
    assert (fit.result, fit.accepted, fit.refusals) == (FitResult.DETERMINED, "", ())
    assert abs(fit.limb.mass - MASS) < 4.0 * fit.limb_mass_std


LIMB = KnownLimb(MASS, 0.02, COM, 0.002)
FREE = InSituOptions(factory_std=(1.0,) * 6)
"""What cross-validation chooses for a factory matrix that is far off."""


@pytest.mark.parametrize(
    ("row", "column", "factor", "sets", "given"),
    [
        (2, 4, -1.0, 4, {}),
        *(
            pytest.param(*entry, *log, marks=pytest.mark.slow)
            for entry in ((2, 4, -1.0), (0, 5, 10.0), (1, 1, 0.1))
            for log in ((4, {"options": FREE}), (1, {"limb": LIMB, "options": FREE}))
        ),
    ],
)
def test_one_corrupt_entry_of_the_factory_matrix_is_named(row, column, factor, sets, given):
    corrupt = MATRIX.copy()
    corrupt[row, column] *= factor
    message = re.escape(
        f"Likeliest: entry [{row}, {column}] of the factory matrix, {corrupt[row, column]:.4g}, is "
    )
    with pytest.raises(CalibrationRefused, match=message):
        calibrate_in_situ(leg_sets()[:sets], factory_matrix=corrupt, **given)


def test_planar_motion_is_a_warning_beside_a_factory_matrix():
    rng = np.random.default_rng(1)
    angle = np.radians(rng.uniform(-40.0, 40.0, 400))
    gravity = 9.81 * np.stack([np.sin(angle), np.zeros(400), np.cos(angle)], axis=1)
    raw = (
        gravity @ wrench_of_gravity(MASS, COM).T @ RESPONSE.T
        + (NOISE * rng.standard_normal((400, 6))) @ RESPONSE.T
    )
    fit = calibrate_in_situ(
        [InSituSet(raw, gravity)], factory_matrix=MATRIX, limb=KnownLimb(MASS, 0.05, COM, 0.005)
    )
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert "in one plane only" in fit.warnings[0]
    np.testing.assert_allclose(fit.offset @ MATRIX.T, 0.0, atol=0.6)


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


ARGUMENTS = {
    "no set": (lambda s: ([], {}), "Give at least one set of readings."),
    "other channels": (
        lambda s: ([s[0], replace(s[1], raw=np.ones((600, 7)))], {}),
        "All sets must have the same number of channels, got [6, 7].",
    ),
    "blank reason": (
        lambda s: (s, {"accept": " \n"}),
        "'accept' must say why a refusal may be passed, got ' \\n'; leave it empty if none may.",
    ),
    "factory shape": (
        lambda s: (s, {"factory_matrix": np.eye(5)}),
        "'factory_matrix' must have shape (6, 6), got (5, 5).",
    ),
    "factory rank": (
        lambda s: (s, {"factory_matrix": np.ones((6, 6))}),
        "'factory_matrix' must be finite and of rank 6",
    ),
}


@pytest.mark.parametrize(("make", "message"), ARGUMENTS.values(), ids=ARGUMENTS.keys())
def test_bad_arguments(make, message):
    sets, options = make(leg_sets())
    with pytest.raises(ValueError, match=re.escape(message)):
        calibrate_in_situ(sets, **options)


SETS = {
    "channels": ({"raw": np.ones((5, 4))}, "'raw' must have shape (n, k) with k >= 6, got (5, 4)."),
    "gravity": ({"gravity": np.ones((4, 3))}, "'gravity' must have shape (5, 3), got (4, 3)."),
    "rate alone": ({"angular_velocity": np.ones((5, 3))}, "give angular velocity and acceleration together"),
    "time": (
        {"time": [0.0, 1.0, 1.0, 2.0, 3.0]},
        "'time' must be finite and increase from sample to sample.",
    ),
    "mass": ({"added_mass": -0.1}, "'added_mass' must be at least 0 kg and finite, got -0.1."),
    "place": ({"added_com": [0.0, np.nan, 0.0]}, "'added_com' must be finite"),
}


@pytest.mark.parametrize(("change", "message"), SETS.values(), ids=SETS.keys())
def test_bad_sets(change, message):
    good = {"raw": np.ones((5, 6)), "gravity": np.ones((5, 3)), "name": "one"}
    with pytest.raises(ValueError, match=re.escape(message)):
        InSituSet(**(good | change))


OPTIONS = {
    "shares": ({"factory_std": (0.1, 0.1)}, "'factory_std' must hold six positive shares, one an axis"),
    "range": ({"code_range": (5.0, 5.0)}, "'code_range' must be (lowest, highest), got (5.0, 5.0)."),
}


@pytest.mark.parametrize(("change", "message"), OPTIONS.values(), ids=OPTIONS.keys())
def test_bad_options(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        InSituOptions(**change)


def test_every_limit_has_a_unit_and_a_source_and_is_used():
    table = {name: value for name, value in vars(limits).items() if isinstance(value, limits.Limit)}
    assert len(table) > 40
    assert all(value.unit and value.source for value in table.values())
    package = Path(limits.__file__).parent
    code = " ".join(path.read_text() for path in package.glob("*.py"))
    assert [name for name in table if f"limits.{name}" not in code] == []


def test_a_known_limb_is_checked():
    with pytest.raises(ValueError, match="'mass_std' must be positive and finite, got 0"):
        KnownLimb(1.0, 0)
    with pytest.raises(ValueError, match="'com' must be three finite numbers in m"):
        KnownLimb(1.0, 0.1, com=np.ones(2))


def test_a_rotation_needs_a_limb_at_rest():
    sets = leg_sets()
    still = np.zeros((600, 3))
    moving = [replace(one, angular_velocity=still, angular_acceleration=still) for one in sets]
    with pytest.raises(ValueError, match="'estimate_rotation' needs a limb at rest"):
        calibrate_in_situ(moving, options=InSituOptions(estimate_rotation=True))


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


def test_gravity_of_the_wrong_sign_contradicts_a_factory_matrix():
    up = [replace(one, gravity=-one.gravity) for one in leg_sets()]
    with pytest.raises(CalibrationRefused, match="Likeliest: the sign of gravity or of the factory"):
        calibrate_in_situ(up[:1], factory_matrix=MATRIX, limb=LIMB, options=FREE)


def test_an_accelerometers_bias_is_taken_off():
    biased = [replace(one, gravity=np.add(one.gravity, [0.1, 0.0, 0.3])) for one in leg_sets()]
    fit, sound = calibrate_in_situ(biased), sound_fit()
    assert "it has a bias of about (0.10, 0.00, 0.30) m/s^2" in fit.warnings[0]
    np.testing.assert_allclose(fit.accelerometer_bias, [0.1, 0.0, 0.3], atol=1e-3)
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
    assert fit.delay < 0.005  # s; a twentieth of the time between samples


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
    def clip(raw):
        raw[:, 4] = np.minimum(raw[:, 4], np.quantile(raw[:, 4], 0.95))

    sets = leg_sets()
    with pytest.raises(CalibrationRefused, match="'data set 2': channel 4 is clipped: 30 samples"):
        calibrate_in_situ([sets[0], with_raw(sets[1], clip), *sets[2:]])


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"added_mass": 703.0}, "likely in grams"),
        ({"added_com": [-21.5, 108.3, 367.4]}, "likely in mm or cm"),
    ],
)
def test_masses_and_places_that_nobody_hangs_are_refused(change, message):
    sets = leg_sets()
    with pytest.raises(CalibrationRefused, match=message):
        calibrate_in_situ([sets[0], replace(sets[1], **change), *sets[2:]])


def test_a_scale_that_is_the_makers_is_as_unsure_as_makers_are():
    fit = calibrate_in_situ(leg_sets()[:1], factory_matrix=1.1 * MATRIX)
    assert any(one.startswith("The readings alone give 0% of what is known of") for one in fit.warnings)
    assert abs(fit.limb.mass - MASS) < 2.5 * fit.limb_mass_std


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
    assert "Likeliest: something touched the limb in 'data set 1'" in said
    assert fit.limb.mass == pytest.approx(MASS, rel=0.01)


@pytest.mark.parametrize("make", [planar, lambda sets: sets[:1], empty], ids=["plane", "one mass", "empty"])
def test_what_has_no_answer_cannot_be_accepted(make):
    with pytest.raises(CalibrationRefused, match=r"It cannot be accepted: there is no answer without that\."):
        calibrate_in_situ(make(leg_sets()), accept="I know better")


@pytest.mark.parametrize(
    ("aged", "shown"),
    [
        (0.64, 0.64),
        pytest.param(1.3, None, marks=pytest.mark.slow),
        ([1.7, 1.6, 1.5, 1, 1, 1], None),
    ],
)
def test_a_factory_matrix_whose_scale_is_nearer_to_another_unit_is_warned_about(aged, shown):
    # Masses in lb read 0.45 times a matrix that has aged, each of its axes by itself.
    fit = calibrate_in_situ(leg_sets(), factory_matrix=np.multiply(np.reshape(aged, (-1, 1)), MATRIX))
    found = re.search(r"By the factory matrix the readings show ([\d.]+) times", " ".join(fit.warnings))
    assert (found and float(found[1])) == (shown and pytest.approx(shown, rel=0.02))


@pytest.mark.parametrize(
    ("aged", "unit"), [pytest.param(0.54, "masses are in lb", marks=pytest.mark.slow), (1.9, "converted")]
)
def test_a_factory_matrix_whose_scale_is_clearly_that_of_another_unit_is_refused(aged, unit):
    with pytest.raises(CalibrationRefused, match=f"Likeliest: .*{unit}"):
        calibrate_in_situ(leg_sets(), factory_matrix=aged * MATRIX)


def test_a_limb_that_bends_a_little_is_answered_if_it_may_and_is_as_unsure():
    sets, _ = noisy_sets("leg", np.random.default_rng(90))
    soft = []
    for one in sets:
        torque = 0.002 * one.gravity * one.gravity[:, [1, 2, 0]]
        soft.append(replace(one, raw=one.raw + torque @ RESPONSE.T[3:]))
    fit = calibrate_in_situ(soft, accept="its joints give")
    assert any("goes with gravity's squares" in refusal.reason for refusal in fit.refusals)
    assert 0.003 < fit.bending < 0.01
    assert (fit.matrix_std > fit.bending * np.abs(fit.matrix)).all()
    assert fit.limb_mass_std > fit.bending * fit.limb.mass
