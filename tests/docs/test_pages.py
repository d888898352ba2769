"""README and docs: their code runs, and the commands, links, modules and files that they name exist."""

import contextlib
import importlib
import io
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import typer

import surefoot
from surefoot.calibration import GRAVITY, Reference, calibrate_in_situ, nao_shoe_layout
from surefoot.experiments.cli.app import app
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.force_torque.export import write_json
from surefoot.experiments.force_torque.log import read_in_situ_log

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("README.md"), *ROOT.glob("CONTRIBUTING.md"), *ROOT.glob("docs/**/*.md")])
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```\n+(?:```text\n(.*?)^```)?", re.MULTILINE | re.DOTALL)
FOLDERS = (
    "calibration|sensors|envs|robot|wrappers|controllers|experiments|native|benchmarks|examples|tests|docs"
)

pytestmark = pytest.mark.skipif(not PAGES, reason="the pages are not part of the wheel")
every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


def blocks(page: Path, language: str) -> Iterator[tuple[str, str | None]]:
    """Give each block's code, after as many empty lines as the page has above it, and its output if shown."""
    text = page.read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        if block[1] == language:
            yield "\n" * text[: block.start(2)].count("\n") + block[2], block[3]


def standing_beliefs() -> dict[str, Any]:
    """The beliefs of a robot that stands still."""
    still = np.zeros(3)
    return {
        "com": np.array([0.02, 0.0, 0.26]),
        "com_acceleration": still,
        "angular_momentum_rate": still,
        "position_sole": np.array([[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]]),
        "R_level_sole": np.tile(np.eye(3), (2, 1, 1)),
        "stance": np.ones(2, bool),
        "swing": np.zeros(2, bool),
        "accelerometer": np.array([0.0, 0.0, GRAVITY]),
        "gyroscope": still,
    }


def standing_robot(_: Any = None) -> dict[str, Any]:
    """A NAO that stands still for two seconds: its model, and what its sensors read."""
    model = resources.files("surefoot.envs") / "robots" / "nao.xml"
    Path("nao.xml").write_text(model.read_text(encoding="utf-8"), encoding="utf-8")
    counts, up = np.full(8, 5.3 * GRAVITY / 8 / 2e-5), np.array([0.0, 0.0, GRAVITY])
    robot = [(0.01 * k, np.zeros(24), np.zeros(3), up, counts) for k in range(200)]
    return {"scale": np.full(8, 2e-5), "offset": np.zeros(8), "robot": robot}


def recorded_leg(_: Any = None) -> dict[str, Any]:
    """The sets of the log that ships with the package."""
    sets = read_in_situ_log(SAMPLE).fitted
    return {"recorded": [(s.raw, s.gravity, s.added_mass, s.added_com, s.time) for s in sets]}


def calibrated_leg(_: Any = None) -> dict[str, Any]:
    """What the command leaves behind, and a reading."""
    log = read_in_situ_log(SAMPLE)
    fit = calibrate_in_situ(log.fitted, factory_matrix=log.config.factory.matrix)
    Path("out/in-situ").mkdir(parents=True)
    write_json(fit, Path("out/in-situ/in_situ_leg.in_situ.json"))
    return {"raw": log.fitted[0].raw[0], "gravity": log.fitted[0].gravity[0]}


def trained_policy(_: Any = None) -> dict[str, Any]:
    """A policy where the training leaves one."""
    Path("out/policy").mkdir(parents=True)
    folder = resources.files("surefoot.experiments.policy")
    policy = folder.joinpath("files", "balance-true", "policy.npz").read_bytes()
    Path("out/policy/policy.npz").write_bytes(policy)
    return {}


def gpu_simulator(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Two robots as tensors, and what the managers of Isaac Lab and mjlab hand out."""
    torch = pytest.importorskip("torch")
    importlib.import_module("_gpu")  # compiles fast, where there is Warp

    class Config:
        def __init__(self, **options: Any) -> None: ...

        def __init_subclass__(cls, **options: Any) -> None: ...

    bases = {name: type(name, (), {}) for name in ("ManagerTermBase", "ModifierBase", "NoiseModel")}
    configurations = dict.fromkeys(("ModifierCfg", "NoiseModelCfg", "ConstantNoiseCfg"), Config)
    for path in MANAGERS:
        monkeypatch.setitem(sys.modules, path, ModuleType(path))
        vars(sys.modules[path]).update(bases | configurations)
    beliefs = standing_beliefs()
    beliefs = {name: torch.as_tensor(value).expand(2, *value.shape) for name, value in beliefs.items()}
    return {
        "num_envs": 2,
        "device": "cpu",
        "step_dt": 1 / 80,  # as in the tests of the module: the same kernel
        "k": 0,
        "layout": nao_shoe_layout(),
        "true_force": torch.full((2, 8), 6.5),
        "reference": Reference(**beliefs),
        "env_ids": torch.tensor([1]),
    }


MANAGERS = (
    "isaaclab",
    "isaaclab.managers",
    "isaaclab.utils",
    "isaaclab.utils.modifiers",
    "isaaclab.utils.noise",
    "mjlab",
    "mjlab.utils",
    "mjlab.utils.noise",
    "mjlab.utils.noise.noise_model",
)
GIVEN = {
    "README": standing_robot,
    "in-situ": recorded_leg,
    "in-situ-tutorial": calibrated_leg,
    "policy": trained_policy,
    "gpu": gpu_simulator,
}
"""What the reader of a page brings along: names that its code uses and does not make."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow) if page.stem == "calibration-motion" else page
        for page in PAGES
        if page.stem != "simulators"
    ],
    ids=lambda page: page.stem,
)
def test_python_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # To plan a minute takes as long as all else here.
    monkeypatch.setitem(gym.spec("surefoot/NaoWalk-v0").kwargs, "duration", 20.0)
    names: dict[str, Any] = {"__name__": page.stem}
    for code, shown in blocks(page, "python"):
        if len(names) == 1:
            names |= GIVEN[page.stem](monkeypatch) if page.stem in GIVEN else {}
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(code, str(page), "exec"), names)
        assert shown is None or printed.getvalue() == shown


@pytest.mark.slow
@pytest.mark.parametrize("module", ["dm_control", "mujoco_playground", "mjlab"])
def test_recipes_run_where_the_simulator_is_installed(module: str, tmp_path: Path) -> None:
    name = f"SUREFOOT_{module.upper()}"
    python = os.environ.get(name, sys.executable)
    if subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode:
        pytest.skip(f"'{module}' cannot be imported; name the Python of an environment that has it by {name}")
    recipes = [code for code, _ in blocks(ROOT / "docs" / "simulators.md", "python") if module in code]
    script = (
        [str(ROOT / "examples" / "mjlab_g1.py"), "--steps", "100"] if module == "mjlab" else ["-c", *recipes]
    )
    path = str(Path(surefoot.__file__).parents[1])
    done = subprocess.run(
        [python, *script], cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@every_page
def test_commands_parse(page: Path) -> None:
    for code, _ in blocks(page, "sh"):
        for line in code.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["surefoot"]:
                command, rest = find_command(words[1:])
                command.make_context("surefoot", rest)
    for words in re.findall(r"`surefoot ([a-z][^`]*)`", page.read_text(encoding="utf-8")):
        command, rest = find_command(words.split())
        options = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in rest if word.startswith("--")} <= options, words


def find_command(words: list[str]) -> tuple[Any, list[str]]:
    """Give the (sub-)command that words begin with, and the rest of them; an old name is no command here."""
    command: Any = typer.main.get_command(app)
    while words and hasattr(command, "commands"):
        command = command.commands[words[0]]
        assert not command.hidden, f"'{words[0]}' is an old name"
        words = words[1:]
    return command, words


@every_page
def test_what_is_named_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for name in set(re.findall(r"`(surefoot(?:\.\w+)+)[`(]", text)):
        pkgutil.resolve_name(name)
    for path in set(re.findall(rf"\b((?:{FOLDERS})/[\w/.-]*[\w/])", text)):
        assert (ROOT / path).exists(), path
    for path, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)]*)\)", text):
        if path.startswith("http"):
            continue
        target = page.parent / path if path else page
        assert target.exists(), path
        headings = (
            re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE) if anchor else []
        )
        slugs = [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]
        assert not anchor or anchor in slugs, f"{path}#{anchor}"


def test_messages_of_the_troubleshooting_page_are_those_of_the_code() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    table = page.partition("## Messages")[2].partition("## ")[0]
    messages = [
        part for row in re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE) for part in row.split("...")
    ]
    files = (
        path for folder in (*FOLDERS.split("|")[:8], "surefoot") for path in (ROOT / folder).rglob("*.py")
    )
    joined = re.compile(r"[\"']\s*\n\s*f?[\"']")  # a message that goes on in the next line
    code = "".join(joined.sub("", path.read_text(encoding="utf-8")) for path in files)
    assert len(messages) > 12
    assert [message for message in messages if message.strip() not in code] == []
