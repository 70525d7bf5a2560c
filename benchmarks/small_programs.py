"""Small programs, such as those that examples and first steps consist of, on OpenCL and on Mesa's llvmpipe.

- pow_triangle: a triangle lit with `pow`.
- spheres: 64 steps of ray marching a pixel.
- terrain: 256×256 heights from an RGBA8 texture, sampled by the vertex stage and, for normals, by the fragment stage.
- julia: up to 64 steps a pixel, which end earlier for most.
- blur: nine bilinear samples a pixel, in two passes.
- particles: 20,000 blended points.
- text: 2,000 blended quads, whose alpha is a texture.
- cubes: 1,000 instances of a cube.

Both backends take turns, round by round, in one process, with the shaders' default precision and with FAST. A time
runs from the first command until the device is finished; figures are medians over the rounds. `ratio` is gl's time
divided by cl's, by the clock; `processor` is the same of the processor time of all threads. Above 1, cl is faster.
`empty` is a pass that only clears: what a frame costs before anything is drawn.

`--kernels optimised`, the default, measures the kernels that a program draws with after some frames, and from the start
if they are in the cache. `--kernels quick` measures those that it draws with until then, in an empty cache.

    python benchmarks/small_programs.py [--json] [--rounds 21] [--size 640x360] [--only julia,blur] [--kernels quick]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import BlendFactor, BlendFunction, CullMode, DepthTest, DepthWrite, Format, Primitive
from rhi.shading import (
    Precision,
    Shader,
    Struct,
    Texture2D,
    Uniform,
    cos,
    cross,
    dot,
    fragment_coordinate,
    length,
    max,
    min,
    normalize,
    pow,
    sin,
    vec2,
    vec3,
    vec4,
    vertex_index,
)

COLUMNS: Final = {
    "milliseconds": time(),
    "times as fast": ratio(2, inverse=True),
    "processor": ratio(2, processor=True, inverse=True),
}
SIDE: Final = 256
PARTICLES: Final = 20_000
GLYPHS: Final = 2000
CUBES: Final = 1000


class Corner(Struct):
    position: vec2


class Frame(Struct):
    size: vec2
    time: float


class Textured(Struct):
    clip: vec4
    at: vec2


class Bump(Struct):
    clip: vec4
    normal: vec3


class Solid(Struct):
    position: vec3
    normal: vec3


class Instance(Struct):
    offset: vec3
    turn: float


class Particle(Struct):
    place: vec2
    speed: vec2


class Glyph(Struct):
    position: vec2
    at: vec2


class PowTriangle(Shader):
    frame: Uniform[Frame]

    def vertex(self, v: Corner) -> Bump:
        return Bump(clip=vec4(v.position * 0.8, 0.5, 1.0), normal=vec3(v.position, 1.0))

    def fragment(self, b: Bump) -> vec4:
        shine = pow(max(normalize(b.normal).z, 0.0), 2.2 + self.frame.time)
        return vec4(vec3(0.9, 0.5, 0.2) * shine, 1.0)


class Spheres(Shader):
    frame: Uniform[Frame]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        size = self.frame.size
        pixel = fragment_coordinate()
        ray = normalize(vec3((pixel.x - 0.5 * size.x) / size.y, (pixel.y - 0.5 * size.y) / size.y, 1.0))
        moved = sin(self.frame.time) * 0.5
        travelled = 0.0
        nearest = 1.0
        for _ in range(64):
            place = ray * travelled - vec3(moved, 0.0, 3.0)
            nearest = min(length(place) - 1.0, length(place - vec3(1.5, 0.2, 0.5)) - 0.5)
            if nearest < 0.001 or travelled > 10.0:
                break
            travelled += nearest
        return vec4(vec3(1.0 / (1.0 + travelled)), 1.0)


class Terrain(Shader):
    heights: Texture2D

    def vertex(self) -> Textured:
        number = vertex_index()
        at = vec2(float(number % 256), float(number // 256)) / 255.0
        height = self.heights.sample_lod(at, 0.0).x
        depth = 1.0 + 2.0 * at.y
        place = vec2(at.x * 4.0 - 2.0, height * 0.6 - 0.5)
        return Textured(clip=vec4(place, 0.3 * depth, depth), at=at)

    def fragment(self, t: Textured) -> vec4:
        step = 1.0 / 256.0
        left = self.heights.sample(t.at - vec2(step, 0.0)).x
        right = self.heights.sample(t.at + vec2(step, 0.0)).x
        above = self.heights.sample(t.at - vec2(0.0, step)).x
        below = self.heights.sample(t.at + vec2(0.0, step)).x
        normal = normalize(vec3(left - right, 0.02, above - below))
        return vec4(vec3(max(dot(normal, vec3(0.5, 0.7, 0.5)), 0.0)), 1.0)


class Julia(Shader):
    frame: Uniform[Frame]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        pixel = fragment_coordinate()
        x = 3.0 * (pixel.x / self.frame.size.x - 0.5)
        y = 2.0 * (pixel.y / self.frame.size.y - 0.5)
        steps = 0.0
        for _ in range(64):
            if x * x + y * y > 4.0:
                break
            wider = x * x - y * y - 0.8 + 0.01 * self.frame.time
            y = 2.0 * x * y + 0.156
            x = wider
            steps += 1.0
        return vec4(vec3(steps / 64.0), 1.0)


class Blur(Shader):
    frame: Uniform[Frame]
    image: Texture2D

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        at = fragment_coordinate()
        place = vec2(at.x, at.y) / self.frame.size
        step = vec2(self.frame.time, 1.0 - self.frame.time) * 1.5 / self.frame.size
        sum = self.image.sample(place) * 0.2
        for i in range(1, 5):
            sum += self.image.sample(place + step * float(i)) * 0.1
            sum += self.image.sample(place - step * float(i)) * 0.1
        return sum


class Particles(Shader):
    frame: Uniform[Frame]

    def vertex(self, p: Particle) -> Textured:
        return Textured(clip=vec4(p.place + p.speed * sin(self.frame.time), 0.5, 1.0), at=p.speed)

    def fragment(self, t: Textured) -> vec4:
        return vec4(0.5 + t.at.x, 0.5, 0.5 + t.at.y, 0.25)


class Text(Shader):
    glyphs: Texture2D

    def vertex(self, g: Glyph) -> Textured:
        return Textured(clip=vec4(g.position, 0.5, 1.0), at=g.at)

    def fragment(self, t: Textured) -> vec4:
        return vec4(1.0, 1.0, 1.0, self.glyphs.sample(t.at).x)


class Cubes(Shader):
    frame: Uniform[Frame]

    def vertex(self, v: Solid, i: Instance) -> Bump:
        angle = i.turn + self.frame.time
        turned = vec3(
            v.position.x * cos(angle) + v.position.z * sin(angle),
            v.position.y,
            v.position.z * cos(angle) - v.position.x * sin(angle),
        )
        place = turned * 0.3 + i.offset
        return Bump(clip=vec4(place.x, place.y * 1.6, 0.5, place.z + 6.0), normal=v.normal)

    def fragment(self, b: Bump) -> vec4:
        light = max(dot(normalize(b.normal), normalize(cross(vec3(1.0, 0.0, 0.2), vec3(0.0, 0.9, 0.3)))), 0.1)
        return vec4(vec3(0.3, 0.6, 0.9) * light, 1.0)


SHADERS: Final[dict[str, type[Shader]]] = {
    "pow_triangle": PowTriangle,
    "spheres": Spheres,
    "terrain": Terrain,
    "julia": Julia,
    "blur": Blur,
    "particles": Particles,
    "text": Text,
    "cubes": Cubes,
}


def make_fast(shader: type[Shader]) -> type[Shader]:
    """Return the same shader with `Precision.FAST`."""
    return type(shader)(f"Fast{shader.__name__}", (shader,), {"precision": Precision.FAST})


def make_grid(side: int) -> NDArray[np.uint32]:
    """Return the indices of the triangles of a grid of side² vertices."""
    first = np.arange(side - 1)[:, None] * side + np.arange(side - 1)
    a, b = first.ravel(), first.ravel() + side
    return np.stack([a, b, a + 1, a + 1, b, b + 1], axis=1).ravel().astype(np.uint32)


def make_cube() -> NDArray[Any]:
    """Return the 36 corners of a cube with edges of 2."""
    corners = np.zeros(36, Solid.dtype)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, -1), (1, 1), (-1, 1)], np.float32)
    for face in range(6):
        axis, sign = face // 2, 1 - 2 * (face % 2)
        part = corners[6 * face : 6 * face + 6]
        part["position"][:, axis], part["normal"][:, axis] = sign, sign
        part["position"][:, (axis + 1) % 3] = square[:, 0]
        part["position"][:, (axis + 2) % 3] = square[:, 1] * sign
    return corners


class Bench:
    """The programs of the benchmark on one device."""

    def __init__(self, backend: str, size: tuple[int, int]) -> None:
        device = self.device = rhi.create_device(backend)
        rng = np.random.default_rng(0)
        self.color = device.texture(size, Format.RGBA8)
        self.middle = device.texture(size, Format.RGBA8)
        self.depth = device.texture(size, Format.D32F)
        self.image = device.texture(rng.integers(0, 256, (SIDE, SIDE, 4), np.uint8), Format.RGBA8)
        x, y = np.meshgrid(np.linspace(0, 12, SIDE), np.linspace(0, 12, SIDE))
        heights = 127.5 + 80 * np.sin(x) * np.cos(y) + 40 * np.sin(3.1 * x + y)
        texels = np.repeat(heights.astype(np.uint8)[:, :, None], 4, axis=2)
        self.heights = device.texture(texels, Format.RGBA8)
        self.frames = [device.uniform(Frame(size=size, time=time)) for time in (0.0, 1.0)]
        self.screen = device.mesh({"position": np.array([(-1, -1), (3, -1), (-1, 3)], np.float32)})
        self.triangle = device.mesh({"position": np.array([(-1, -1), (1, -1), (0, 1)], np.float32)})
        self.grid = device.mesh(SIDE * SIDE, make_grid(SIDE))
        particles = np.zeros(PARTICLES, Particle.dtype)
        particles["place"] = rng.uniform(-1, 1, (PARTICLES, 2))
        particles["speed"] = rng.uniform(-0.5, 0.5, (PARTICLES, 2))
        self.particles = device.mesh(particles, primitive=Primitive.POINTS)
        quads = np.zeros((GLYPHS, 4), Glyph.dtype)
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
        quads["position"] = rng.uniform(-1, 0.95, (GLYPHS, 1, 2)) + square * (0.03, 0.06)
        quads["at"] = rng.integers(0, 16, (GLYPHS, 1, 2)) / 16 + square / 16
        self.text = device.mesh(quads.ravel(), primitive=Primitive.QUADS)
        instances = np.zeros(CUBES, Instance.dtype)
        instances["offset"], instances["turn"] = rng.uniform(-4, 4, (CUBES, 3)), rng.uniform(0, 6, CUBES)
        self.cubes = device.mesh(make_cube(), instances=instances)

    def run(self, name: str, fast: bool) -> Callable[[int], None]:
        """Return the function that draws one frame of a program and waits for the device."""
        work = self.make_work(name, fast)

        def draw(_: int) -> None:
            work()
            self.device.finish()

        return draw

    def make_work(self, name: str, fast: bool) -> Callable[[], None]:
        """Return the function that draws one frame of a program."""
        device, frame, target = self.device, self.frames[0], self.color

        def clear() -> None:
            with device.render_pass(target, clear=(0, 0, 0, 1)):
                pass

        if name == "empty":
            return clear
        shader = SHADERS[name]
        program: rhi.Program[...] = device.program(make_fast(shader) if fast else shader)
        meshes = {
            "terrain": self.grid, "particles": self.particles, "text": self.text, "cubes": self.cubes,
            "pow_triangle": self.triangle,
        }  # fmt: skip
        mesh = meshes.get(name, self.screen)
        blend = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
        flat = device.states(DepthTest.OFF, DepthWrite.OFF, CullMode.NONE)
        blended = device.states(DepthTest.OFF, DepthWrite.OFF, CullMode.NONE, blend)

        def draw_flat() -> None:
            with device.render_pass(target, clear=(0, 0, 0, 1)), flat:
                device.draw(program, mesh, frame=frame)

        def draw_solid() -> None:
            cleared = device.render_pass(target, self.depth, clear=(0, 0, 0, 1), clear_depth=0.0)
            with cleared, device.states(CullMode.NONE):
                if name == "cubes":
                    device.draw(program, mesh, CUBES, frame=frame)
                else:
                    device.draw(program, mesh, heights=self.heights)

        def draw_blended() -> None:
            with device.render_pass(target, clear=(0, 0, 0, 1)), blended:
                if name == "text":
                    device.draw(program, mesh, glyphs=self.image)
                else:
                    device.draw(program, mesh, frame=frame)

        def draw_blur() -> None:
            for source, goal, direction in (
                (self.image, self.middle, self.frames[0]), (self.middle, target, self.frames[1]),
            ):  # fmt: skip
                with device.render_pass(goal), flat:
                    device.draw(program, self.screen, frame=direction, image=source)

        work: dict[str, Callable[[], None]] = {
            "terrain": draw_solid, "cubes": draw_solid, "blur": draw_blur,
            "particles": draw_blended, "text": draw_blended,
        }  # fmt: skip
        return work.get(name, draw_flat)


OPTIONS: Final = (
    options.rounds("rounds", 21),
    options.size((640, 360)),
    options.some("--only", ["empty", *SHADERS], "is no program", ["empty", *SHADERS], "all"),
    options.choice("--kernels", "which kernels cl runs", ("optimised", "quick"), "optimised"),
)


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of each program's frame on both backends in milliseconds, and their ratios."""
    os.environ["RHI_KERNELS"] = given.kernels
    with ExitStack() as stack:
        if given.kernels == "quick":  # the optimised ones of the cache would be taken instead
            os.environ["RHI_CACHE"] = stack.enter_context(tempfile.TemporaryDirectory())
        benches = {backend: Bench(backend, given.size) for backend in ("gl", "cl")}
        for bench in benches.values():
            stack.callback(bench.device.close)
        for name in given.only:
            for fast in (False,) if name == "empty" else (False, True):
                about = {"program": name, "precision": "fast" if fast else "default"}
                subjects = [
                    Subject(about | {"backend": backend}, bench.run(name, fast), device=bench.device)
                    for backend, bench in benches.items()
                ]
                yield from compare(subjects, COLUMNS, range(given.rounds), warm_ups=3)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
