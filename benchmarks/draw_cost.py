"""The cost of a draw through rhi, compared with bare moderngl doing the same OpenGL work with the same GL
objects.

- `bare moderngl`: a loop that binds a range of a uniform buffer and renders a vertex array. It is the
  reference.
- `device.draw`, `program.draw`: the same draws through rhi. Each has its own vertex buffer and its own
  constants.
- `device.draw, one mesh`, `scope around device.draw`: the same with one vertex buffer for all, and with a
  state each.
- `device.draw_many`: as many draws of one shared mesh in one call, with the constants as instance attributes.
- `bare, constants set`, `device.draw, value`: each draw's two constants are numbers of Python. The bare loop
  sets two uniforms of its program, ours passes a struct that is made for the draw; the first is the reference
  of the second.
- `scope of 3 states`: entering and leaving `device.states` with 3 states, without a draw.

With --wgpu the same draws on wgpu take turns with these, and with `bare wgpu-py`: its public calls, with
objects of its own. They are timed until the pass ends, without its submission.

The rows on `null` have what a scope of each kind costs around nothing, its creation included, on a device
without a recorder, so that no driver hides it. Their reference is `empty block`: a Python `with` block that
does nothing. `ratio` is the cost in such blocks. Timing is off, except in `timed event`.

The target has 64×64 pixels. The variants take turns, round by round, in one process. A figure is the time of
all draws of a round divided by their number, the median over the rounds; `ratio` is the median of the ratios
to the bare loop of the same round. The device is finished between rounds, outside of the measured time,
because llvmpipe runs the GPU's work on the same cores. Triangles stop before the rasteriser unless
--rasterize is given: filling pixels costs all variants the same, and would hide the differences.

    python benchmarks/draw_cost.py [--json] [--draws 2000] [--triangles 10] [--rounds 41] [--rasterize]
    [--wgpu]

In a page it measures the web backend, whole frames with their submission, against loops of JavaScript that make
the same calls of WebGPU. `one mesh`: the vertex buffer is set once. `value`: each draw's constants are numbers.
`all set`: as most programs have it, each draw also sets the pipeline, and passes its offsets as a new array.
`another pass each frame`: a further draw has another number of instances in each frame, so no pass is repeated.
`another order each frame`: the draws are shuffled, so hardly two of them follow on each other as before.

    RHI_WEB_DAWN_OPTIONS=backend=null python scripts/run_in_node.py benchmarks/draw_cost.py --draws 1000
"""

from __future__ import annotations

import argparse
import gc
import itertools
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import ColorWrite, CullMode, DepthWrite
from rhi.backends.null import NullBackend
from rhi.contract.descriptors import Stage
from rhi.shading import Shader, Struct, Uniform, compile_shader, vec2, vec4

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
        position = vec4(v.position, 0.5, 1.0) * self.camera.scale + self.object.offset
        return Varying(clip=position, color=self.object.color)

    def fragment(self, v: Varying) -> vec4:
        return v.color


class CornerOfObject(Corner):
    offset: vec4
    color: vec4


class FlatMany(Shader):
    """Reads its per-object constants from instance attributes, which each draw selects by its base
    instance."""

    camera: Uniform[Camera]

    def vertex(self, v: CornerOfObject) -> Varying:
        position = vec4(v.position, 0.5, 1.0) * self.camera.scale + v.offset
        return Varying(clip=position, color=v.color)

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


