"""The kernels that draw, built on first use.

- `set_up`, `prefix` and `scatter` don't depend on programs and are built once per device. A program has a vertex kernel
  for each layout of its vertices and a raster kernel for each `MergerKey`. All else is data, so few kernels are built.
- A program whose positions can be bounded before they are computed also has the kernel `measure` for each vertex layout
  (kernels/vertex.cl).
- Each kernel takes one argument, the address of a batch table.
- Compiled kernels are cached on disk by PoCL, or by pyopencl for other drivers, under a key of source, options, device
  and driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from operator import itemgetter
from typing import Final, TypeAlias

import pyopencl as cl

from rhi.backends.cl.context import ClContext
from rhi.backends.cl.pools import Addresses
from rhi.backends.cl.programs import FaultBuffer, make_shader_error
from rhi.backends.cl.raster import merger, tables
from rhi.backends.cl.raster.builds import Builds, Kernel
from rhi.backends.cl.raster.rows import FIXED_COLUMNS, SLOT_COLUMNS
from rhi.contract.descriptors import BindingKind, ProgramDescriptor, Stage, StageText, VertexStream

__rhi_internal__ = True

LANGUAGE: Final = "opencl16"
_BOXED: Final = "#define RHI_BOXED"

StreamLayout: TypeAlias = tuple[tuple[int, bool, tuple[object, ...]], ...]
"""Stride, rate (whether per instance) and attributes of each vertex stream."""


class GeometryKernels:
    """The kernels that all programs share."""

    def __init__(self, builds: Builds) -> None:
        texts = map(read_kernels, ("common", "triangles", "polygon", "setup", "bin"))
        source = tables.common_macros() + "".join(texts)
        self.set_up, self.prefix, self.scatter = builds.build(source, ("set_up", "prefix", "scatter"))


@dataclass(frozen=True, slots=True, eq=False)
class VertexKernels:
    """The kernels for vertices of one layout; `measure` is None if positions can't be bounded."""

    transform: Kernel
    measure: Kernel | None = None


class Pipeline:
    """A program that draws, and its kernels.

    Attributes:
        pick: picks a draw's row out of the columns of all slots.
        starts: offset of each binding's words behind a row's fixed columns, and at the end their total.
        elements: for each storage binding, the offset of its size behind the fixed columns, and the size of an element.
        written: the bindings that the program writes.
        faults: for a checked program, the memory that each stage reports faults in. Its address is part of the kernels'
            source.
    """

    def __init__(
        self, context: ClContext, builds: Builds, descriptor: ProgramDescriptor, addresses: Addresses
    ) -> None:
        self._builds = builds
        self.descriptor = descriptor
        self.starts = tables.row_starts(descriptor.bindings)
        self.elements = [
            (at + 1, max(1, binding.size))
            for binding, at in zip(descriptor.bindings, self.starts, strict=False)
            if binding.kind is BindingKind.STORAGE
        ]
        columns = list(range(FIXED_COLUMNS))
        for binding in descriptor.bindings:
            start = SLOT_COLUMNS[binding.kind, binding.slot]
            columns += [start] if binding.kind is BindingKind.UNIFORM else [start, start + 1]
        self.pick = itemgetter(*columns)
        self.written = [binding for binding in descriptor.bindings if binding.writes]
        self._vertex_text = descriptor.emit(LANGUAGE, Stage.VERTEX)
        self._fragment_text = StageText("")
        if Stage.FRAGMENT in descriptor.stages:
            self._fragment_text = descriptor.emit(LANGUAGE, Stage.FRAGMENT)
        self.faults: dict[Stage, FaultBuffer] = {}
        self._fault_places = dict.fromkeys(Stage, 0)
        for stage in descriptor.stages if descriptor.checked else ():
            text = self._vertex_text if stage is Stage.VERTEX else self._fragment_text
            self.faults[stage] = FaultBuffer(context.context, text.origins)
            self._fault_places[stage] = addresses.find(self.faults[stage].memory)
        self._vertex: dict[StreamLayout, VertexKernels] = {}
        self._raster: dict[merger.MergerKey, Kernel] = {}

    def find_vertex(self, streams: Sequence[VertexStream]) -> VertexKernels:
        """Return the kernels for vertices of this layout, building them on first use."""
        layout = tuple((stream.stride, stream.per_instance, stream.attributes) for stream in streams)
        if layout not in self._vertex:
            before = [tables.common_macros(), read_kernels("common")]
            macros = tables.vertex_macros(self.descriptor, streams, self._fault_places[Stage.VERTEX])
            behind = [macros, read_kernels("vertex")]
            names = "transform", *(["measure"] if _BOXED in self._vertex_text.text else [])
            kernels = self._build(Stage.VERTEX, names, before, self._vertex_text, behind)
            self._vertex[layout] = VertexKernels(*kernels)
        return self._vertex[layout]

    def find_raster(self, key: merger.MergerKey) -> Kernel:
        """Return the raster kernel for targets and states with this key, building it on first use."""
        if key not in self._raster:
            before = [
                tables.common_macros(), *map(read_kernels, ("common", "triangles", "polygon")), key.defines(),
                merger.read_source(),
            ]  # fmt: skip
            macros = tables.raster_macros(self.descriptor, key, self._fault_places[Stage.FRAGMENT])
            behind = [macros, read_kernels("raster")]
            text = self._fragment_text if key.shades else StageText("")
            (self._raster[key],) = self._build(Stage.FRAGMENT, ("raster",), before, text, behind)
        return self._raster[key]

    def _build(
        self, stage: Stage, names: Sequence[str], before: list[str], text: StageText, behind: list[str]
    ) -> list[Kernel]:
        """Build kernels from the stage's text, and the text before and behind it."""
        source = "\n".join([*before, text.text, *behind])
        try:
            return self._builds.build(source, names, self.descriptor.flushes_denormals)
        except cl.Error as error:
            lines = "\n".join([*before, ""]).count("\n")
            whole = StageText(source, (*[("", 0)] * lines, *text.origins))
            raise make_shader_error(self.descriptor, stage, whole, str(error)) from error


@cache
def read_kernels(name: str) -> str:
    """Return the text of a file in kernels/."""
    return files(__package__).joinpath("kernels", f"{name}.cl").read_text()
