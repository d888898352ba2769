"""How feet are found and measured, on toys whose soles are known."""

import re
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from surefoot.envs import instrument


def toy(foot, extra="", names=("foot_l", "foot_r")):
    """A torso on two legs with feet of some geoms."""
    legs = "".join(
        f'<body name="{name}" pos="0 {y} -0.5"><joint name="{name}" axis="0 1 0" pos="0 0 0.1"/>{foot}</body>'
        for name, y in zip(names, (0.1, -0.1), strict=True)
    )
    return mujoco.MjSpec.from_string(
        '<mujoco><asset><mesh name="wedge" '
        'vertex="-0.1 -0.04 0 0.1 -0.04 0 0.1 0.04 0 -0.1 0.04 0 0 0 0.06"/></asset>'
        '<worldbody><geom name="floor" type="plane" size="5 5 1"/><body name="torso" pos="0 0 1">'
        f'<freejoint/><geom size="0.1" mass="5"/>{legs}</body></worldbody>{extra}</mujoco>'
    )


BOX = '<geom type="box" size="0.1 0.04 0.02" pos="0.03 0 0"/>'


@pytest.mark.parametrize(
    ("geoms", "corners"),
    [
        (BOX, [(-0.07, -0.04), (0.13, -0.04), (0.13, 0.04), (-0.07, 0.04)]),
        ('<geom type="mesh" mesh="wedge"/>', [(-0.1, -0.04), (0.1, -0.04), (0.1, 0.04), (-0.1, 0.04)]),
        (
            '<geom type="capsule" size="0.01" fromto="-0.1 -0.03 0 0.1 -0.03 0"/>'
            '<geom type="capsule" size="0.01" fromto="-0.1 0.03 0 0.1 0.03 0"/>',
            [(-0.1, -0.03), (0.1, -0.03), (0.1, 0.03), (-0.1, 0.03)],
        ),
        (
            '<geom size="0.02" pos="0.1 0 0"/><geom size="0.02" pos="-0.1 0.04 0"/>'
            '<geom type="ellipsoid" size="0.03 0.03 0.02" pos="-0.1 -0.04 0"/>',
            [(-0.1, -0.04), (0.1, 0.0), (-0.1, 0.04)],
        ),
    ],
    ids=["box", "mesh", "capsules", "round"],
)
def test_the_polygon_is_the_lowest_face(geoms, corners):
    foot = instrument(toy(geoms)).feet[0]
    np.testing.assert_allclose(sorted(foot.polygon.tolist()), sorted(corners), atol=1e-7)
    x, y = foot.polygon.T
    assert x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0
    inside = foot.layout(0.002)
    assert np.all(inside[:2, 0] > inside[2:, 0])
    assert np.all(inside[::2, 1] > inside[1::2, 1])


def test_a_round_pad_is_a_polygon():
    foot = instrument(toy('<geom type="cylinder" size="0.05 0.01"/>')).feet[0]
    np.testing.assert_allclose(np.linalg.norm(foot.polygon, axis=1), 0.05, atol=1e-9)
    np.testing.assert_allclose(np.abs(foot.layout(0.0)), 0.05 / np.sqrt(2.0), atol=2e-3)


def test_a_sole_that_leans_in_its_body_and_toes_out_keeps_its_own_axes():
    lean = np.array([np.cos(np.radians(4.0)), 0.0, np.sin(np.radians(4.0)), 0.0])
    spec = toy(f'<geom type="box" size="0.1 0.04 0.02" quat="{" ".join(map(str, lean))}"/>')
    half = np.radians(20.0) / 2.0
    spec.body("foot_l").quat = [np.cos(half), 0.0, 0.0, np.sin(half)]
    foot = instrument(spec).feet[0]
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, lean)
    np.testing.assert_allclose(foot.R_foot_sole, R.reshape(3, 3), atol=1e-9)
    np.testing.assert_allclose(np.ptp(foot.polygon, axis=0), (0.2, 0.08), atol=1e-9)


