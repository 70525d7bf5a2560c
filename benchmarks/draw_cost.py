"""The cost of a draw through rhi, compared with bare moderngl doing the same OpenGL work with the same GL objects.

- `bare moderngl`: a loop that binds a range of a uniform buffer and renders a vertex array. It is the reference.
- `device.draw`, `program.draw`: the same draws through rhi. Each has its own vertex buffer and its own constants.
- `device.draw_many`: as many draws of one shared mesh in one call, with the constants as instance attributes.
- `bare, constants set`, `device.draw, value`: each draw's two constants are numbers of Python. The bare loop sets two
  uniforms of its program, ours passes a struct that is made for the draw; the first is the reference of the second.
- `scope of 3 states`: entering and leaving `device.states` with 3 states, without a draw.

The rows on `null` have what a scope of each kind costs around nothing, its creation included, on a device without a
recorder, so that no driver hides it. Their reference is `empty block`: a Python `with` block that does nothing. `ratio`
is the cost in such blocks. Timing is off, except in `timed event`.

The target has 64×64 pixels. The variants take turns, round by round, in one process. A figure is the time of all draws
of a round divided by their number, the median over the rounds; `ratio` is the median of the ratios to the bare loop of
the same round. The device is finished between rounds, outside of the measured time, because llvmpipe runs the GPU's
work on the same cores. Triangles stop before the rasteriser unless --rasterize is given: filling pixels costs all
variants the same, and would hide the differences.

    python benchmarks/draw_cost.py [--json] [--draws 2000] [--triangles 10] [--rounds 41] [--rasterize]
"""

from __future__ import annotations

import argparse
import gc
import itertools
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import moderngl
import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import ColorWrite, CullMode, DepthWrite
from rhi.backends.gl.backend import GlBackend
from rhi.backends.null import NullBackend
from rhi.shading import Shader, Struct, Uniform, vec2, vec4

RASTERIZER_DISCARD = 0x8C89


class Corner(Struct):
    position: vec2


class Camera(Struct):
    scale: vec4


class Object(Struct):
    offset: vec4
    color: vec4


class Varying(Struct):
    clip: vec4
    color: vec4


class Flat(Shader):
    """Reads its per-object constants from a range of a uniform buffer."""

    camera: Uniform[Camera]
    object: Uniform[Object]

    def vertex(self, v: Corner) -> Varying:
        place = vec4(v.position, 0.5, 1.0) * self.camera.scale + self.object.offset
        return Varying(clip=place, color=self.object.color)

    def fragment(self, v: Varying) -> vec4:
        return v.color


class CornerOfObject(Corner):
    offset: vec4
    color: vec4


class FlatMany(Shader):
    """Reads its per-object constants from instance attributes, which each draw selects by its base instance."""

    camera: Uniform[Camera]

    def vertex(self, v: CornerOfObject) -> Varying:
        place = vec4(v.position, 0.5, 1.0) * self.camera.scale + v.offset
        return Varying(clip=place, color=v.color)

    def fragment(self, v: Varying) -> vec4:
        return v.color


BARE_VERTEX = """#version 430
in vec2 position;
uniform vec4 offset;
void main() { gl_Position = vec4(position, 0.5, 1.0) + offset; }
"""
BARE_FRAGMENT = """#version 430
uniform vec4 color;
out vec4 shown;
void main() { shown = color; }
"""


