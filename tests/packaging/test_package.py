"""What must hold of the package as a user installs it."""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import requires
from pathlib import Path

import pytest
import yaml

import surefoot

ROOT = Path(__file__).parents[2]
SUBPACKAGES = ("calibration", "controllers", "envs", "experiments", "robot", "sensors", "wrappers")


def run_python(code: str) -> str:
    """Run code in a fresh interpreter and give back what it printed."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_suite_tests_the_installation_it_claims_to_test() -> None:
    expected = os.environ.get("SUREFOOT_EXPECT_ROOT")
    if expected is None:
        pytest.skip("SUREFOOT_EXPECT_ROOT is set by `make wheel-test` alone")
    assert Path(surefoot.__file__).is_relative_to(expected)


@pytest.mark.skipif(not (ROOT / "Makefile").exists(), reason="not part of the wheel")
def test_the_version_is_said_alike_and_what_other_machines_run_exists() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## [{version}] - 20" in (ROOT / "CHANGELOG.md").read_text()
    assert f"<version>{version}</version>" in (ROOT / "ros2" / "package.xml").read_text()
    assert f"\nversion={version}\n" in (ROOT / "arduino" / "library.properties").read_text()
    assert json.loads((ROOT / "arduino" / "library.json").read_text())["version"] == version
    makefile = (ROOT / "Makefile").read_text().replace("$(VENV)", ".venv")
    workflows = [yaml.safe_load(file.read_text()) for file in ROOT.glob(".github/workflows/*.yml")]
    steps = [step for workflow in workflows for job in workflow["jobs"].values() for step in job["steps"]]
    runs = [step["run"] for step in steps if "run" in step]
    for target in re.findall(r"\bmake ([\w./]+)", "\n".join([*runs, (ROOT / "Dockerfile").read_text()])):
        assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), target


def test_each_extra_is_tried_before_a_release(load_script) -> None:
    release = load_script("tests/packaging/release.py")
    assert set(release.SERVES) == {"", *release.EXTRAS} - {"dev", "test"}


@pytest.mark.parametrize("name", SUBPACKAGES)
def test_every_public_name_exists(name: str) -> None:
    module = getattr(surefoot, name)
    assert module.__doc__
    for public in module.__all__:
        assert hasattr(module, public), f"surefoot.{name}.__all__ names '{public}', which is not there"


def test_package_is_typed_and_carries_its_models() -> None:
    root = Path(surefoot.__file__).parent
    assert (root / "py.typed").is_file()
    assert (Path(surefoot.envs.__file__).parent / "robots" / "nao.xml").is_file()


def test_a_robot_needs_three_small_packages() -> None:
    core = [r for r in requires("surefoot") or [] if "extra ==" not in r]
    assert sorted(r.split(">")[0] for r in core) == ["numpy", "scipy", "threadpoolctl"]


def test_calibration_imports_on_a_robot_without_a_simulator() -> None:
    printed = run_python(
        "import sys\n"
        "class Absent:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in {'gymnasium', 'mujoco', 'mink', 'torch', 'pandas', 'matplotlib'}:\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, Absent())\n"
        "import importlib.util as u\n"
        "find = u.find_spec\n"
        "u.find_spec = lambda name, package=None: "
        "None if name in {'gymnasium', 'mujoco'} else find(name, package)\n"
        "import surefoot, json\n"
        "calibration, sensors = surefoot.calibration, surefoot.sensors\n"
        "print(json.dumps([calibration.__name__, sensors.__name__]))\n"
    )
    assert json.loads(printed) == ["surefoot.calibration", "surefoot.sensors"]


@pytest.mark.parametrize(
    ("statements", "missing", "extra"),
    [
        (["surefoot.envs.NaoWalkEnv"], "gymnasium", "sim"),
        (["surefoot.wrappers.FootSensors", "surefoot.robot.NominalModel"], "mujoco", "sim"),
        (["import surefoot.wrappers.gpu"], "torch", "gpu"),
        (["from surefoot.experiments import read_log"], "pyarrow", "experiments"),
        (
            ["import surefoot.wrappers.vector.sb3", "import surefoot.wrappers.vector.sb3_log"],
            "stable_baselines3",
            "rl",
        ),
    ],
)
def test_what_an_extra_brings_is_asked_for_by_its_name(
    statements: list[str], missing: str, extra: str
) -> None:
    printed = run_python(
        f"import sys\nsys.modules['{missing}'] = None\nimport surefoot\n"
        + "".join(
            f"try:\n    {statement}\nexcept ModuleNotFoundError as error:\n    print(error)\n"
            for statement in statements
        )
    )
    said = printed.splitlines()
    assert len(said) == len(statements)
    for line in said:
        assert missing in line
        assert f'pip install "surefoot[{extra}]"' in line


@pytest.mark.parametrize(
    ("module", "absent"),
    [("wrappers.gpu", ("gymnasium", "mujoco")), ("robot.beliefs.native", ("gymnasium",))],
)
def test_what_needs_no_simulator_is_imported_without(module: str, absent: tuple[str, ...]) -> None:
    run_python(f"import sys, surefoot\nsys.modules.update(dict.fromkeys({absent}))\nimport surefoot.{module}")


def test_import_is_light() -> None:
    printed = run_python(
        "import sys, surefoot\n"
        "heavy = ('numpy', 'gymnasium', 'mujoco', 'torch', 'pandas', 'matplotlib')\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    assert printed.strip() == "[]"


def test_a_robots_loop_waits_for_no_part_of_scipy_that_logs_alone_need() -> None:
    printed = run_python(
        "import sys, surefoot.calibration\n"
        "slow = ('scipy.interpolate', 'scipy.optimize', 'scipy.signal', 'scipy.stats')\n"
        "print([m for m in slow if m in sys.modules])"
    )
    assert printed.strip() == "[]"


@pytest.mark.parametrize(
    "imports",
    [
        "import surefoot, gymnasium",
        "import gymnasium, surefoot",
        "import surefoot, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium.envs",
    ],
)
def test_environments_are_registered_in_every_order_of_imports(imports: str) -> None:
    printed = run_python(f"{imports}; print(sorted(i for i in gymnasium.registry if i[:9] == 'surefoot/'))")
    naos = ("NaoBalance", "NaoBalanceHard", "NaoCarry", "NaoCarryHard", "NaoStand", "NaoWalk")
    assert ast.literal_eval(printed) == [f"surefoot/{name}-v0" for name in ("Exercise", "G1Lean", *naos)]


def test_unknown_subpackage_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'surefoot' has no attribute 'sensor'$"):
        _ = surefoot.sensor
