"""What the robot believes of its own motion, against the truth of walking in the simulator."""

from functools import cache

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from surefoot.calibration import ground_reference
from surefoot.calibration.front_end.filters import low_pass
from surefoot.calibration.reference import Reference
from surefoot.envs import load_nao_spec
from surefoot.robot import Beliefs, NominalModel, TelemetryLayout
from surefoot.robot.beliefs.errors import NO_ERRORS, BeliefErrors
from surefoot.sensors import Imu, Link, preset
from surefoot.sensors.transport.link import Packet
from surefoot.wrappers import FootSensors, SelfCalibration

DT = 1 / 80


@pytest.fixture(scope="module")
def exact() -> NominalModel:
    model = NominalModel(load_nao_spec(), NO_ERRORS)
    model.draw(np.random.default_rng(0))
    return model


def test_an_exact_model_agrees_with_the_simulator(exact: NominalModel) -> None:
    full = load_nao_spec().compile()
    data = mujoco.MjData(full)
    rng = np.random.default_rng(1)
    for _ in range(5):
        data.qpos[7:] = rng.uniform(-0.4, 0.4, full.nq - 7)
        data.qvel[6:] = rng.uniform(-1.0, 1.0, full.nv - 6)
        data.qvel[3:6] = rng.uniform(-1.0, 1.0, 3)
        mujoco.mj_forward(full, data)
        mujoco.mj_subtreeVel(full, data)
        torso = full.body("torso").id
        com, momentum, sites, axes = exact.evaluate(data.qpos[7:], data.qvel[6:], data.qvel[3:6])
        R, origin = data.xmat[torso].reshape(3, 3), data.xpos[torso]
        np.testing.assert_allclose(origin + R @ com, data.subtree_com[torso], atol=1e-12)
        np.testing.assert_allclose(R @ momentum, data.subtree_angmom[torso], atol=1e-12)
        for i, name in enumerate(("imu", "left_sole", "right_sole")):
            np.testing.assert_allclose(origin + R @ sites[i], data.site(name).xpos, atol=1e-12)
        for i, name in enumerate(("left_sole", "right_sole")):
            R_world_sole = data.site(name).xmat.reshape(3, 3)
            np.testing.assert_allclose(R @ axes[3 * i : 3 * i + 3].T, R_world_sole, atol=1e-12)


def test_the_nominal_model_is_wrong_by_its_errors(exact: NominalModel) -> None:
    nothing = np.zeros(24), np.zeros(24), np.zeros(3)
    com = exact.evaluate(*nothing)[0].copy()
    model = NominalModel(load_nao_spec())
    offsets, masses = [], []
    for seed in range(20):
        model.draw(np.random.default_rng(seed))
        offsets.append(model.evaluate(*nothing)[0] - com)
        masses.append(model.mass / exact.mass)
    np.testing.assert_allclose(np.abs(np.array(masses) - 1.0), 0.005, atol=1e-9)
    assert {mass > 1.0 for mass in masses} == {True, False}
    distance = np.linalg.norm(offsets, axis=1)
    assert distance.mean() == pytest.approx(0.003, rel=0.1)
    assert np.ptp(distance) < 1.5e-3
    model.draw(np.random.default_rng(3))
    np.testing.assert_array_equal(model.evaluate(*nothing)[0] - com, offsets[3])


def test_a_drawing_without_the_sites_is_refused() -> None:
    with pytest.raises(ValueError, match=r"has no site 'chest'; it has \['imu'"):
        NominalModel(load_nao_spec(), sites=("chest", "left_sole", "right_sole"))
    with pytest.raises(ValueError, match=r"BeliefErrors.com must lie in 0 to 1, got -0.1"):
        BeliefErrors(com=-0.1)


def test_soles_come_in_the_order_of_their_names() -> None:
    still = np.zeros(24), np.zeros(24), np.zeros(3)
    _, _, sites, axes = NominalModel(load_nao_spec()).evaluate(*still)
    _, _, turned, turned_axes = NominalModel(
        load_nao_spec(), sites=("imu", "right_sole", "left_sole")
    ).evaluate(*still)
    np.testing.assert_array_equal(turned, sites[[0, 2, 1]])
    np.testing.assert_array_equal(turned_axes, axes[[3, 4, 5, 0, 1, 2]])
    assert sites[1, 1] > 0.0 > sites[2, 1]


def packets_of(count: int, values: np.ndarray, jitter: float = 0.0, seed: int = 0) -> tuple[Packet, ...]:
    rng = np.random.default_rng(seed)
    late = 0.020 + jitter * rng.standard_normal(count)
    return tuple(Packet(i, 0.01 * i + late[i], values) for i in range(count))


