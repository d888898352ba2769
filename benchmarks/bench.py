"""What the studies of this folder share: options, a run that can be resumed, tables and a page.

A study is a script with a function that returns rows by the name of their table::

    def walk(seed: int) -> bench.Rows:
        return {"walks": [{"seed": seed, "time": ...}]}

    rows = bench.run(folder, "walking", walk, [(seed,) for seed in range(10)], jobs=2)
    bench.publish(folder, "Walks", "How long robots walk.", [table_of(..., rows["walks"])])

Finished cases stay in the folder: an interrupted study goes on where it stopped, and a case is run again once
the code behind it changes. ``joblib.parallel_config`` chooses another backend, such as dask, if ``jobs`` is
``None``.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console

from surefoot.experiments.study.page import ReportFigure, Section
from surefoot.experiments.study.page import publish as write
from surefoot.experiments.study.runner import runner
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Frame, Table

HERE = Path(__file__).parent
RESULTS = Path("out/results")
Rows = Mapping[str, Any]  # rows, or a data frame, by the name of a table


def options(doc: str | None, name: str, seeds: int = 0) -> argparse.ArgumentParser:
    """Return a parser with the options of all studies; without a number of seeds there is no ``--seeds``."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=doc, formatter_class=layout)
    if seeds:
        parser.add_argument("--seeds", type=int, default=seeds, help=f"{seeds} by default")
    parser.add_argument("--jobs", type=int, default=1, help="processes that work at the same time")
    parser.add_argument("--out", type=Path, default=RESULTS / name, help="folder of results")
    parser.add_argument("--quick", action="store_true", help="a small configuration, to see whether it runs")
    return parser


def run(
    folder: Path,
    what: str,
    function: Callable[..., Rows],
    arguments: Sequence[tuple[Any, ...]],
    *,
    jobs: int | None = 1,
    depends: Callable[..., Any] = lambda *arguments: arguments,
) -> dict[str, Frame]:
    """Call a function with each tuple of arguments, unless its result is kept, and return all rows by table.

    Args:
        folder: Where results are kept.
        what: The name of this stage in the progress bar.
        function: A function of a module in this folder that returns rows by table.
        arguments: Arguments of each call.
        jobs: Processes; ``None`` for what ``joblib.parallel_config`` says.
        depends: Returns what decides the result of a call, by default its arguments. Their ``repr`` must be
            the same in every run, so that folders do not belong there.
    """
    code = _code()
    cases = [
        Case(f"{what} {number}: {given}", function, given, (depends(*given), code))
        for number, given in enumerate(arguments)
    ]
    store = Store(folder / "results")
    with store.open_for(), runner(jobs) as work:
        work.run(what, cases, store)
    for name, error in store.failures(cases).items():
        print(f"{name} failed: {error.splitlines()[-1]}", file=sys.stderr)
    found = [store.outcomes[case.key] for case in cases if case.key in store.outcomes]
    return {name: store.rows(name, cases) for outcome in found for name in outcome.tables}


def publish(
    folder: Path, title: str, text: str, tables: Sequence[Table], figures: Sequence[ReportFigure] = ()
) -> None:
    """Print tables, save them as CSV with a note of how they were made, and write a page with the figures."""
    section = Section("results", "Results", tables=tuple(tables), figures=tuple(figures))
    report = write(folder, title, (text,), (section,))
    show(tables)
    print(f"Report: {report.page}")


def show(tables: Sequence[Table]) -> None:
    """Print tables."""
    console = Console(width=180)
    for table in tables:
        console.print(table.to_rich())


def start(file: str) -> None:
    """Run ``main`` of a script as a module, so that other processes find its functions by name."""
    import_module(Path(file).stem).main()


@cache
def _code() -> str:
    """Return a hash of all modules of this folder that are imported: results depend on them as well."""
    files = [getattr(module, "__file__", None) or "" for module in sys.modules.values()]
    own = sorted({Path(file) for file in files if Path(file).parent == HERE})
    return sha256(b"".join(file.read_bytes() for file in own)).hexdigest()[:16]
