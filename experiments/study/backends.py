"""Who does the work: processes of this machine, or a cluster of dask or ray, all through joblib.

A worker that dies is reported with the task that it may have died of, and costs nothing else:

* loky breaks all of its processes with one, so that whatever was under way is suspect;
* dask says which task its worker died of, and brings up another worker;
* ray's pool goes on handing work to the dead, so that it is left, and a fresh one is taken.

joblib's dask backend never reports a task whose worker died, and its ray backend hands results out only when
all are there; the two subclasses below add just that.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from joblib import Parallel, delayed, parallel_config

__all__ = ["BACKENDS", "Died", "Task", "Workers", "workers"]

BACKENDS = ("local", "dask", "ray", "here")
"""Processes of this machine, two clusters, and this very process: for debuggers, where a crash ends all."""

IDLE_TIMEOUT = 20.0
"""Time in s after which a local worker that has nothing to do leaves; another comes when there is work."""

Task = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and what to give it; both must survive pickling."""

_DEATHS = ("BrokenExecutor", "KilledWorker", "RayActorError", "WorkerCrashedError", "OutOfMemoryError")


@dataclass(frozen=True)
class Died:
    """A worker died.

    Attributes:
        tasks: Numbers of the tasks that it may have died of.
        reason: What is known about it.
        broken: Whether nothing more comes from the same workers.
    """

    tasks: tuple[int, ...]
    reason: str
    broken: bool


@dataclass(frozen=True)
class Workers:
    """Somebody to work.

    Attributes:
        backend: One of :data:`BACKENDS`.
        under_way: How many tasks are handed out at the same time.
    """

    backend: str
    under_way: int = 1

    def results(self, tasks: Mapping[int, Task]) -> Iterator[tuple[int, Any]]:
        """Do tasks until each has a result, in any order, whoever dies of them.

        A task that a worker may have died of is done by itself; if that kills its worker too, its result is
        :class:`Died`.

        Args:
            tasks: Tasks by number.

        Yields:
            The number of a task and its result.
        """
        pending = dict(tasks)
        while pending:
            suspects: set[int] = set()
            for number, result in self._stream(dict(pending)):
                if isinstance(result, Died):
                    suspects.update(result.tasks)
                else:
                    del pending[number]
                    yield number, result
            for suspect in sorted(suspects & pending.keys()):
                for _, result in self._stream({suspect: pending.pop(suspect)}, at_once=1):
                    yield suspect, result

    def _stream(self, tasks: Mapping[int, Task], at_once: int | None = None) -> Iterator[tuple[int, Any]]:
        handed_out: set[int] = set()

        def work() -> Iterator[Any]:
            for number, task in tasks.items():
                handed_out.add(number)
                yield delayed(_done)(number, *task)

        results: Any = None
        try:
            before = at_once or self.under_way
            parallel = Parallel(batch_size=1, pre_dispatch=before, return_as="generator_unordered")
            results = parallel(work())
            for number, result in results:
                if not isinstance(result, Died):
                    handed_out.discard(number)
                yield number, result
                if isinstance(result, Died) and result.broken:
                    return
        except Exception as error:
            if not _is_death(error):
                raise
            yield -1, Died(tuple(sorted(handed_out)), _reason(error), broken=True)
        finally:
            if results is not None:
                results.close()


