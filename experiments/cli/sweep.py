"""``surefoot sweep`` and ``surefoot replay``: controllers over sensor faults, and single episodes again."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import CONTROLLERS, Feeds, Names, Numbers, fail, one_line_errors, show


def sweep(
    plan: Annotated[Path | None, Argument(help="TOML that says what to sweep; options go before it.")] = None,
    controller: Annotated[Names, Option(help=f"{CONTROLLERS}; again for more.")] = None,
    feed: Feeds = None,
    scenario: Annotated[Names, Option(help="A scenario; again for more.")] = None,
    severity: Annotated[Numbers, Option(help="Factor of the cells' errors; again for more.")] = None,
    seeds: Annotated[int | None, Option(help="Episodes of each combination.", min=1)] = None,
    first_seed: Annotated[int, Option(help="The first of the seeds.", min=0)] = 0,
    duration: Annotated[float | None, Option(help="Longest duration of an episode in s.")] = None,
    out: Annotated[Path, Option(help="Folder of the sweep; an interrupted one goes on.")] = Path("out/sweep"),
    jobs: Annotated[int, Option(help="Episodes that are run at the same time here.", min=1)] = 2,
    backend: Annotated[str, Option(help="local, dask or ray; or here, in this very process.")] = "local",
    address: Annotated[str | None, Option(help="Of a running scheduler of dask or head of ray.")] = None,
    retry_failed: Annotated[bool, Option("--retry-failed", help="Run failed episodes again.")] = False,
    any_version: Annotated[bool, Option("--any-version", help="Go on with other versions' results.")] = False,
    films: Annotated[int, Option(help="How many of the worst episodes to film.", min=0)] = 0,
    scenarios: Annotated[bool, Option("--scenarios", help="List the scenarios, and end.")] = False,
) -> None:
    """Sweep controllers over feeds, scenarios, severities and seeds, and report."""
    from surefoot.experiments.episodes.plan import EpisodePlan, plan_from_toml
    from surefoot.experiments.episodes.run import run_plan
    from surefoot.experiments.episodes.sweep_page import SweepPage

    if scenarios:
        _list_scenarios()
        return
    given: dict[str, Any] = {
        "controllers": tuple(controller or ()),
        "feeds": tuple(feed or ()),
        "scenarios": tuple(scenario or ()),
        "severities": tuple(severity or ()),
        "seeds": tuple(range(first_seed, first_seed + seeds)) if seeds else (),
        "duration": duration,
    }
    changes = {name: value for name, value in given.items() if value not in ((), None)}
    if first_seed and not seeds:
        fail("--first-seed needs --seeds, how many.")
    with one_line_errors(out, "what is finished is kept."):
        chosen = EpisodePlan(**changes) if plan is None else plan_from_toml(plan, **changes)
        where: Any = {"backend": backend, "jobs": jobs, "address": address}
        results = run_plan(chosen, out, retry_failed=retry_failed, any_version=any_version, **where)
        page = SweepPage(results, films=films)
        report = page.write()
    show(page.tables)
    kept = len(results.rows) - results.computed
    typer.echo(f"{results.computed} episodes run, {kept} were there, {len(results.failed)} failed.")
    typer.echo(f"Report: {report}")


def replay(
    results: Annotated[Path, Argument(help="Folder of a sweep or an evaluation, or its episodes.parquet.")],
    case: Annotated[int, Option(help="Number of the episode.", min=0)],
    video: Annotated[Path | None, Option(help="Film it into this .mp4 as well.")] = None,
) -> None:
    """Run one episode again, and say whether it comes out the same to the last digit."""
    from surefoot.experiments.episodes.episode import OUTCOME
    from surefoot.experiments.episodes.run import replay_episode
    from surefoot.experiments.episodes.sweep_page import film_episode

    if video is not None and video.suffix != ".mp4":
        fail(f"'{video}' must end in .mp4.")
    with one_line_errors():
        replayed = replay_episode(results, case)
        if video is not None:
            typer.echo(f"Film: {film_episode(video, replayed.episode)}")
    for name in (*OUTCOME, "error"):
        then, now = replayed.then[name], replayed.now[name]
        mark = f"  <- {then!r} then" if name in replayed.different else ""
        if now != "":
            typer.echo(f"{name:14s} {now!r}{mark}" if name != "error" else f"{now}{mark}")
    if replayed.other_versions:
        typer.echo(f"Versions: {', '.join(replayed.other_versions)}")
    typer.echo("Different." if replayed.different else "Identical.")
    if replayed.different:
        raise typer.Exit(1)


def _list_scenarios() -> None:
    from surefoot.experiments.episodes.scenarios import SCENARIOS, scenario_named

    for name in SCENARIOS:
        try:
            typer.echo(f"{name:22s} {scenario_named(name).title}")
        except ValueError:
            continue