class Work:
    """The draws of a round on a device: as many meshes, each with its own vertices and constants."""

    def __init__(self, backend: str, draws: int, triangles: int) -> None:
        device = self.device = rhi.create_device(backend)
        random = np.random.default_rng(0)
        self.count = triangles * 3
        self.corners = (random.random((draws, self.count, 2), np.float32) - 0.5) * 0.1
        self.rows = np.zeros(draws, Object.dtype)
        self.rows["offset"][:, :2] = random.random((draws, 2)) * 1.8 - 0.9  # nothing needs clipping
        self.rows["color"] = random.random((draws, 4))
        self.objects = device.uniform_array(Object, draws)
        padded = np.zeros(draws, self.objects.dtype)
        for name in self.rows.dtype.names or ():
            padded[name] = self.rows[name]
        self.objects.write(padded)
        self.camera = device.uniform(Camera(scale=(1, 1, 1, 1)))
        self.program, self.meshes = (
            device.program(Flat),
            [device.mesh({"position": part}) for part in self.corners],
        )
        self.ranges = [self.objects[i] for i in range(draws)]
        self.pairs = list(zip(self.meshes, self.ranges, strict=True))
        self.image = device.texture((64, 64), rhi.Format.RGBA8)

    def list_variants(self) -> dict[str, Callable[[], None]]:
        """The draws through rhi, by name."""
        device, camera, draws, first = self.device, self.camera, len(self.pairs), self.meshes[0]
        draw, own_draw, states, program = device.draw, self.program.draw, device.states, self.program

        def through_device() -> None:
            for mesh, constants in self.pairs:
                draw(program, mesh, camera=camera, object=constants)

        def through_program() -> None:
            for mesh, constants in self.pairs:
                own_draw(mesh, camera=camera, object=constants)

        def with_one_mesh() -> None:
            for constants in self.ranges:
                draw(program, first, camera=camera, object=constants)

        def in_scopes() -> None:
            for mesh, constants in self.pairs:
                with states(DepthWrite.OFF):
                    draw(program, mesh, camera=camera, object=constants)

        shared = device.mesh({"position": self.corners.reshape(-1, 2)}, instances=self.rows)
        many = device.program(FlatMany)
        parts = shared.draws(np.arange(draws) * self.count, self.count, base_instance=np.arange(draws))

        def many_draws() -> None:
            device.draw_many(many, shared, parts, camera=camera)

        def scopes() -> None:
            for _ in range(draws):
                with states(CullMode.NONE, DepthWrite.OFF, ColorWrite.OFF):
                    pass

        return {
            "device.draw": through_device,
            "program.draw": through_program,
            "device.draw, one mesh": with_one_mesh,
            "scope around device.draw": in_scopes,
            "device.draw_many": many_draws,
            "scope of 3 states": scopes,
        }

    def open_pass(self, opened: ExitStack) -> None:
        """Begin a pass to draw in, after what the last subject has drawn is finished."""
        opened.close()
        self.device.finish()
        opened.enter_context(self.device.render_pass(self.image, clear=(0, 0, 0, 1)))
        opened.enter_context(self.device.states(CullMode.NONE))
        # One untimed draw binds the program and the camera, which the bare loop does not bind itself.
        self.program.draw(self.meshes[0], camera=self.camera, object=self.ranges[0])


def make_bare_gl(work: Work) -> Callable[[], None]:
    """Return a loop of moderngl that does the same OpenGL work with the same objects."""
    import moderngl

    from rhi.backends.gl.gl_backend import GlBackend

    backend = work.device.backend_as(GlBackend)
    linked = backend._programs[work.program.id]
    buffer = backend._buffers.objects[work.objects.buffer.id]
    pairs = [
        (linked._vertex_arrays[mesh.data.vertex_arrays[work.program]], constants.offset, constants.size)
        for mesh, constants in work.pairs
    ]
    mode, count = moderngl.TRIANGLES, work.count

    def bare() -> None:
        for array, offset, size in pairs:
            buffer.bind_to_uniform_block(1, offset, size)
            array.render(mode, count)

    return bare


