"""Names of the columns of a log, with units, and their conversion to arrays."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.arrays import Floats
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import GRAVITY
from surefoot.names import slug

_VECTORS = {
    "reference": {
        "com": "m",
        "com_acceleration": "m_s2",
        "angular_momentum_rate": "Nm",
        "accelerometer": "m_s2",
        "gyroscope": "rad_s",
    },
    "momentum": {"com": "m", "com_velocity": "m_s", "angular_momentum": "Nms"},
}
"""Vector fields of references and momentum, with their units, by the prefix of their columns."""
_TRUTH = {"force": "N", "scale": "N_per_count", "offset": "N"}  # fields with one column per channel
PHASES = ("stance", "swing")  # certain contacts; a foot can be in neither phase
LOADS = {"load_kg": GRAVITY, "load_N": 1.0}
"""Columns of the load on each single cell, with the factor to N."""
_POSE = "pose"  # stands for the two fields of the soles' poses


def channel_slugs(layout: FeetLayout) -> list[str]:
    """Return the channel names in the form used in column names."""
    return [slug(name) for name in layout.channel_names]


def raw_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns of counts."""
    return [f"raw_{name}_count" for name in channel_slugs(layout)]


def phase_names(layout: FeetLayout, phase: str) -> list[str]:
    """Return the names of the columns of ``stance`` or ``swing``."""
    return [f"reference_{slug(foot.name)}_{phase}" for foot in layout.feet]


def has_references(names: Iterable[str]) -> bool:
    """Return whether there are reference columns other than contacts. Without them, feet are alone."""
    return any(name.startswith("reference_") and not name.endswith(PHASES) for name in names)


def _pose_names(layout: FeetLayout, stem: str) -> list[str]:
    """Return the columns of the soles' poses: per foot, three of the position and four of the quaternion."""
    parts = [*(f"{axis}_m" for axis in "xyz"), *(f"q{axis}" for axis in "wxyz")]
    return [f"{stem}_{slug(foot.name)}_sole_{part}" for foot in layout.feet for part in parts]


def names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the required columns of a log."""
    return ["time_s", *raw_names_of(layout), *part_names(layout, "reference")]


def part_names(layout: FeetLayout, part: str) -> list[str]:
    """Return the names of the columns with the prefix ``"reference"``, ``"momentum"`` or ``"truth"``."""
    return [name for names in _names_by_field(layout, part).values() for name in names]


def _names_by_field(layout: FeetLayout, part: str) -> dict[str, list[str]]:
    """Return the column names of each field of a record, in order."""
    if part == "truth":
        slugs = channel_slugs(layout)
        found = {name: [f"truth_{name}_{one}_{unit}" for one in slugs] for name, unit in _TRUTH.items()}
        return found | {_POSE: _pose_names(layout, part)}
    vectors = _VECTORS[part].items()
    found = {name: [f"{part}_{name}_{axis}_{unit}" for axis in "xyz"] for name, unit in vectors}
    found[_POSE] = _pose_names(layout, part)
    return found | {name: phase_names(layout, name) for name in PHASES if part == "reference"}


def columns_of(log: Any) -> dict[str, NDArray[Any]]:
    """Return the columns of a log by name."""
    columns: dict[str, NDArray[Any]] = {"time_s": log.time}

    def add(names: list[str], values: Any) -> None:
        columns.update(zip(names, np.ascontiguousarray(np.asarray(values).T), strict=True))

    add(raw_names_of(log.layout), log.raw)
    for part in ("reference", "momentum", "truth"):
        record = getattr(log, part)
        for field, names in _names_by_field(log.layout, part).items() if record is not None else ():
            if field == _POSE:
                add(names, _flat_poses(record.position_sole, getattr(record, _rotation(part))))
            elif field in PHASES:
                add(names, np.asarray(getattr(record, field)).astype(np.int8))
            else:
                add(names, getattr(record, field))
    return columns


def fields_of(
    values: dict[str, Floats], layout: FeetLayout, part: str, reference: Any = None
) -> dict[str, Any]:
    """Return the fields of ``"reference"``, ``"truth"`` or ``"momentum"`` (without contacts) from columns.

    Poses of the soles that equal those of the ``reference`` share its arrays, which saves most of the memory.
    """
    named = _names_by_field(layout, part)
    pose_names = named.pop(_POSE)
    found: dict[str, Any] = {field: stack(values, names) for field, names in named.items()}
    pairs = zip(pose_names, _pose_names(layout, "reference"), strict=True)
    if reference is not None and all(np.array_equal(values[one], values[other]) for one, other in pairs):
        return found | {"position_sole": reference.position_sole, "R_level_sole": reference.R_level_sole}
    flat = stack(values, pose_names)
    poses = flat.reshape(len(flat), -1, 7)
    R = Rotation.from_quat(poses[..., [4, 5, 6, 3]].reshape(-1, 4)).as_matrix()
    found["position_sole"] = poses[..., :3].copy()
    found[_rotation(part)] = R.reshape(*poses.shape[:2], 3, 3)
    return found | {phase: found[phase] > 0.5 for phase in PHASES if phase in found}


def _rotation(part: str) -> str:
    return "R_world_sole" if part == "truth" else "R_level_sole"


def _flat_poses(position: Floats, R: Floats) -> Floats:
    """Return positions (N, F, 3) and rotations (N, F, 3, 3) as columns (N, 7 F)."""
    quaternion = Rotation.from_matrix(np.reshape(R, (-1, 3, 3))).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    parts = [np.reshape(position, (-1, 3)), quaternion]
    return np.concatenate(parts, axis=1).reshape(len(position), -1)


def stack(values: dict[str, Floats], names: Sequence[str]) -> Floats:
    """Return columns side by side, shape (samples, columns)."""
    return np.stack([values[name] for name in names], axis=-1)
