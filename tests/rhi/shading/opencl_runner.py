"""Runs compute shaders through pyopencl: the shading language and a driver, nothing else of rhi."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pyopencl as cl

from rhi.descriptors import BindingKind
from rhi.shading import Shader, compile_shader, opencl_kernel
from rhi.shading.evaluate import storage_words, uniform_words

PROBE = "kernel void probe(global int *p) { p[get_global_id(0)] = (int)get_global_id(0); }"


@cache
def queue() -> cl.CommandQueue:
    """A queue on the first device that builds and runs a kernel, not the first that says it could."""
    for platform in cl.get_platforms():
        for device in platform.get_devices():
            try:
                found = cl.Context([device])
                found_queue = cl.CommandQueue(found)
                buffer = cl.Buffer(found, cl.mem_flags.READ_WRITE, 16)
                cl.Kernel(cl.Program(found, PROBE).build(), "probe")(found_queue, (4,), None, buffer).wait()
                result = np.zeros(4, "i4")
                cl.enqueue_copy(found_queue, result, buffer)
                if result.tolist() == [0, 1, 2, 3]:
                    return found_queue
            except cl.Error:
                continue
    raise RuntimeError("no OpenCL device works")


class Kernel:
    """A compute shader for `width` lanes, its arguments set once."""

    def __init__(self, shader: type[Shader], width: int, **bindings: Any) -> None:
        self.queue = queue()
        descriptor = compile_shader(shader)
        self.text = opencl_kernel(shader, width).text
        self.kernel = cl.Kernel(cl.Program(queue().context, self.text).build(["-w"]), "compute")
        self.items = -(-math.prod(descriptor.work_group) // width)
        self.buffers: dict[str, tuple[cl.Buffer, Any]] = {}
        arguments: list[Any] = []
        for binding in descriptor.bindings:
            value = bindings[binding.name]
            if binding.kind is BindingKind.UNIFORM:
                words = uniform_words(shader._declared[binding.name].type, value, binding.name)
                arguments.append(self._buffer(words))
            else:
                element = shader._declared[binding.name].type.element
                whole, words = storage_words(element, value, binding.name)
                arguments += [self._buffer(words), np.int32(len(whole))]
                if binding.writes:
                    self.buffers[binding.name] = (arguments[-2], whole)
        self.arguments = arguments  # a kernel doesn't keep its buffers alive
        self.kernel.set_args(*arguments)

    def _buffer(self, words: Any) -> cl.Buffer:
        padded = np.zeros(max(64, words.size), np.uint32)
        padded[: words.size] = words
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(queue().context, flags, hostbuf=padded)

    def launch(self, groups: Any = 1) -> None:
        """Enqueue and wait."""
        x, y, z = (*(groups if isinstance(groups, tuple) else (groups,)), 1, 1)[:3]
        cl.enqueue_nd_range_kernel(self.queue, self.kernel, (x * self.items, y, z), (self.items, 1, 1)).wait()

    def results(self) -> dict[str, Any]:
        """What each writable buffer holds."""
        for buffer, whole in self.buffers.values():
            if whole.size:
                cl.enqueue_copy(self.queue, whole, buffer)
        return {name: whole for name, (_, whole) in self.buffers.items()}


def run_opencl(shader: type[Shader], width: int, groups: Any = 1, **bindings: Any) -> dict[str, Any]:
    """Run once; gives each writable buffer's contents."""
    kernel = Kernel(shader, width, **bindings)
    kernel.launch(groups)
    return kernel.results()
