"""In-situ logs with one thing wrong: none is answered wrongly without a word, and the true cause is named."""

from dataclasses import replace

import pytest

spoilt_logs = pytest.importorskip("_spoilt_in_situ", reason="benchmarks are not part of the wheel")
SOUND, SPOILTS = spoilt_logs.SOUND, spoilt_logs.SPOILTS
outcome, record = spoilt_logs.outcome, spoilt_logs.record

pytestmark = pytest.mark.slow

KINDS = [kind for kind, spoilt in SPOILTS.items() if not spoilt.unknowable]


def test_no_mistake_is_silent_and_nine_in_ten_are_named():
    """One size, with or without a gyroscope and a factory matrix in turn, of every kind."""
    found = {}
    for number, kind in enumerate(KINDS):
        spoilt = SPOILTS[kind]
        change = next(iter(spoilt.sizes.values()))
        gyroscope = spoilt.gyroscope[number % len(spoilt.gyroscope)]
        factory = spoilt.factory[number // 2 % len(spoilt.factory)]
        of_rig = change if isinstance(change, dict) else {}
        log = record(2, gyroscope, **of_rig)
        log = log if of_rig else change(log)
        found[kind] = outcome(log if factory else replace(log, factory=None), spoilt.cause)
    assert [kind for kind, one in found.items() if one["wrong"]] == []
    wrong = [kind for kind, one in found.items() if not one["right"]]
    assert len(wrong) <= 0.1 * len(found), wrong


@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_log_is_answered(kind):
    for seed, gyroscope in ((50, False), (51, True)):
        found = outcome(SOUND[kind](record(seed, gyroscope, ("leg", "foot")[seed % 2]), seed))
        assert found["came out"] in ("answered", "warned")
        assert not found["wrong"]
