"""The headers in C as kernels of Warp: one robot is one thread, on the CPU or on a GPU; see docs/native.md.

Records are laid out by the compiler that makes the kernel, of the sizes and the precision that are asked
for: the table in the source of a library, compiled for the CPU, tells where their fields are.
"""

# Warp reads types of arguments that mypy does not know.
# mypy: disable-error-code="arg-type, no-untyped-def, untyped-decorator, valid-type"

import ctypes
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from surefoot.native import FOLDER, Library, places_at

ARRAYS = 9
"""Arrays that a kernel is given."""

WARP = 32
"""Threads of a block: one warp, so that a few thousand robots are spread over all multiprocessors."""

THREADS = 256
"""Threads of a large kernel that a GPU's multiprocessor runs at once: each takes 255 of 65,536 registers."""

Bytes = wp.array2d[wp.uint8]


class Kernel:
    """The work of one thread for one robot.

    Args:
        package: Whose source has the table of records: "calibration" or "sensors".
        headers: Those that are needed.
        body: The work for one robot, in C. It has its number ``robot``, ``worker``, the thread's, and
            what :meth:`launch` is given.
        fits: Functions of that source that say whether constants fit.
        sizes: Largest sizes, by their names without ``SF_``.
        single: Whether its numbers are floats rather than doubles.
    """

    library: Library  # where the fields of its records lie, and the functions
    layout: str  # the mark of this layout

    def __init__(
        self, package: str, headers: tuple[str, ...], body: str, fits: tuple[str, ...],
        sizes: tuple[tuple[str, int], ...], single: bool,
    ) -> None:  # fmt: skip
        wp.init()
        self._given = package, headers, body, fits, sizes, single
        lines = [f"#define SF_{name} {size}" for name, size in sizes] + ["#define SF_SINGLE"] * single
        lines.append('#include "device.h"')
        told = "surefoot_places()", "surefoot_places_count()", *fits
        tell = "".join(f"((size_t *)config.data)[{i}] = (size_t){one};" for i, one in enumerate(told))
        table = torch.zeros((1, len(told)), dtype=torch.int64, device="cpu")
        self._steps = _new_kernel(package, [*lines, f'#include "{package}.c"'], tell)
        self.launch(1, [table])
        first, count, *functions = table[0].tolist()
        kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
        callable_ = {name: kind(at) for name, at in zip(fits, functions, strict=True)}
        # They live as long as the module that holds them.
        library = SimpleNamespace(**callable_, kept=self._steps)
        places = places_at(first, count)
        self.library = Library(library, np.dtype("f4" if single else "f8"), places, {})
        self.layout = sha256(repr(places).encode()).hexdigest()[:16]
        self._steps = _new_kernel(package, [*lines, *(f'#include "{name}.h"' for name in headers)], body)

    def launch(
        self, robots: int, arrays: Sequence[Tensor], what: int = 0, rows: int = 0, count: int = 0,
        dt: float = 0.0, span: float = 0.0, workers: int | None = None,
    ) -> None:  # fmt: skip
        """Run it for all robots on the stream that torch uses.

        Nothing is copied, and nobody waits for the end on a GPU, so that it may be captured in a graph. Given
        are up to nine contiguous tensors on one device, a row a robot, or one for all, which in C are
        ``config``, ``state``, ``own``, ``given``, ``more``, ``found``, ``marks``, ``other`` and ``rest``;
        three whole numbers and two times in s; and how many threads share the robots, by default as many.
        """
        device = arrays[0].device
        shared = [wp.from_torch(array.view(torch.uint8).reshape(len(array), -1)) for array in arrays]
        shared += shared[:1] * (ARRAYS - len(shared))
        stream = wp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None
        workers = workers or robots
        inputs = [robots, workers, what, rows, count, dt, span, *shared]
        wp.launch(
            self._steps, workers, inputs, device=wp.device_from_torch(device), stream=stream, block_dim=WARP
        )

    @property
    def module(self) -> Any:
        """The kernel's module of Warp, to compile it ahead of time."""
        return self._steps.module

    def __reduce__(self) -> tuple[Any, ...]:
        return kernel, self._given


@cache
def kernel(*given: Any) -> Kernel:
    """Return a :class:`Kernel`, made once; its first launch compiles it, unless Warp's cache has it."""
    return Kernel(*given)


def threads_at_once(device: torch.device) -> int:
    """Return how many threads of a large kernel a device runs at once: on a CPU one after the other."""
    if device.type != "cuda":
        return 1
    return THREADS * torch.cuda.get_device_properties(device).multi_processor_count


def _new_kernel(package: str, lines: Sequence[str], body: str) -> Any:
    """Return a kernel of Warp in a module of its own; nothing is compiled yet."""

    @wp.func_native(body)
    def step(
        what: int, rows: int, count: int, dt: wp.float64, span: wp.float64, config: Bytes, state: Bytes,
        own: Bytes, given: Bytes, more: Bytes, found: Bytes, marks: Bytes, other: Bytes, rest: Bytes,
        robot: int, worker: int,
    ): ...  # fmt: skip

    def steps(
        robots: int, workers: int, what: int, rows: int, count: int, dt: wp.float64, span: wp.float64,
        config: Bytes, state: Bytes, own: Bytes, given: Bytes, more: Bytes, found: Bytes, marks: Bytes,
        other: Bytes, rest: Bytes,
    ):  # fmt: skip
        worker = wp.tid()
        for robot in range(worker, robots, workers):
            step(
                what, rows, count, dt, span, config, state, own, given, more, found, marks, other, rest,
                robot, worker,
            )  # fmt: skip

    preamble = "\n".join([*lines, ""])
    options = wp.ModuleBuildOptions(
        extra_cuda_include_dirs=[FOLDER],
        extra_cpu_include_dirs=[FOLDER],
        extra_cuda_preamble=preamble,
        extra_cpu_preamble=preamble,
        extra_build_dependencies=sorted(FOLDER.glob("*.[ch]")),
    )
    module = wp.get_module(f"surefoot_{package}_{sha256((preamble + body).encode()).hexdigest()[:12]}")
    level = wp.config.optimization_level
    chosen = {
        "extra_build_options": options,
        "enable_backward": False,
        "fuse_fp": False,  # a product and a sum are rounded one after the other, as everywhere
        "optimization_level": 3 if level is None else level,
        "cpu_compiler_flags": "-march=native",  # Warp's own flags inline all of it, which takes a minute
    }
    wp.set_module_options(chosen, module=module)
    return wp.kernel(steps, module=module, enable_backward=False)
