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

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from operator import itemgetter
from typing import Final, TypeAlias

import pyopencl as cl

from rhi.backends.cl.cache import strip_comments
from rhi.backends.cl.context import ClContext
from rhi.backends.cl.held_programs import HeldProgram
from rhi.backends.cl.pools import Addresses
from rhi.backends.cl.programs import FaultBuffer, make_shader_error
from rhi.backends.cl.raster import merger, tables
from rhi.backends.cl.raster.builds import Builds, Kernel, Optimisation, Text, make_text
from rhi.backends.cl.raster.rows import FIXED_COLUMNS, SLOT_COLUMNS
from rhi.contract.descriptors import BindingKind, ProgramDescriptor, Stage, StageText, VertexStream

__rhi_internal__ = True

LANGUAGE: Final = "opencl16"
_RASTER: Final = "raster"
_BOXED: Final = "#define RHI_BOXED"

StreamLayout: TypeAlias = tuple[tuple[int, bool, tuple[object, ...]], ...]
"""Stride, rate (whether per instance) and attributes of each vertex stream."""


class GeometryKernels:
    """The kernels that all programs share."""

    def __init__(self, builds: Builds) -> None:
        texts = map(read_kernels, ("common", "triangles", "polygon", "setup", "bin"))
        source = tables.common_macros() + "".join(texts)
        self.set_up, self.prefix, self.scatter = builds.build(make_text(source, ("set_up", "prefix", "scatter")))


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
        self._general_raster: HeldProgram | None = None
        self._optimisations: dict[merger.MergerKey, Optimisation] = {}  # of kernels that no draw has needed yet

    def find_vertex(self, streams: Sequence[VertexStream]) -> VertexKernels:
        """Return the kernels for vertices of this layout, building them on first use."""
        layout = tuple((stream.stride, stream.per_instance, stream.attributes) for stream in streams)
        if layout not in self._vertex:
            text, faults = self._vertex_text, self._fault_places[Stage.VERTEX]
            macros = tables.vertex_macros(self.descriptor, streams, faults)
            source = "\n".join(
                (tables.common_macros(), read_kernels("common"), text.text, macros, read_kernels("vertex"))
            )
            names = "transform", *(["measure"] if _BOXED in text.text else [])
            whole = make_text(source, names, self.descriptor.flushes_denormals)
            kernels = self._build(Stage.VERTEX, whole, text)
            self._vertex[layout] = VertexKernels(*kernels)
        return self._vertex[layout]

    def find_raster(self, key: merger.MergerKey) -> Kernel:
        """Return the raster kernel for targets and states with this key.

        It is at first a general one, which is built on first use and serves all keys. A kernel that is in the cache or
        built for this key replaces it.
        """
        if key not in self._raster:
            optimisation = self._optimisations.pop(key, None)
            text = self._fragment_text if key.shades else StageText("")
            special = self._assemble_raster(text, key.defines(), key.shades, key.stages_depth, key.bounds_depth)
            if optimisation is not None and optimisation.program is not None:
                self._raster[key] = Kernel(optimisation.program, _RASTER)
            elif self._builds.is_quick and not self._builds.is_cached(special):
                optimisation = optimisation or self._builds.optimise(special)
                self._raster[key] = Kernel(self._general(key.output_words), _RASTER, optimisation)
            else:
                (self._raster[key],) = self._build(Stage.FRAGMENT, special, text)
        return self._raster[key]

    def optimise_raster(self, key: merger.MergerKey) -> Future[None] | None:
        """Begin to build the raster kernel for this key; return the end of that, or None if there is nothing to do."""
        if key in self._raster:
            return self._raster[key].optimise()
        if not self._builds.is_quick:
            self.find_raster(key)
            return None
        if key not in self._optimisations:
            text = self._fragment_text if key.shades else StageText("")
            special = self._assemble_raster(text, key.defines(), key.shades, key.stages_depth, key.bounds_depth)
            self._optimisations[key] = self._builds.optimise(special)
        return self._optimisations[key].begin()

    def _general(self, output_words: int) -> HeldProgram:
        """Return the raster kernel for all keys, building it on first use."""
        if self._general_raster is None:
            text, shades = self._fragment_text, Stage.FRAGMENT in self.descriptor.stages
            general = self._assemble_raster(text, merger.general_defines(output_words), shades, False, False)
            with self._locating_errors(Stage.FRAGMENT, general, text):
                self._general_raster = self._builds.compile(general, quick=True)
        return self._general_raster

    def _assemble_raster(
        self, text: StageText, defines: str, fragment: bool, stages_depth: bool, bounds_depth: bool
    ) -> Text:  # fmt: skip
        macros = tables.raster_macros(
            self.descriptor, fragment, stages_depth, bounds_depth, self._fault_places[Stage.FRAGMENT]
        )
        parts = (
            tables.common_macros(), *map(read_kernels, ("common", "triangles", "polygon")), defines,
            merger.read_source(), text.text, macros, read_kernels("raster"),
        )  # fmt: skip
        return make_text("\n".join(parts), (_RASTER,), self.descriptor.flushes_denormals)

    def _build(self, stage: Stage, kernels: Text, text: StageText) -> list[Kernel]:
        """Build kernels that contain the stage's text."""
        with self._locating_errors(stage, kernels, text):
            return self._builds.build(kernels)

    @contextmanager
    def _locating_errors(self, stage: Stage, kernels: Text, text: StageText) -> Iterator[None]:
        """Raise what the driver says of kernels as errors of the stage's text, which they contain."""
        try:
            yield
        except cl.Error as error:
            lines = kernels.source[: kernels.source.index(text.text)].count("\n")
            whole = StageText(kernels.source, (*[("", 0)] * lines, *text.origins))
            raise make_shader_error(self.descriptor, stage, whole, str(error)) from error


@cache
def read_kernels(name: str) -> str:
    """Return the text of a file in kernels/, without comments."""
    return strip_comments(files(__package__).joinpath("kernels", f"{name}.cl").read_text())