def make_bare_wgpu(work: Work, opened: ExitStack) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return a loop of wgpu-py's public calls that draws the same, with objects of its own, and what opens
    its pass."""
    import wgpu

    from rhi.backends.wgpu.wgpu_backend import WgpuBackend

    device: Any = work.device.backend_as(WgpuBackend).device
    stages = {
        stage: compile_shader(Flat).emit("wgsl", stage).text for stage in (Stage.VERTEX, Stage.FRAGMENT)
    }
    modules = {stage: device.create_shader_module(code=text) for stage, text in stages.items()}
    uniform = {"type": "uniform", "has_dynamic_offset": True}
    visible = wgpu.ShaderStage.VERTEX | wgpu.ShaderStage.FRAGMENT
    layout = device.create_bind_group_layout(
        entries=[{"binding": 2 * slot, "visibility": visible, "buffer": uniform} for slot in range(2)]
    )
    attribute = {"format": "float32x2", "offset": 0, "shader_location": 0}
    pipeline = device.create_render_pipeline(
        layout=device.create_pipeline_layout(bind_group_layouts=[layout]),
        vertex={
            "module": modules[Stage.VERTEX],
            "entry_point": "main",
            "buffers": [{"array_stride": 8, "attributes": [attribute]}],
        },
        fragment={
            "module": modules[Stage.FRAGMENT],
            "entry_point": "main",
            "targets": [{"format": "rgba8unorm"}],
        },
    )
    usage = wgpu.BufferUsage
    camera = device.create_buffer_with_data(data=np.ones(4, np.float32), usage=usage.UNIFORM)
    padded = np.zeros((len(work.pairs), 64), np.float32)
    padded[:, :8] = work.rows.view(np.float32).reshape(-1, 8)
    objects = device.create_buffer_with_data(data=padded, usage=usage.UNIFORM)
    sizes = {0: (camera, 16), 1: (objects, 32)}
    entries = [
        {"binding": 2 * n, "resource": {"buffer": b, "offset": 0, "size": s}} for n, (b, s) in sizes.items()
    ]
    group = device.create_bind_group(layout=layout, entries=entries)
    buffers = [device.create_buffer_with_data(data=part, usage=usage.VERTEX) for part in work.corners]
    pairs = [(uniform_buffer, 256 * number) for number, uniform_buffer in enumerate(buffers)]
    view = device.create_texture(
        size=(64, 64, 1), format="rgba8unorm", usage=wgpu.TextureUsage.RENDER_ATTACHMENT
    )
    target = {
        "view": view.create_view(),
        "load_op": "clear",
        "store_op": "store",
        "clear_value": (0, 0, 0, 1),
    }
    passes: list[Any] = []

    def open_pass() -> None:
        opened.close()
        encoder = device.create_command_encoder()
        passes[:] = [encoder.begin_render_pass(color_attachments=[target])]
        passes[0].set_pipeline(pipeline)
        opened.callback(lambda: device.queue.submit([encoder.finish()]))
        opened.callback(passes[0].end)

    def bare() -> None:
        to, count = passes[0], work.count
        for buffer, offset in pairs:
            to.set_bind_group(0, group, [0, offset])
            to.set_vertex_buffer(0, buffer)
            to.draw(count)

    return bare, open_pass


def measure_draws(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the microseconds per draw of each variant, and its ratio to the bare loop."""
    import moderngl

    from rhi.backends.gl.gl_backend import GlBackend

    work = Work("gl", arguments.draws, arguments.triangles)
    devices, gl_backend = [work.device], work.device.backend_as(GlBackend)
    with ExitStack() as opened:
        variants = work.list_variants()
        work.open_pass(opened)
        variants["device.draw"]()  # makes the vertex arrays that the bare loop draws
        opened.close()
        bare_program = gl_backend.context.program(vertex_shader=BARE_VERTEX, fragment_shader=BARE_FRAGMENT)
        position = gl_backend.context.buffer(work.corners[0].tobytes())
        vertex_array = gl_backend.context.vertex_array(bare_program, [(position, "2f", "position")])
        set_offset, set_color = bare_program["offset"], bare_program["color"]
        numbers = [tuple(map(tuple, (row["offset"].tolist(), row["color"].tolist()))) for row in work.rows]

        def bare_constants() -> None:
            for offset, color in numbers:
                set_offset.value, set_color.value = offset, color
                vertex_array.render(moderngl.TRIANGLES, work.count)

        def through_values() -> None:
            draw, mesh, camera = work.device.draw, work.meshes[0], work.camera
            for offset, color in numbers:
                draw(work.program, mesh, camera=camera, object=Object(offset=offset, color=color))

        def subjects(work: Work, variants: dict[str, Callable[[], None]]) -> list[Subject]:
            names, on = variants.items(), work.device.backend_name
            return [
                Subject({"on": on, "variant": name}, lambda _, run=run: run(), lambda: work.open_pass(opened))
                for name, run in names
            ]

        def compare_all(subjects: list[Subject]) -> list[Record]:
            return compare(
                subjects,
                {"microseconds": time(1e6 / arguments.draws), "ratio": ratio()},
                range(arguments.rounds),
            )

        if not arguments.rasterize:
            gl_backend.gl.Enable(RASTERIZER_DISCARD)
        rows = subjects(work, {"bare moderngl": make_bare_gl(work), **variants})
        if arguments.wgpu:
            other = Work("wgpu", arguments.draws, arguments.triangles)
            devices.append(other.device)
            bare, open_bare = make_bare_wgpu(other, opened)
            rows.append(Subject({"on": "wgpu", "variant": "bare wgpu-py"}, lambda _: bare(), open_bare))
            rows += subjects(other, other.list_variants())
        gc.disable()
        costs = compare_all(rows)
        costs += compare_all(
            subjects(work, {"bare, constants set": bare_constants, "device.draw, value": through_values})
        )
        gc.enable()
    for device in devices:
        device.close()
    yield from costs


