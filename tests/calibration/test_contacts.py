"""Contacts by the feet's own load, of recordings and of streams."""

import numpy as np
import pytest

from surefoot.calibration.contacts import LoadContacts, contacts_from_load

WEIGHT, DT = 300.0, 0.01


def steps(zero: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertical forces in N, (N, 2), of a robot that steps in place, and which feet bear load."""
    left = 0.5 + 0.5 * np.clip(3.0 * np.sin(2 * np.pi * np.arange(1200) * DT / 1.2), -1.0, 1.0)
    share = np.column_stack([left, 1.0 - left])
    noise = 0.3 * np.random.default_rng(0).standard_normal(share.shape)
    return WEIGHT * share + zero + noise, share > 0.0


@pytest.mark.parametrize("zero", [0.0, -70.0, 120.0])
def test_a_stream_finds_them_with_any_zero(zero: float) -> None:
    load, bears = steps(zero)
    contacts = LoadContacts(WEIGHT, 2, DT)
    found = [contacts.update(one) for one in load]
    stance, swing = (np.array(part)[600 + contacts.lag :] for part in zip(*found, strict=True))
    bears = bears[600 : len(load) - contacts.lag]
    assert bears[stance].all()
    assert not bears[swing].any()
    assert 0.2 < swing.mean() < 0.5
    assert stance.mean() > 0.4


def test_a_robot_that_stands_and_feet_that_are_not_read_are_left_open() -> None:
    contacts = LoadContacts(WEIGHT, 2, DT)
    for k in range(500):
        load = np.full(2, np.nan) if k % 2 else np.array([140.0, 160.0])
        stance, swing = contacts.update(load)
    assert not stance.any()
    assert not swing.any()
    stance, swing = contacts_from_load(np.full((300, 2), np.nan), WEIGHT, DT)
    assert not (stance | swing).any()
