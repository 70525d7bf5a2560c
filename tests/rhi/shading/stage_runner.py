"""Runs a shader's vertex and fragment stages on plain arrays, without rasterising: on 16 lanes through
pyopencl, as a rasteriser does; with NumPy; and as GLSL, capturing vertices and drawing a triangle over all
pixels.

All runners take the same arguments and return the same results: "position" (n, 4) and each varying (n, …) for
vertices; each output (height, width, components), "depth" and "kept" for fragments; and each writable buffer.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pyopencl as cl
from glsl_runner import GlslBuffers
from opencl_runner import BoundMemory, binding_words, buffer, build_text, queue

from rhi.contract.descriptors import BindingKind, Interpolation, ProgramDescriptor, Stage
from rhi.shading import Shader, compile_shader, run_fragment, run_vertex
from rhi.shading.compile import compiled_code

VERTEX = """
kernel void run({parameters}global const uint *inputs, global const int *vertex, int instance, int draw,
                global const int *mask, global uint *outputs) {{
    int group = get_global_id(0);
    uint16 in[{inputs} + 1], out[{outputs}];
    for (int i = 0; i < {inputs}; i++) in[i] = vload16(group * {inputs} + i, inputs);
    for (int i = 0; i < {outputs}; i++) out[i] = 0;
    rhi_vertex({arguments}in, vload16(group, vertex), instance, draw, vload16(group, mask), out);
    for (int i = 0; i < {outputs}; i++) vstore16(out[i], group * {outputs} + i, outputs);
}}
"""
FRAGMENT = """
kernel void run({parameters}global const uint *inputs, global const uint *flats, global const float *place, int front,
                int primitive, global const int *mask, global uint *outputs) {{
    int block = get_global_id(0);
    uint16 in[{inputs} + 1], out[{outputs} + 1];
    uint flat[{inputs} + 1];
    float16 at[4], depth = 0.0f;
    for (int i = 0; i < {inputs}; i++) in[i] = vload16(block * {inputs} + i, inputs);
    for (int i = 0; i < {inputs}; i++) flat[i] = flats[block * {inputs} + i];
    for (int i = 0; i < 4; i++) at[i] = vload16(block * 4 + i, place);
    for (int i = 0; i < {outputs}; i++) out[i] = 0;
    int16 left = rhi_fragment({arguments}in, flat, at[0], at[1], at[2], at[3], front, primitive, (float16)(0.0f),
                              (float16)(0.0f), vload16(block, mask), out, &depth);
    for (int i = 0; i < {outputs}; i++) vstore16(out[i], block * ({outputs} + 2) + i, outputs);
    vstore16(as_uint16(depth), block * ({outputs} + 2) + {outputs}, outputs);
    vstore16(as_uint16(left), block * ({outputs} + 2) + {outputs} + 1, outputs);
}}
"""


class StageKernel:
    """A kernel that runs one stage of a program on arrays of words, in groups of 16 lanes."""

    def __init__(self, descriptor: ProgramDescriptor, stage: Stage, bindings: dict[str, Any]) -> None:
        parameters = []
        arguments = []
        self.memory = BoundMemory(descriptor, bindings)
        for binding in descriptor.bindings:
            name = f"b_{binding.name}"
            arguments.append(name)
            if binding.kind is BindingKind.UNIFORM:
                parameters.append(f"global const uint *{name}")
            elif binding.kind in (BindingKind.TEXTURE, BindingKind.IMAGE):
                access = "global const uchar" if binding.kind is BindingKind.TEXTURE else "global uchar"
                parameters += [f"{access} *{name}", f"global const int *{name}_words"]
                arguments.append(f"{name}_words")
            else:
                parameters += [f"global uint *{name}", f"int {name}_count"]
                arguments.append(f"{name}_count")
        self.inputs = sum(varying.words for varying in descriptor.varyings)
        if stage is Stage.VERTEX:
            self.outputs = 4 + self.inputs
            self.inputs = sum(getattr(attribute.type, "size", 1) for attribute in descriptor.attributes)
        else:
            self.outputs = 4 * len(descriptor.outputs)
        text = (VERTEX if stage is Stage.VERTEX else FRAGMENT).format(
            parameters="".join(f"{argument}, " for argument in parameters),
            arguments="".join(f"{argument}, " for argument in arguments),
            inputs=self.inputs,
            outputs=self.outputs,
        )
        self.text = descriptor.emit("opencl16", stage).text + text
        self.kernel = cl.Kernel(build_text(self.text), "run")

    def launch(self, groups: int, words: int, *values: Any) -> Any:
        """Run groups of lanes and return their words, (groups, words, 16) uint32."""
        out = np.zeros((groups, words, 16), np.uint32)
        target = buffer(out)
        arguments = [buffer(value) if isinstance(value, np.ndarray) else np.int32(value) for value in values]
        self.kernel(queue(), (groups,), None, *self.memory.arguments, *arguments, target).wait()
        cl.enqueue_copy(queue(), out, target)
        return out


def as_words(array: Any, lanes: int) -> Any:
    """Convert values (lanes, …) to words (lanes, n)."""
    array = np.ascontiguousarray(array)
    array = array.astype({"f": "f4", "i": "i4", "u": "u4"}[array.dtype.kind])
    return np.ascontiguousarray(array.reshape(lanes, -1)).view(np.uint32)


def view(words: Any, kind: str) -> Any:
    """Convert words to numbers."""
    return np.ascontiguousarray(words).view({"float": np.float32, "int": np.int32, "uint": np.uint32}[kind])


def run_vertex_lanes(
    shader: type[Shader],
    attributes: dict[str, Any],
    count: int,
    *,
    first: int = 0,
    vertices: Any = None,
    instance: int = 0,
    draw: int = 0,
    **bindings: Any,
) -> dict[str, Any]:
    """Run `count` vertices from `first` on, or `vertices`, on OpenCL.

    Returns:
        "position" (n, 4), each varying (n, words), and each writable buffer.
    """
    descriptor = compile_shader(shader)
    kernel = StageKernel(descriptor, Stage.VERTEX, binding_words(shader, bindings))
    groups = -(-count // 16)
    words = np.zeros((groups * 16, kernel.inputs), np.uint32)
    if kernel.inputs:
        columns = [as_words(attributes[attribute.name], count) for attribute in descriptor.attributes]
        words[:count] = np.concatenate(columns, axis=1)
    indices = np.arange(groups * 16, dtype=np.int32) + first
    if vertices is not None:
        indices[:count] = vertices
    mask = -(np.arange(groups * 16) < count).astype(np.int32)
    inputs = np.ascontiguousarray(words.reshape(groups, 16, -1).swapaxes(1, 2))
    out = kernel.launch(groups, kernel.outputs, inputs, indices, instance, draw, mask)
    rows = out.swapaxes(1, 2).reshape(groups * 16, -1)[:count]
    results = {"position": view(rows[:, :4], "float")}
    for varying in descriptor.varyings:
        part = rows[:, 4 + varying.word : 4 + varying.word + varying.words]
        results[varying.name] = view(part, varying.kind)
    return results | kernel.memory.read_back()


def blocks(image: Any) -> Any:
    """Convert (height, width, n) to blocks (blocks, n, 16)."""
    height, width, words = image.shape
    parts = image.reshape(height // 4, 4, width // 4, 4, words)
    return np.ascontiguousarray(parts.transpose(0, 2, 4, 1, 3).reshape(height * width // 16, words, 16))


def unblocked(data: Any, height: int, width: int) -> Any:
    """Convert (blocks, n, 16) to (height, width, n)."""
    words = data.shape[1]
    parts = data.reshape(height // 4, width // 4, words, 4, 4)
    return np.ascontiguousarray(parts.transpose(0, 3, 1, 4, 2).reshape(height, width, words))


def run_fragment_lanes(
    shader: type[Shader],
    varyings: dict[str, Any],
    shape: tuple[int, int],
    *,
    mask: Any = True,
    depth: Any = 0.0,
    w: Any = 1.0,
    front: bool = True,
    primitive: int = 0,
    **bindings: Any,
) -> dict[str, Any]:
    """Run fragments on OpenCL.

    Height and width are multiples of 4. Smooth varyings are (height, width, …), flat ones one value.

    Returns:
        Each output (height, width, components), "depth", "kept", and each writable buffer.
    """
    descriptor = compile_shader(shader)
    kernel = StageKernel(descriptor, Stage.FRAGMENT, binding_words(shader, bindings))
    height, width = shape
    count = height * width // 16
    words = np.zeros((height, width, kernel.inputs), np.uint32)
    flats = np.zeros((count, max(kernel.inputs, 1)), np.uint32)
    for varying in descriptor.varyings:
        value = np.asarray(varyings[varying.name])
        span = slice(varying.word, varying.word + varying.words)
        if varying.interpolation is Interpolation.FLAT:
            flats[:, span] = as_words(value, 1)
        else:
            words[..., span] = as_words(value, height * width).reshape(height, width, -1)
    rows, columns = np.mgrid[:height, :width]
    coordinates = np.stack(
        [columns + 0.5, rows + 0.5, np.broadcast_to(depth, shape), np.broadcast_to(w, shape)], axis=-1
    )
    masks = -np.broadcast_to(mask, shape).astype(np.int32)
    out = kernel.launch(
        count,
        kernel.outputs + 2,
        blocks(words),
        flats,
        blocks(coordinates.astype(np.float32)),
        int(front),
        primitive,
        blocks(masks[..., None]),
    )
    image = unblocked(out, height, width)
    results = {"depth": view(image[..., -2], "float"), "coverage": image[..., -1] != 0}
    for output in descriptor.outputs:
        part = image[..., 4 * output.location : 4 * output.location + output.components]
        results[output.name] = view(part, output.kind)
    return results | kernel.memory.read_back()


# -- NumPy -------------------------------------------------------------------------------------------------


def run_vertex_numpy(
    shader: type[Shader],
    attributes: dict[str, Any],
    count: int,
    *,
    first: int = 0,
    vertices: Any = None,
    instance: int = 0,
    draw: int = 0,
    dtype: Any = np.float32,
    **bindings: Any,
) -> dict[str, Any]:
    """Run vertices on NumPy; parameters and results as for `run_vertex_lanes`."""
    vertices = np.arange(first, first + count) if vertices is None else vertices
    indices = {"vertex_index": vertices, "instance_index": instance, "draw_index": draw}
    run = run_vertex(shader, attributes, **indices, dtype=dtype, **bindings)  # type: ignore[arg-type]
    read = {varying.name for varying in compile_shader(shader).varyings}
    varyings = {name: value.reshape(count, -1) for name, value in run.varyings.items() if name in read}
    return {"position": run.position, **varyings, **run.memory}


def run_fragment_numpy(
    shader: type[Shader],
    varyings: dict[str, Any],
    shape: tuple[int, int],
    *,
    mask: Any = True,
    depth: Any = 0.0,
    w: Any = 1.0,
    front: bool = True,
    primitive: int = 0,
    dtype: Any = np.float32,
    **bindings: Any,
) -> dict[str, Any]:
    """Run fragments on NumPy; parameters and results as for `run_fragment_lanes`."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    rest = (np.broadcast_to(depth, shape), np.broadcast_to(w, shape))
    run = run_fragment(
        shader,
        varyings,
        covered=np.broadcast_to(mask, shape),
        front_facing=front,
        primitive_index=primitive,
        fragment_coordinate=np.stack([columns + 0.5, rows + 0.5, *rest], axis=-1),
        dtype=dtype,
        **bindings,
    )
    outputs = {name: value.reshape(*shape, -1) for name, value in run.outputs.items()}
    return {"depth": run.depth, "coverage": run.coverage, **outputs, **run.memory}


