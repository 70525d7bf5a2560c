"""Compute programs: kernels and their arguments.

What a program's OpenCL C must look like, be it written by the shading language or by hand:

- One kernel. Its arguments are the program's bindings in their order: for a uniform `constant T *`, for storage
  `global T *` and, right behind it, an `int`: how many elements are bound.
- Bound ranges begin at multiples of the capabilities' alignments, and vector loads may run past their end by
  `rhi.backends.cl.resources.GRAIN` bytes.
- Its `reqd_work_group_size` is the work-group in work-items. It divides the descriptor's work-group, which counts
  invocations: a work-item may do several as lanes of a vector. Without the attribute, each does one.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.context import Context, build
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.resources import Buffers
from rhi.backends.cl.states import States
from rhi.descriptors import BindingKind, Id, ProgramDescriptor, Stage
from rhi.errors import CallSite, ShaderError
from rhi.rules import SHADER_DRIVER

__rhi_internal__ = True

_WIDTHS: Final = (16, 8, 4)
_LINE: Final = re.compile(r":(\d+):\d+: *(?:(?:fatal )?error: *)?")  # file:line:column: …, as Clang has it
_SHOWN_ERRORS: Final = 10


def count_lanes(device: cl.Device) -> int:
    """How many invocations a work-item does: as many as a vector register of the device has floats; 1 on GPUs, whose
    compilers make vectors of work-items themselves."""
    native = int(device.native_vector_width_float)
    return next((width for width in _WIDTHS if native >= width), 1)


class Program:
    """A kernel, and which arguments it was given last."""

    def __init__(self, context: Context, descriptor: ProgramDescriptor) -> None:
        source = descriptor.emit(f"opencl{count_lanes(context.device)}", Stage.COMPUTE)
        try:
            program = build(context.context, source)
            (kernel,) = program.all_kernels()
        except cl.Error as error:
            raise make_shader_error(descriptor, source, str(error)) from error
        except ValueError as error:
            call = f"device.program({descriptor.name})"
            raise ShaderError(SHADER_DRIVER, call, "not one kernel", "a text with one kernel") from error
        required = kernel.get_work_group_info(
            cl.kernel_work_group_info.COMPILE_WORK_GROUP_SIZE, context.device
        )
        self._kernel = kernel
        self._group = tuple(required) if any(required) else descriptor.work_group
        self._bindings = descriptor.bindings
        # Each kept alive while a kernel has it for an argument, which OpenCL doesn't promise to do.
        self._bound: list[tuple[cl.Buffer, int] | None] = [None] * len(descriptor.bindings)

    def launch(
        self, queue: cl.CommandQueue, buffers: Buffers, states: States, groups: tuple[int, int, int]
    ) -> None:
        """Run work-groups with what is bound."""
        place = 0
        for i, binding in enumerate(self._bindings):
            buffer, offset, size = states.ranges[binding.kind, binding.slot]
            memory = buffers.bound(buffer, offset, size)
            bound = self._bound[i]
            if bound is None or bound[0] is not memory or bound[1] != size:
                self._kernel.set_arg(place, memory)
                if binding.kind is BindingKind.STORAGE:
                    self._kernel.set_arg(place + 1, np.int32(size // max(1, binding.size)))
                self._bound[i] = memory, size
            place += 2 if binding.kind is BindingKind.STORAGE else 1
        if 0 not in groups:
            whole = tuple(count * items for count, items in zip(groups, self._group, strict=True))
            cl.enqueue_nd_range_kernel(queue, self._kernel, whole, self._group)


class Programs:
    """All programs of a device, by id."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._programs: dict[Id, Program] = {}

    def __getitem__(self, program: Id) -> Program:
        return self._programs[program]

    def create(self, program: Id, descriptor: ProgramDescriptor) -> None:
        with translate_errors(f"device.program({descriptor.name})"):
            self._programs[program] = Program(self._context, descriptor)

    def destroy(self, program: Id) -> None:
        del self._programs[program]


def make_shader_error(descriptor: ProgramDescriptor, source: str, log: str) -> ShaderError:
    """The error for a text that the driver refused; `site` is the Python line of the first error, if
    `descriptor.lines` knows it."""
    lines, origins = source.split("\n"), descriptor.lines.get(Stage.COMPUTE, ())
    rows: list[str] = []
    site = None
    for message in [row.strip() for row in log.splitlines() if "error:" in row][:_SHOWN_ERRORS]:
        match = _LINE.search(message)
        number = int(match[1]) if match else 0
        rows.append(message[match.end() :].strip() if match else message)
        if not 1 <= number <= len(lines):
            continue
        rows.append(f"  OpenCL C line {number}: {lines[number - 1].strip()}")
        if number <= len(origins):
            origin = CallSite(*origins[number - 1])
            rows.append(f"  from {origin}")
            site = site or origin
    call = f"device.program({descriptor.name}), its compute stage"
    return ShaderError(SHADER_DRIVER, call, "\n".join(rows) or log.strip(), site=site)