BARE_JAVASCRIPT = """(device, texts, corners, numbers, draws) => {
  const [vertex, fragment] = texts.map((code) => device.createShaderModule({code}));
  const uniform = {type: "uniform", hasDynamicOffset: true}, uniforms = 0x48, vertices = 0x28;
  const layout = device.createBindGroupLayout(
    {entries: [0, 2].map((binding) => ({binding, visibility: 3, buffer: uniform}))});
  const attributes = [{format: "float32x2", offset: 0, shaderLocation: 0}];
  const pipeline = device.createRenderPipeline({
    layout: device.createPipelineLayout({bindGroupLayouts: [layout]}),
    vertex: {module: vertex, entryPoint: "main", buffers: [{arrayStride: 8, attributes}]},
    fragment: {module: fragment, entryPoint: "main", targets: [{format: "rgba8unorm"}]},
  });
  const fill = (data, usage) => {
    const buffer = device.createBuffer({size: data.byteLength, usage});
    device.queue.writeBuffer(buffer, 0, data);
    return buffer;
  };
  const camera = fill(new Float32Array([1, 1, 1, 1]), uniforms);
  const constants = new Float32Array(64 * draws);
  const rows = [], meshes = [], count = corners.length / 2 / draws;
  for (let i = 0; i < draws; i++) {
    constants.set(numbers.subarray(8 * i, 8 * i + 8), 64 * i);
    rows.push({offset: Array.from(numbers.subarray(8 * i, 8 * i + 4)),
               color: Array.from(numbers.subarray(8 * i + 4, 8 * i + 8))});
    meshes.push(fill(corners.slice(2 * count * i, 2 * count * (i + 1)), vertices));
  }
  const objects = fill(constants, uniforms);
  const resources = [{buffer: camera, size: 16}, {buffer: objects, size: 32}];
  const entries = resources.map((resource, i) => ({binding: 2 * i, resource}));
  const group = device.createBindGroup({layout, entries});
  const target = device.createTexture({size: [64, 64], format: "rgba8unorm", usage: 0x11});
  const clear = {loadOp: "clear", storeOp: "store", clearValue: [0, 0, 0, 1]};
  const offsets = new Uint32Array(2);
  return (own, values, all) => {
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginRenderPass({colorAttachments: [{view: target.createView(), ...clear}]});
    pass.setPipeline(pipeline);
    pass.setVertexBuffer(0, meshes[0]);
    for (let i = 0; i < draws; i++) {
      if (values) {
        constants.set(rows[i].offset, 64 * i);
        constants.set(rows[i].color, 64 * i + 4);
      }
      if (all) {
        pass.setPipeline(pipeline);
        pass.setBindGroup(0, group, [0, 256 * i]);
        pass.setVertexBuffer(0, meshes[0]);
      } else {
        offsets[1] = 256 * i;
        pass.setBindGroup(0, group, offsets, 0, 2);
      }
      if (own) pass.setVertexBuffer(0, meshes[i]);
      pass.draw(count);
    }
    pass.end();
    if (values) device.queue.writeBuffer(objects, 0, constants);
    device.queue.submit([encoder.finish()]);
  };
}"""


