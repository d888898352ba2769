"""Who does the work of a study, piece by piece, with a bar and a stopwatch.

Workers are this process, processes of this machine, or a cluster of dask or ray. One that dies costs nothing
but the task that it died of. Whatever may have killed one is done once more, by itself; if that kills its
worker too, its result is :class:`Died`.
"""

import os
import platform
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

from joblib.externals import loky
from rich.progress import Progress

import surefoot
from surefoot.experiments.study.progress import bars
from surefoot.experiments.study.store import Case, Outcome, Store, StudyError, as_kept
from surefoot.experiments.study.tables import plural
from surefoot.extras import not_installed

BACKENDS = ("local", "dask", "ray", "here")  # here: for debuggers, where a crash ends all
IDLE_TIMEOUT = 20.0  # s after which an idle local worker leaves, also one whose process was killed
Task = tuple[Callable[..., Any], tuple[Any, ...]]  # must survive pickling

_DEATHS = ("BrokenExecutor", "KilledWorker", "WorkerCrashedError", "OutOfMemoryError")
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Died:
    """The result of a task that its worker died of, twice; ``reason`` is the known cause."""

    reason: str


@dataclass(frozen=True)
class Workers:
    """Somebody to work."""

    submit: Callable[..., "Future[Any]"]  # a function and what to give it in, a future out
    under_way: int = 1  # tasks that are handed out at the same time

    def results(self, tasks: Mapping[int, Task]) -> Iterator[tuple[int, Any]]:
        """Yield the number and the result of each task, in any order; errors of a task are raised here."""
        waiting: list[int] = list(tasks)[::-1]
        suspects: list[int] = []
        under_way: dict[Future[Any], int] = {}
        try:
            while waiting or suspects or under_way:
                alone = bool(suspects) and not under_way
                if alone:
                    waiting.append(suspects.pop())
                while waiting and len(under_way) < (1 if alone else 0 if suspects else self.under_way):
                    number = waiting.pop()
                    function, arguments = tasks[number]
                    under_way[self.submit(function, *arguments)] = number
                for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                    number, error = under_way.pop(future), future.exception()
                    if error is None:
                        yield number, future.result()
                    elif not any(kind.__name__ in _DEATHS for kind in type(error).__mro__):
                        raise error
                    elif alone:
                        yield number, Died(" ".join(f"{type(error).__name__}: {error}".split())[:400])
                    else:
                        suspects.append(number)
        finally:
            for future in under_way:
                future.cancel()


@contextmanager
def workers(backend: str, jobs: int, address: str | None = None) -> Iterator[Workers]:
    """Bring up workers here, or those at an address of dask or ray; raise ValueError at a refused one."""
    if backend not in BACKENDS:
        raise ValueError(f"There is no backend '{backend}'. Available: {', '.join(map(repr, BACKENDS))}.")
    if jobs < 1:
        raise ValueError(f"'jobs' must be at least 1, got {jobs}.")
    if address is not None and backend not in ("dask", "ray"):
        raise ValueError(f"Only dask and ray have an address; backend is '{backend}'.")
    if backend == "here":
        yield Workers(_here)
    elif backend == "local":
        with _local(jobs) as submit:
            yield Workers(submit, jobs)
    else:
        with (_dask if backend == "dask" else _ray)(jobs, address) as crew:
            yield crew


def _here(function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
    future: Future[Any] = Future()
    future.set_result(function(*arguments))
    return future


@contextmanager
def _local(jobs: int) -> Iterator[Callable[..., "Future[Any]"]]:
    def executor() -> Any:
        # One that broke is replaced.
        return loky.get_reusable_executor(max_workers=jobs, timeout=IDLE_TIMEOUT, env=_ONE_THREAD)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        try:
            yield lambda function, *arguments: executor().submit(function, *arguments)
        except BaseException:
            executor().shutdown(kill_workers=True)
            raise


@contextmanager
def _dask(jobs: int, address: str | None) -> Iterator[Workers]:
    dask, distributed = _module("dask"), _module("distributed", "dask")
    # A task whose worker dies is tried again by itself, by us: dask need not.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        _explain_address("dask", address),
    ):
        local = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": None}
        client = distributed.Client(**local) if address is None else distributed.Client(address)
    with client:
        # A queue of two for each keeps workers busy that are far away.
        under_way = jobs if address is None else 2 * sum(client.ncores().values())
        yield Workers(partial(_to_dask, client), under_way)


