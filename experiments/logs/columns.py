"""The columns of a log: their names with units, and the arrays behind them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.calibration.reference import Reference

__all__ = [
    "channel_slugs",
    "columns_of",
    "names_of",
    "raw_names_of",
    "reference_of",
    "stack",
    "truth_names_of",
    "truth_of",
]


def _slug(name: str) -> str:
    return name.replace("/", "_").replace("-", "_").replace(" ", "_")


def channel_slugs(layout: FeetLayout) -> list[str]:
    """Return the channels' names as they stand in column names."""
    return [_slug(name) for name in layout.channel_names]


def raw_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns of counts."""
    return [f"raw_{name}_count" for name in channel_slugs(layout)]


def _vector_names(stem: str, unit: str) -> list[str]:
    return [f"{stem}_{axis}_{unit}" for axis in "xyz"]


def _pose_names(stem: str, foot: FootLayout) -> tuple[list[str], list[str]]:
    sole = f"{stem}_{_slug(foot.name)}_sole"
    return _vector_names(sole, "m"), [f"{sole}_q{axis}" for axis in "wxyz"]


_REFERENCE_VECTORS = {
    "com": "m",
    "com_acceleration": "m_s2",
    "angular_momentum_rate": "Nm",
    "accelerometer": "m_s2",
    "gyroscope": "rad_s",
}


_TRUTH_CHANNELS = {"force": "N", "scale": "N_per_count", "offset": "N"}


def _channel_names(layout: FeetLayout, quantity: str) -> list[str]:
    return [f"truth_{quantity}_{_slug(name)}_{_TRUTH_CHANNELS[quantity]}" for name in layout.channel_names]


def names_of(layout: FeetLayout) -> list[str]:
    """Return the names of all columns that a log must have."""
    names = ["time_s", *raw_names_of(layout)]
    for quantity, unit in _REFERENCE_VECTORS.items():
        names += _vector_names(f"reference_{quantity}", unit)
    for foot in layout.feet:
        position, quaternion = _pose_names("reference", foot)
        names += position + quaternion
        names += [f"reference_{_slug(foot.name)}_{phase}" for phase in ("stance", "swing")]
    return names


def truth_names_of(layout: FeetLayout) -> list[str]:
    """Return the names of the columns that hold the truth."""
    names = [name for quantity in _TRUTH_CHANNELS for name in _channel_names(layout, quantity)]
    for foot in layout.feet:
        position, quaternion = _pose_names("truth", foot)
        names += position + quaternion
    return names


def columns_of(log: Any) -> dict[str, NDArray[Any]]:
    """Return the columns of a log by name."""
    columns: dict[str, NDArray[Any]] = {"time_s": log.time}
    columns |= dict(zip(raw_names_of(log.layout), log.raw.T, strict=True))
    for quantity, unit in _REFERENCE_VECTORS.items():
        names = _vector_names(f"reference_{quantity}", unit)
        columns |= dict(zip(names, np.asarray(getattr(log.reference, quantity)).T, strict=True))
    reference = log.reference
    for i, foot in enumerate(log.layout.feet):
        columns |= _pose_columns(
            "reference", foot, reference.position_sole[:, i], reference.R_level_sole[:, i]
        )
        for phase in ("stance", "swing"):
            flags = np.asarray(getattr(reference, phase))[:, i]
            columns[f"reference_{_slug(foot.name)}_{phase}"] = flags.astype(np.int8)
    if log.truth is not None:
        for quantity in _TRUTH_CHANNELS:
            names = _channel_names(log.layout, quantity)
            columns |= dict(zip(names, getattr(log.truth, quantity).T, strict=True))
        for i, foot in enumerate(log.layout.feet):
            columns |= _pose_columns(
                "truth", foot, log.truth.position_sole[:, i], log.truth.R_world_sole[:, i]
            )
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _pose_columns(
    stem: str, foot: FootLayout, position: NDArray[np.float64], R: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    position_names, quaternion_names = _pose_names(stem, foot)
    quaternion = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
    return dict(zip(position_names + quaternion_names, [*position.T, *quaternion.T], strict=True))


def stack(values: dict[str, NDArray[np.float64]], names: list[str]) -> NDArray[np.float64]:
    """Return columns side by side, shape (samples, columns)."""
    return np.stack([values[name] for name in names], axis=-1)


def _poses(
    values: dict[str, NDArray[np.float64]], stem: str, layout: FeetLayout
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    names = [_pose_names(stem, foot) for foot in layout.feet]
    position = np.stack([stack(values, p) for p, _ in names], axis=1)
    R = [Rotation.from_quat(stack(values, q), scalar_first=True).as_matrix() for _, q in names]
    return position, np.stack(R, axis=1)


def reference_of(values: dict[str, NDArray[np.float64]], layout: FeetLayout) -> Reference:
    """Return the reference that columns hold."""
    vectors = {
        quantity: stack(values, _vector_names(f"reference_{quantity}", unit))
        for quantity, unit in _REFERENCE_VECTORS.items()
    }
    position, R = _poses(values, "reference", layout)
    phases = {
        phase: stack(values, [f"reference_{_slug(foot.name)}_{phase}" for foot in layout.feet]) > 0.5
        for phase in ("stance", "swing")
    }
    return Reference(position_sole=position, R_level_sole=R, **vectors, **phases)


def truth_of(values: dict[str, NDArray[np.float64]], layout: FeetLayout) -> tuple[NDArray[np.float64], ...]:
    """Return forces, scales, offsets and poses that columns hold as the truth."""
    position, R = _poses(values, "truth", layout)
    force, scale, offset = (stack(values, _channel_names(layout, quantity)) for quantity in _TRUTH_CHANNELS)
    return force, position, R, scale, offset
