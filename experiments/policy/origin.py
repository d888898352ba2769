"""Where episodes come from: what was evaluated, and with what, as it was written down when it was run.

A policy file may be another one by the time a page is made of its episodes, so that nothing is read from it
then.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surefoot.experiments.policy.controllers import controller_hash, trained_on
from surefoot.experiments.policy.episodes import EPISODES, UNNAMED
from surefoot.experiments.policy.tasks import TASKS
from surefoot.experiments.study.files import write_text

__all__ = ["PLAN", "Origin", "Plan", "merged", "origins_of"]

PLAN = "evaluation.json"


@dataclass(frozen=True)
class Origin:
    """What is known of a controller whose episodes are there.

    Attributes:
        file: Hash of the file behind it when it was run, see
            :func:`~surefoot.experiments.policy.controllers.controller_hash`; nothing if there is none, or
            nobody wrote it down.
        trained: What it was trained on, see :func:`~surefoot.experiments.policy.controllers.trained_on`.
        versions: With what it was run.
        runs: Whether it runs under its name: other names were made up for a file of episodes.
    """

    file: str = ""
    trained: str = ""
    versions: str = ""
    runs: bool = True


@dataclass(frozen=True)
class Plan:
    """What a folder's ``evaluation.json`` says.

    Attributes:
        evaluation: What is compared, as plain data.
        versions: Packages, and a hash of the sources.
        trained: What each controller was trained on.
    """

    evaluation: dict[str, Any]
    versions: dict[str, str]
    trained: dict[str, str]

    @classmethod
    def read(cls, path: Path) -> "Plan":
        """Read it.

        Raises:
            ValueError: If it is damaged.
        """
        try:
            made = json.loads(path.read_text(encoding="utf-8"))
            evaluation, versions = dict(made["evaluation"]), dict(made["versions"])
            files = dict(evaluation["files"])
            trained = made.get("trained")
            if trained is None:
                env_id = TASKS[evaluation["task"]].env_id
                trained = {name: _trained_still(name, held, env_id) for name, held in files.items()}
            return cls(evaluation, versions, dict(trained))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"'{path}' does not say what was evaluated ({error}); give another folder with --out."
            ) from error

    def write(self, path: Path) -> None:
        """Write it down."""
        held = {"evaluation": self.evaluation, "trained": self.trained, "versions": self.versions}
        write_text(path, json.dumps(held, indent=1) + "\n")

    def origins(self) -> dict[str, Origin]:
        """Say what is known of each controller."""
        versions = ", ".join(f"{name} {value}" for name, value in self.versions.items())
        return {
            str(name): Origin(str(file), str(self.trained.get(name, "")), versions)
            for name, file in dict(self.evaluation["files"]).items()
        }


def origins_of(path: Path, controllers: Sequence[str], name: str = "") -> dict[str, Origin]:
    """Say what is known of the controllers in a file of episodes.

    Args:
        path: The file, or its folder.
        controllers: Who acted, as it is read.
        name: What the one that acted is called, if not as the file says.

    Raises:
        ValueError: If what lies beside the file is damaged.
    """
    plan = (path if path.is_dir() else path.parent) / PLAN
    beside = path.is_dir() or path.name == EPISODES
    known = Plan.read(plan).origins() if beside and plan.is_file() else {}
    if name:
        written = next(iter(known.values())) if len(known) == 1 else Origin(trained=_shipped_on(name))
        return {name: Origin(written.file, written.trained, written.versions, runs=False)}
    return {who: known.get(who, Origin(trained=_shipped_on(who), runs=who != UNNAMED)) for who in controllers}


def merged(controller: str, origins: Sequence[Origin]) -> Origin:
    """Put together what several files know of a controller.

    Raises:
        ValueError: If it was another file in one of them.
    """
    if len({origin.file for origin in origins if origin.file}) > 1:
        raise ValueError(
            f"'{controller}' is not the same file everywhere: it was changed between one evaluation and the "
            "next; give controllers of different files different names, NAME=FILE."
        )
    files, trained = {origin.file for origin in origins}, {origin.trained for origin in origins}
    return Origin(
        files.pop() if len(files) == 1 else "",
        trained.pop() if len(trained) == 1 else "",
        "; ".join(dict.fromkeys(origin.versions for origin in origins if origin.versions)),
        all(origin.runs for origin in origins),
    )


def _shipped_on(name: str) -> str:
    """Say what a policy was trained on if its name alone says so."""
    return "" if Path(name).suffix else trained_on(name)


def _trained_still(name: str, held: str, env_id: str) -> str:
    """Say what a policy was trained on whose evaluation did not write it down, if it is still the same."""
    if not Path(name).is_file():
        return _shipped_on(name)
    return trained_on(name) if held and controller_hash(name, env_id) == held else ""
