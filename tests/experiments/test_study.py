"""A tiny study, whole; what is kept of it whatever happens; and what a page makes of it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from surefoot.experiments.study.figures import (
    draw_curve,
    figure_at,
    grid_of,
    legend_below,
    limit_to,
    look_of,
    short_label,
    show_values,
)
from surefoot.experiments.study.page import ReportFigure, Section, failure_section, publish, write_page
from surefoot.experiments.study.runner import attempt, runner
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.statistics import survival
from surefoot.experiments.study.store import JOURNAL, Case, Store, StudyError
from surefoot.experiments.study.tables import Table, Verdict

Rows = dict[str, list[dict[str, Any]]]


def walk(speed: float, seed: int) -> Rows:
    rng = np.random.default_rng(seed)
    return {
        "walks": [{"speed": speed, "seed": seed, "time": rng.uniform(10.0, 30.0), "fell": bool(seed % 2)}],
        "steps": [{"seed": seed, "step": i, "length": [0.1 * i, float("nan")]} for i in range(seed)],
    }


def fails(seed: int) -> Rows:
    raise ValueError(f"seed {seed} cannot walk")


def cases(seeds: int = 3) -> list[Case]:
    return [Case(f"{v:g} m/s, seed {s}", walk, (v, s)) for v in (0.02, 0.04) for s in range(seeds)]


def run(folder: Path, listed: list[Case], jobs: int = 1, **options: Any) -> tuple[Store, int]:
    store = Store(folder)
    with store.open_for(), runner(jobs, **options) as work:
        return store, work.run("walk", listed, store)


def test_a_whole_study(tmp_path: Path) -> None:
    listed, seconds = cases(), dict[str, float]()
    with Store(tmp_path / "results").open_for() as store, runner(1, seconds) as work:
        assert work.run("walk", listed, store) == 6
        rows, failures = store.rows("walks", listed), store.failures(listed)
    assert list(rows["seed"]) == [0, 1, 2] * 2
    assert seconds["walk"] > 0.0
    cells = (("time", Verdict.of(rows["time"].min() > 5.0)), ("share", Verdict.of(False)))
    table = Table("targets", "Targets", ("what", "reached"), cells)
    curve = survival(rows["time"], rows["fell"])
    with figure_at(tmp_path / "time.svg", 6.0, 3.0) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        draw_curve(axes, curve.time, curve.share, look_of("none"), curve.low, curve.high)
        legend_below(figure, axes)
    shown = ReportFigure(tmp_path / "time.svg", "Figure 1", "Time on its feet.")
    lead = Section("lead", "What was done", ("One sentence.",), video="walk.mp4", figures=(shown,))
    sections = (Section("walks", "Walks", tables=(table,), figures=(shown,)), *failure_section(failures))
    report = publish(tmp_path, "Walks", ("Introduced.",), sections, lead=lead)
    assert report.tables == (table,)
    text = report.page.read_text()
    assert text.count("data:image/svg+xml;base64,") == 2
    assert text.index("walk.mp4") < text.index("One sentence.") < text.index("Introduced.")
    for cell in ('<td class="good">yes</td>', '<td class="bad">no</td>'):
        assert cell in text
    assert list(pd.read_csv(tmp_path / "tables" / "targets.csv")["reached"]) == ["yes", "no"]


def test_nothing_is_run_twice_and_numbers_come_back_as_they_were(tmp_path: Path) -> None:
    first, count = run(tmp_path, cases())
    again, more = run(tmp_path, [*cases(), *cases(5)[3:5]])
    assert (count, more) == (6, 2)
    for table in ("walks", "steps"):
        before, after = first.rows(table, cases()), again.rows(table, cases())
        assert before.astype(str).equals(after.astype(str))


def test_other_code_is_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path, cases())
    monkeypatch.setattr("surefoot.experiments.study.store.code_of", lambda module: "code of tomorrow")
    store = Store(tmp_path)
    store.read()
    assert not any(map(store.holds, cases()))
    assert all(store.holds(case, any_version=True) for case in cases())


def test_a_case_that_fails_is_kept_as_such_and_tried_again(tmp_path: Path) -> None:
    listed = [*cases(1), Case("bad", fails, (7,))]
    store, _ = run(tmp_path, listed)
    assert list(store.failures(listed)) == ["bad"]
    (section,) = failure_section(store.failures(listed))
    assert section.tables[0].rows == (("bad", "ValueError: seed 7 cannot walk"),)
    with store.open_for(), runner(1) as work:
        named = work.run("walk", listed, store, failed=lambda case, error: {"walks": [{"error": error}]})
    assert named == 1
    assert "seed 7 cannot walk" in store.rows("walks", listed)["error"].iloc[-1]


def test_a_study_that_is_killed_goes_on(tmp_path: Path) -> None:
    script = tmp_path / "slow_study.py"
    script.write_text(
        "import sys, time\nfrom pathlib import Path\n"
        "from surefoot.experiments.study.runner import runner\n"
        "from surefoot.experiments.study.store import Case, Store\n"
        "def slow(i):\n    time.sleep(0.05)\n    return {'rows': [{'i': i}]}\n"
        "if __name__ == '__main__':\n"
        "    store = Store(Path(sys.argv[1]))\n"
        "    with store.open_for(), runner(1) as work:\n"
        "        print(work.run('s', [Case(str(i), slow, (i,)) for i in range(9)], store))\n"
    )
    folder = tmp_path / "results"
    command = [sys.executable, str(script), str(folder)]
    first = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    journal = folder / JOURNAL
    while not (journal.is_file() and journal.read_bytes().count(b"\n") >= 3) and first.poll() is None:
        time.sleep(0.01)
    first.send_signal(signal.SIGKILL)
    first.wait()
    there = journal.read_bytes().count(b"\n")
    assert 3 <= there < 9
    second = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(second.stdout) == 9 - there
    store = Store(folder)
    store.read()
    assert sorted(store.rows("rows")["i"]) == list(range(9))


def test_half_a_line_and_damaged_lines_cost_their_cases_alone(tmp_path: Path) -> None:
    run(tmp_path, cases())
    first, second, *others = (tmp_path / JOURNAL).read_bytes().splitlines(keepends=True)
    bad = b"\0" + second
    (tmp_path / JOURNAL).write_bytes(b"".join([first, bad, *others, b'{"key": "abc"}\n{"key": "de']))
    store, count = run(tmp_path, cases())
    assert count == 1
    assert len(store.rows("steps", cases())) == 6
    assert run(tmp_path, cases())[1] == 0


@pytest.mark.slow
def test_a_worker_that_dies_ends_work_that_is_not_kept() -> None:
    # That it costs its case alone is shown with episodes: workers cannot import this file.
    with runner(2) as work, pytest.raises(StudyError, match="A worker died"):
        work.do("die", [(os._exit, (9,))])


def test_a_folder_serves_one_study_at_a_time(tmp_path: Path) -> None:
    with Store(tmp_path).open_for(), pytest.raises(StudyError, match="Another study is at work"):  # noqa: SIM117
        with Store(tmp_path).open_for():
            pass


def test_a_folder_with_a_plan_refuses_others(tmp_path: Path) -> None:
    plan, now = {"seeds": [0, 1], "task": "walk"}, {"numpy": "2"}
    with Store(tmp_path).open_for(plan, now):
        pass
    refused = [
        ({**plan, "seeds": [0]}, now, r"holds another study: seeds \[0, 1\] and not \[0\]"),
        ({**plan, "own": "word " * 99}, now, r"study: own None and not word .{50,99} \[\.\.\.\]\. Give its"),
        (plan, {"numpy": "3"}, "started with numpy 2, which is not what runs now"),
    ]
    for other, versions, match in refused:
        with pytest.raises(StudyError, match=match), Store(tmp_path).open_for(other, versions):
            pass
    with Store(tmp_path).open_for(plan, {"numpy": "3"}, any_version=True):
        pass


def test_a_full_disk_keeps_what_was_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    with store.open_for():
        store.add(attempt(cases()[0]))
        before = (tmp_path / JOURNAL).read_bytes()

        def full(file: int, data: bytes) -> int:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("surefoot.experiments.study.store.os.write", full)
            with pytest.raises(StudyError, match="No space left on device"):
                store.add(attempt(cases()[1]))
        assert (tmp_path / JOURNAL).read_bytes() == before


def test_code_that_changes_meanwhile_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def elsewhere(case: Case) -> Any:
        outcome = attempt(case)
        return type(outcome)(outcome.key, outcome.name, "code 0", outcome.tables)

    monkeypatch.setattr("surefoot.experiments.study.runner.attempt", elsewhere)
    with pytest.raises(StudyError, match="The code has changed meanwhile"):
        run(tmp_path, cases())


def test_legends_fit_their_figure_and_single_values_have_room() -> None:
    figure = Figure(figsize=(4.0, 3.0), layout="constrained")
    axes = grid_of(figure, 1, 1)[0, 0]
    for name in ("true-map", "none", "tare", "quasi-static", "window", "baseline"):
        draw_curve(axes, [1.0], [2.0], look_of(name))
        assert axes.lines[-1].get_marker() == look_of(name).marker
    legend_below(figure, axes)
    (legend,) = figure.legends
    assert legend.get_window_extent().width <= figure.bbox.width
    show_values(axes, [1.0])
    assert axes.get_xlim() == (0.5, 1.5)
    assert short_label("nobody") == "nobody"
    axes.plot([0.0, 1.0], [-1000.0, 1000.0])
    limit_to(axes, [0.0, 1.0, np.nan], least=2.0)
    assert axes.get_ylim() == (-1.2, 2.2)
    limit_to(axes, [np.nan], least=2.0)
    assert axes.get_ylim() == (-1.2, 2.2)


def test_cells_are_coloured_by_verdicts_and_not_by_words(tmp_path: Path) -> None:
    table = Table("t", "T", ("a", "fell"), (("x", "yes"), ("y", Verdict.of(False, "fallen")), ("w" * 40, "")))
    text = write_page(tmp_path / "p.html", "P", (), (Section("s", "S", tables=(table,)),)).read_text()
    assert "<td>yes</td>" in text
    assert '<td class="bad">fallen</td>' in text
    assert f'<td class="words">{"w" * 40}</td>' in text


def test_code_that_decides_results_counts_and_code_that_shows_them_does_not(monkeypatch):
    read, before = Path.read_bytes, source_hash.__wrapped__()
    for file, counts in (("native/surefoot_moment.h", True), ("walks/figures.py", False)):
        changed = lambda path, end=file: read(path) + b"\n" * path.as_posix().endswith(end)  # noqa: E731
        monkeypatch.setattr(Path, "read_bytes", changed)
        assert (source_hash.__wrapped__() != before) == counts


def test_other_code_is_another_hash():
    assert source_hash("surefoot.calibration.online") != source_hash("surefoot.sensors.severity")
    with pytest.raises(ModuleNotFoundError, match="no module"):
        source_hash("surefoot.magic")