def at_rest() -> np.ndarray:
    layout = TelemetryLayout(24)
    values = np.zeros(layout.size)
    values[layout.accelerometer] = 0.0, 0.0, 9.81
    return values


def test_at_rest_nothing_moves_and_soles_are_level(exact: NominalModel) -> None:
    beliefs = Beliefs(exact, TelemetryLayout(24), 0.01, 0.02, averaged=True)
    beliefs.update(packets_of(30, at_rest()))
    reference = beliefs.reference(0.15, np.ones(2, bool), np.zeros(2, bool))
    np.testing.assert_allclose(reference.com_acceleration, 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.angular_momentum_rate, 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.position_sole, [(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)], atol=1e-9)
    np.testing.assert_allclose(reference.R_level_sole, np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)
    assert reference.com[2] == pytest.approx(0.287, abs=0.03)
    left, right = beliefs.soles(0.35)
    assert left == pytest.approx((0.0, 0.05, 1.0, 0.0), abs=1e-9)
    assert right == pytest.approx((0.0, -0.05, 1.0, 0.0), abs=1e-9)


def test_before_telemetry_has_come_nothing_is_known(exact: NominalModel) -> None:
    beliefs = Beliefs(exact, TelemetryLayout(24), 0.01, 0.02, averaged=True)
    beliefs.update(packets_of(3, at_rest()))
    reference = beliefs.reference(0.0, np.ones(2, bool), np.zeros(2, bool))
    assert np.isnan(reference.com).all()
    assert reference.stance.all()


def test_a_lost_packet_is_no_jump(exact: NominalModel) -> None:
    beliefs = Beliefs(exact, TelemetryLayout(24), 0.01, 0.02, averaged=True)
    packets = packets_of(40, at_rest())
    beliefs.update((*packets[:20], *packets[23:]))
    reference = beliefs.reference(0.2, np.ones(2, bool), np.zeros(2, bool))
    np.testing.assert_allclose(reference.com_acceleration, 0.0, atol=1e-9)


def test_jitter_averages_out_of_the_clock(exact: NominalModel) -> None:
    """A joint that turns evenly is read at its right angle although packets come 4 ms early or late."""
    layout, errors = TelemetryLayout(24), []
    for seed in range(5):
        beliefs = Beliefs(exact, layout, 0.01, 0.02, averaged=True)
        for packet in packets_of(400, at_rest(), jitter=0.004, seed=seed):
            values = at_rest()
            values[layout.gyroscope] = packet.number, 0.0, 0.0
            beliefs.update((packet._replace(values=values),))
        # A sample that is the mean since the packet before stands for half a period earlier.
        when = beliefs.reference(3.5, np.ones(2, bool), np.zeros(2, bool)).gyroscope[0] - 0.5
        errors.append(0.01 * when - 3.5)
    assert np.abs(errors).max() < 1.2e-3


