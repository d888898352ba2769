"""Logs that contradict themselves are explained; sound ones, and what filters are for, are let through."""

import dataclasses
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from _logs import redescribe, refusal_of, run

from surefoot.calibration import CalibrationRefused
from surefoot.experiments import write_log
from surefoot.experiments.instrument.check import check_log, words_of
from surefoot.experiments.logs.checks import LISTED
from surefoot.experiments.logs.format import Log, read_log
from surefoot.experiments.walking.calibrate import calibrate_log
from surefoot.experiments.walking.claims import claims_of, fit_claims
from surefoot.experiments.walking.hypotheses import hypotheses
from surefoot.experiments.walking.judge import Judgement, judge_log
from surefoot.experiments.walking.notices import weigh_feet
from surefoot.experiments.walks.replay import starting_map


def judge(log: Log) -> Judgement:
    return judge_log(log, starting_map(log))


QUICK = (
    "feet", "cells", "gain 64", "millimetres", "mirror", "late", "roles", "contacts", "gravity",
    "accelerometer", "x and y", "half turn",
)  # fmt: skip


@pytest.mark.parametrize("name", QUICK)
def test_a_mistake_is_named(spoilt: ModuleType, bad_start: Log, name: str) -> None:
    first = judge(spoil(spoilt, bad_start, name)).findings[0]
    assert first.name == spoilt.SPOILERS[name][0]
    assert first.value > first.limit
    # A late log is answered with its lateness undone.
    assert first.contradicts == (name != "late")


@pytest.mark.parametrize("name", ["feet", "contacts", "all signs"])
def test_feet_that_pull_by_offsets_read_in_the_air(
    spoilt: ModuleType, bad_start: Log, tmp_path: Path, name: str
) -> None:
    """A foot that stood when its offsets were read pulls, as one of the other sign does."""
    kind = "sign of channels"
    log = dataclasses.replace(bad_start, raw=-bad_start.raw)
    if name != "all signs":
        kind, log = spoilt.SPOILERS[name][0], spoil(spoilt, bad_start, name)
    path = write_log(log, tmp_path / "walk.csv")
    redescribe(path, nominal={"scale_N_per_count": log.nominal.scale.tolist()}, calibrated=None)
    log = read_log(path)
    wrong = weigh_feet(log, "nominal", log.nominal)
    assert wrong is not None
    assert wrong.name == kind
    assert "the feet pull the ground with " in wrong.reason
    assert " (probability 9" in wrong.reason
    assert " %, unknown " in wrong.reason
    alone = dataclasses.replace(log, about={"feet_alone": True})
    unsettled = weigh_feet(alone, "nominal", log.nominal)
    assert unsettled is not None
    assert unsettled.cure.startswith("If so, turn the signs of scale_N_per_count")


@pytest.mark.parametrize("lower", [[20.0] * 8, [60.0] * 4 + [0.0] * 4], ids=["all cells", "a foot"])
def test_feet_that_pull_by_offsets_of_others(bad_start: Log, lower: list[float]) -> None:
    nominal = bad_start.nominal._replace(offset=bad_start.nominal.offset - lower)
    wrong = weigh_feet(bad_start, "nominal", nominal)
    assert wrong is not None
    assert wrong.name == "offset"
    assert wrong.cure == "Leave out offset_N, which is then read while a foot swings."


def test_sound_walks_are_let_through(walks: dict[str, Log]) -> None:
    for log in walks.values():
        verdict = judge(log)
        assert verdict.findings == ()
        assert verdict.as_it_is.worst < 1.5


@pytest.mark.parametrize("fault", ["dies", "leaps", "missing"])
def test_faults_of_one_cell_are_for_the_filter(spoilt: ModuleType, bad_start: Log, fault: str) -> None:
    assert not any(one.refuses for one in judge(spoilt.break_cell(bad_start, fault)).findings)


def test_each_hypothesis_keeps_the_shapes_of_claims(bad_start: Log) -> None:
    claims = claims_of(bad_start, starting_map(bad_start), 0.17)
    tried = list(hypotheses(bad_start.layout))
    assert len(tried) > 100
    assert len({one.cause for one in tried}) == len(tried)
    for one in tried:
        undone = one.undo(claims)
        assert undone.raw.shape == claims.raw.shape
        assert all(
            np.shape(a) == np.shape(b) for a, b in zip(undone.reference, claims.reference, strict=True)
        )


