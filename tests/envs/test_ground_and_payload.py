"""Soft and slippery ground, and a payload: what changes, and that nothing else does."""

import mujoco
import numpy as np
import pytest
from _refusals import refusals

from surefoot.envs.nao.disturbances import POSITION_PAYLOAD_TORSO, Payload
from surefoot.envs.nao.stand import NaoStandEnv
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.robots.nao import load_nao_spec

GRAVITY = 9.81
ZERO = np.zeros(11, dtype=np.float32)


def rows(env, seed, steps):
    env.reset(seed=seed)
    seen = []
    for _ in range(steps):
        env.step(ZERO)
        seen.append(env.truth.rows.copy())
    return np.array(seen)


def test_by_default_nothing_is_changed_bit_for_bit():
    options = {"duration": 6.0, "push_impulse": (0.1, 0.3), "push_interval": 0.5}
    off = {"route": None, "foot_roll": 0.0, "ground_time_constant": 0.02, "payload": None}
    plain, explicit = NaoWalkEnv(**options), NaoWalkEnv(**options, **off)
    model, published = plain.model, load_nao_spec().compile()
    for name in ("pair_solref", "body_mass", "body_inertia", "body_ipos", "body_iquat", "body_invweight0"):
        np.testing.assert_array_equal(getattr(model, name), getattr(published, name), err_msg=name)
    expected = rows(plain, 3, 170)
    np.testing.assert_array_equal(rows(explicit, 3, 170), expected)
    # A payload of another episode's future is none in this one's past.
    later = rows(NaoWalkEnv(**options, payload=(0.5, 2.0)), 3, 170)
    np.testing.assert_array_equal(later[:160], expected[:160])
    assert not np.array_equal(later, expected)


def sole_height(env):
    for _ in range(160):
        env.step(ZERO)
    return env.truth.position_sole[-1, :, 2]


def test_softer_ground_gives_way_further_and_carries_the_same_weight():
    depth = []
    for constant in (0.01, 0.02, 0.04, 0.06):
        env = NaoStandEnv(joint_noise=0.0, velocity_noise=0.0, ground_time_constant=constant)
        env.reset(seed=0)
        start = -env.truth.position_sole[-1, :, 2]
        depth.append(-sole_height(env))
        # The robot starts less deep than it will stand, but not far above.
        assert (start < depth[-1]).all()
        assert (start > 0.3 * depth[-1]).all()
        weight = env.model.body_subtreemass[0] * GRAVITY
        assert env.truth.vgrf().sum() == pytest.approx(weight, rel=0.005)
    growth = np.diff(np.log(depth), axis=0) / np.diff(np.log([0.01, 0.02, 0.04, 0.06]))[:, None]
    assert (growth > 1.0).all()
    assert (growth < 2.2).all()


def test_slippery_ground_is_slipped_on():
    """A stance foot stays where it is on rough ground and slides where friction cannot hold the walk."""
    slid = []
    for friction in (0.7, 0.03):
        env = NaoWalkEnv(speed=0.1, duration=6.0, friction=(friction, friction), push_impulse=(0.0, 0.0))
        env.reset(seed=0)
        way, last = 0.0, env.truth.position_sole[-1].copy()
        for _ in range(320):
            env.step(ZERO)
            now = env.truth.position_sole[-1]
            carrying = env.truth.vgrf() > 20.0
            way += np.linalg.norm((now - last)[carrying, :2], axis=-1).sum()
            last = now.copy()
        slid.append(way)
    assert slid[0] < 0.03
    assert slid[1] > 3.0 * slid[0]


def test_a_payload_appears_at_its_time_and_weighs_what_it_weighs():
    env = NaoStandEnv(duration=None, payload=(0.4, 2.0), joint_noise=0.0, velocity_noise=0.0)
    env.reset(seed=0)
    weight, com = [], []
    for _ in range(400):
        env.step(ZERO)
        weight.append(env.truth.vgrf().sum() / GRAVITY)
        com.append(env.truth.com[-1].copy())
    assert weight[150] == pytest.approx(5.30535, rel=1e-3)
    assert weight[-1] == pytest.approx(5.70535, rel=1e-3)
    # The centre of mass jumps with it, by the payload's share of the way to it, and not a step before.
    jump = np.abs(np.diff(com, axis=0)).max(axis=1)
    assert int(jump.argmax()) == 159
    torso = env.truth.position_torso[-1]
    expected = 0.4 * (torso + POSITION_PAYLOAD_TORSO - com[159]) / 5.70535
    np.testing.assert_allclose(com[160] - com[159], expected, atol=3e-4)
    # What the robot commands itself knows nothing of it.
    np.testing.assert_array_equal(env.command.com, NaoStandEnv().command_at(None, 400).com)


def test_a_payload_is_put_down_at_the_reset_bit_for_bit():
    env, fresh = NaoStandEnv(payload=(0.6, 0.5)), NaoStandEnv(payload=(0.6, 0.5))
    first = rows(env, 5, 120)
    np.testing.assert_array_equal(first, rows(env, 5, 120))
    np.testing.assert_array_equal(first, rows(fresh, 5, 120))


def test_torso_and_payload_make_one_rigid_body():
    """Against MuJoCo's own compiler, given the cube as a body of its own: the same mass matrix."""
    spec = load_nao_spec()
    cube = spec.body("torso").add_body(name="payload", pos=list(POSITION_PAYLOAD_TORSO))
    cube.explicitinertial = True
    cube.mass, cube.ipos, cube.inertia = 0.5, [0.0] * 3, [0.5 * 0.06**2 / 6] * 3
    expected, model = spec.compile(), load_nao_spec().compile()
    payload = Payload(model, (0.5, 0.0), 0.0125)
    payload.apply(0)
    assert not payload.carried
    payload.apply(1)
    assert payload.carried
    matrices = []
    for each in (expected, model):
        data = mujoco.MjData(each)
        mujoco.mj_resetDataKeyframe(each, data, 0)
        mujoco.mj_forward(each, data)
        full = np.zeros((each.nv, each.nv))
        mujoco.mj_fullM(each, data, full)
        matrices.append(full)
    np.testing.assert_allclose(matrices[1], matrices[0], atol=1e-9)
    assert model.body_subtreemass[0] == pytest.approx(expected.body_subtreemass[0])


test_impossible_options_are_refused = refusals(
    lambda options: NaoStandEnv(**options),
    ({"ground_time_constant": 0.001}, r"'ground_time_constant' must lie between 0.005 s .* got 0.001"),
    ({"payload": 0.5}, r"'payload' must be \(mass in kg, time in s .* got 0.5"),
)
