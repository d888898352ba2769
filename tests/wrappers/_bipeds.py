"""Bipeds in MJCF, in the forms in which people and converters write them."""

import mujoco
import numpy as np

BOX = '<geom type="box" size="0.08 0.035 0.012" pos="0.02 0 -0.038" mass="0.5"/>'
TRUNK = '<geom type="box" size="0.07 0.09 0.12" pos="0.01 0 0.12" mass="7"/>'
LIGHT = '<inertial pos="0 0 0" mass="{}" diaginertia="{} {} {}"/>'


def corners(shape: str) -> str:
    """Put a geom into each corner of a sole."""
    places = [(x, y) for x in (-0.05, 0.09) for y in (-0.03, 0.03)]
    return "".join(f'<geom {shape} pos="{x} {y} -0.04" mass="0.125"/>' for x, y in places)


def limb(length: float, mass: float) -> str:
    """Write a limb that touches nothing."""
    capsule = f'<geom type="capsule" fromto="0 0 -0.02 0 0 {-length}" size="0.025" mass="{mass}"'
    return capsule + ' contype="0" conaffinity="0"/>'


def arms(attributes: str = "", hand: str = "") -> str:
    """Write two arms of 0.9 kg on springs."""
    return "".join(
        f'<body name="{s}_arm" pos="0 {y} 0.2" {attributes}>'
        f'<joint name="{s}_shoulder" axis="0 1 0" stiffness="30"/>{limb(0.22, 0.9)}'
        f"{hand.replace('SIDE', s)}</body>"
        for s, y in (("left", 0.15), ("right", -0.15))
    )


def hand(joint: str, mass: float) -> str:
    """Write a hand or finger on a joint without a motor."""
    return (
        f'<body name="SIDE_hand" pos="0 0 -0.25"><joint name="SIDE_wrist" {joint}/>'
        f'<geom size="0.02" mass="{mass}" contype="0" conaffinity="0"/></body>'
    )


def turned(seed: int) -> tuple[str, str]:
    """Return a random rotation and its inverse."""
    quaternion, inverse = np.random.default_rng(seed).normal(size=4), np.zeros(4)
    quaternion /= np.linalg.norm(quaternion)
    mujoco.mju_negQuat(inverse, quaternion)
    return " ".join(map(repr, quaternion.tolist())), " ".join(map(repr, inverse.tolist()))


def in_frame(turn: int | None, inside: str) -> tuple[str, str]:
    """Turn a body's own frame at random and leave what is inside in its place: attributes, and the inside."""
    if turn is None:
        return "", inside
    quaternion, inverse = turned(turn)
    return f'quat="{quaternion}"', f'<frame quat="{inverse}">{inside}</frame>'


def biped(
    trunk: str = TRUNK,
    foot: str = BOX,
    *,
    root: int | None = None,
    feet: int | None = None,
    height: float = 0.6,
    floor: str = '<geom name="floor" type="plane" size="5 5 0.1"/>',
    option: str = "",
    end: str = "",
    assets: str = "",
) -> str:
    """Write a biped of some 11 kg on position servos."""
    legs, motors = "", ""
    for s, y in (("left", 0.08), ("right", -0.08)):
        turn = None if feet is None else feet + (s == "left")
        joints = f'<joint name="{s}_pitch" axis="0 1 0"/><joint name="{s}_roll" axis="1 0 0"/>'
        attributes, inside = in_frame(turn, joints + foot.replace("SIDE", s))
        legs += (
            f'<body name="{s}_thigh" pos="0 {y} 0"><joint name="{s}_hip" axis="0 1 0"/>'
            f"{limb(0.24, 1.0)}"
            f'<body name="{s}_shank" pos="0 0 -0.27"><joint name="{s}_knee" axis="0 1 0"/>'
            f"{limb(0.2, 0.7)}"
            f'<body name="{s}_foot" pos="0 0 -0.28" {attributes}>{inside}</body></body></body>'
        )
        motors += "".join(f'<position joint="{s}_{j}"/>' for j in ("hip", "knee", "pitch", "roll"))
    attributes, inside = in_frame(root, trunk + legs)
    return (
        f'<mujoco><option timestep="0.002" {option}/><asset>{assets}</asset>'
        '<default><joint damping="1" armature="0.02"/>'
        '<position kp="500" kv="12" ctrlrange="-1 1"/></default>'
        f'<worldbody>{floor}<body name="base_link" pos="0 0 {height}" {attributes}><freejoint/>{inside}'
        f"</body></worldbody><actuator>{motors}</actuator>{end}</mujoco>"
    )


