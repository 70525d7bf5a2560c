"""Compute programs: kernels and their arguments.

The OpenCL C of a compute program, whether written by the shading language or by hand, follows these rules:

- It has one kernel. The kernel's arguments are the program's bindings in order: `constant T *` for a uniform;
  `global T *` and an `int`, the number of bound elements, for storage; `global const uchar *` for a texture
  or `global uchar *` for an image, then `global const int *`, the words of `rhi.shading.ir.texture_words`.
- Bound ranges begin at multiples of the capabilities' alignments. Vector loads may run past their end by up
  to `rhi.backends.cl.memory.planes.GRAIN` bytes.
- Its `reqd_work_group_size` is the work-group's size in work-items. It divides the descriptor's work-group,
  which counts invocations: a work-item may execute several as lanes of a vector. Without the attribute it
  executes one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Final, TypeAlias

import numpy as np
import pyopencl as cl

from rhi.backends.cl.builds import Builds, Kernel, Launch, Optimisation
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.memory.cl_samplers import Samplers
from rhi.backends.cl.memory.cl_textures import Textures
from rhi.backends.cl.memory.planes import allocate
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.contract.descriptors import (
    Binding,
    BindingKind,
    Id,
    ProgramDescriptor,
    SamplerDescriptor,
    Stage,
    StageText,
    TextureKind,
)
from rhi.contract.driver_log import make_driver_error
from rhi.contract.formats import Format
from rhi.errors import ShaderError
from rhi.errors.rules import SHADER_DRIVER
from rhi.shading.ir.faults import FAULT_WORDS, find_fault
from rhi.shading.ir.texture_words import LevelLayout, describe_texture

Slots: TypeAlias = dict[tuple[BindingKind, int], tuple[int, ...]]
"""Bound resources by kind and slot: the arguments of the binding command that follow the slot."""
_WIDTHS: Final = (16, 8, 4)
_GENERATED: Final = "compute"  # the name of a kernel that the shading language writes
_TEXEL: Final = describe_texture(
    Format.RGBA8, TextureKind.D2, [LevelLayout(0, 1, 1, 1, 1, 1)], SamplerDescriptor()
).tobytes()
_LINE: Final = re.compile(r":(\d+):\d+: *(?:(?:fatal )?error: *)?")  # file:line:column: …, Clang's format


def count_lanes(device: cl.Device) -> int:
    """Return the number of invocations that a work-item executes: as many as a vector register of the device has
    floats, or 1 on GPUs, whose compilers vectorise over work-items themselves."""
    native = int(device.native_vector_width_float)
    return next((width for width in _WIDTHS if native >= width), 1)


class KernelArguments:
    """Finds the kernel arguments of bound resources."""

    def __init__(self, buffers: Buffers, textures: Textures, samplers: Samplers) -> None:
        self._buffers = buffers
        self._textures = textures
        self._samplers = samplers

    def collect(self, binding: Binding, bound: tuple[int, ...]) -> tuple[cl.Buffer | np.int32, ...]:
        """Return the kernel arguments of a binding; `bound`: the arguments of the command that bound it."""
        if binding.kind is BindingKind.TEXTURE:
            name, sampler = bound
            texture = self._textures[name]
            return texture.levels[0].memory, self._samplers.describe(texture, sampler).memory
        name, first, second = bound
        if binding.kind is BindingKind.IMAGE:
            texture = self._textures[name]
            return texture.levels[0].memory, self._samplers.describe_image(texture, first, second).memory
        memory = self._buffers.bound(name, first, second)
        if binding.kind is BindingKind.UNIFORM:
            return (memory,)
        return memory, np.int32(second // max(1, binding.size))


class FaultBuffer:
    """The device memory in which a stage of a checked shader reports faults (`rhi.shading.ir.faults`)."""

    def __init__(self, context: cl.Context, lines: Sequence[tuple[str, int]]) -> None:
        self._lines = lines
        self._words = np.zeros(FAULT_WORDS, np.int32)
        with translate_errors("device.program", "memory for the faults of a checked shader"):
            self.memory = allocate(context, self._words.nbytes)

    def read(self, queue: cl.CommandQueue) -> None:
        """Wait for the launch, and check whether it reported a fault.

        Raises:
            ShaderError: the fault. The memory is reset for the next launch.
        """
        cl.enqueue_copy(queue, self._words, self.memory)
        error = find_fault(self._words.tolist(), self._lines)
        if error is not None:
            self._words[:] = 0
            cl.enqueue_copy(queue, self.memory, self._words)
            raise error


class ComputeProgram:
    """A compute kernel and the arguments that it was last given.

    A generated kernel is built at its first launch, unless it is in the cache, so that it can be prepared
    before. A kernel written by hand is built at once, since the driver may refuse it.

    Attributes:
        written: the bindings that the kernel writes.
    """

    def __init__(
        self, context: ClContext, builds: Builds, descriptor: ProgramDescriptor, arguments: KernelArguments
    ) -> None:
        self._context = context
        self._builds = builds
        self._descriptor = descriptor
        source = descriptor.emit(f"opencl{count_lanes(context.device)}", Stage.COMPUTE)
        self._kernel: Kernel | None = None
        self._optimisation: Optimisation | None = None
        self._group: tuple[int, ...] = descriptor.work_group
        request = builds.request(source.text, (), descriptor.flushes_denormals)
        launch = _describe_launch(descriptor)
        self._unbuilt: tuple[StageText, Request] | None = source, request
        if builds.is_quick and source.generated and not builds.is_cached(request, launch):
            self._optimisation = Optimisation(request, launch, builds)
        else:
            self._build()
        self.written = [binding for binding in descriptor.bindings if binding.writes]
        self._arguments = arguments
        self._bindings: list[tuple[int, Binding]] = []
        index = 0
        for binding in descriptor.bindings:
            self._bindings.append((index, binding))
            index += 1 if binding.kind is BindingKind.UNIFORM else 2
        self._faults: FaultBuffer | None = None
        if descriptor.checked:
            self._faults = FaultBuffer(context.context, source.origins)
        self._fault_argument = index
        # The last bound resources, by ids that are never reused, and the arguments made of them. The
        # arguments are kept alive here because OpenCL doesn't promise that a kernel does.
        self._bound: dict[int, tuple[int, ...]] = {}
        self._argument_values: dict[int, tuple[cl.Buffer | np.int32, ...]] = {}
        self._argument_build: object = None  # the build whose kernel has these arguments

    def _build(self) -> Kernel:
        assert self._unbuilt is not None
        descriptor, optimisation, (source, request) = self._descriptor, self._optimisation, self._unbuilt
        try:
            if optimisation is None:
                program = self._context.compile(request.source, request.options)
            else:
                program = optimisation.program or self._builds.compile(request, quick=True)
            # By name: kernels of `all_kernels` keep a reference to the program that is never released.
            (name,) = program.list_names()
            kernel = program.find(name)
        except cl.Error as error:
            raise make_shader_error(descriptor, Stage.COMPUTE, source, str(error)) from error
        except ValueError as error:
            call = f"device.program({descriptor.name})"
            raise ShaderError(SHADER_DRIVER, call, "no single kernel", "a source with one kernel") from error
        required = kernel.get_work_group_info(
            cl.kernel_work_group_info.COMPILE_WORK_GROUP_SIZE, self._context.device
        )
        if any(required):
            self._group = tuple(required)
        self._kernel = Kernel(program, name, optimisation)
        self._unbuilt = None
        return self._kernel

    def prepare(self) -> list[Future[None]]:
        """Begin to optimise the kernel; return a future of the end, or None if there is nothing to do."""
        return [] if self._optimisation is None else [self._optimisation.begin()]

    def forget(self, resource: Id) -> None:
        """Drop the arguments that refer to a resource, since it is being destroyed."""
        for index in [index for index, bound in self._bound.items() if bound[0] == resource]:
            del self._bound[index], self._argument_values[index]

    def launch(self, queue: cl.CommandQueue, slots: Slots, groups: tuple[int, int, int]) -> None:
        """Run work-groups with the bound resources."""
        holder = self._kernel or self._build()
        items = math.prod(groups) * math.prod(self._group)
        kernel = holder.get(items)
        build = holder.program, holder.program.builds
        if self._argument_build != build:  # the kernel has no arguments yet
            self._argument_build = build
            self._bound.clear()
            self._argument_values.clear()
            if not holder.is_quick:
                self._optimisation = None  # with its source code
            if self._faults is not None:
                kernel.set_arg(self._fault_argument, self._faults.memory)
        for index, binding in self._bindings:
            bound = slots[binding.kind, binding.slot]
            if self._bound.get(index) != bound:
                arguments = self._arguments.collect(binding, bound)
                previous = self._argument_values.get(index, (None, None))
                for i, argument in enumerate(arguments):
                    if (
                        argument != previous[i]
                    ):  # setting a number takes pyopencl 80 times as long as comparing it
                        kernel.set_arg(index + i, argument)
                self._argument_values[index], self._bound[index] = arguments, bound
        if 0 not in groups:
            whole = tuple(count * items for count, items in zip(groups, self._group, strict=True))
            holder.watch(cl.enqueue_nd_range_kernel(queue, kernel, whole, self._group), items)
            if self._faults is not None:
                self._faults.read(queue)


class ComputePrograms:
    """The compute programs of a device, by id."""

    def __init__(
        self, context: ClContext, builds: Builds, buffers: Buffers, textures: Textures, samplers: Samplers
    ) -> None:
        self._context = context
        self._builds = builds
        self._arguments = KernelArguments(buffers, textures, samplers)
        self._programs: dict[Id, ComputeProgram] = {}

    def __contains__(self, program: Id) -> bool:
        return program in self._programs

    def __getitem__(self, program: Id) -> ComputeProgram:
        return self._programs[program]

    def create(self, program: Id, descriptor: ProgramDescriptor) -> None:
        with translate_errors(f"device.program({descriptor.name})"):
            self._programs[program] = ComputeProgram(self._context, self._builds, descriptor, self._arguments)

    def destroy(self, program: Id) -> None:
        del self._programs[program]

    def forget(self, resource: Id) -> None:
        """Drop all arguments that refer to a buffer or texture, since it is being destroyed."""
        for program in self._programs.values():
            program.forget(resource)


def _describe_launch(descriptor: ProgramDescriptor) -> Launch:
    """Return a launch of a generated kernel with memory and textures of zeros."""
    arguments: list[int | bytes] = []
    for binding in descriptor.bindings:
        arguments.append(b"")
        if binding.kind is BindingKind.STORAGE:
            arguments.append(0)
        elif binding.kind is not BindingKind.UNIFORM:
            arguments.append(_TEXEL)
    return Launch((_GENERATED,), (*arguments, *[b""] * descriptor.checked))


def make_shader_error(
    descriptor: ProgramDescriptor, stage: Stage, source: StageText, log: str
) -> ShaderError:
    """Return the error for source code of `stage` that the driver rejected."""
    messages = [_read_message(row.strip()) for row in log.splitlines() if "error:" in row]
    return make_driver_error(descriptor, stage, source, messages or [(log.strip(), 0)], "OpenCL C")


def _read_message(line: str) -> tuple[str, int]:
    """Return a compiler message's text and line number; 0 without one."""
    match = _LINE.search(line)
    return (line[match.end() :].strip(), int(match[1])) if match else (line, 0)