def test_chosen_cells_are_used_and_wrong_ones_are_refused():
    places = np.array([(0.1, 0.03), (0.1, -0.03), (-0.05, 0.03), (-0.05, -0.03)])
    instrumentation = instrument(toy(BOX), cells={"foot_l": places})
    np.testing.assert_array_equal(instrumentation.cells[0], places)
    np.testing.assert_allclose(instrumentation.cells[1][0], (0.125, 0.035), atol=1e-9)
    refused = [
        ({"hand": places}, r"\['hand'\], which are no feet here; the feet are \['foot_l', 'foot_r'\]"),
        ({"foot_l": places[:3]}, r"four finite places .* got shape \(3, 2\)"),
        ({"foot_l": places * (1.0, 0.0)}, "lie on one line"),
        ({"foot_l": 1e3 * places}, r"than that is long and wide, from .* got \[\[100.0, 30.0\]"),
    ]
    for cells, match in refused:
        with pytest.raises(ValueError, match=match):
            instrument(toy(BOX), cells=cells)
    for margin in (-0.001, 0.04, np.nan):
        with pytest.raises(ValueError, match=r"'margin' must be at least 0 and leave 0.001 m of 0.0400 m"):
            instrument(toy(BOX), margin=margin)


def test_feet_that_cannot_be_found_are_refused_with_what_there_is():
    bodies = re.escape("['torso', 'foot_l', 'foot_r']")
    for feet in (("foot_l", "paw"), (), ("foot_l", "foot_l")):
        with pytest.raises(ValueError, match=rf"each once, got .*; the model's bodies are {bodies}"):
            instrument(toy(BOX), feet)
    with pytest.raises(TypeError, match="got a string"):
        instrument(toy(BOX), "foot_l")
    with pytest.raises(ValueError, match="'foot_l' hangs on the foot 'torso'"):
        instrument(toy(BOX), ("torso", "foot_l"))
    ghost = '<geom size="0.02" mass="1" contype="0" conaffinity="0"/>'
    with pytest.raises(ValueError, match=r"No left and right foot .* Leaves that can touch the ground: \[\]"):
        instrument(toy(ghost))
    with pytest.raises(ValueError, match=r"No geom of the foot 'foot_l' .* whose geoms can are \['torso'\]"):
        instrument(toy(ghost), ("foot_l", "foot_r"))
    ant = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"
    with pytest.raises(ValueError, match="No left and right foot"):
        instrument(mujoco.MjSpec.from_file(str(ant)))


def test_named_feet_keep_their_order_and_one_is_enough():
    assert [foot.body for foot in instrument(toy(BOX), ("foot_r", "foot_l")).feet] == ["foot_r", "foot_l"]
    assert instrument(toy(BOX), ["foot_r"]).feet[0].body == "foot_r"
    # Without sides in their names, places tell: the first lies to the left.
    assert [foot.body for foot in instrument(toy(BOX, names=("a", "b"))).feet] == ["a", "b"]


def test_joints_may_be_called_like_the_torso():
    # As one of Unitree's H1 is.
    spec = toy(BOX)
    spec.compile()
    renamed = spec.to_xml().replace('joint name="foot_l"', 'joint name="torso"')
    model = instrument(mujoco.MjSpec.from_string(renamed)).spec.compile()
    data = mujoco.MjData(model)
    data.joint("torso").qpos = 0.1
    mujoco.mj_forward(model, data)
    assert data.sensor("surefoot/joint/torso_position").data == 0.1


def test_taken_names_a_compiled_model_and_a_bare_model_are_refused():
    once = instrument(toy(BOX))
    with pytest.raises(ValueError, match=r"begin with 'surefoot/' already: \['surefoot/foot_l_ankle'"):
        instrument(once.spec)
    twice = instrument(once.spec, prefix="again/")
    model = twice.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(once.read(model, data).wrench_ankle, twice.read(model, data).wrench_ankle)
    bare = toy(BOX).compile()
    with pytest.raises(TypeError, match="got a MjModel, which is compiled already"):
        instrument(bare)
    with pytest.raises(ValueError, match="has no sensor 'surefoot/foot_l_ankle_force': compile"):
        once.read(bare, mujoco.MjData(bare))


def test_an_unloaded_foot_has_no_centre_of_pressure():
    instrumentation = instrument(toy(BOX))
    model = instrumentation.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    truth = instrumentation.read(model, data)
    assert np.isnan(truth.cop_sole).all()
    np.testing.assert_array_equal(truth.force_cell, 0.0)
