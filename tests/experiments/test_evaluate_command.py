"""``surefoot evaluate``: from a line to a page, again, and one episode of it once more."""

import json
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from _logs import run, run_for_json

from surefoot.experiments.evaluate.command import Wanted

HERE = str(Path(__file__).parent)
STAND = ["surefoot/NaoStand-v0", "stabiliser", "--option", "duration=0.3"]
FEW = ["--feed", "true", "--feed", "raw", "--severity", "1", "--seeds", "2", "--jobs", "1"]


@pytest.fixture(autouse=True)
def _own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(HERE)


def test_from_one_line_to_the_page_and_again(tmp_path: Path, undrawn: None) -> None:
    out = tmp_path / "out"
    answer = run("evaluate", *STAND, *FEW, "--out", out)
    assert "4 episodes run, 0 were there, 0 failed." in answer.stdout
    text = (out / "index.html").read_text()
    first = text[text.index('<section class="lead"') :]
    assert "At severity 1 drift costs stabiliser" in first[: first.index("</p>")]
    assert "95 % interval" in first[: first.index("</p>")]
    assert "Does sensor drift hurt this policy? surefoot/NaoStand-v0" in text
    assert text.count("data:image/svg+xml;base64,") == 2
    assert {path.stem for path in (out / "tables").glob("*.csv")} == {"scores_0", "differences", "worst"}
    assert list(pd.read_parquet(out / "episodes.parquet")["seed"]) == [20_000, 20_001] * 2
    found = run_for_json("evaluate", *STAND, *FEW, "--out", out)
    assert found["episodes"] == {"run": 0, "were there": 4, "failed": 0}
    assert found["answer"].startswith("At severity 1 drift costs stabiliser")
    assert "holds another study: seeds" in run(
        "evaluate", *STAND, *FEW, "--first-seed", "3", "--out", out, code=2
    ).output.replace("\n", " ")
    # One episode again, by the folder alone.
    assert run("evaluate", "--out", out, "--case", "3").stdout.endswith("Identical.\n")
    journal = (out / "journal.jsonl").read_text()
    (out / "journal.jsonl").write_text(journal.replace('"length": 24', '"length": 23'))
    assert "Different." in run("evaluate", "--out", out, "--case", "3", code=1).stdout
    assert "There is no row of case 9" in run("evaluate", "--out", out, "--case", "9", code=2).stderr


def test_a_file_says_the_same_and_options_replace_it(tmp_path: Path, undrawn: None) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        'env = "_biped:make"\npolicies = { lean = "_biped:lean" }\nobserve = "_biped:cop_of"\n'
        'feeds = ["true", "raw"]\nseverities = [1, 2]\nseeds = 2\nfirst_seed = 7\n'
        'faults = { dies = 0.1 }\nscenario = ["payload=1"]\n'
    )
    run(
        "evaluate",
        "--config",
        path,
        "--severity",
        "1",
        "--jobs",
        "1",
        "--metric",
        "height",
        "--out",
        tmp_path / "a",
    )
    rows = pd.read_parquet(tmp_path / "a" / "episodes.parquet")
    assert set(rows["severity"]) == {0.0, 1.0}
    assert set(rows["seed"]) == {7, 8}
    assert set(rows["policy"]) == {"lean"}
    assert set(rows["fault"]) == {"", "{'dies': 0.1}"}
    assert rows["height"].notna().all()
    # What is written into the folder repeats it.
    run("evaluate", "--config", tmp_path / "a" / "evaluation.json", "--jobs", "1", "--out", tmp_path / "b")
    again = pd.read_parquet(tmp_path / "b" / "episodes.parquet")
    assert list(again["digest"]) == list(rows["digest"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "'env' is missing: surefoot evaluate ENV POLICY"),
        (["surefoot/NaoStand-v0"], "'policies' is missing: surefoot evaluate ENV POLICY"),
        ([*STAND, "--feed", "sand"], "There is no feed 'sand'"),
        ([*STAND, "--option", "duration"], "An option of the environment is NAME=VALUE, got 'duration'."),
        ([*STAND, "--scenario", "payload=much"], "The scenario 'payload' needs a number, as in payload=1.5"),
        (
            [*STAND, "--fault", "dies=0.1", "--fault", "at t=1 s cell left/2 dies"],
            "--fault takes probabilities",
        ),
        ([*STAND, "--address", "tcp://here:1"], "name its --backend, dask or ray"),
        ([*STAND, "--case", "1"], "holds no evaluation; give its folder with --out."),
        ([*STAND, "--video", "a.mp4"], "--video films one episode into an .mp4: give --case"),
        (["surefoot/NaoStand-v0", "model.zip"], "There is no policy file 'model.zip'"),
    ],
)
def test_wrong_words_end_in_one_line_before_anything_is_run(words: Any, message: str, tmp_path: Path) -> None:
    result = run("evaluate", *words, "--out", tmp_path / "out", code=2)
    assert result.stderr.startswith("surefoot: ")
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_file_with_an_unknown_key_is_refused(tmp_path: Path) -> None:
    for text, message in (
        ("severity = [1]", "There is no key 'severity'. Available: env, policies, feeds, severities"),
        ('severities = 3\nenv = "a"\npolicies = "zero"', "'severities' must be a list, got 3."),
        ("seeds = [", "not TOML"),
    ):
        (tmp_path / "study.toml").write_text(text)
        result = run("evaluate", "--config", tmp_path / "study.toml", "--out", tmp_path / "out", code=2)
        assert message in result.stderr


def test_policies_are_named_and_trainings_gathered() -> None:
    wanted = Wanted("a", ["ppo=a.npz", "ppo=b.npz", "zero"])
    assert wanted._arms == {"ppo": ["a.npz", "b.npz"], "zero": ["zero"]}
    assert Wanted("a", ["zero"])._arms == "zero"


def test_failures_end_with_a_status_and_stand_on_the_page(tmp_path: Path, undrawn: None) -> None:
    words = [
        "_biped:make",
        "_biped:raises",
        "--feed",
        "true",
        "--seeds",
        "6",
        "--jobs",
        "1",
        "--out",
        tmp_path,
    ]
    assert "failed." in run("evaluate", *words, code=1).stdout
    assert "the gains are &lt;gone&gt;" in (tmp_path / "index.html").read_text()
    failed = json.loads((tmp_path / "journal.jsonl").read_text().splitlines()[0])
    assert failed["key"]


@pytest.mark.slow
def test_an_episode_is_filmed(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    run("evaluate", "_biped:make", "_biped:swing", *FEW, "--out", tmp_path)
    film = tmp_path / "worst.mp4"
    run("evaluate", "--out", tmp_path, "--case", "2", "--video", film)
    assert film.stat().st_size > 1000
    assert "surefoot" in sys.modules
