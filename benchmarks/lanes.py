"""The gain of explicit lanes: the same compute shaders as GLSL on OpenGL, and as OpenCL C with 1 and with 16 lanes.

- Each of the 64 lights reaches 22 % of the pixels. Each of the 64 far lights reaches 61 %, so that an early exit which
  needs all lanes to be out of range is seldom taken.
- The variants take turns in one process; times are medians in milliseconds, ratios those of the rounds. On OpenGL a
  time is that of a dispatch and `glFinish`, on OpenCL that of a launch and a wait. Buffers are filled beforehand.
- `ratio` is OpenGL's time divided by the time with 16 lanes, `target_ratio` its goal. `lanes_16_over_1` is the time
  with 1 lane divided by the time with 16.
- `emit_ms` is the time of compiling the shader to OpenCL C with 16 lanes. `build_ms` and `cached_build_ms` are the
  processor time in milliseconds that this process uses to build that text and launch it once: a text that is new to
  PoCL, and one from PoCL's cache.
- `front end` is the processor time in seconds of parsing and typing all shaders of the renderer, and of emitting each
  stage as GLSL and as OpenCL C with 16 lanes.

    python benchmarks/lanes.py [--json] [--repeats 9]
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/rhi/shading"))

import moderngl
import pyopencl as cl
from opencl_runner import Kernel, queue

import renderer
import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio
from renderer.lab.comparison import time as time_column
from rhi.contract.descriptors import BindingKind, SamplerDescriptor, Stage
from rhi.contract.formats import Format
from rhi.contract.layout import Layout, element_dtype
from rhi.shading import (
    HostTexture,
    Precision,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    abs,
    atomic_add,
    barrier,
    compile_shader,
    dot,
    function,
    global_id,
    group_id,
    inversesqrt,
    local_index,
    max,
    min,
    normalize,
    opencl_kernel,
    pow,
    saturate,
    shared,
    value_type_of,
    vec2,
    vec3,
    vec4,
)

WIDTH, HEIGHT = 1280, 720


class Light(Struct):
    position: vec3
    range: float
    color: vec3
    power: float


class Frame(Struct):
    width: int
    height: int
    lights: int
    tile: int


@function
def shade(position: vec3, normal: vec3, light_position: vec3, reach: float, color: vec3) -> vec3:
    """Return Blinn-Phong shading, windowed so that it reaches 0 at the distance `reach`."""
    to_light = light_position - position
    distance_squared = dot(to_light, to_light)
    if distance_squared >= reach * reach:
        return vec3(0.0)
    direction = to_light * inversesqrt(distance_squared)
    half = normalize(direction + vec3(0.0, 0.0, 1.0))
    window = 1.0 - distance_squared / (reach * reach)
    shine = pow(max(dot(normal, half), 0.0), 32.0)
    return color * (window * window * (saturate(dot(normal, direction)) + shine))


class ManyLights(Shader):
    """Shades every pixel with every light."""

    work_group = (16, 16)
    precision = Precision.FAST
    frame: Uniform[Frame]
    lights: Storage[Light]
    normals: Storage[vec4]
    out: StorageRW[vec4]

    def compute(self) -> None:
        place = global_id()
        i = place.y * self.frame.width + place.x
        surface = self.normals[i]
        position = vec3(float(place.x) * 0.1, float(place.y) * 0.1, surface.w)
        color = vec3(0.0)
        for k in range(self.frame.lights):
            light = self.lights[k]
            color += shade(position, surface.xyz, light.position, light.range, light.color)
        self.out[i] = vec4(color, 1.0)


class TiledLights(ManyLights):
    """Shades every pixel with the lights listed for its tile. A tile is a work-group."""

    counts: Storage[int]
    lists: Storage[int]

    def compute(self) -> None:
        place = global_id()
        i = place.y * self.frame.width + place.x
        surface = self.normals[i]
        position = vec3(float(place.x) * 0.1, float(place.y) * 0.1, surface.w)
        tile = group_id().y * (self.frame.width // 16) + group_id().x
        color = vec3(0.0)
        for k in range(self.counts[tile]):
            light = self.lights[self.lists[tile * 64 + k]]
            color += shade(position, surface.xyz, light.position, light.range, light.color)
        self.out[i] = vec4(color, 1.0)


class Cull(Shader):
    """Lists the lights whose sphere reaches into each tile."""

    work_group = (16, 16)
    frame: Uniform[Frame]
    lights: Storage[Light]
    counts: StorageRW[int]
    lists: StorageRW[int]
    count = shared(int)
    invocations = 256

    def compute(self) -> None:
        i = local_index()
        tile = group_id().y * (self.frame.width // self.frame.tile) + group_id().x
        if i == 0:
            self.count = 0
        barrier()
        size = float(self.frame.tile) * 0.1
        low = vec2(float(group_id().x), float(group_id().y)) * size
        high = low + vec2(size)
        for k in range(i, self.frame.lights, self.invocations):
            center = self.lights[k].position
            reach = self.lights[k].range
            nearest = max(low, min(center.xy, high))
            away = vec3(nearest - center.xy, max(abs(center.z) - 2.0, 0.0))
            if dot(away, away) < reach * reach:
                slot = atomic_add(self.count, 1)
                if slot < 64:
                    self.lists[tile * 64 + slot] = k
        barrier()
        if i == 0:
            self.counts[tile] = min(self.count, 64)


class Cull8(Cull):
    work_group = (8, 8)
    invocations = 64


class Octahedral(Shader):
    """Encodes normals as two numbers each (octahedral mapping) and decodes them."""

    work_group = (64,)
    normals: Storage[vec4]
    out: StorageRW[vec4]

    def compute(self) -> None:
        i = global_id().x
        n = self.normals[i].xyz
        p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z))
        if n.z < 0.0:
            p = (1.0 - abs(p.yx)) * vec2(1.0 if p.x >= 0.0 else -1.0, 1.0 if p.y >= 0.0 else -1.0)
        z = 1.0 - abs(p.x) - abs(p.y)
        fold = max(-z, 0.0)
        x = p.x + (-fold if p.x >= 0.0 else fold)
        y = p.y + (-fold if p.y >= 0.0 else fold)
        self.out[i] = vec4(normalize(vec3(x, y, z)), n.x)


class Scan(Shader):
    """Computes inclusive prefix sums in blocks of 256."""

    work_group = (256,)
    values: Storage[int]
    out: StorageRW[int]
    partial = shared(int, 256)

    def compute(self) -> None:
        i = local_index()
        self.partial[i] = self.values[global_id().x]
        step = 1
        while step < 256:
            barrier()
            before = 0
            if i >= step:
                before = self.partial[i - step]
            barrier()
            self.partial[i] += before
            step *= 2
        self.out[global_id().x] = self.partial[i]


class FourTaps(Shader):
    """Averages four bilinear samples of an RGBA8 texture, 0.01 apart in u and v; the image spans 1.7
    times the texture in each direction."""

    work_group = (16, 16)
    frame: Uniform[Frame]
    source: Texture2D
    out: StorageRW[vec4]

    def compute(self) -> None:
        place = global_id()
        at = (vec2(place.xy) + 0.5) * vec2(1.7 / 1280.0, 1.7 / 720.0)
        color = self.source.sample(at)
        color += self.source.sample(at + vec2(0.01, 0.0))
        color += self.source.sample(at + vec2(0.0, 0.01))
        color += self.source.sample(at + vec2(0.01, 0.01))
        self.out[place.y * self.frame.width + place.x] = color * 0.25


class GlRun:
    """A compute shader on OpenGL, with its buffers and textures."""

    def __init__(self, context: moderngl.Context, shader: type[Shader], **values: Any) -> None:
        self.context, self.slots = context, []
        program = compile_shader(shader)
        self.compute = context.compute_shader(program.emit("glsl", Stage.COMPUTE).text)
        self.arrays = {}
        for binding in program.bindings:
            value = values[binding.name]
            if binding.kind is BindingKind.UNIFORM:
                self.slots.append((binding, context.buffer(value.to_bytes())))
            elif binding.kind is BindingKind.TEXTURE:
                _, height, width, channels = value.levels[0].shape
                self.slots.append((binding, context.texture((width, height), channels, value.levels[0].tobytes())))
            else:
                dtype = element_dtype(value_type_of(binding.type), Layout.STD430)
                array = np.zeros(value, dtype) if isinstance(value, int) else value
                buffer = context.buffer(array.tobytes())
                self.slots.append((binding, buffer))
                self.arrays[binding.name] = (buffer, array)

    def launch(self, groups: tuple[int, int]) -> None:
        for binding, buffer in self.slots:
            if binding.kind is BindingKind.UNIFORM:
                buffer.bind_to_uniform_block(binding.slot)
            elif binding.kind is BindingKind.TEXTURE:
                buffer.use(binding.slot)
            else:
                buffer.bind_to_storage_buffer(binding.slot)
        self.compute.run(*groups)
        self.context.finish()

    def result(self, name: str) -> Any:
        buffer, array = self.arrays[name]
        return np.frombuffer(buffer.read(), array.dtype).reshape(array.shape)


def make_lights(count: int, reach: float) -> Any:
    rng = np.random.default_rng(0)
    lights = np.zeros(count, Light.dtype)
    lights["position"] = rng.uniform((0, 0, 0.5), (WIDTH * 0.1, HEIGHT * 0.1, 3), (count, 3))
    lights["range"] = reach
    lights["color"] = rng.uniform(0, 1, (count, 3))
    return lights


def make_cases() -> dict[str, tuple[type[Shader], tuple[int, int], dict[str, Any], str]]:
    """Return each case: its shader, groups, bindings, and the buffer whose contents are compared."""
    rng = np.random.default_rng(1)
    pixels = WIDTH * HEIGHT
    normals = rng.normal(0, 1, (pixels, 4)).astype("f4")
    normals[:, :3] /= np.linalg.norm(normals[:, :3], axis=1, keepdims=True)
    normals[:, 3] = 0
    unit = rng.normal(0, 1, (1 << 20, 4)).astype("f4")
    unit[:, :3] /= np.linalg.norm(unit[:, :3], axis=1, keepdims=True)
    frame = Frame(width=WIDTH, height=HEIGHT, lights=64, tile=16)
    whole = {"frame": frame, "lights": make_lights(64, 60.0)}
    near = {"frame": frame, "lights": make_lights(64, 30.0)}
    many = {
        "frame": Frame(width=WIDTH, height=HEIGHT, lights=1024, tile=16),
        "lights": make_lights(1024, 3.0),
    }
    many8 = {**many, "frame": Frame(width=WIDTH, height=HEIGHT, lights=1024, tile=8)}
    tiles, tiles8 = (WIDTH // 16) * (HEIGHT // 16), (WIDTH // 8) * (HEIGHT // 8)
    counts = rng.integers(6, 14, tiles).astype("i4")
    lists = rng.integers(0, 64, tiles * 64).astype("i4")
    pixel_groups, tile8_groups = (WIDTH // 16, HEIGHT // 16), (WIDTH // 8, HEIGHT // 8)
    values = rng.integers(0, 100, 1 << 20).astype("i4")
    linear = SamplerDescriptor(mip=None)
    texture = HostTexture(rng.integers(0, 256, (512, 512, 4), "u1"), Format.RGBA8, sampler=linear)
    taps = {"frame": frame, "source": texture, "out": pixels}
    return {
        "64 lights, 720p": (ManyLights, pixel_groups, {**near, "normals": normals, "out": pixels}, "out"),
        "64 far lights": (ManyLights, pixel_groups, {**whole, "normals": normals, "out": pixels}, "out"),
        "64 lights by tile lists": (
            TiledLights,
            pixel_groups,
            {**whole, "counts": counts, "lists": lists, "normals": normals, "out": pixels},
            "out",
        ),
        "cull 1024 lights, 16x16": (
            Cull,
            pixel_groups,
            {**many, "counts": tiles, "lists": tiles * 64},
            "counts",
        ),
        "cull 1024 lights, 8x8": (
            Cull8,
            tile8_groups,
            {**many8, "counts": tiles8, "lists": tiles8 * 64},
            "counts",
        ),
        "octahedral, 1 M": (Octahedral, ((1 << 20) // 64, 1), {"normals": unit, "out": 1 << 20}, "out"),
        "4 bilinear taps, 720p": (FourTaps, pixel_groups, taps, "out"),
        "scan of 256, 1 M": (Scan, ((1 << 20) // 256, 1), {"values": values, "out": 1 << 20}, "out"),
    }


TARGETS = {
    "64 lights, 720p": 20.0,
    "64 far lights": 0.0,
    "64 lights by tile lists": 6.0,
    "cull 1024 lights, 16x16": 4.0,
    "cull 1024 lights, 8x8": 3.0,
    "octahedral, 1 M": 4.0,
    "scan of 256, 1 M": 4.0,
    "4 bilinear taps, 720p": 1.2,
}


def milliseconds(call: Callable[[], None]) -> float:
    started = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - started)


def launch(one: GlRun | Kernel, groups: tuple[int, int], _: int) -> None:
    one.launch(groups)


def measure_cases(repeats: int) -> Iterator[Record]:
    """Yield a row for each case.

    Raises:
        AssertionError: if results differ from OpenGL's.
    """
    context = moderngl.create_context(standalone=True, backend="egl", require=430)
    cl.Program(queue().context, "kernel void first() {}").build()  # makes PoCL load its compiler
    for name, (shader, groups, bindings, result) in make_cases().items():
        emit = milliseconds(lambda shader=shader: opencl_kernel(shader, 16))  # not emitted before, so not cached
        gl = GlRun(context, shader, **bindings)
        kernels, build = {}, {}
        for width in (1, 16):
            kernels[width] = Kernel(shader, width, **bindings)
            kernels[width].launch(groups)
        for way, mark in (("cold", f"kernel void mark_{time.time_ns()}() {{}}"), ("cached", "")):
            started = time.process_time()
            built = cl.Program(queue().context, f"{kernels[16].text}{mark}").build(["-w"])
            once = cl.Kernel(built, "compute")
            once.set_args(*kernels[16].arguments)
            items = (kernels[16].items, 1, 1)
            cl.enqueue_nd_range_kernel(queue(), once, items, items).wait()
            build[way] = 1e3 * (time.process_time() - started)
        gl.launch(groups)
        for kernel in kernels.values():
            np.testing.assert_allclose(kernel.memory.contents()[result], gl.result(result), rtol=2e-2, atol=2e-3)
        ways = {"lanes_16_ms": kernels[16], "glsl_ms": gl, "lanes_1_ms": kernels[1]}
        subjects = [Subject({"way": way}, partial(launch, one, groups)) for way, one in ways.items()]
        columns = {"ms": time_column(digits=2), "ratio": ratio(2)}
        timed = {row["way"]: row for row in compare(subjects, columns, range(repeats))}
        yield {
            "case": name,
            **{way: timed[way]["ms"] for way in ("glsl_ms", "lanes_1_ms", "lanes_16_ms")},
            "ratio": timed["glsl_ms"]["ratio"],
            "target_ratio": TARGETS[name],
            "lanes_16_over_1": timed["lanes_1_ms"]["ratio"],
            "emit_ms": round(emit, 1),
            "build_ms": round(build["cold"], 0),
            "cached_build_ms": round(build["cached"], 0),
        }


def measure_front_end() -> Record:
    """Return the seconds to parse, type and emit all shaders of the renderer."""
    shaders = []
    for module in pkgutil.walk_packages(renderer.__path__, "renderer."):
        if not module.name.endswith("__main__"):
            for value in vars(importlib.import_module(module.name)).values():
                is_own = isinstance(value, type) and issubclass(value, Shader) and value.__module__ == module.name
                if is_own and (hasattr(value, "vertex") or hasattr(value, "compute")):  # not just a base class
                    shaders.append(value)
    bases = 0
    started = time.process_time()
    for shader in shaders:
        try:
            program = compile_shader(shader, strict=True)
        except rhi.ShaderError as error:
            if error.rule.id != "shading-unused-binding":
                raise
            bases += 1  # of other shaders, which use all that it declares
            continue
        for stage in program.stages:
            program.emit("glsl", stage)
            program.emit("opencl16", stage)
    return {
        "front end": "all shaders",
        "shaders": len(shaders) - bases,
        "seconds": round(time.process_time() - started, 3),
    }


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the row of the front end, and those of all cases."""
    yield measure_front_end()
    yield from measure_cases(given.repeats)


if __name__ == "__main__":
    run_benchmark(__doc__, (options.count("--repeats", "runs of each variant", 9),), measure)
