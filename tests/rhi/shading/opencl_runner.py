"""Runs compute shaders through pyopencl, using only rhi's shading language, its way of building and a
driver."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

from rhi.backends.cl.cl_context import KERNELS_ENVIRONMENT, QUICK, caches_kernels, declares_kernels
from rhi.backends.cl.pocl.kernel_cache import KernelCache
from rhi.contract.descriptors import BindingKind, ProgramDescriptor, StageText
from rhi.shading import Shader, compile_shader, opencl_kernel
from rhi.shading.evaluation.compute import storage_words, uniform_words
from rhi.shading.ir.faults import FAULT_WORDS, find_fault
from rhi.shading.ir.texture_words import LevelLayout, describe_texture
from rhi.shading.numpy.host_textures import HostTexture

PROBE = "kernel void probe(global int *p) { p[get_global_id(0)] = (int)get_global_id(0); }"


@cache
def queue() -> cl.CommandQueue:
    """Return a queue on the first device that does build and run a kernel; without one the test is
    skipped."""
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:  # no platform at all
        platforms = []
    for platform in platforms:
        for device in platform.get_devices():
            try:
                context = cl.Context([device])
                found_queue = cl.CommandQueue(context)
                buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 16)
                cl.Kernel(cl.Program(context, PROBE).build(), "probe")(found_queue, (4,), None, buffer).wait()
                result = np.zeros(4, "i4")
                cl.enqueue_copy(found_queue, result, buffer)
                if result.tolist() == [0, 1, 2, 3]:
                    return found_queue
            except cl.Error:
                continue
    pytest.skip("no OpenCL device works")


Built = tuple[StageText, cl.Program, str]
_together: dict[tuple[type[Shader], int], Built] = {}


def build(text: str, shader: type[Shader]) -> cl.Program:
    """Build a program with the options that a shader needs."""
    return build_text(text, ["-cl-denorms-are-zero"] if compile_shader(shader).flushes_denormals else [])


def build_text(text: str, options: Sequence[str] = ()) -> cl.Program:
    """Build a program, as the OpenCL backend does: without the driver's header where it can do without, and
    quickly if that is wanted."""
    device = queue().device
    if os.environ.get(KERNELS_ENVIRONMENT) == "quick":
        options = (*options, *QUICK)
    cache = KernelCache(None, "", declares=caches_kernels(device) and declares_kernels(device))
    source, options = cache.request(text, ["-w", *options]).write()
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", cl.CompilerWarning
        )  # some drivers log what they think of register use
        return cl.Program(queue().context, source).build(list(options))


@lru_cache(64)
def built_alone(shader: type[Shader], width: int) -> Built:
    """Return a kernel's text, a program of this kernel alone, and the kernel's name."""
    text = opencl_kernel(shader, width)
    return text, build(text.text, shader), "compute"


def built(shader: type[Shader], width: int) -> Built:
    """Return a kernel's text, program and name; see `built_together`."""
    return _together.get((shader, width)) or built_alone(shader, width)


@contextmanager
def built_together(shaders: Iterable[type[Shader]], width: int) -> Iterator[None]:
    """Build the kernels of several shaders as one program; inside this block they run from it.

    To PoCL a program costs processor time before the first kernel, whatever is in it. The texts stay as they
    are, but for the kernels' names and for functions that a text before had already.
    """
    shaders = list(dict.fromkeys(shaders))
    texts = [opencl_kernel(shader, width) for shader in shaders]
    parts: dict[str, None] = {}
    names = [f"compute_{i}" for i in range(len(shaders))]
    for name, text in zip(names, texts, strict=True):
        for part in split_functions(text.text):
            parts.setdefault(part.replace("kernel void compute(", f"kernel void {name}("))
    program = build("\n".join(parts), shaders[0])
    kernels = {
        (shader, width): (text, program, name)
        for shader, text, name in zip(shaders, texts, names, strict=True)
    }
    _together.update(kernels)
    try:
        yield
    finally:
        for key in kernels:
            del _together[key]


def split_functions(text: str) -> Iterator[str]:
    """Yield the functions, directives and declarations of a kernel's text."""
    part: list[str] = []
    depth = 0
    for line in text.split("\n"):
        part.append(line)
        depth += line.count("{") - line.count("}")
        if (depth == 0 and line.endswith((";", "}"))) or line.startswith(("#", "//")):
            yield "\n".join(part)
            part = []
    yield "\n".join(part)


def buffer(array: Any) -> cl.Buffer:
    """Create a buffer with an array's contents and some padding after them."""
    data = np.frombuffer(np.ascontiguousarray(array).tobytes() + bytes(256), np.uint8)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(queue().context, flags, hostbuf=data)


