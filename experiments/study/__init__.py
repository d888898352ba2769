"""One framework for all studies: declare cases, and get them run, kept, judged, laid out and shown.

* :mod:`~surefoot.experiments.study.store`: a :class:`Case` is a function that returns rows, and the code
  that it depends on; a :class:`Store` keeps the result of each, on the disk.
* :mod:`~surefoot.experiments.study.runner`: a :class:`Runner` runs the cases that a store lacks, in this
  process or in several; a case that fails is kept as such.
* :mod:`~surefoot.experiments.study.tables`: tables, declared by their columns, and claims with a computed
  verdict; ``statistics``, ``figures``, ``page``: the parts that a person sees.

A whole study (the tests hold it)::

    def walk(speed: float, seed: int) -> dict[str, list[dict[str, float]]]:
        return {"walks": [{"speed": speed, "seed": seed, "time": ...}]}

    cases = [Case(f"{v:g} m/s, seed {s}", walk, (v, s)) for v in (0.02, 0.04) for s in range(10)]
    with Store(out / "results").open_for() as store, runner(jobs=2) as run:
        run.run("walk", cases, store)
        rows, failures = store.rows("walks", cases), store.failures(cases)
    table = claim_table([at_least("time on its feet (s)", rows["time"].mean(), 20.0)])
    with figure_at(out / "time.svg", 6.0, 3.0) as figure:
        draw_curve(grid_of(figure, 1, 1)[0, 0], rows["seed"], rows["time"], look_of("none"))
    shown = ReportFigure(out / "time.svg", "Figure 1", "Time on its feet.")
    sections = (Section("walks", "Walks", tables=(table,), figures=(shown,)), *failure_section(failures))
    publish(out, "Walks", ("The method.",), sections)
"""