class _Walk:
    """A walk, its references, and the truth at the moments that they describe."""

    def __init__(self, make_bare, steps: int = 480, **options) -> None:
        env = SelfCalibration(FootSensors(make_bare()), "none", **options)
        env.reset(seed=4)
        base, references, moments, rows = env.unwrapped, [], [], []
        for step in range(steps):
            env.step(np.zeros(11, dtype=np.float32))
            rows.append(base.truth)
            if step > 40:
                references.append(env.reference)
                moments.append(env.reference_time)
        self.mass = env.beliefs.model.mass
        self.reference = Reference(*(np.stack(part) for part in zip(*references, strict=True)))
        # The host's clock counts the end of a substep, a row of truth its beginning.
        time = np.concatenate([truth.time for truth in rows]) + DT / 10
        force = np.concatenate([truth.force_cell for truth in rows])
        self._time, self._moments = time, np.array(moments)
        position = self._at(np.concatenate([truth.position_sole for truth in rows]))
        R = self._at(np.concatenate([truth.R_world_sole for truth in rows]))
        cells = np.concatenate(base.position_cell_sole)
        feet = np.repeat([0, 1], 4)
        places = position[:, feet] + np.einsum("nkij,kj->nki", R[:, feet], cells)
        force = self._at(force)
        origin, forward = position.mean(axis=1), R[:, :, :2, 0].sum(axis=1)
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
        self._origin, self._forward = origin, forward
        self.vgrf = force.sum(axis=-1)
        self.moment = np.einsum("nk,nki->ni", force, self._level(places - origin[:, None]))
        self.com = self._level(self._at(np.concatenate([truth.com for truth in rows])) - origin)
        self.position_sole = self._level(position - origin[:, None])
        self.load = force.reshape(-1, 2, 4).sum(axis=-1)

    def _at(self, values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1)
        found = [np.interp(self._moments, self._time, column) for column in flat.T]
        return np.stack(found, axis=-1).reshape(len(self._moments), *values.shape[1:])

    def _level(self, vectors: np.ndarray) -> np.ndarray:
        shape = (-1,) + (1,) * (vectors.ndim - 2)
        c, s = self._forward[:, 0].reshape(shape), self._forward[:, 1].reshape(shape)
        x, y = vectors[..., 0], vectors[..., 1]
        return np.stack([c * x + s * y, c * y - s * x], axis=-1)

    def ground(self) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the reference's vertical force in N and centre of pressure in m behind 10 Hz filters."""
        asked = ground_reference(self.reference, self.mass)
        both = []
        for force, moment in ((asked.vgrf, asked.moment), (self.vgrf, self.moment)):
            signal = np.column_stack([force, moment])
            init, apply = low_pass(10.0, DT)
            state, rows = init(signal[0]), []
            for sample in signal:
                filtered, state = apply(sample, state)
                rows.append(filtered)
            rows = np.array(rows)[80:]
            both.append((rows[:, 0], rows[:, 1:] / rows[:, :1]))
        (force, cop), (true_force, true_cop) = both
        return force - true_force, cop - true_cop


@pytest.fixture(scope="module")
def walks() -> dict[str, _Walk]:
    @cache
    def make() -> gym.Env:
        return gym.make("surefoot/NaoWalk-v0", speed=0.04, duration=12.0, push_impulse=(0.0, 0.0))

    return {
        "exact": _Walk(make, errors=NO_ERRORS),
        "default": _Walk(make),
    }


def test_the_soles_are_where_they_are(walks: dict[str, _Walk]) -> None:
    error = walks["exact"].reference.position_sole[..., :2] - walks["exact"].position_sole
    assert np.sqrt(np.mean(error**2)) < 0.6e-3


def test_the_centre_of_mass_is_off_by_what_the_model_is_off(walks: dict[str, _Walk]) -> None:
    exact, default = (walk.reference.com[:, :2] - walk.com for walk in walks.values())
    assert np.sqrt(np.mean(np.sum(exact**2, axis=-1))) < 1e-3
    assert np.sqrt(np.mean(np.sum(default**2, axis=-1))) < 4e-3
    assert default.std(axis=0).max() < 1e-3


def test_what_the_motion_asks_for_is_what_the_ground_exerts(walks: dict[str, _Walk]) -> None:
    force, cop = walks["exact"].ground()
    assert np.sqrt(np.mean(force**2)) < 0.5
    assert np.sqrt(np.mean(np.sum(cop**2, axis=-1))) < 2.5e-3
    force, cop = walks["default"].ground()
    assert np.sqrt(np.mean(force**2)) < 0.7
    assert np.sqrt(np.mean(np.sum(cop**2, axis=-1))) < 5e-3


def test_feet_that_surely_stand_or_swing_do(walks: dict[str, _Walk]) -> None:
    walk = walks["default"]
    stance, swing = walk.reference.stance, walk.reference.swing
    assert stance.mean() > 0.5
    assert swing.mean() > 0.1
    assert not (stance & swing).any()
    assert walk.load[stance].min() > 0.5
    assert np.abs(walk.load[swing]).max() < 0.5


def test_links_decide_how_late_a_reference_is(make_bare) -> None:
    late = {}
    for link in (Link(), Link(delay=0.05), preset("perfect", Link)):
        env = SelfCalibration(FootSensors(make_bare(), link=link), "none")
        late[link.delay] = env.reset(seed=0)[1]["surefoot"]["lag"]
    assert late[0.02] == 4
    assert late[0.05] == 6
    assert late[0.0] == 4


def test_an_imu_without_averaging_does_as_well(make_bare) -> None:
    imu = Imu(averaged=False)
    env = SelfCalibration(FootSensors(make_bare(), imu=imu), "none", errors=NO_ERRORS)
    env.reset(seed=0)
    lift = [env.step(np.zeros(11, dtype=np.float32))[4]["surefoot"]["reference"] for _ in range(240)]
    vertical = np.array([reference["com_acceleration"][2] for reference in lift[80:]])
    assert abs(vertical.mean()) < 0.05