# -- GLSL --------------------------------------------------------------------------------------------------

SENTINEL = 0x4B3C2D1E


def run_vertex_glsl(
    context: moderngl.Context,
    shader: type[Shader],
    attributes: dict[str, Any],
    count: int,
    *,
    vertices: Any = None,
    instance: int = 0,
    **bindings: Any,
) -> dict[str, Any]:
    """Run vertices on OpenGL by transform feedback, and return the last of `instance` + 1 instances.

    Parameters and results are those of `run_vertex_lanes`.
    """
    descriptor = compile_shader(shader)
    names = ["gl_Position", *(f"v_{varying.name}" for varying in descriptor.varyings)]
    program = context.program(vertex_shader=descriptor.emit("glsl", Stage.VERTEX).text, varyings=names)
    buffers = GlslBuffers(context, shader, bindings)
    content, used = [], []
    for attribute in descriptor.attributes:
        name = f"in_{attribute.name}"
        words = as_words(attributes[attribute.name], count)
        kind = {"float": "f4", "int": "i4", "uint": "u4"}[
            getattr(attribute.type, "scalar", attribute.type).name
        ]
        used.append(context.buffer(words.tobytes()))
        if name in program:
            content.append((used[-1], f"{words.shape[1]}{kind}", name))
    index = None if vertices is None else context.buffer(np.asarray(vertices, np.uint32).tobytes())
    array = context.vertex_array(program, content, index_buffer=index)
    frame = context.simple_framebuffer((1, 1))
    frame.use()
    width = 4 + sum(varying.words for varying in descriptor.varyings)
    target = context.buffer(reserve=count * (instance + 1) * width * 4)
    array.transform(target, mode=moderngl.POINTS, vertices=count, instances=instance + 1)
    out = np.frombuffer(target.read(), np.uint32).reshape(-1, width)[-count:]
    results = {"position": view(out[:, :4], "float")}
    for varying in descriptor.varyings:
        part = out[:, 4 + varying.word : 4 + varying.word + varying.words]
        results[varying.name] = view(part, varying.kind)
    for resource in (array, target, program, index, frame, *used):
        if resource is not None:
            resource.release()
    return results | buffers.finish()