def binding_words(shader: type[Shader], bindings: dict[str, Any]) -> dict[str, Any]:
    """Return a shader's bindings as words."""
    words = {}
    for name, declaration in shader._declared.items():
        if declaration.storage_class.value == "uniform":
            words[name] = uniform_words(declaration.type, bindings[name], name)
        elif declaration.storage_class.value in ("texture", "image"):
            words[name] = bindings[name]
        elif declaration.storage_class.value == "storage":  # not shared memory
            words[name] = storage_words(declaration.type.element, bindings[name], name)
    return words


class BoundMemory:
    """A shader's bindings in buffers of OpenCL, of which `arguments` are those of a kernel."""

    def __init__(self, descriptor: ProgramDescriptor, words: dict[str, Any]) -> None:
        self.arguments: list[Any] = []
        self._buffers: dict[str, tuple[cl.Buffer, Any]] = {}
        self._images: dict[str, tuple[cl.Buffer, Any, HostTexture]] = {}
        for binding in descriptor.bindings:
            value = words[binding.name]
            if binding.kind is BindingKind.UNIFORM:
                self.arguments.append(buffer(value))
            elif binding.kind in (BindingKind.TEXTURE, BindingKind.IMAGE):
                memory, described = texture_memory(value)
                self.arguments += [buffer(memory), buffer(described)]
                if binding.kind is BindingKind.IMAGE:
                    self._images[binding.name] = (self.arguments[-2], memory, value)
            else:
                whole, content = value
                self.arguments += [buffer(content), np.int32(len(whole))]
                if binding.writes:
                    self._buffers[binding.name] = (self.arguments[-2], whole)

    def read_back(self) -> dict[str, Any]:
        """Return the contents of each writable buffer and each image."""
        for memory, whole in self._buffers.values():
            if whole.size:
                cl.enqueue_copy(queue(), whole, memory)
        results = {name: whole for name, (_, whole) in self._buffers.items()}
        for name, (image, memory, texture) in self._images.items():
            cl.enqueue_copy(queue(), memory, image)
            results[name] = texels_of(memory, texture.levels[0])
        return results


class Kernel:
    """A compute shader for `width` lanes, whose arguments are set once."""

    def __init__(self, shader: type[Shader], width: int, **bindings: Any) -> None:
        self.queue = queue()
        descriptor = compile_shader(shader)
        written, program, name = built(shader, width)
        self.text, self.origins = written.text, written.origins
        self.kernel = cl.Kernel(program, name)
        self.items = -(-math.prod(descriptor.work_group) // width)
        self.memory = BoundMemory(descriptor, binding_words(shader, bindings))
        self.faults = buffer(np.zeros(FAULT_WORDS, np.uint32)) if descriptor.checked else None
        # A kernel doesn't keep its buffers alive.
        self.arguments = [*self.memory.arguments, *([self.faults] if descriptor.checked else [])]
        self.kernel.set_args(*self.arguments)

    def launch(self, groups: Any = 1) -> None:
        """Enqueue the kernel and wait; raises the fault that a checked shader found."""
        x, y, z = (*(groups if isinstance(groups, tuple) else (groups,)), 1, 1)[:3]
        cl.enqueue_nd_range_kernel(self.queue, self.kernel, (x * self.items, y, z), (self.items, 1, 1)).wait()
        if self.faults is not None:
            words = np.zeros(FAULT_WORDS, np.int32)
            cl.enqueue_copy(self.queue, words, self.faults)
            error = find_fault(words.tolist(), self.origins)
            if error is not None:
                raise error


def texture_memory(texture: HostTexture) -> tuple[Any, Any]:
    """Return a texture's levels as bytes, with padding in rows and columns that must not be read, and its
    words."""
    parts, levels = [], []
    for texels in texture.levels:
        layers, height, width, channels = texels.shape
        padded = np.full((layers, -(-height // 4) * 4, -(-width // 4) * 4, channels), 77, texels.dtype)
        padded[:, :height, :width] = texels
        start = sum(map(len, parts))
        levels.append(LevelLayout(start, width, height, layers, padded[0, 0].nbytes, padded[0].nbytes))
        parts.append(padded.view(np.uint8).reshape(-1))
        parts.append(np.zeros(-len(parts[-1]) % 128, np.uint8))
    words = describe_texture(texture.format, texture.kind, levels, texture.sampler)
    return np.concatenate(parts), words


def texels_of(memory: Any, like: Any) -> Any:
    """Return the first level from memory, without padding."""
    layers, height, width, channels = like.shape
    shape = (layers, -(-height // 4) * 4, -(-width // 4) * 4, channels)
    return memory.view(like.dtype)[: np.prod(shape)].reshape(shape)[:, :height, :width]


def run_opencl(shader: type[Shader], width: int, groups: Any = 1, **bindings: Any) -> dict[str, Any]:
    """Run a compute shader once and return the contents of each writable buffer."""
    kernel = Kernel(shader, width, **bindings)
    kernel.launch(groups)
    return kernel.memory.read_back()