def measure_frames(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the microseconds per draw of frames in a page, and their ratios to the same loop in JavaScript."""
    from pyodide.code import run_js
    from pyodide.ffi import to_js

    from rhi.backends.web.web_backend import WebBackend

    work = Work("web", arguments.draws, arguments.triangles)
    device, program = work.device, work.program
    shader = compile_shader(Flat)
    texts = [shader.emit("wgsl", stage).text for stage in (Stage.VERTEX, Stage.FRAGMENT)]
    numbers = np.stack([work.rows["offset"], work.rows["color"]], 1)
    bare = run_js(BARE_JAVASCRIPT)(
        device.backend_as(WebBackend).device._internal,
        to_js(texts),
        to_js(work.corners.reshape(-1)),
        to_js(numbers.reshape(-1)),
        arguments.draws,
    )
    values = [(row["offset"].tolist(), row["color"].tolist()) for row in work.rows]
    variants = work.list_variants()

    def draw_values() -> None:
        draw, mesh, camera = device.draw, work.meshes[0], work.camera
        for offset, color in values:
            draw(program, mesh, camera=camera, object=Object(offset=offset, color=color))

    orders = itertools.cycle(
        [np.random.default_rng(n).permutation(len(work.pairs)).tolist() for n in range(200)]
    )

    def draw_shuffled() -> None:
        draw, camera, pairs = device.draw, work.camera, work.pairs
        for index in next(orders):
            mesh, constants = pairs[index]
            draw(program, mesh, camera=camera, object=constants)

    numbers_of_frames = itertools.count(1)

    def frame(draw: Callable[[], None], changes: bool = False) -> Callable[[], None]:
        def run() -> None:
            with device.render_pass(work.image, clear=(0, 0, 0, 1)):
                if changes:
                    instances = next(numbers_of_frames)
                    program.draw(work.meshes[0], instances, camera=work.camera, object=work.ranges[0])
                draw()
            device.present()

        return run

    own_mesh, shared_mesh, value = "device.draw", "device.draw, one mesh", "device.draw, value"
    changing = "{}, another pass each frame"
    groups: list[dict[str, Callable[[], None]]] = [
        {
            "JavaScript": lambda: bare(True, False, False),
            own_mesh: frame(variants[own_mesh]),
            changing.format(own_mesh): frame(variants[own_mesh], changes=True),
            "device.draw, another order each frame": frame(draw_shuffled),
            "device.draw_many": frame(variants["device.draw_many"]),
        },
        {
            "JavaScript, one mesh": lambda: bare(False, False, False),
            shared_mesh: frame(variants[shared_mesh]),
            changing.format(shared_mesh): frame(variants[shared_mesh], changes=True),
        },
        {
            "JavaScript, value": lambda: bare(False, True, False),
            value: frame(draw_values),
            changing.format(value): frame(draw_values, changes=True),
        },
        {
            "JavaScript, value, all set": lambda: bare(False, True, True),
            value: frame(draw_values),
            changing.format(value): frame(draw_values, changes=True),
        },
    ]
    columns = {"microseconds": time(1e6 / arguments.draws), "ratio": ratio()}
    gc.disable()
    for group in groups:
        rows = [
            Subject({"on": "web", "variant": name}, lambda _, run=run: run(), device.finish)
            for name, run in group.items()
        ]
        yield from compare(rows, columns, range(arguments.rounds))
        gc.collect()
    gc.enable()
    device.close()


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
            for open_device in (device, timed):
                open_device.present()
                open_device.finish()
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


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of draws, and those of scopes around nothing on the null device; in a page, the rows of
    its frames."""
    if sys.platform == "emscripten":
        yield from measure_frames(arguments)
        return
    yield from measure_draws(arguments)
    for row in measure_scopes(1000, arguments.rounds):
        yield {"on": "null", **row}


OPTIONS = (
    options.count("--draws", "draws per round", 2000),
    options.count("--triangles", "triangles per draw", 10),
    options.rounds("rounds", 41),
    options.switch("--rasterize", "let the triangles reach the rasteriser"),
    options.switch("--wgpu", "measure wgpu, too, in the same rounds"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
