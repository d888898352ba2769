"""Install the wheel for this machine with each extra alone, away from the checkout, and use what it serves.

    python tests/packaging/release.py dist [EXTRA ...]     (make release-check)

Each environment is made of the wheels that pip downloads for it and of nothing else, and removed afterwards.
What an extra does not bring has to fail with the name of an extra that does. Prints a table as it goes.
"""

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORK = ROOT / "build" / "release"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
SERVES = {
    "": [
        "python -c 'from surefoot.native import CALIBRATION; assert len(CALIBRATION.rooms()) == 2'",
        "python -c 'from surefoot.native import SENSORS; assert SENSORS.installed()'",
        "python -c 'import surefoot.controllers'",
    ],
    "sim": [
        "python -c 'import surefoot; surefoot.wrappers.FootSensors; surefoot.envs.NaoWalkEnv().reset()'",
        "python -c 'from surefoot.native import ENVS; assert ENVS.installed()'",
    ],
    "dask": ["python -c 'from distributed import LocalCluster'"],
    "robots": ["python -c 'from surefoot import envs; envs.load_robot_spec(\"g1\").compile()'"],
    "rl": ["python -c 'import surefoot.wrappers.vector.sb3'"],
    "gpu": ["python -c 'import surefoot.wrappers.gpu'"],
    "experiments": [
        "surefoot --help",
        "surefoot calibrate ft --sample",
        "surefoot evaluate surefoot/NaoStand-v0 zero --option duration=0.5 --seeds 2",
    ],
    "ros": ["surefoot calibrate walk no.bag > said 2>&1; cat said; grep -q 'no such bag' said"],
    "view": ["timeout --preserve-status -s INT 60 surefoot view --port 8397"],
    "docs": [f"sphinx-build -q -W -D nb_execution_mode=off {ROOT}/docs site"],
}
"""What each extra serves; "docs" serves the checkout alone."""


def brought(extra: str) -> set[str]:
    """Return an extra and those that come with it."""
    inside = re.findall(r"surefoot\[([\w,]+)\]", " ".join(EXTRAS.get(extra, ())))
    return {extra, ""}.union(*(brought(name) for names in inside for name in names.split(",")))


def sh(command: str, folder: Path) -> tuple[bool, str]:
    """Run a command with the environment's programs; return whether it went well, and what it said."""
    path = f"{WORK}/venv/bin:{os.environ['PATH']}"
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        cwd=folder,
        env={**inherited, "PATH": path, "COLUMNS": "10000"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    return done.returncode == 0, done.stdout


def check(folder: Path, extra: str) -> tuple[str, list[str]]:
    """Return the row of an extra and what is wrong with it."""
    shutil.rmtree(WORK, ignore_errors=True)
    empty = WORK / "empty"
    empty.mkdir(parents=True)
    began = time.monotonic()
    wrong = []
    for command in (
        f"{sys.executable} -m pip wheel -q -c {ROOT}/constraints.txt -w {WORK}/wheels --find-links {folder} "
        f"'surefoot[{extra}]=={PROJECT['version']}'",
        f"{sys.executable} -m venv {WORK}/venv",
        f"pip install -q --no-index --find-links {WORK}/wheels 'surefoot[{extra}]'",
        "pip check",
    ):
        well, said = sh(command, empty)
        if not well:
            return f"| `{extra}` | | | |", [f"[{extra}] {command}: {said}"]
    ready = time.monotonic() - began
    for other, commands in SERVES.items():
        lacking = brought(other) - brought(extra)
        for command in commands:
            well, said = sh(command, empty)
            named = set(re.findall(r"surefoot\[(\w+)\]", said))
            if well == bool(lacking) or (lacking and other != "docs" and not named & lacking):
                wrong.append(f"[{extra}] {command}: {said[-1000:]}")
    sizes = [file.stat().st_size for file in (WORK / "wheels").iterdir()]
    served = len([c for other, commands in SERVES.items() if other in brought(extra) for c in commands])
    return f"| `{extra or '-'}` | {len(sizes)} | {sum(sizes) / 1e6:.0f} | {ready:.0f} | {served} |", wrong


def main(folder: str, *extras: str) -> None:
    """Check the extras that are named, or all."""
    print("| extra | packages | MB to download | s to install | uses that went well |\n|---|---|---|---|---|")
    wrong = []
    for extra in extras or SERVES:
        row, found = check(Path(folder).resolve(), extra)
        wrong += found
        print("\n".join([row, *found]), flush=True)
    shutil.rmtree(WORK, ignore_errors=True)
    raise SystemExit(f"{len(wrong)} of the above went wrong." if wrong else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
