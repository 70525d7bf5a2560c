"""Compute programs: the NumPy code that the shading language emits, run on the bound ranges of buffers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract import BindingKind, Id, ProgramDescriptor, Stage
from rhi.shading import NumpyKernel

__rhi_internal__ = True


class Program:
    """A compute stage and its bindings."""

    def __init__(self, descriptor: ProgramDescriptor) -> None:
        self._kernel = NumpyKernel(descriptor.emit("numpy", Stage.COMPUTE).text, descriptor.name)
        self._bindings = descriptor.bindings

    def launch(
        self,
        groups: tuple[int, int, int],
        buffers: Mapping[Id, NDArray[np.uint8]],
        ranges: Mapping[tuple[BindingKind, int], tuple[Id, int, int]],
    ) -> None:
        """Run work-groups on the bound ranges."""
        memory: dict[str, Any] = {}
        for binding in self._bindings:
            buffer, offset, size = ranges[binding.kind, binding.slot]
            memory[binding.name] = buffers[buffer][offset : offset + size].view(np.uint32)
        self._kernel.launch(groups, memory)