def run_fragment_glsl(
    context: moderngl.Context,
    shader: type[Shader],
    varyings: dict[str, Any],
    shape: tuple[int, int],
    *,
    mask: Any = True,
    depth: float = 0.0,
    front: bool = True,
    **bindings: Any,
) -> dict[str, Any]:
    """Run fragments on OpenGL; smooth varyings must be linear in rows and columns, and `mask` a rectangle.

    Parameters and results are those of `run_fragment_lanes`.
    """
    descriptor, (height, width) = compile_shader(shader), shape
    corners = np.array([(0, 0), (2, 0), (0, 2)], np.float32)
    declared, sets, content = [], [], [(context.buffer(corners.tobytes()), "2f4", "corner")]
    types = {}
    for declared_varying in compiled_code(shader).interface.varyings:
        name, role = declared_varying.name, declared_varying.role
        types[name] = declared_varying.type
        location = f"layout(location = {declared_varying.location})"
        declared.append(f"{location} {role.value if role else ''} out {types[name]} v_{name};")
    for varying in descriptor.varyings:
        declared.append(f"in {types[varying.name]} in_{varying.name};")
        sets.append(f"v_{varying.name} = in_{varying.name};")
        value = np.asarray(varyings[varying.name])
        if varying.interpolation is Interpolation.FLAT:
            words = np.repeat(as_words(value, 1), 3, axis=0)
        else:
            grid = np.asarray(value, np.float64).reshape(height, width, -1)
            right, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
            start = grid[0, 0] - (right + down) / 2
            words = as_words(start + corners[:, :1] * width * right + corners[:, 1:] * height * down, 3)
        kind = {"float": "f4", "int": "i4", "uint": "u4"}[varying.kind]
        content.append((context.buffer(words.tobytes()), f"{varying.words}{kind}", f"in_{varying.name}"))
    position = f"gl_Position = vec4(corner * 2.0 - 1.0, {float(depth) * 2 - 1!r}, 1.0);"
    text = ["#version 430 core", "in vec2 corner;", *declared, "void main() {", *sets, position, "}"]
    program = context.program(
        vertex_shader="\n".join(text), fragment_shader=descriptor.emit("glsl", Stage.FRAGMENT).text
    )
    buffers = GlslBuffers(context, shader, bindings)
    targets = []
    for output in descriptor.outputs:
        dtype = {"float": "f4", "int": "i4", "uint": "u4"}[output.kind]
        sentinel = np.full(height * width * output.components, SENTINEL, np.uint32).tobytes()
        targets.append(context.texture((width, height), output.components, sentinel, dtype=dtype))
    depths = context.depth_texture((width, height))
    frame = context.framebuffer(targets, depths)
    frame.use()
    if mask is not True:
        rows, columns = np.nonzero(mask)
        box = (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)
        assert box[2] * box[3] == np.count_nonzero(mask), "not a rectangle"
        frame.scissor = tuple(map(int, box))
    context.enable_only(moderngl.DEPTH_TEST)
    context.depth_func = "1"
    order = [0, 1, 2] if front else [0, 2, 1]
    index = context.buffer(np.array(order, np.uint32).tobytes())
    array = context.vertex_array(
        program, [item for item in content if item[2] in program], index_buffer=index
    )
    array.render(moderngl.TRIANGLES)
    context.finish()
    depth_image = np.frombuffer(depths.read(), np.float32).reshape(height, width)
    results: dict[str, Any] = {"depth": depth_image, "coverage": np.broadcast_to(mask, shape)}
    for output, target in zip(descriptor.outputs, targets, strict=True):
        image = np.frombuffer(target.read(), np.uint32).reshape(height, width, -1)
        results["coverage"] = results["coverage"] & (image != SENTINEL).any(axis=-1)
        results[output.name] = view(image, output.kind)
    for item in (array, index, frame, depths, program, *targets, *(part[0] for part in content)):
        item.release()
    return results | buffers.finish()
