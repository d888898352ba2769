"""The affine map and its relative form."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.calibration.parameters import Parameters

SIZE = st.floats(-6.0, 2.0)
SIGN = st.sampled_from([-1.0, 1.0])


@settings(deadline=None, derandomize=True, max_examples=100)
@given(magnitude=SIZE, sign=SIGN, ratio=st.floats(0.5, 2.0), shift=st.floats(-10.0, 10.0))
def test_relative_form_says_the_same(magnitude, sign, ratio, shift):
    start = Parameters(np.array([sign * 10.0**magnitude]), np.array([-sign * 10.0**magnitude * 8.3e6]))
    correction = Parameters(np.array([ratio]), np.array([shift]))
    absolute = correction.after(start)
    raw = np.array([8.3e6 + 3e5])

    expected = ratio * start.force(raw) + shift
    np.testing.assert_allclose(absolute.force(raw), expected, rtol=1e-12, atol=1e-9 * 10.0**magnitude)

    back = absolute.relative_to(start)
    np.testing.assert_allclose(back.scale, ratio, rtol=1e-13)
    np.testing.assert_allclose(back.offset, shift, rtol=1e-12, atol=1e-14 * abs(start.offset[0]) * 10)


def test_a_map_relative_to_itself_changes_nothing():
    start = Parameters(np.array([2e-5, -4e-5]), np.array([-160.0, 330.0]))
    same = start.relative_to(start)
    np.testing.assert_array_equal(same.scale, 1.0)
    np.testing.assert_array_equal(same.offset, 0.0)
