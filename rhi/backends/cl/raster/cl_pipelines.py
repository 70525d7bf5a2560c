"""The kernels that draw, built on first use.

- `set_up`, `prefix` and `scatter` don't depend on programs and are built once per device. A program has a
  vertex kernel for each layout of its vertices and a raster kernel for each `MergerKey`. All else is data, so
  few kernels are built.
- A program whose positions can be bounded before they are computed also has the kernel `measure` for each
  vertex layout (kernels/vertex.cl).
- Each kernel takes one argument, the address of a batch table.
- Compiled kernels are cached on disk by PoCL, or by pyopencl for other drivers, under a key of source,
  options, device and driver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Final, TypeAlias

import pyopencl as cl

from rhi.backends.cl.builds import Builds, Kernel, Launch, Optimisation
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_programs import FaultBuffer, make_shader_error
from rhi.backends.cl.memory.planes import buffer_address
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.backends.cl.pocl.program_residency import EvictableProgram
from rhi.backends.cl.raster import kernel_structs, merger
from rhi.backends.cl.raster.draw_columns import FIXED_COLUMNS, SLOT_COLUMNS
from rhi.backends.cl.raster.general_raster import (
    POLYGONS,
    RASTER,
    RASTER_FILES,
    STAGE,
    STAGE_FILES,
    GeneralRaster,
)
from rhi.backends.cl.raster.kernel_text import read_kernels
from rhi.contract.descriptors import BindingKind, ProgramDescriptor, Stage, StageText, VertexStream
from rhi.shading.opencl.opencl_textures import call_textures, texture_function

LANGUAGE: Final = "opencl16"
_BOXED: Final = "#define RHI_BOXED"

StreamLayout: TypeAlias = tuple[tuple[int, bool, tuple[object, ...]], ...]
"""Stride, rate (whether per instance) and attributes of each vertex stream."""


def request_geometry(builds: Builds) -> tuple[Request, Launch]:
    """Return the request for the kernels that all programs share, and a launch of them."""
    source = kernel_structs.common_structs() + "".join(map(read_kernels, (*POLYGONS, "setup", "bin")))
    request = builds.request(source, ("set_up", "prefix", "scatter"))
    return request, _launch(request)


class GeometryKernels:
    """The kernels that all programs share."""

    def __init__(self, builds: Builds) -> None:
        self.set_up, self.prefix, self.scatter = builds.build(*request_geometry(builds))


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
        elements: for each storage binding, the offset of its size behind the fixed columns, and the size of
            an element.
        written: the bindings that the program writes.
        faults: for a checked program, the memory that each stage reports faults in. Its address is part of
            the kernels' source.
        stage_address: the address of the fragment stage, once the shared raster kernel calls it; else 0.
    """

    def __init__(
        self, context: ClContext, builds: Builds, shared: GeneralRaster, descriptor: ProgramDescriptor
    ) -> None:
        """`shared`: the raster kernels that programs share until their own are optimised."""
        self._builds = builds
        self._shared = shared
        self.stage_address = 0
        self.descriptor = descriptor
        self.starts = kernel_structs.binding_offsets(descriptor.bindings)
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
        self._fault_addresses = dict.fromkeys(Stage, 0)
        for stage in descriptor.stages if descriptor.checked else ():
            text = self._vertex_text if stage is Stage.VERTEX else self._fragment_text
            self.faults[stage] = FaultBuffer(context.context, text.origins)
            self._fault_addresses[stage] = buffer_address(self.faults[stage].memory)
        self._vertex: dict[StreamLayout, VertexKernels] = {}
        self._raster: dict[merger.MergerKey, Kernel] = {}
        self._general_raster: EvictableProgram | None = None
        self._optimisations: dict[
            merger.MergerKey, Optimisation
        ] = {}  # of kernels that no draw has needed yet

    def get_vertex_kernels(self, streams: Sequence[VertexStream]) -> VertexKernels:
        """Return the kernels for vertices of this layout, building them on first use."""
        layout = tuple((stream.stride, stream.per_instance, stream.attributes) for stream in streams)
        if layout not in self._vertex:
            first = next((line for line, origin in enumerate(self._vertex_text.origins, 1) if origin[0]), 1)
            macros = kernel_structs.vertex_macros(
                self.descriptor, streams, self._fault_addresses[Stage.VERTEX], first
            )
            names = "transform", *(["measure"] if _BOXED in self._vertex_text.text else [])
            request = self._assemble(read_kernels("common"), self._vertex_text, macros, ("vertex",), names)
            with self._locating_errors(Stage.VERTEX, request, self._vertex_text):
                self._vertex[layout] = VertexKernels(*self._builds.build(request, _launch(request)))
        return self._vertex[layout]

    def get_raster_kernel(self, key: merger.MergerKey) -> Kernel:
        """Return the raster kernel for targets and states with this key.

        It is at first a general one, which is built on first use and serves all keys. A kernel that is in the
        cache or built for this key replaces it.
        """
        if key not in self._raster:
            optimisation = self._optimisations.pop(key, None)
            special, text = self._assemble_raster(key, key.defines())
            if optimisation is not None and optimisation.program is not None:
                self._raster[key] = Kernel(optimisation.program, RASTER)
            elif self._builds.is_quick and not self._builds.is_cached(special, _launch(special)):
                optimisation = optimisation or self._optimise(special)
                self._raster[key] = Kernel(self._general(key.output_words), RASTER, optimisation)
            else:
                with self._locating_errors(Stage.FRAGMENT, special, text):
                    (self._raster[key],) = self._builds.build(special, _launch(special))
        return self._raster[key]

    def optimise_raster(self, key: merger.MergerKey) -> Future[None] | None:
        """Begin to build the raster kernel for this key; return a future of the end, or None if there is
        nothing to do."""
        if key in self._raster:
            return self._raster[key].optimise()
        if not self._builds.is_quick:
            self.get_raster_kernel(key)
            return None
        if key not in self._optimisations:
            self._optimisations[key] = self._optimise(self._assemble_raster(key, key.defines())[0])
        return self._optimisations[key].begin()

    def _optimise(self, request: Request) -> Optimisation:
        """Return a build of optimised kernels, which hasn't begun."""
        return Optimisation(request, _launch(request), self._builds)

    def _general(self, output_words: int) -> EvictableProgram:
        """Return the raster kernel for all keys, building it on first use."""
        if self._general_raster is None:
            self._general_raster = self._share()
        if self._general_raster is None:
            general, text = self._assemble_raster(None, merger.general_defines(output_words))
            with self._locating_errors(Stage.FRAGMENT, general, text):
                self._general_raster = self._builds.compile(general, quick=True)
        return self._general_raster

    def _share(self) -> EvictableProgram | None:
        """Build the fragment stage, and return the raster kernel that calls it; None if it can't be called."""
        if not self._shared.calls_stages:
            return None
        if Stage.FRAGMENT in self.descriptor.stages:
            request, text = self._assemble_stage()
            with self._locating_errors(Stage.FRAGMENT, request, text):
                self.stage_address = self._shared.load_function(request)
            if not self.stage_address:
                return None
        return self._shared.get_program(self.descriptor.flushes_denormals)

    def _assemble_stage(self) -> tuple[Request, StageText]:
        """Return the request for the fragment stage alone, and its text, which calls the functions that sample."""
        macros = kernel_structs.stage_macros(self.descriptor, self._fault_addresses[Stage.FRAGMENT])
        text = self._fragment_text
        function = texture_function(text.text) if text.generated else None
        if function is not None and self._shared.load_texture_function(function):
            text = replace(text, text=call_textures(text.text, function))
        return self._assemble(read_kernels("common"), text, macros, STAGE_FILES, (STAGE,)), text

    def _assemble_raster(self, key: merger.MergerKey | None, defines: str) -> tuple[Request, StageText]:
        """Return the raster kernel for a key, or for all of them, and the text of the stage in it."""
        shades = Stage.FRAGMENT in self.descriptor.stages if key is None else key.shades
        text = self._fragment_text if shades else StageText("")
        caches_depth, bounds_depth = (key.caches_depth, key.bounds_depth) if key else (False, False)
        faults = self._fault_addresses[Stage.FRAGMENT]
        macros = kernel_structs.raster_macros(self.descriptor, shades, caches_depth, bounds_depth, faults)
        before = "\n".join((*map(read_kernels, POLYGONS), defines, read_kernels("merger")))
        return self._assemble(before, text, macros, RASTER_FILES, (RASTER,)), text

    def _assemble(
        self, before: str, text: StageText, macros: str, files: Sequence[str], names: Sequence[str]
    ) -> Request:
        """Return the request for the kernels of some files, behind a stage's text and its preamble."""
        kernels = "\n".join(map(read_kernels, files))
        source = "\n".join((kernel_structs.common_structs(), before, text.text, macros, kernels))
        return self._builds.request(source, names, self.descriptor.flushes_denormals)

    @contextmanager
    def _locating_errors(self, stage: Stage, kernels: Request, text: StageText) -> Iterator[None]:
        """Raise the driver's errors as `ShaderError`s at lines of the stage's text, which the kernels
        contain."""
        try:
            yield
        except cl.Error as error:
            lines = kernels.source[: kernels.source.index(text.text)].count("\n")
            whole = StageText(kernels.source, (*[("", 0)] * lines, *text.origins))
            raise make_shader_error(self.descriptor, stage, whole, str(error)) from error


def _launch(request: Request) -> Launch:
    return Launch(request.kernels, (kernel_structs.EMPTY_TABLE,))
