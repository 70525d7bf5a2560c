"""Small programs, such as those that examples and first steps consist of, on OpenCL and on Mesa's llvmpipe.

- pow_triangle: a triangle lit with `pow`.
- spheres: 64 steps of ray marching a pixel.
- julia: up to 64 steps a pixel, which end earlier for most.
- blur: nine bilinear samples a pixel, in two passes.
- particles: 20,000 blended points.
- text: 2,000 blended quads, whose alpha is a texture.

Both backends take turns, round by round, in one process, with the shaders' default precision and with FAST. A
time runs from the first command until the device is finished; figures are medians over the rounds. `ratio` is
gl's time divided by cl's, by the clock; `processor` is the same of the processor time of all threads. Above
1, cl is faster. `empty` is a pass that only clears: what a frame costs before anything is drawn.

`--kernels optimised`, the default, measures the kernels that a program draws with after some frames, and from
the start if they are in the cache. `--kernels quick` measures those that it draws with until then, in an
empty cache.

    python benchmarks/small_programs.py [--json] [--rounds 21] [--size 640x360] [--only julia,blur] [--kernels
    quick]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Final

import numpy as np

import rhi
import rhi.shading as sl
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import BlendFactor, BlendFunction, CullMode, DepthTest, DepthWrite, Format, Primitive

COLUMNS: Final = {
    "milliseconds": time(),
    "times as fast": ratio(2, inverse=True),
    "processor": ratio(2, processor=True, inverse=True),
}
SIDE: Final = 256
PARTICLES: Final = 20_000
GLYPHS: Final = 2000


class Corner(sl.Struct):
    position: sl.vec2


class Frame(sl.Struct):
    size: sl.vec2
    time: float


class Textured(sl.Struct):
    clip: sl.vec4
    uv: sl.vec2


class Bump(sl.Struct):
    clip: sl.vec4
    normal: sl.vec3


class Particle(sl.Struct):
    position: sl.vec2
    speed: sl.vec2


class Glyph(sl.Struct):
    position: sl.vec2
    uv: sl.vec2


class PowTriangle(sl.Shader):
    frame: sl.Uniform[Frame]

    def vertex(self, v: Corner) -> Bump:
        return Bump(clip=sl.vec4(v.position * 0.8, 0.5, 1.0), normal=sl.vec3(v.position, 1.0))

    def fragment(self, b: Bump) -> sl.vec4:
        shine = sl.pow(sl.max(sl.normalize(b.normal).z, 0.0), 2.2 + self.frame.time)
        return sl.vec4(sl.vec3(0.9, 0.5, 0.2) * shine, 1.0)


class Spheres(sl.Shader):
    frame: sl.Uniform[Frame]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        size = self.frame.size
        pixel = sl.fragment_coordinate()
        ray = sl.normalize(sl.vec3((pixel.x - 0.5 * size.x) / size.y, (pixel.y - 0.5 * size.y) / size.y, 1.0))
        moved = sl.sin(self.frame.time) * 0.5
        travelled = 0.0
        nearest = 1.0
        for _ in range(64):
            position = ray * travelled - sl.vec3(moved, 0.0, 3.0)
            nearest = sl.min(sl.length(position) - 1.0, sl.length(position - sl.vec3(1.5, 0.2, 0.5)) - 0.5)
            if nearest < 0.001 or travelled > 10.0:
                break
            travelled += nearest
        return sl.vec4(sl.vec3(1.0 / (1.0 + travelled)), 1.0)


class Julia(sl.Shader):
    frame: sl.Uniform[Frame]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        pixel = sl.fragment_coordinate()
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
        return sl.vec4(sl.vec3(steps / 64.0), 1.0)


class Blur(sl.Shader):
    frame: sl.Uniform[Frame]
    image: sl.Texture2D

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        uv = sl.fragment_coordinate()
        position = sl.vec2(uv.x, uv.y) / self.frame.size
        step = sl.vec2(self.frame.time, 1.0 - self.frame.time) * 1.5 / self.frame.size
        sum = self.image.sample(position) * 0.2
        for i in range(1, 5):
            sum += self.image.sample(position + step * float(i)) * 0.1
            sum += self.image.sample(position - step * float(i)) * 0.1
        return sum


class Particles(sl.Shader):
    frame: sl.Uniform[Frame]

    def vertex(self, p: Particle) -> Textured:
        return Textured(clip=sl.vec4(p.position + p.speed * sl.sin(self.frame.time), 0.5, 1.0), uv=p.speed)

    def fragment(self, t: Textured) -> sl.vec4:
        return sl.vec4(0.5 + t.uv.x, 0.5, 0.5 + t.uv.y, 0.25)


class Text(sl.Shader):
    glyphs: sl.Texture2D

    def vertex(self, g: Glyph) -> Textured:
        return Textured(clip=sl.vec4(g.position, 0.5, 1.0), uv=g.uv)

    def fragment(self, t: Textured) -> sl.vec4:
        return sl.vec4(1.0, 1.0, 1.0, self.glyphs.sample(t.uv).x)


SHADERS: Final[dict[str, type[sl.Shader]]] = {
    "pow_triangle": PowTriangle,
    "spheres": Spheres,
    "julia": Julia,
    "blur": Blur,
    "particles": Particles,
    "text": Text,
}


def make_fast(shader: type[sl.Shader]) -> type[sl.Shader]:
    """Return the same shader with `Precision.FAST`."""
    return type(shader)(f"Fast{shader.__name__}", (shader,), {"precision": sl.Precision.FAST})


class Bench:
    """The programs of the benchmark on one device."""

    def __init__(self, backend: str, size: tuple[int, int]) -> None:
        device = self.device = rhi.create_device(backend)
        rng = np.random.default_rng(0)
        self.color = device.texture(size, Format.RGBA8)
        self.median_of = device.texture(size, Format.RGBA8)
        self.image = device.texture(rng.integers(0, 256, (SIDE, SIDE, 4), np.uint8), Format.RGBA8)
        self.frames = [device.uniform(Frame(size=size, time=time)) for time in (0.0, 1.0)]
        self.screen = device.mesh({"position": np.array([(-1, -1), (3, -1), (-1, 3)], np.float32)})
        self.triangle = device.mesh({"position": np.array([(-1, -1), (1, -1), (0, 1)], np.float32)})
        particles = np.zeros(PARTICLES, Particle.dtype)
        particles["position"] = rng.uniform(-1, 1, (PARTICLES, 2))
        particles["speed"] = rng.uniform(-0.5, 0.5, (PARTICLES, 2))
        self.particles = device.mesh(particles, primitive=Primitive.POINTS)
        quads = np.zeros((GLYPHS, 4), Glyph.dtype)
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
        quads["position"] = rng.uniform(-1, 0.95, (GLYPHS, 1, 2)) + square * (0.03, 0.06)
        quads["uv"] = rng.integers(0, 16, (GLYPHS, 1, 2)) / 16 + square / 16
        self.text = device.mesh(quads.ravel(), primitive=Primitive.QUADS)

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
        meshes = {"particles": self.particles, "text": self.text, "pow_triangle": self.triangle}
        mesh = meshes.get(name, self.screen)
        blend = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
        flat = device.states(DepthTest.OFF, DepthWrite.OFF, CullMode.NONE)
        blended = device.states(DepthTest.OFF, DepthWrite.OFF, CullMode.NONE, blend)

        def draw_flat() -> None:
            with device.render_pass(target, clear=(0, 0, 0, 1)), flat:
                device.draw(program, mesh, frame=frame)

        def draw_blended() -> None:
            with device.render_pass(target, clear=(0, 0, 0, 1)), blended:
                if name == "text":
                    device.draw(program, mesh, glyphs=self.image)
                else:
                    device.draw(program, mesh, frame=frame)

        def draw_blur() -> None:
            for source, goal, direction in (
                (self.image, self.median_of, self.frames[0]),
                (self.median_of, target, self.frames[1]),
            ):
                with device.render_pass(goal), flat:
                    device.draw(program, self.screen, frame=direction, image=source)

        return {"blur": draw_blur, "particles": draw_blended, "text": draw_blended}.get(name, draw_flat)


OPTIONS: Final = (
    options.rounds("rounds", 21),
    options.size((640, 360)),
    options.names("--only", ["empty", *SHADERS], "is no program", ["empty", *SHADERS], "all"),
    options.choice("--kernels", "which kernels cl runs", ("optimised", "quick"), "optimised"),
)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of each program's frame on both backends in milliseconds, and their ratios."""
    os.environ["RHI_KERNELS"] = arguments.kernels
    with ExitStack() as stack:
        if arguments.kernels == "quick":  # the optimised ones of the cache would be taken instead
            os.environ["RHI_CACHE"] = stack.enter_context(tempfile.TemporaryDirectory())
        benches = {backend: Bench(backend, arguments.size) for backend in ("gl", "cl")}
        for bench in benches.values():
            stack.callback(bench.device.close)
        for name in arguments.only:
            for fast in (False,) if name == "empty" else (False, True):
                labels = {"program": name, "precision": "fast" if fast else "default"}
                subjects = [
                    Subject(labels | {"backend": backend}, bench.run(name, fast), device=bench.device)
                    for backend, bench in benches.items()
                ]
                yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
