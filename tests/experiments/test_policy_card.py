"""Cards and origins: scores are credited to the policy that won them, and to no other."""

import json
import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from surefoot.experiments.cli.app import app
from surefoot.experiments.policy.card import own_scores, write_card
from surefoot.experiments.policy.controllers import controller_hash
from surefoot.experiments.policy.episodes import read_episodes
from surefoot.experiments.policy.evaluation import Evaluation
from surefoot.experiments.policy.evaluation_folder import EvaluationFolder
from surefoot.experiments.policy.origin import Origin, merged, origins_of
from surefoot.experiments.policy.scores import score_table
from surefoot.experiments.policy.shipped import SHIPPED, shipped_policy
from surefoot.experiments.policy.tasks import TASKS

pytestmark = pytest.mark.filterwarnings("ignore:.*unconventional shape")

RUNNER = CliRunner()
BALANCE = str(files("surefoot.experiments.policy") / "files" / "balance-true" / "policy.npz")


@pytest.fixture
def mine(tmp_path):
    """A folder with a policy."""
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(BALANCE, folder / "policy.npz")
    return folder


def card_of(folder):
    path = folder / "card.md"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def scored(*arguments):
    answer = RUNNER.invoke(app, ["evaluate", *arguments, "--feed", "true", "--seeds", "3"])
    assert answer.exit_code == 0, answer.output
    return answer.output


def test_a_card_takes_the_scores_of_its_own_policy_alone(mine, invented):
    for others in (["zero"], ["shipped-randomised"]):
        assert "Card" not in scored(*others, "--out", str(mine))
        assert card_of(mine) == ""
        assert "None yet" in write_card(mine).read_text()
        for path in mine.iterdir():
            if path.is_file() and path.suffix != ".npz" and path.suffix != ".csv":
                path.unlink()
    hint = f"`surefoot evaluate {mine / 'policy.npz'} --out {mine}` writes it here"
    assert hint in write_card(mine).read_text()
    output = scored("zero", str(mine / "policy.npz"), "--out", str(mine))
    assert "Card" in output
    text = card_of(mine)
    own = 100.0 + np.mean([np.sin(seed + 4) for seed in (20_000, 20_001, 20_002)])
    assert f"| true | – | {own:.2f} ±" in text
    assert "1100" not in text
    assert "policy file" not in text
    assert "the episodes of the seeds 20000 to 20002, the same for all rows" in text


def test_a_card_does_not_take_what_an_earlier_policy_left(mine, invented):
    scored(str(mine / "policy.npz"), "--out", str(mine))
    assert "Means with" in card_of(mine)
    shipped_policy("randomised").save(mine / "policy.npz")
    assert "None yet" in write_card(mine).read_text()
    (mine / "evaluation.csv").write_text("CoP fed back,return\ntrue,12\n")
    assert "None yet" in write_card(mine).read_text()
    (mine / "evaluation.csv").write_bytes(b"\xff\x00,")
    assert "None yet" in write_card(mine).read_text()


def test_what_is_shipped_has_the_scores_of_its_own_episodes():
    for task, kinds in SHIPPED.items():
        for sensors in kinds:
            folder = Path(str(files("surefoot.experiments.policy") / "files" / f"{task}-{sensors}"))
            own = own_scores(folder)
            assert own is not None
            assert set(own["task"]) == {task}
            table = score_table(read_episodes(folder)).to_frame()
            pd.testing.assert_frame_equal(own[table.columns].astype(object), table.astype(object))


def test_a_page_says_what_a_policy_was_when_it_was_run(tmp_path, mine, invented):
    out, policy = tmp_path / "out", str(mine / "policy.npz")
    scored(policy, "--out", str(out))
    held = json.loads((out / "evaluation.json").read_text())
    assert held["trained"] == {policy: "true"}
    before = held["evaluation"]["files"][policy]
    assert before == controller_hash(policy) == controller_hash("shipped", TASKS["balance"].env_id)
    shipped_policy("randomised").save(policy)
    assert origins_of(out, [policy])[policy].trained == "true"
    assert origins_of(out, ["mine"], "mine") == {
        "mine": Origin(before, "true", origins_of(out, [policy])[policy].versions, runs=False)
    }
    # Older evaluations wrote no more than the hash: the file tells if it is still the same.
    del held["trained"]
    (out / "evaluation.json").write_text(json.dumps(held))
    assert origins_of(out, [policy])[policy].trained == ""
    shutil.copy(BALANCE, policy)
    assert origins_of(out, [policy])[policy].trained == "true"
    shipped_policy("randomised").save(policy)
    answer = RUNNER.invoke(app, ["evaluate", policy, "--feed", "true", "--seeds", "3", "--out", str(out)])
    assert "holds another evaluation: files" in answer.output.replace("\n", " ")
    other = tmp_path / "other"
    answer = RUNNER.invoke(app, ["evaluate", policy, "--feed", "none", "--seeds", "3", "--out", str(other)])
    assert answer.exit_code == 0
    both = ["evaluate", "--page-of", str(out), "--page-of", str(other), "--out", str(tmp_path / "page")]
    assert "is not the same file everywhere" in RUNNER.invoke(app, both).output
    with pytest.raises(ValueError, match=r"changed between one evaluation and the next; .*NAME=FILE"):
        merged("mine", [Origin("1"), Origin("2")])
    assert merged("a", [Origin("1", "true", "v1"), Origin("", "true", "v2", False)]) == Origin(
        "", "true", "v1; v2", False
    )


def test_a_policy_that_is_changed_while_it_is_evaluated_is_refused(mine, invented):
    policy = str(mine / "policy.npz")
    evaluation = Evaluation((policy,), ("true",), seeds=3)
    with EvaluationFolder(mine, evaluation).opened() as folder:
        running = folder.run()
        next(running)
        shipped_policy("randomised").save(policy)
        with pytest.raises(ValueError, match=r"policy\.npz' was changed while it was being evaluated"):
            next(running)
    assert len(read_episodes(mine)) == 1