def test_the_fit_finds_the_cells(bad_start: Log, walks: dict[str, Log]) -> None:
    """By its map the feet bear what they truly bear, to the noise of the motion and the drift of the walk."""
    truth = walks["bad-start"].truth
    assert truth is not None
    start, weight = bad_start.nominal.force(bad_start.raw), bad_start.mass * 9.81
    found = fit_claims(claims_of(bad_start, bad_start.nominal, 0.17)).map
    true = truth.force.reshape(-1, 2, 4).sum(axis=2)
    before, after = (
        np.std(force.reshape(-1, 2, 4).sum(axis=2) - true)
        for force in (start, found.scale * start + weight * found.offset)
    )
    assert after < 0.3 * before


def test_a_short_log_says_nothing(log: Log) -> None:
    assert judge(log).findings == ()


def test_a_log_that_nothing_mends_is_refused_with_its_figures(bad_start: Log) -> None:
    rng = np.random.default_rng(0)
    log = dataclasses.replace(bad_start, raw=bad_start.raw[rng.permutation(len(bad_start))])
    first = judge(log).findings[0]
    assert (first.name, first.refuses) == ("contradiction", True)
    assert "None of the mistakes that were tried explains it." in first.reason
    assert first.value > first.limit


def test_a_contradiction_without_a_sure_cause_is_refused(bad_start: Log) -> None:
    """Rows of half a log are out of order: a part fits itself, and no mistake explains the whole."""
    rows = np.arange(len(bad_start))
    rows[len(rows) // 2 :] = np.random.default_rng(7).permutation(rows[len(rows) // 2 :])
    refused = [
        one for one in judge(dataclasses.replace(bad_start, raw=bad_start.raw[rows])).findings if one.refuses
    ]
    assert [one.name for one in refused] == ["contradiction"]


def spoil(spoilt: ModuleType, log: Log, name: str) -> Log:
    changed: Log = spoilt.SPOILERS[name][1](log, np.random.default_rng(1))
    return changed


class TestCommand:
    """Exit status 3, no file, and a way past it that every file tells."""

    def test_it_refuses(self, spoilt: ModuleType, bad_start: Log, tmp_path: Path) -> None:
        path = write_log(spoil(spoilt, bad_start, "feet"), tmp_path / "walk.parquet")
        result = run("calibrate", "walk", path, code=3)
        assert result.stderr.startswith(
            "surefoot: walk.parquet: Readings, layout, mass and motion contradict each other (by the best "
        )
        assert (
            "The likeliest cause: the readings of the left and of the right foot are exchanged (probability 9"
        ) in result.stderr
        assert " %, unknown " in result.stderr
        assert result.stderr.endswith(
            "Exchange their plugs or their columns. If you know better: --accept REASON goes on, and every "
            "file says so.\n"
        )
        assert [one.name for one in tmp_path.iterdir()] == ["walk.parquet"]

    def test_with_a_reason_it_goes_on(
        self, spoilt: ModuleType, bad_start: Log, tmp_path: Path, no_page: None
    ) -> None:
        options: dict[str, Any] = {"folder": tmp_path, "stem": "walk", "file": "walk.csv"}
        result = calibrate_log(spoil(spoilt, bad_start, "x and y"), "none", accept="a test", **options)
        assert result.notices[0].startswith("walk.csv: accepted (a test): Readings, layout, mass and motion")
        assert json.loads(result.parameters.read_text())["notices"][0] == result.notices[0]
        with pytest.raises(CalibrationRefused):
            calibrate_log(spoil(spoilt, bad_start, "x and y"), "none", **options)

    def test_a_reason_must_be_given(self, tmp_path: Path) -> None:
        result = run("calibrate", "walk", tmp_path / "walk.csv", "--accept", " ", code=2)
        assert "--accept needs the reason to continue" in result.stderr

    def test_slow_converters_are_told(self, bad_start: Log, tmp_path: Path, no_page: None) -> None:
        raw = bad_start.raw.copy()
        raw[np.arange(len(raw)) % 8 != 0] = np.nan
        log = dataclasses.replace(bad_start, raw=raw)
        notices = calibrate_log(log, "moment", folder=tmp_path, stem="walk", file="walk.csv").notices
        assert (
            "walk.csv: nothing was learnt: the moment map is the one at the start. 88 % of the readings are "
            "missing, and a method learns from rows in which all channels were read; if the converters are "
            "slower than the rows, write rows at their rate."
        ) in notices


def feet_alone(log: Log, path: Path, *, contacts: bool) -> Path:
    pd = pytest.importorskip("pandas")
    write_log(log, path)
    table = pd.read_csv(path)
    kept = ["time_s", *(name for name in table if name.startswith("raw_"))]
    kept += [name for name in table if name.endswith(("_stance", "_swing"))] if contacts else []
    table[kept].to_csv(path, index=False)
    return path


class TestFeetAlone:
    """Insoles, plates and boards know no robot."""

    @pytest.mark.parametrize("contacts", [True, False])
    def test_they_are_tared(
        self, walks: dict[str, Log], tmp_path: Path, no_page: None, contacts: bool
    ) -> None:
        pd = pytest.importorskip("pandas")
        log = walks["bad-start"]
        path = feet_alone(dataclasses.replace(log, truth=None), tmp_path / "feet.csv", contacts=contacts)
        result = run("calibrate", "walk", path, "--method", "tare", "--json")
        assert "agreement" not in json.loads(result.stdout)["tables"]
        found = pd.read_parquet(tmp_path / "feet.tare.parquet")
        assert "cop_level_x_m" not in found
        np.testing.assert_allclose(found["vgrf_N"], found["vgrf_left_N"] + found["vgrf_right_N"])
        truth = log.truth
        assert truth is not None
        # The offset of a cell is what it reads in the air.
        last = json.loads((tmp_path / "feet.tare.json").read_text())["offset_N"]
        right = truth.offset[-1] * log.nominal.scale / truth.scale[-1]
        assert np.abs(last - right).max() < 0.5
        assert np.abs(log.nominal.offset - right).max() > 1.0

    def test_contacts_are_felt(self, walks: dict[str, Log], tmp_path: Path) -> None:
        log = walks["bad-start"]
        path = feet_alone(log, tmp_path / "feet.csv", contacts=False)
        felt = read_log(path, feet_alone=True)
        raw = np.where(np.random.default_rng(0).random(log.raw.shape) < 0.05, np.nan, log.raw)
        lacking = feet_alone(dataclasses.replace(log, raw=raw), tmp_path / "lacking.csv", contacts=False)
        truth = log.truth
        assert truth is not None
        load = truth.force.reshape(-1, 2, 4).sum(axis=2)
        for reference in (felt.reference, again := read_log(lacking, feet_alone=True).reference):
            assert load[reference.swing].max() < 0.05 * log.mass * 9.81
            assert load[reference.stance].min() > 0.1 * log.mass * 9.81
        assert (again.swing.sum(axis=0) > 0.9 * felt.reference.swing.sum(axis=0)).all()
        assert felt.reference.swing.any(axis=0).all()
        assert words_of(check_log(path)) == (
            "Clock, channels and weight are sound; feet alone show no wrong signs, places or exchanges."
        )

    def test_other_methods_need_the_robot(self, log: Log, tmp_path: Path) -> None:
        path = feet_alone(log, tmp_path / "feet.csv", contacts=True)
        assert refusal_of(path).endswith(
            f"{LISTED} Feet alone, without references, can be calibrated by --method tare or none."
        )


@pytest.mark.slow
def test_the_table_of_spoilt_and_sound_logs(spoilt: ModuleType) -> None:
    """Nine in ten named first, none wrong without a word, no sound one refused."""
    outcomes = list(spoilt.walk_outcomes())
    assert len(outcomes) >= 100
    assert [(one.log, one.mistake) for one in outcomes if not one.findings] == []
    assert np.mean([one.is_right for one in outcomes]) >= 0.9
    refused = spoilt.refusals("walks")
    assert len(refused) >= 40
    assert not any(refused)
