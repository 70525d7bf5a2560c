"""Executes shaders on request: compute shaders on NumPy, and stand-ins for programs.

- The NumPy source of a compute stage (`ProgramDescriptor.emit`) is executed on the bound memory, in the order
  of the commands.
- Nothing is rasterised, so fragment stages never run. What fragments write to memory depends on what is
  visible, and only the caller knows that. So the caller provides a *stand-in*: a function that is called in
  place of a program, for each of its draws and dispatches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.backends.null.execution import ExecutionState
from rhi.backends.null.null_buffers import Buffers
from rhi.backends.null.null_draws import Draw
from rhi.backends.null.null_textures import Textures
from rhi.contract.descriptors import Binding, BindingKind, Id, ProgramDescriptor, SamplerDescriptor, Stage
from rhi.contract.layout import Layout, dtype_of, element_dtype

StandIn: TypeAlias = Callable[[Mapping[str, Any], Draw | None], object]
"""A function called in place of a program, with the bound resources by name, and the draw (None for a
dispatch). Storage is an array of its elements (n,), a uniform an array of one element. Both are the memory
itself, to be read and written. Textures and images are `HostTexture`s."""


class Shaders:
    """Executes the shaders of a device: none, until `run` is called.

    Attributes:
        stand_ins: the stand-ins, by program.
        runs: whether dispatches do anything.
    """

    def __init__(self, buffers: Buffers, textures: Textures, state: ExecutionState) -> None:
        self.stand_ins: Mapping[Id, StandIn] = {}
        self.runs = False
        self._buffers = buffers
        self._textures = textures
        self._state = state
        self._kernels: dict[ProgramDescriptor, Any] = {}

    def run(self, stand_ins: Mapping[Id, StandIn]) -> None:
        """Execute dispatches from now on, with these stand-ins."""
        self.runs = True
        self.stand_ins = dict(stand_ins)

    def draw(self, draw: Draw) -> None:
        """Call the stand-in of the draw's program, which must have one."""
        self.stand_ins[draw.program](self._bound(draw.program), draw)

    def dispatch(self, groups: tuple[int, int, int]) -> None:
        """Execute work-groups of the bound program, or call its stand-in."""
        program = self._state.program
        if program in self.stand_ins:
            self.stand_ins[program](self._bound(program), None)
        elif self.runs and 0 not in groups:
            memory = {
                name: bound.reshape(-1).view(np.uint32) if isinstance(bound, np.ndarray) else bound
                for name, bound in self._bound(program).items()
            }
            self._kernel(self._state.get(program, ProgramDescriptor)).launch(groups, memory)

    def _kernel(self, descriptor: ProgramDescriptor) -> Any:
        kernel = self._kernels.get(descriptor)
        if kernel is None:
            from rhi.shading.numpy.kernel import NumpyKernel

            text = descriptor.emit("numpy", Stage.COMPUTE).text
            kernel = self._kernels[descriptor] = NumpyKernel(text, descriptor.name)
        return kernel

    def _bound(self, program: Id) -> dict[str, Any]:
        bindings = self._state.get(program, ProgramDescriptor).bindings
        return {binding.name: self._bound_value(binding) for binding in bindings}

    def _bound_value(self, binding: Binding) -> Any:
        name, *location = self._state.slots[binding.kind, binding.slot]
        if binding.kind is BindingKind.TEXTURE:
            return self._texture(binding, name, location[0])
        if binding.kind is BindingKind.IMAGE:
            return self._image(binding, name, *location)
        offset, size = location
        return _view(self._buffers.memory[name][offset : offset + size], binding)

    def _texture(self, binding: Binding, name: Id, sampler: Id) -> Any:
        from rhi.shading.numpy.host_textures import HostTexture

        texture = self._textures.textures[name]
        return HostTexture(
            texture.levels,
            texture.descriptor.format,
            texture.descriptor.kind,
            self._state.get(sampler, SamplerDescriptor),
        )

    def _image(self, binding: Binding, name: Id, level: int, layer: int) -> Any:
        from rhi.shading.numpy.host_textures import HostTexture

        texture = self._textures.textures[name]
        texels = texture.levels[level]
        bound = HostTexture(texels[:0], texture.descriptor.format, texture.descriptor.kind)
        bound.levels = [texels if layer < 0 else texels[layer : layer + 1]]  # no copy: shaders write into it
        return bound


def _view(memory: NDArray[np.uint8], binding: Binding) -> NDArray[Any]:
    """Return a range of a buffer as an array of a binding's elements."""
    from rhi.shading.language.annotations import value_type_of

    type = value_type_of(binding.type)
    is_uniform = binding.kind is BindingKind.UNIFORM
    dtype = dtype_of(type, Layout.STD140) if is_uniform else element_dtype(type, Layout.STD430)
    base, shape = dtype.subdtype or (dtype, ())
    count = 1 if is_uniform else len(memory) // dtype.itemsize
    return memory[: count * dtype.itemsize].view(base).reshape(count, *shape)
