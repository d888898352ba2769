"""The columns of a log: their names with units, and the arrays behind them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.experiments.arrays import Floats
from surefoot.names import slug

_VECTORS = {
    "com": "m",
    "com_acceleration": "m_s2",
    "angular_momentum_rate": "Nm",
    "accelerometer": "m_s2",
    "gyroscope": "rad_s",
}
_MOMENTA = {"com": "m", "com_velocity": "m_s", "angular_momentum": "Nms"}
PHASES = ("stance", "swing")
"""Contacts that a robot is sure of; a foot in between is neither."""
MOMENTUM = "momentum"
"""What columns begin with that hold beliefs as momentum."""
_TRUTH = {"force": "N", "scale": "N_per_count", "offset": "N"}


def channel_slugs(layout: FeetLayout) -> list[str]:
    """Return the channels' names as they stand in column names."""
    return [slug(name) for name in layout.channel_names]


def raw_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns of counts."""
    return [f"raw_{name}_count" for name in channel_slugs(layout)]


def _vector_names(quantity: str, stem: str = "reference") -> list[str]:
    units = _VECTORS if stem == "reference" else _MOMENTA
    return [f"{stem}_{quantity}_{axis}_{units[quantity]}" for axis in "xyz"]


def phase_names(layout: FeetLayout, phase: str) -> list[str]:
    """Return the names of the columns of ``stance`` or ``swing``."""
    return [f"reference_{slug(foot.name)}_{phase}" for foot in layout.feet]


def has_references(names: Iterable[str]) -> bool:
    """Whether columns hold beliefs of a robot, besides contacts; without any, feet are alone."""
    return any(name.startswith("reference_") and not name.endswith(PHASES) for name in names)


def _truth_names(layout: FeetLayout, quantity: str) -> list[str]:
    return [f"truth_{quantity}_{name}_{_TRUTH[quantity]}" for name in channel_slugs(layout)]


def _pose_names(layout: FeetLayout, stem: str) -> list[str]:
    """Return the columns of the soles' poses: of each foot three of its place, four of its quaternion."""
    parts = [*(f"{axis}_m" for axis in "xyz"), *(f"q{axis}" for axis in "wxyz")]
    return [f"{stem}_{slug(foot.name)}_sole_{part}" for foot in layout.feet for part in parts]


def names_of(layout: FeetLayout) -> list[str]:
    """Return the names of all columns that a log must have."""
    names = ["time_s", *raw_names_of(layout)]
    for quantity in _VECTORS:
        names += _vector_names(quantity)
    names += _pose_names(layout, "reference")
    return names + [name for phase in PHASES for name in phase_names(layout, phase)]


def momentum_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns that hold beliefs as momentum."""
    return [name for part in _MOMENTA for name in _vector_names(part, MOMENTUM)] + _pose_names(
        layout, MOMENTUM
    )


def truth_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns that hold the truth."""
    return [name for quantity in _TRUTH for name in _truth_names(layout, quantity)] + _pose_names(
        layout, "truth"
    )


def columns_of(log: Any) -> dict[str, NDArray[Any]]:
    """Return the columns of a log by name."""
    layout, reference, truth = log.layout, log.reference, log.truth
    columns: dict[str, NDArray[Any]] = {"time_s": log.time}

    def add(names: list[str], values: Any) -> None:
        columns.update(zip(names, np.ascontiguousarray(np.asarray(values).T), strict=True))

    add(raw_names_of(layout), log.raw)
    for quantity in _VECTORS:
        add(_vector_names(quantity), getattr(reference, quantity))
    add(_pose_names(layout, "reference"), _flat_poses(reference.position_sole, reference.R_level_sole))
    for phase in PHASES:
        add(phase_names(layout, phase), np.asarray(getattr(reference, phase)).astype(np.int8))
    if (momentum := log.momentum) is not None:
        for quantity in _MOMENTA:
            add(_vector_names(quantity, MOMENTUM), getattr(momentum, quantity))
        add(_pose_names(layout, MOMENTUM), _flat_poses(momentum.position_sole, momentum.R_level_sole))
    if truth is not None:
        for quantity in _TRUTH:
            add(_truth_names(layout, quantity), getattr(truth, quantity))
        add(_pose_names(layout, "truth"), _flat_poses(truth.position_sole, truth.R_world_sole))
    return columns


def _flat_poses(position: Floats, R: Floats) -> Floats:
    """Return poses (N, F, 3), (N, F, 3, 3) as (N, 7 F)."""
    quaternion = Rotation.from_matrix(np.reshape(R, (-1, 3, 3))).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    parts = [np.reshape(position, (-1, 3)), quaternion]
    return np.concatenate(parts, axis=1).reshape(len(position), -1)


def _poses(values: dict[str, Floats], stem: str, layout: FeetLayout) -> tuple[Floats, Floats]:
    flat = stack(values, _pose_names(layout, stem))
    poses = flat.reshape(len(flat), -1, 7)
    R = Rotation.from_quat(poses[..., [4, 5, 6, 3]].reshape(-1, 4)).as_matrix()
    return poses[..., :3], R.reshape(*poses.shape[:2], 3, 3)


def stack(values: dict[str, Floats], names: Sequence[str]) -> Floats:
    """Return columns side by side, shape (samples, columns)."""
    return np.stack([values[name] for name in names], axis=-1)


def reference_of(values: dict[str, Floats], layout: FeetLayout) -> Reference:
    """Return the reference that columns hold."""
    position, R = _poses(values, "reference", layout)
    vectors = {quantity: stack(values, _vector_names(quantity)) for quantity in _VECTORS}
    phases = {phase: stack(values, phase_names(layout, phase)) > 0.5 for phase in PHASES}
    return Reference(position_sole=position, R_level_sole=R, **vectors, **phases)


def momentum_of(values: dict[str, Floats], layout: FeetLayout, reference: Reference) -> MomentumReference:
    """Return the beliefs as momentum that columns hold, with the contacts of a reference."""
    position, R = _poses(values, MOMENTUM, layout)
    vectors = {quantity: stack(values, _vector_names(quantity, MOMENTUM)) for quantity in _MOMENTA}
    contacts = {phase: getattr(reference, phase) for phase in PHASES}
    return MomentumReference(position_sole=position, R_level_sole=R, **vectors, **contacts)


def truth_of(values: dict[str, Floats], layout: FeetLayout) -> tuple[Floats, ...]:
    """Return forces, scales, offsets and poses that columns hold as the truth."""
    position, R = _poses(values, "truth", layout)
    force, scale, offset = (stack(values, _truth_names(layout, quantity)) for quantity in _TRUTH)
    return force, position, R, scale, offset
