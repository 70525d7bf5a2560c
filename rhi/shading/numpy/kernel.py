"""Compute stages as Python modules that run on NumPy, and their launch over work-groups.

- `ProgramDescriptor.emit("numpy", Stage.COMPUTE)` returns the text of the module, so that a backend gets it
  in the same way as GLSL.
- `NumpyKernel` runs it on many work-groups at a time: enough to hide Python's overhead, few enough to stay in
  cache.
"""

from __future__ import annotations

import itertools
import linecache
import math
import weakref
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from rhi.shading.ir.lanes import AddressSpace, Code
from rhi.shading.numpy import runtime as numpy_runtime
from rhi.shading.numpy.numpy_writer import write_numpy_function

LaneFunction = Callable[..., tuple[Any, ...]]
"""A `run(F, M, P, arguments)` that `rhi.shading.numpy.numpy_writer` has written."""

INVOCATIONS: Final = 1 << 18
"""Number of invocations that run together."""

_NUMBERS: Final = itertools.count()


def write_numpy_kernel(code: Code) -> str:
    """Return the text of a compute stage's module: `run`, `WORK_GROUP` and `SHARED`, the lengths of shared
    arrays."""
    shared = {memory.name: memory.length for memory in code.memories if memory.space is AddressSpace.SHARED}
    head = [
        "import numpy as np",
        "from rhi.shading.numpy import runtime as R",
        "__rhi_internal__ = True",
        f"WORK_GROUP = {tuple(code.work_group)}",
        f"SHARED = {shared}",
    ]
    return "\n".join(head) + "\n" + write_numpy_function(code)


def load_module(text: str, name: str) -> dict[str, Any]:
    """Execute the text of a module and return its names; tracebacks show its lines."""
    file = f"<lanes of {name} {next(_NUMBERS)}>"
    space: dict[str, Any] = {"np": np, "R": numpy_runtime, "__rhi_internal__": True}
    exec(compile(text, file, "exec"), space)
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)
    weakref.finalize(space["run"], linecache.cache.pop, file, None).atexit = False
    return space


class NumpyKernel:
    """A compute stage loaded from the text that `write_numpy_kernel` returns."""

    def __init__(self, text: str, name: str = "") -> None:
        space = load_module(text, name)
        self._run: LaneFunction = space["run"]
        self._shared: dict[str, int] = space["SHARED"]
        self._invocations = math.prod(space["WORK_GROUP"])

    def launch(
        self,
        groups: tuple[int, int, int],
        memory: Mapping[str, Any],
        dtype: type[np.float32] | type[np.float64] = np.float32,
    ) -> None:
        """Run work-groups.

        Args:
            groups: the number of work-groups along each axis.
            memory: by the names of the bindings a uint32 array of words for uniforms and storage, which is
                written in place and whose size gives the number of elements, or a `HostTexture`.
            dtype: the type of floats in variables and shared memory.
        """
        total, size = math.prod(groups), self._invocations
        chunk = max(1, INVOCATIONS // size)
        for first in range(0, total, chunk):
            count = min(chunk, total - first)
            running = numpy_runtime.WorkGroups(first, count, groups, size)
            shared = {name: np.zeros((count, length), np.uint64) for name, length in self._shared.items()}
            with np.errstate(all="ignore"):
                self._run(dtype, {**memory, **shared}, running, ())
