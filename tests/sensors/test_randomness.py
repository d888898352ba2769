"""Streams of a robot's own: the published numbers, the same in C and in Python."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from surefoot.native import SENSORS, Library
from surefoot.sensors.randomness import AHEAD, Stream, philox, uniform

# Random123, its file kat_vectors: philox4x32 of ten rounds; counter, key, block.
VECTORS = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


@pytest.fixture(params=["C", "Python"])
def way(request: Any, monkeypatch: pytest.MonkeyPatch) -> str:
    found = request.getfixturevalue("library") if request.param == "C" else None
    monkeypatch.setattr(SENSORS, "installed", lambda: found)
    return str(request.param)


def words(text: str) -> Any:
    return np.array([int(word, 16) for word in text.split()], dtype=np.uint32)


@pytest.mark.parametrize(("counter", "key", "block"), VECTORS)
def test_blocks_are_those_that_its_authors_publish(
    library: Library, counter: str, key: str, block: str
) -> None:
    assert philox(words(counter)[None], words(key)).tolist() == [words(block).tolist()]
    found = np.zeros(4, dtype=np.uint32)
    given = words(counter), words(key)
    library.functions.surefoot_philox(*(part.ctypes.data for part in given), found.ctypes.data)
    assert found.tolist() == words(block).tolist()


def test_numbers_are_made_of_blocks_as_the_page_says(way: str) -> None:
    stream = Stream(0x0123456789ABCDEF)
    stream.record["count"] = 2**32 + 5
    counter, key = words("00000005 00000001 00000000 00000000"), words("89abcdef 01234567")
    block = philox(counter[None], key)[0].tolist()
    first, second = (((a >> 5) * 2**26 + (b >> 6)) / 2**53 for a, b in (block[:2], block[2:]))
    again = copy.deepcopy(stream)
    assert stream.random((2,)).tolist() == [first, second]
    length, angle = np.sqrt(-2.0 * np.log(1.0 - first)), 2.0 * np.pi * second
    expected = [length * np.cos(angle), length * np.sin(angle)]
    np.testing.assert_allclose(again.standard_normal((2,)), expected, rtol=1e-15, atol=1e-15)
    assert int(again.record["count"]) == 2**32 + 6


def test_c_and_python_draw_the_same(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    for found in (library, None):
        monkeypatch.setattr(SENSORS, "installed", lambda found=found: found)
        one = Stream.of(3, 1)
        parts = [one.standard_normal((3, 8)), one.random((5,)), one.standard_normal((2 * AHEAD + 3,))]
        parts += [one.standard_normal(()), one.random((0,)), one.random((2,))]
        parts += [part for _ in range(200) for part in (one.standard_normal((3, 7)), one.random((2, 2)))]
        drawn.append([*parts, one.record["count"].copy()])
    for by_c, by_python in zip(*drawn, strict=True):
        assert by_c.shape == by_python.shape
        np.testing.assert_allclose(by_python, by_c, rtol=1e-14, atol=1e-15)


def test_draws_go_on_after_a_copy_and_a_file(way: str) -> None:
    stream = Stream.of(11, 4)
    stream.standard_normal((7,))
    others = [copy.deepcopy(stream), pickle.loads(pickle.dumps(stream))]
    expected = stream.standard_normal((9,))
    for other in others:
        np.testing.assert_array_equal(other.standard_normal((9,)), expected)


def test_draws_have_the_right_spread_and_do_not_depend_on_each_other(way: str) -> None:
    drawn = np.array([Stream.of(seed).standard_normal((500,)) for seed in range(200)])
    assert abs(drawn.mean()) < 4.0 / np.sqrt(drawn.size)
    assert abs(drawn.var() - 1.0) < 4.0 * np.sqrt(2.0 / drawn.size)
    assert abs(np.corrcoef(drawn[:, ::2].ravel(), drawn[:, 1::2].ravel())[0, 1]) < 4.0 / np.sqrt(
        drawn.size / 2
    )
    assert abs(np.corrcoef(drawn[0], drawn[1])[0, 1]) < 4.0 / np.sqrt(500)
    even = Stream.of(0).random((4096,))
    assert (even >= 0.0).all()
    assert (even < 1.0).all()
    assert abs(even.mean() - 0.5) < 4.0 / np.sqrt(12.0 * even.size)


def test_a_range_is_kept_and_without_numbers_nobody_knows_the_key(way: str) -> None:
    drawn = uniform(Stream.of(1), 2.0, 3.0, (100,))
    assert (drawn >= 2.0).all()
    assert (drawn < 3.0).all()
    assert Stream.of().record["key"] != Stream.of().record["key"]