MESH = (
    '<mesh name="sole" vertex="-.06 -.03 -.05 .1 -.03 -.05 .1 .03 -.05 -.06 .03 -.05 '
    '-.05 -.02 -.02 .08 -.02 -.02 .08 .02 -.02 -.05 .02 -.02"/>'
)
HEEL = '<geom type="box" size="0.05 0.035 0.012" pos="-0.01 0 -0.038" mass="0.35"/>'
TOE = (
    '<body name="SIDE_toe" pos="0.045 0 -0.038">{}<geom type="box" size="0.025 0.035 0.012" pos="0.025 0 0" '
    'mass="0.15"/></body>'
)
WELDED = f'<body name="trunk" pos="0 0 0.02">{TRUNK}</body>'
PAIRS = "<contact>" + "".join(f'<pair geom1="floor" geom2="{s}"/>' for s in ("left", "right")) + "</contact>"

ROBOTS = {
    "spheres": biped(foot=corners('type="sphere" size="0.01"')),
    "capsules": biped(foot=corners('type="capsule" size="0.01 0.01"')),
    "cylinder": biped(foot='<geom type="cylinder" size="0.06 0.01" pos="0 0 -0.04" mass="0.5"/>'),
    "mesh": biped(foot='<geom type="mesh" mesh="sole" mass="0.5"/>', assets=MESH),
    "contact pairs": biped(
        foot=BOX.replace("<geom", '<geom name="SIDE" contype="0" conaffinity="0"'), end=PAIRS
    ),
    "toe on a hinge": biped(foot=HEEL + TOE.format('<joint name="SIDE_toe" axis="0 1 0" stiffness="60"/>')),
    "toe welded": biped(foot=HEEL + TOE.format("")),
    "sole welded to a bare link": biped(
        foot=f'{LIGHT.format(0.05, 1e-5, 1e-5, 1e-5)}<body name="SIDE_sole">{BOX}</body>'
    ),
    "frame below the foot": biped(foot=f'{BOX}<body name="SIDE_tip" pos="0.1 0 0"><site/></body>'),
    "trunk welded to a bare body": biped(WELDED),
    "trunk welded over two": biped(f'<body name="pelvis" pos="0 0 0.01">{WELDED}</body>'),
    "trunk welded to 1 g": biped(LIGHT.format(0.001, 1e-7, 1e-7, 1e-7) + WELDED),
    "trunk on a waist, base of 1 g": biped(
        LIGHT.format(0.001, 1e-7, 1e-7, 1e-7)
        + WELDED.replace(TRUNK, '<joint name="waist" axis="0 0 1" stiffness="300"/>' + TRUNK)
    ),
    "base on the ground": biped(TRUNK).replace('pos="0 0 0.6"', 'pos="0 0 0.001"').replace(
        TRUNK, f'<frame pos="0 0 0.599">{TRUNK}'
    ).replace("</body></worldbody>", "</frame></body></worldbody>"),
    "base turned": biped(root=11),
    "feet turned": biped(feet=21),
    "all turned": biped(WELDED, HEEL + TOE.format(""), root=31, feet=41),
    "weightless arms": biped(TRUNK + arms('gravcomp="1"')),
    "grippers": biped(TRUNK + arms(hand=hand('type="slide" axis="1 0 0" range="0 0.02"', 0.03))),
    "ball wrists": biped(TRUNK + arms(hand=hand('type="ball" stiffness="2"', 0.05))),
    "keyframe": biped(end='<keyframe><key name="home" qpos="0 0 0.6 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe>'),
    "floor of a box": biped(floor='<geom type="box" size="2 2 0.1" pos="0 0 -0.1"/>'),
    "tilted gravity": biped(option='gravity="0.5 -0.3 -9.8"'),
    "moon": biped(option='gravity="0 0 -1.62"'),
    "implicitfast": biped(option='integrator="implicitfast"'),
    "elliptic cone": biped(option='cone="elliptic" impratio="10"'),
}  # fmt: skip
