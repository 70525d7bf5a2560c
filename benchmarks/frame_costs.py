"""What frames cost through rhi on gl, compared with bare moderngl that does the same work in the same context.

Each frame is finished within its time, because llvmpipe runs the GPU's work on the same cores. `ratio` is the median of
the ratios to moderngl in the same round, in processor time. Both take turns in one process. Memory that is made anew,
as in `mesh made`, takes less time while the C library has freed pages: 9,000 page faults are 10 ms.

    python benchmarks/frame_costs.py [--json] [--rounds 21] [--triangles 2000000]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np

import rhi
import rhi.shading as sl
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import DepthTest, Format, Primitive
from rhi.backends.gl.backend import GlBackend

SIZE = (1280, 720)
POINTS = 4096
SPRITE = np.dtype([("position", "f4", 3), ("tint", "u1", 4)])
SIDES = np.array([(0, 0, 0), (0.005, 0, 0), (0.005, 0.005, 0), (0, 0.005, 0)], "f4")


class Place(sl.Struct):
    position: sl.vec3


class Plain(sl.Shader):
    def vertex(self, v: Place) -> sl.vec4:
        return sl.vec4(v.position, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class Step(sl.Shader):
    work_group = (64,)
    places: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        self.places[i] = self.places[i] * 0.999


class Show(sl.Shader):
    places: sl.Storage[sl.vec4]

    def vertex(self) -> sl.vec4:
        return self.places[sl.vertex_index()]

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


WHITE = "#version 430\nout vec4 c; void main() { c = vec4(1.0); }"
FORWARDED = "#version 430\nin vec3 position; void main() { gl_Position = vec4(position, 1.0); }"
STORED = "layout(std430, binding=0) buffer P { vec4 p[]; };"
STEP = f"""#version 430
layout(local_size_x=64) in; {STORED}
void main() {{ p[gl_GlobalInvocationID.x] = p[gl_GlobalInvocationID.x] * 0.999; }}"""
SHOWN = f"#version 430\n{STORED} void main() {{ gl_Position = p[gl_VertexID]; }}"


def list_frames(device: rhi.Device, triangles: int) -> dict[str, tuple[Callable[[], object], Callable[[], object]]]:
    """Return each frame twice: as moderngl draws it, and through the device."""
    context, side = device.backend_as(GlBackend).context, max(2, int((triangles / 2) ** 0.5) + 1)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, side, dtype="f4")] * 2, [0.5]), -1).reshape(-1, 3).astype("f4")
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    quad = (0, 1, side, side, 1, side + 1)
    indices = (corner[:, None] + quad).ravel().astype("u4")
    white = context.program(vertex_shader=FORWARDED, fragment_shader=WHITE)
    image, depth = device.texture(SIZE, Format.RGBA8), device.texture(SIZE, Format.D24)
    samples, sampled_depth = device.texture(SIZE, Format.RGBA8, samples=4), device.texture(SIZE, Format.D24, samples=4)
    target = context.framebuffer([context.texture(SIZE, 4)], context.depth_texture(SIZE))
    many = context.framebuffer([context.renderbuffer(SIZE, 4, samples=4)], context.depth_renderbuffer(SIZE, samples=4))
    rows = grid.view([("position", "f4", 3)]).ravel()
    plain, mesh = device.program(Plain), device.mesh(rows, indices)
    array, brief = min(len(indices), 60_000), rows[:100_000]
    vertices = context.buffer(grid)
    bare = context.vertex_array(white, [(vertices, "3f", "position")], context.buffer(indices))
    written = device.buffer(np.zeros(len(rows), rows.dtype))
    points = np.random.default_rng(1).random((POINTS, 4), np.float32)
    storage, dots = device.storage(sl.vec4, points), device.mesh(POINTS, primitive=Primitive.POINTS)
    sprites = np.random.default_rng(1).uniform(-1, 1, (10_000, 1, 3)).astype("f4")
    quads = (np.arange(10_000)[:, None] * 4 + (0, 1, 2, 0, 2, 3)).ravel().astype("u4")
    sent = context.buffer(reserve=40_000 * SPRITE.itemsize)
    bare_sprites = context.vertex_array(white, [(sent, "3f 4x1", "position")], context.buffer(quads))
    step, show = device.program(Step), device.program(Show)
    bare_step = context.compute_shader(STEP)
    bare_dots = context.vertex_array(context.program(vertex_shader=SHOWN, fragment_shader=WHITE), [])
    bare_storage = context.buffer(points)

    def frame(draw: Callable[[], object], read: Callable[[], object] = device.finish) -> Callable[[], object]:
        def run() -> None:
            with device.render_pass(image, depth, clear=(0, 0, 0, 1), clear_depth=0.0):
                draw()
            device.present()
            read()

        return run

    def bare_frame(draw: Callable[[], object], read: Callable[[], object] = context.finish) -> Callable[[], object]:
        def run() -> None:
            target.use()
            target.clear()
            context.enable_only(moderngl.DEPTH_TEST)
            draw()
            read()

        return run

    def make() -> None:
        device.mesh({"position": grid}, indices).destroy()
        device.finish()

    def bare_make() -> None:
        made: list[Any] = [context.buffer(grid), context.buffer(indices)]
        made.append(context.vertex_array(white, [(made[0], "3f", "position")], made[1]))
        context.finish()
        for each in reversed(made):
            each.release()

    def resolve() -> None:
        with device.render_pass(samples, sampled_depth, clear=(0, 0, 0, 1), clear_depth=0.0, resolve=image):
            device.draw(plain, mesh.view(0, array))
        device.present()
        device.finish()

    def bare_resolve() -> None:
        many.use()
        many.clear()
        context.enable_only(moderngl.DEPTH_TEST)
        bare.render(vertices=array)
        context.copy_framebuffer(target, many)
        context.finish()

    def alternate() -> None:
        for _ in range(50):
            device.dispatch(step, POINTS // 64, places=storage)
            with device.render_pass(image), device.states(DepthTest.OFF):
                device.draw(show, dots, places=storage)
        device.present()
        device.finish()

    def bare_alternate() -> None:
        target.use()
        context.disable(moderngl.DEPTH_TEST)
        bare_storage.bind_to_storage_buffer(0)
        for _ in range(50):
            bare_step.run(POINTS // 64)
            context.memory_barrier()
            bare_dots.render(moderngl.POINTS, vertices=POINTS)
        context.finish()

    def upload(buffer: moderngl.Buffer, rows: np.ndarray, array: moderngl.VertexArray, count: int = -1) -> None:
        buffer.orphan()
        buffer.write(rows)
        array.render(vertices=count)

    def build() -> np.ndarray:
        rows = np.zeros((10_000, 4), SPRITE)
        rows["position"], rows["tint"] = sprites + SIDES, 255
        return rows.ravel()

    def write() -> None:
        written.write(rows)
        device.finish()

    return {
        "empty, cleared": (bare_frame(lambda: None), frame(lambda: None)),
        "mesh made": (bare_make, make),
        "mesh drawn": (bare_frame(bare.render), frame(lambda: device.draw(plain, mesh))),
        "vertices written": (bare_frame(lambda: vertices.write(grid)), frame(lambda: None, write)),
        "transient mesh": (
            bare_frame(lambda: upload(vertices, grid[: len(brief)], bare, 3)),
            frame(lambda: device.draw(plain, device.transient.mesh(plain, brief).view(0, 3))),
        ),
        "10,000 sprites built": (
            bare_frame(lambda: upload(sent, build(), bare_sprites)),
            frame(lambda: device.draw(plain, device.transient.mesh(plain, build(), quads))),
        ),
        "image read": (
            bare_frame(lambda: bare.render(vertices=3), lambda: np.frombuffer(target.read(components=4), "u1")),
            frame(lambda: device.draw(plain, mesh.view(0, 3)), image.read),
        ),
        "4 samples, resolved": (bare_resolve, resolve),
        "50 dispatches and draws": (bare_alternate, alternate),
    }


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield a row of each frame for moderngl and for rhi."""
    with rhi.create_device("gl") as device:
        for name, pair in list_frames(device, given.triangles).items():
            subjects = [
                Subject({"frame": name, "variant": variant}, lambda _, run=run: run(), device.make_current)
                for variant, run in zip(("moderngl", "rhi"), pair, strict=True)
            ]
            columns = {"milliseconds": time(processor=True), "ratio": ratio(processor=True)}
            yield from compare(subjects, columns, range(given.rounds), warm_ups=3)


OPTIONS = (
    options.rounds("rounds", 21),
    options.count("--triangles", "triangles of the mesh", 2_000_000),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