def _done(number: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return number, function(*arguments)


@contextmanager
def workers(backend: str, jobs: int, address: str | None = None) -> Iterator[Workers]:
    """Bring up workers.

    Args:
        backend: One of :data:`BACKENDS`.
        jobs: How many, on this machine.
        address: Of a running scheduler of dask or head of ray; then its workers do it, however many.

    Raises:
        ValueError: If there is no such backend, or what it needs is not installed or not reached.
    """
    if backend not in BACKENDS:
        raise ValueError(f"There is no backend '{backend}'. Available: {', '.join(map(repr, BACKENDS))}.")
    if jobs < 1:
        raise ValueError(f"'jobs' must be at least 1, got {jobs}.")
    if address is not None and backend not in ("dask", "ray"):
        raise ValueError(f"Only dask and ray have an address; backend is '{backend}'.")
    if backend == "here":
        with parallel_config(backend="sequential"):
            yield Workers(backend)
    elif backend == "local":
        # joblib would work in this process if there were one job: then a crash would end the study. Workers
        # of a process that was killed do not know of it: they leave once they have been idle for a while.
        loky: dict[str, Any] = {"inner_max_num_threads": 1, "idle_worker_timeout": IDLE_TIMEOUT}
        with warnings.catch_warnings(), parallel_config(backend="loky", n_jobs=max(jobs, 2), **loky):
            warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
            yield Workers(backend, jobs)
    elif backend == "dask":
        with _dask(jobs, address) as client, parallel_config(backend=_dask_backend(client), n_jobs=-1):
            # A queue of two for each keeps workers busy that are far away.
            yield Workers(backend, jobs if address is None else 2 * sum(client.ncores().values()))
    else:
        with _ray(jobs, address) as count, parallel_config(backend=_ray_backend(), n_jobs=max(count, 2)):
            yield Workers(backend, count)


@contextmanager
def _dask(jobs: int, address: str | None) -> Iterator[Any]:
    dask, distributed = _module("dask"), _module("distributed", "dask[distributed]")
    if address is not None:
        with _reached("dask", address), distributed.Client(address) as client:
            yield client
        return
    # A task whose worker dies is tried again by itself, by us: dask need not.
    settings = {"distributed.scheduler.allowed-failures": 0}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=jobs, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@contextmanager
def _ray(jobs: int, address: str | None) -> Iterator[int]:
    ray = _module("ray")
    ours = not ray.is_initialized()
    if ours:
        local = {"num_cpus": max(jobs, 2), "include_dashboard": False, "object_store_memory": 100_000_000}
        # Results are small; by default ray takes a third of the memory for what it moves about.
        options = {"address": "local", **local} if address is None else {"address": address}
        with _reached("ray", address):
            ray.init(log_to_driver=False, logging_level="ERROR", **options)
    try:
        count = jobs if address is None else int(ray.cluster_resources().get("CPU", 0))
        if address is not None and count < 2:
            raise ValueError(f"The ray cluster at {address} has {count} CPUs; at least 2 are needed.")
        yield count
    finally:
        if ours:
            ray.shutdown()


def _dask_backend(client: Any) -> Any:
    base: Any = import_module("joblib._dask").DaskDistributedBackend

    class Dask(base):  # type: ignore[misc]
        def effective_n_jobs(self, n_jobs: int) -> int:
            # While but one worker is up joblib would work in this process, which must not die of a task.
            return max(int(super().effective_n_jobs(n_jobs)), 2)

        def submit(self, func: Any, callback: Any = None) -> Any:
            future = super().submit(func, callback)

            def done(finished: Any) -> None:
                error = finished.exception()
                if error is not None and callback is not None:
                    callback(_Failure(func, error))

            future.add_done_callback(done)
            return future

        def retrieve_result_callback(self, out: Any) -> Any:
            if isinstance(out, _Failure):
                return out.outcome(broken=False)
            return super().retrieve_result_callback(out)

    return Dask(client=client)


def _ray_backend() -> Any:
    base: Any = import_module("ray.util.joblib.ray_backend").RayBackend

    class Ray(base):  # type: ignore[misc]
        supports_return_generator = True

        def submit(self, func: Any, callback: Any = None) -> Any:
            def named(out: Any) -> None:
                callback(_Failure(func, out) if isinstance(out, BaseException) else out)

            return super().submit(func, None if callback is None else named)

        def retrieve_result_callback(self, out: Any) -> Any:
            if isinstance(out, _Failure):
                return out.outcome(broken=True)
            return super().retrieve_result_callback(out)

    return Ray()


@dataclass(frozen=True)
class _Failure:
    """A batch of one task that came to nothing."""

    batch: Any
    error: BaseException

    def outcome(self, *, broken: bool) -> list[tuple[int, Died]]:
        if not _is_death(self.error):
            raise self.error
        (_, (number, *_), _) = self.batch.items[0]
        return [(number, Died((number,), _reason(self.error), broken))]


@contextmanager
def _reached(name: str, address: str | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ValueError(f"No {name} cluster is reached at {address}: {error}.") from error


def _module(name: str, package: str | None = None) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ValueError(
            f"Backend '{name}' needs a package that is not installed: pip install '{package or name}'."
        ) from error


def _is_death(error: BaseException) -> bool:
    return any(kind.__name__ in _DEATHS for kind in type(error).__mro__)


def _reason(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:400]
