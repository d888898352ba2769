"""A hash of sources covers the code that really ran."""

import sys

import pytest

from surefoot.controllers import zero_action
from surefoot.experiments.episodes.plan import run_episode
from surefoot.experiments.study.sources import source_hash, source_modules


def test_what_an_episode_runs_is_in_its_hash():
    ran = set()

    def note(frame, event, argument):
        module = frame.f_globals.get("__name__", "")
        if event == "call" and module.startswith("surefoot."):
            ran.add(module)

    sys.setprofile(note)
    try:
        run_episode(zero_action, "moment", 3, duration=0.5)
    finally:
        sys.setprofile(None)
    assert {"surefoot.envs.nao.balance", "surefoot.calibration.moment.filter"} <= ran
    packages = {name for name in ran if hasattr(sys.modules[name], "__path__")}
    assert ran - packages <= source_modules("surefoot.experiments.episodes.plan")


def test_a_name_is_followed_to_the_module_that_defines_it():
    modules = source_modules("surefoot.experiments.walks.score")
    assert "surefoot.calibration.cop" in modules
    assert "surefoot.calibration.in_situ.calibrate" not in modules


def test_other_code_is_another_hash():
    assert source_hash("surefoot.calibration.online") != source_hash("surefoot.sensors.severity")
    with pytest.raises(ModuleNotFoundError, match="no module"):
        source_hash("surefoot.calibration.magic")