def measure_draws(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the microseconds per draw of each variant, and its ratio to the bare loop."""
    draws, triangles = given.draws, given.triangles
    device = rhi.create_device("gl")
    backend = device.backend_as(GlBackend)
    program, many = device.program(Flat), device.program(FlatMany)
    random = np.random.default_rng(0)
    corners = (random.random((draws, triangles * 3, 2), np.float32) - 0.5) * 0.1
    meshes = [device.mesh({"position": part}) for part in corners]
    rows = np.zeros(draws, Object.dtype)
    rows["offset"][:, :2] = random.random((draws, 2)) * 1.8 - 0.9  # nothing needs clipping
    rows["color"] = random.random((draws, 4))
    objects = device.uniform_array(Object, draws)
    padded = np.zeros(draws, objects.dtype)
    for name in rows.dtype.names or ():
        padded[name] = rows[name]
    objects.write(padded)
    shared = device.mesh({"position": corners.reshape(-1, 2)}, instances=rows)
    camera = device.uniform(Camera(scale=(1, 1, 1, 1)))
    image = device.texture((64, 64), rhi.Format.RGBA8)
    ranges = [objects[i] for i in range(draws)]
    pairs = list(zip(meshes, ranges, strict=True))

    draw, own_draw, states = device.draw, program.draw, device.states

    def through_device() -> None:
        for mesh, constants in pairs:
            draw(program, mesh, camera=camera, object=constants)

    def through_program() -> None:
        for mesh, constants in pairs:
            own_draw(mesh, camera=camera, object=constants)

    parts = shared.draws(np.arange(draws) * triangles * 3, triangles * 3, base_instance=np.arange(draws))

    def many_draws() -> None:
        device.draw_many(many, shared, parts, camera=camera)

    def scopes() -> None:
        for _ in range(draws):
            with states(CullMode.NONE, DepthWrite.OFF, ColorWrite.OFF):
                pass

    with device.render_pass(image, clear=(0, 0, 0, 1)), device.states(CullMode.NONE):
        through_device()
    linked = backend._programs[program.id]
    buffer = backend._buffers.objects[objects.buffer.id]
    bare_pairs = [
        (linked._vertex_arrays[mesh.data.vertex_arrays[program]], constants.offset, constants.size)
        for mesh, constants in pairs
    ]
    mode, count = moderngl.TRIANGLES, triangles * 3

    def bare() -> None:
        for array, offset, size in bare_pairs:
            buffer.bind_to_uniform_block(1, offset, size)
            array.render(mode, count)

    bare_program = backend.context.program(vertex_shader=BARE_VERTEX, fragment_shader=BARE_FRAGMENT)
    position = backend.context.buffer(corners[0].tobytes())
    one = backend.context.vertex_array(bare_program, [(position, "2f", "position")])
    set_offset, set_color = bare_program["offset"], bare_program["color"]
    numbers = [tuple(map(tuple, (row["offset"].tolist(), row["color"].tolist()))) for row in rows]

    def bare_constants() -> None:
        for offset, color in numbers:
            set_offset.value, set_color.value = offset, color
            one.render(mode, count)

    mesh_of_one = meshes[0]

    def through_values() -> None:
        for offset, color in numbers:
            draw(program, mesh_of_one, camera=camera, object=Object(offset=offset, color=color))

    variants: dict[str, Callable[[], None]] = {
        "bare moderngl": bare,
        "device.draw": through_device,
        "program.draw": through_program,
        "device.draw_many": many_draws,
        "scope of 3 states": scopes,
    }
    if not given.rasterize:
        backend.gl.Enable(RASTERIZER_DISCARD)
    with ExitStack() as opened:

        def open_pass() -> None:
            opened.close()
            device.finish()
            opened.enter_context(device.render_pass(image, clear=(0, 0, 0, 1)))
            opened.enter_context(device.states(CullMode.NONE))
            # One untimed draw binds the program and the camera, which the bare loop does not bind itself.
            own_draw(meshes[0], camera=camera, object=ranges[0])

        def compare_variants(variants: dict[str, Callable[[], None]]) -> list[Record]:
            names = variants.items()
            subjects = [Subject({"variant": name}, lambda _, run=run: run(), open_pass) for name, run in names]
            return compare(subjects, {"microseconds": time(1e6 / draws), "ratio": ratio()}, range(given.rounds))

        gc.disable()
        costs = compare_variants(variants)
        costs += compare_variants({"bare, constants set": bare_constants, "device.draw, value": through_values})
        gc.enable()
    device.close()
    yield from costs


class EmptyBlock:
    """The least that a `with` block costs which is made anew each time."""

    __slots__ = ()

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


def measure_scopes(count: int, rounds: int) -> Iterator[Record]:
    """Yield the microseconds of a scope of each kind, and its ratio to an empty block."""
    device, timed = rhi.Device(NullBackend()), rhi.Device(NullBackend(), timing=True)
    image = device.texture((4, 4), rhi.Format.R8)
    query, answered = device.occlusion_query(), device.occlusion_query()
    emulated = device.occlusion_query(emulated=True)
    with device.render_pass(image), answered:
        pass
    states, event, conditional, timed_event = device.states, device.event, device.conditional, timed.event
    render_pass = device.render_pass

    def empty() -> None:
        for _ in itertools.repeat(None, count):
            with EmptyBlock():
                pass

    def scopes() -> None:
        for _ in itertools.repeat(None, count):
            with states(CullMode.NONE, DepthWrite.OFF, ColorWrite.OFF):
                pass

    def events() -> None:
        for _ in itertools.repeat(None, count):
            with event("label"):
                pass

    def timed_events() -> None:
        for _ in itertools.repeat(None, count):
            with timed_event("label"):
                pass

    def queries() -> None:
        for _ in itertools.repeat(None, count):
            query.begin()
            query.end()

    def blocks() -> None:
        for _ in itertools.repeat(None, count):
            with query:
                pass

    def emulated_queries() -> None:
        for _ in itertools.repeat(None, count):
            emulated.begin()
            emulated.end()

    def conditions() -> None:
        for _ in itertools.repeat(None, count):
            with conditional(answered):
                pass

    def passes() -> None:
        for _ in itertools.repeat(None, count):
            with render_pass(image):
                pass

    in_pass: dict[str, Callable[[], None]] = {
        "empty block": empty,
        "scope of 3 states": scopes,
        "event": events,
        "query.begin, query.end": queries,
        "with query": blocks,
        "emulated query": emulated_queries,
        "condition": conditions,
    }
    outside: dict[str, Callable[[], None]] = {"timed event": timed_events, "render pass": passes}
    with ExitStack() as opened:

        def open_pass(name: str) -> None:
            opened.close()
            for each in (device, timed):
                each.present()
                each.finish()
            if name in in_pass:
                opened.enter_context(render_pass(image))

        subjects = [
            Subject({"variant": name}, lambda _, run=run: run(), lambda name=name: open_pass(name))
            for name, run in (in_pass | outside).items()
        ]
        columns = {"microseconds": time(1e6 / count, processor=True), "ratio": ratio(processor=True)}
        gc.disable()
        rows = compare(subjects, columns, range(rounds))
        gc.enable()
    device.close()
    timed.close()
    yield from rows


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of draws, and those of scopes around nothing on the null device."""
    for row in measure_draws(given):
        yield {"on": "gl", **row}
    for row in measure_scopes(1000, given.rounds):
        yield {"on": "null", **row}


OPTIONS = (
    options.count("--draws", "draws per round", 2000),
    options.count("--triangles", "triangles per draw", 10),
    options.rounds("rounds", 41),
    options.switch("--rasterize", "let the triangles reach the rasteriser"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
