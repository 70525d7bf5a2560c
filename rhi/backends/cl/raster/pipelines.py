"""The kernels that draw: built when they are first needed, and kept.

- `set_up`, `prefix` and `scatter` know nothing of programs: one build per device. A program has a vertex kernel for
  each layout of its vertices, and a raster kernel for each `MergerKey`. All else is data, so few are built.
- Beside a vertex kernel lies `measure`, where positions can be bounded before they are computed (kernels/vertex.cl).
- Each takes one argument, the address of a batch, and is launched by `launch`.
- PoCL keeps what it compiled on disk, elsewhere pyopencl does, under a key of source, options, device and driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final

import pyopencl as cl

from rhi.backends.cl.context import ClContext
from rhi.backends.cl.pools import Addresses
from rhi.backends.cl.programs import FaultBuffer, make_shader_error
from rhi.backends.cl.raster import merger as targets
from rhi.backends.cl.raster import tables
from rhi.backends.cl.raster.builds import Builds, Kernel
from rhi.contract.descriptors import BindingKind, ProgramDescriptor, Stage, VertexStream

__rhi_internal__ = True

LANGUAGE: Final = "opencl16"
_BOXED: Final = "#define RHI_BOXED"

Layout = tuple[tuple[int, bool, tuple[object, ...]], ...]


class Geometry:
    """The kernels that all draws share."""

    def __init__(self, builds: Builds) -> None:
        source = tables.common_macros() + "".join(map(read_kernels, ("common", "polygon", "setup", "bin")))
        self.set_up, self.prefix, self.scatter = builds.build(source, ("set_up", "prefix", "scatter"))


@dataclass(frozen=True, slots=True, eq=False)
class VertexKernels:
    """What is done with vertices of one layout; `measure` where instances can be dropped by boxes."""

    transform: Kernel
    measure: Kernel | None = None


class Pipeline:
    """The kernels of one program that draws.

    Attributes:
        starts: where each binding's words begin in a draw's row, and where they end.
        elements: of what is bound by size, where in the row its bytes stand, and those of an element.
        faults: of a checked program, where each stage leaves what it finds. Their addresses stand in the kernels' text.
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
        self._vertex_text = descriptor.emit(LANGUAGE, Stage.VERTEX)
        self._fragment_text = ""
        if Stage.FRAGMENT in descriptor.stages:
            self._fragment_text = descriptor.emit(LANGUAGE, Stage.FRAGMENT)
        self.faults: dict[Stage, FaultBuffer] = {}
        self._fault_places = dict.fromkeys(Stage, 0)
        for stage in descriptor.stages if descriptor.checked else ():
            self.faults[stage] = FaultBuffer(context.context, descriptor.lines.get(stage, ()))
            self._fault_places[stage] = addresses.find(self.faults[stage].memory)
        self._vertex: dict[Layout, VertexKernels] = {}
        self._raster: dict[targets.MergerKey, Kernel] = {}

    def find_vertex(self, streams: Sequence[VertexStream]) -> VertexKernels:
        """The kernels for vertices of this layout."""
        layout = tuple((stream.stride, stream.per_instance, stream.attributes) for stream in streams)
        if layout not in self._vertex:
            before = [tables.common_macros(), read_kernels("common")]
            macros = tables.vertex_macros(self.descriptor, streams, self._fault_places[Stage.VERTEX])
            behind = [macros, read_kernels("vertex")]
            names = "transform", *(["measure"] if _BOXED in self._vertex_text else [])
            kernels = self._build(Stage.VERTEX, names, before, self._vertex_text, behind)
            self._vertex[layout] = VertexKernels(*kernels)
        return self._vertex[layout]

    def find_raster(self, key: targets.MergerKey) -> Kernel:
        """The kernel for targets and states of this key."""
        if key not in self._raster:
            before = [
                tables.common_macros(), read_kernels("common"), read_kernels("polygon"), key.defines(),
                targets.read_source(),
            ]  # fmt: skip
            macros = tables.raster_macros(self.descriptor, key, self._fault_places[Stage.FRAGMENT])
            behind = [macros, read_kernels("raster")]
            text = self._fragment_text if key.shades else ""
            (self._raster[key],) = self._build(Stage.FRAGMENT, ("raster",), before, text, behind)
        return self._raster[key]

    def _build(
        self, stage: Stage, names: Sequence[str], before: list[str], text: str, behind: list[str]
    ) -> list[Kernel]:
        """Kernels of the stage's text and what stands before and behind it."""
        source = "\n".join([*before, text, *behind])
        try:
            return self._builds.build(source, names, self.descriptor.flushes_denormals)
        except cl.Error as error:
            lines = "\n".join([*before, ""]).count("\n")
            raise make_shader_error(self.descriptor, stage, source, str(error), lines) from error


@cache
def read_kernels(name: str) -> str:
    """The text of a file in kernels/."""
    return files(__package__).joinpath("kernels", f"{name}.cl").read_text()
