"""A compute stage as the text of a Python module that runs on NumPy, and its launch over work-groups.

- `ProgramDescriptor.emit("numpy", Stage.COMPUTE)` gives the text, so that a backend can have it as it has GLSL.
- `NumpyKernel` runs it: many work-groups at a time, as many as hide Python's cost and stay in cache.
"""

from __future__ import annotations

import linecache
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from rhi.shading.ir.lanes import AddressSpace, Code
from rhi.shading.numpy import runtime as numpy_runtime
from rhi.shading.numpy.writer import write_numpy

__rhi_internal__ = True

Run = Callable[..., tuple[Any, ...]]

INVOCATIONS: Final = 1 << 18
"""How many invocations run together."""


def write_kernel(code: Code) -> str:
    """The module of a compute stage: `run`, and what its launch must know."""
    shared = {memory.name: memory.length for memory in code.memories if memory.space is AddressSpace.SHARED}
    head = [
        "import numpy as np",
        "from rhi.shading.numpy import runtime as R",
        "__rhi_internal__ = True",
        f"WORK_GROUP = {tuple(code.work_group)}",
        f"SHARED = {shared}",
    ]
    return "\n".join(head) + "\n" + write_numpy(code)


def load_module(text: str, name: str) -> dict[str, Any]:
    """The names of a module, with its lines in tracebacks."""
    file = f"<lanes of {name} {id(text)}>"
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)
    space: dict[str, Any] = {"np": np, "R": numpy_runtime, "__rhi_internal__": True}
    exec(compile(text, file, "exec"), space)
    return space


class NumpyKernel:
    """A compute stage that was written by `write_kernel`."""

    def __init__(self, text: str, name: str = "") -> None:
        space = load_module(text, name)
        self._run: Run = space["run"]
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
            memory: by the names of the bindings; of uniforms and storage their words, arrays of uint32 that are
                written in place, whose size says how many elements there are.
            dtype: of floats in variables and shared memory.
        """
        total, size = math.prod(groups), self._invocations
        chunk = max(1, INVOCATIONS // size)
        for first in range(0, total, chunk):
            count = min(chunk, total - first)
            places = numpy_runtime.Places(first, count, groups, size)
            shared = {name: np.zeros((count, length), np.uint64) for name, length in self._shared.items()}
            with np.errstate(all="ignore"):
                self._run(dtype, {**memory, **shared}, places, ())