def _to_dask(client: Any, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
    # dask's own executor never hears of a task whose result was lost with its worker.
    theirs, ours = client.submit(function, *arguments, pure=False), Future[Any]()

    def on_done(_: Any) -> None:
        try:
            ours.set_result(theirs.result())
        except Exception as error:
            ours.set_exception(error)

    theirs.add_done_callback(on_done)
    return ours


@contextmanager
def _ray(jobs: int, address: str | None) -> Iterator[Workers]:
    ray = _module("ray")
    ours = not ray.is_initialized()
    if ours:
        # Results are small; by default ray takes a third of the memory for what it moves about.
        local = {"num_cpus": jobs, "include_dashboard": False, "object_store_memory": 100_000_000}
        options = {"address": "local", **local} if address is None else {"address": address}
        with _explain_address("ray", address):
            ray.init(log_to_driver=False, logging_level="ERROR", **options)
    try:
        call = ray.remote(max_retries=0)(_call)
        count = jobs if address is None else int(ray.cluster_resources().get("CPU", 1))
        yield Workers(lambda function, *arguments: call.remote(function, *arguments).future(), count)
    finally:
        if ours:
            ray.shutdown()


def _call(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


@contextmanager
def _explain_address(name: str, address: str | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ValueError(f"No {name} cluster is reached at {address}: {error}.") from error


def _module(name: str, extra: str = "") -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ValueError(str(not_installed(f"Backend '{name}'", error, extra or name))) from None


LONGEST_ERROR = 4000  # characters of a failed case's traceback that are kept, its end
Failed = Callable[[Case, str], Mapping[str, Any]]  # rows of a failed case, from what was raised


@dataclass(eq=False)
class Runner:
    """Does the work of a study, shows it, and notes how long each stage took; :func:`runner` makes one."""

    workers: Workers
    progress: Progress
    seconds: dict[str, float]

    def do(self, what: str, work: Sequence[Task]) -> list[Any]:
        """Do the pieces of a stage, return results in the order given; raise StudyError if a worker died."""
        found: list[Any] = [None] * len(work)
        with self._stage(what, len(work)) as seen:
            for number, result in self.workers.results(dict(enumerate(work))):
                if isinstance(result, Died):
                    raise StudyError(f"A worker died ('{what}', piece {number}): {result.reason}")
                found[number] = result
                seen("")
        return found

    def run(
        self,
        what: str,
        cases: Iterable[Case],
        store: Store,
        *,
        retry_failed: bool = True,
        any_version: bool = False,
        failed: Failed | None = None,
        count: Mapping[str, Callable[[Outcome], bool]] = MappingProxyType({}),
    ) -> int:
        """Run the cases that a store does not hold yet, write each result, and return how many.

        ``any_version`` takes results of other code as they are, here before or from a cluster; ``failed``
        makes rows of a failed case, and ``count`` names the outcomes that are counted beside the bar.
        """
        listed = list(cases)
        # Before anything runs: what is on the disk now is what has been imported.
        codes = {case.key: case.code for case in listed}
        options = {"retry_failed": retry_failed, "any_version": any_version}
        missing = {i: case for i, case in enumerate(listed) if not store.holds(case, **options)}
        counters: dict[str, Callable[[Outcome], bool]] = {**count, "failed": lambda one: bool(one.error)}
        there = [store.outcomes[case.key] for i, case in enumerate(listed) if i not in missing]
        counted = {word: sum(map(of, there)) for word, of in counters.items()}
        with self._stage(what, len(listed), len(there)) as seen:
            if store.damaged:
                lines = plural(store.damaged, "damaged line")
                self.progress.console.print(f"{store.folder} had {lines}; these cases are run again.")
                store.damaged = 0
            tasks: dict[int, Task] = {i: (attempt, (case,)) for i, case in missing.items()}
            for number, result in self.workers.results(tasks):
                case = missing[number]
                if isinstance(result, Died):
                    reason = f"The worker that ran this case died: {result.reason}"
                    result = Outcome(case.key, case.name, codes[case.key], error=reason)
                if result.code != codes[case.key] and not any_version:
                    raise StudyError(
                        f"A worker runs {result.code}, which is not what runs here ({codes[case.key]}). "
                        "Install the same on all of them and give the same command to go on."
                    )
                if result.error and failed is not None:
                    result = replace(result, tables=as_kept(failed(case, result.error)))
                store.add(result)
                for word, of in counters.items():
                    counted[word] += of(result)
                seen(", ".join(f"{number} {word}" for word, number in counted.items()))
        return len(missing)

    @contextmanager
    def _stage(self, what: str, total: int, done: int = 0) -> Iterator[Callable[[str], None]]:
        began = time.perf_counter()
        task = self.progress.add_task(what, total=total, completed=done, said="")
        yield lambda said: self.progress.update(task, advance=1, said=said)
        self.seconds[what] = time.perf_counter() - began


@contextmanager
def runner(
    jobs: int,
    seconds: dict[str, float] | None = None,
    *,
    backend: str = "",
    address: str | None = None,
) -> Iterator[Runner]:
    """Lend a runner of a study's stages, which notes seconds of each; one job works in this very process."""
    chosen = backend or ("local" if jobs > 1 else "here")
    with workers(chosen, jobs, address) as crew, bars("{task.fields[said]}") as progress:
        yield Runner(crew, progress, {} if seconds is None else seconds)


def attempt(case: Case) -> Outcome:
    """Run a case; whatever goes wrong in it is part of the outcome."""
    began = time.perf_counter()
    try:
        tables, error = as_kept(case.run(*case.arguments)), ""
    except Exception:
        tables, error = {}, traceback.format_exc().strip()[-LONGEST_ERROR:]
    return Outcome(case.key, case.name, case.code, tables, error, time.perf_counter() - began)


def machine() -> str:
    """Versions, cores and architecture of this machine."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "mujoco", "gymnasium"))
    return (
        f"surefoot {surefoot.__version__}, Python {platform.python_version()}, {packages}; "
        f"{os.cpu_count()} cores, {platform.machine()}"
    )
