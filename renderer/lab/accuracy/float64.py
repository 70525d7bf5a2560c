"""Pictures of forward shading in float64: what the device's picture would be if nothing were rounded on the way.

The device says which triangle it has drawn to each pixel. All else is computed by NumPy: the vertex stage for the
corners of those triangles, their varyings at the pixel's centre, and the fragment stage. A fragment has a quad of its
own, in which the other three are helpers of the same triangle, so differences are those that the device has. Buffers
hold float32 in both cases. So arithmetic is all that differs, at edges, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, BoundProgram, Frame, Needs, Pass, Target, TechniquePass
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic
from renderer.scene.arrays import Floats
from renderer.shaders import Object, ObjectPosition, Vertex, ViewConstants, relative_position
from renderer.techniques import Forward
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import bind, find_variant, list_shaders
from rhi import Format, StorageBuffer, Texture, TextureKind, UniformBuffer

_TRIANGLES: Final = "triangles"
_CHUNK: Final = 1 << 14
"""Fragments that are shaded at a time, each with three helpers."""


class NumberVarying(sl.Struct):
    """The varyings of `NumberShader`."""

    clip: sl.vec4
    row: int


class NumberShader(sl.Shader):
    """Draws an object's row + 1, and which of its triangles it is."""

    view: sl.Uniform[ViewConstants]
    objects: sl.Storage[Object]
    places: sl.Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> NumberVarying:
        row = sl.instance_index()
        position = self.objects[row].linear @ v.position + relative_position(self.places[row], self.view)
        return NumberVarying(clip=self.view.relative_view_projection @ sl.vec4(position, 1.0), row=row)

    def fragment(self, v: NumberVarying) -> sl.uvec2:
        return sl.uvec2(sl.uint(v.row + 1), sl.uint(sl.primitive_index()))


class TracedForward:
    """Forward shading, which also tells what it has drawn where, and with what."""

    name: Final = "forward"

    def __init__(self) -> None:
        self.numbers: NDArray[np.uint32] = np.zeros((0, 0, 2), np.uint32)
        self.shaders: list[tuple[int, type[Any], dict[str, Any]]] = []  # shaders of materials, by their numbers

    def declare(self, needs: Needs) -> Sequence[Pass[Frame]]:
        """Return the passes of forward shading, one that draws the numbers of triangles, and one that reads them."""
        contents = Target(_TRIANGLES, Format.RG32UI), Target("depth of triangles", DEPTH_FORMAT)
        return (
            *Forward().declare(needs),
            Pass("triangles", _draw_numbers, "was asked for", reads=("image",), writes=contents),
            Pass("read back", self._read, "was asked for", reads=(_TRIANGLES,), has_side_effects=True),
        )

    def _read(self, frame: Frame) -> None:
        self.numbers = frame.targets[_TRIANGLES].read()
        images = frame.resources.images
        samplers = {} if images is None else dict(zip(images.arrays, images.samplers, strict=True))
        self.shaders = []
        for number, bases, parameters in list_shaders(frame):
            shader = find_variant(frame, *bases, ForwardShader)
            bindings = bind(frame, frame.program(shader), parameters)
            self.shaders.append((number, shader, {name: _take(one, samplers) for name, one in bindings.items()}))


def _draw_numbers(frame: Frame) -> None:
    resources = frame.resources
    arrays = resources.list_arrays(frame.view.buffer)
    bindings = {"view": arrays.view, "objects": arrays.objects, "places": arrays.places}
    frame.draw_visible(
        TechniquePass(
            frame.device, resources, frame.view, [BoundProgram(frame.program(NumberShader), bindings)],
            color=frame.targets[_TRIANGLES], depth=frame.targets["depth of triangles"], clear=(0, 0, 0, 0),
        )
    )  # fmt: skip


def _take(binding: Any, samplers: Mapping[Any, Any]) -> Any:
    """Return what a binding holds, as NumPy's stages take it."""
    if isinstance(binding, UniformBuffer):
        (row,) = binding.owner.read()
        return _rebuild(binding.type, row)
    if isinstance(binding, StorageBuffer):
        return binding.read()
    assert isinstance(binding, sl.TextureBinding)
    texture = binding if isinstance(binding, Texture) else binding.owner
    assert isinstance(texture, Texture)
    layers = texture.descriptor.layers if texture.descriptor.kind is TextureKind.D2_ARRAY else 1
    levels = [
        np.stack([texture.read(level, layer) for layer in range(layers)]) for level in range(texture.descriptor.levels)
    ]
    if texture.format.components == 1:
        levels = [level[..., None] for level in levels]
    return sl.HostTexture(levels, texture.format, texture.descriptor.kind, samplers.get(binding))


def _rebuild(kind: Any, row: Any) -> Any:
    """Return the struct that a row of a buffer holds, with the structs inside it."""
    values = {}
    hints = get_type_hints(kind)
    for name in row.dtype.names:
        value, hint = row[name], hints[name]
        inside = [one for one in (hint, *get_args(hint)) if isinstance(one, type) and issubclass(one, sl.Struct)]
        if inside:
            value = [_rebuild(inside[0], one) for one in value] if np.ndim(value) else _rebuild(inside[0], value)
        values[name] = value[:, :3] if hint is sl.mat3 else value  # its rows are as wide as vec4 in memory
    return kind(**values)


@dataclass(frozen=True, eq=False, slots=True)
class ExactPicture:
    """A picture in float64, and what is seen in it.

    Attributes:
        levels: (h, w, 3), sRGB in levels of 255, not rounded; 0 where there is nothing.
        objects: (h, w) the object of each pixel, -1 where there is nothing.
        depth: (h, w) as the depth buffer has it. distances: (h, w) from the plane of the eye.
        positions: (h, w, 3), relative to the eye.
    """

    levels: Floats
    objects: NDArray[np.int64]
    depth: Floats
    distances: Floats
    positions: Floats


def shade_exactly(renderer: Renderer, camera: Camera, seconds: float = 0.0) -> ExactPicture:
    """Return the picture that forward shading with the renderer's settings and its light lists would draw in float64.
    Transparent surfaces are left out."""
    technique, traced = renderer.technique, TracedForward()
    renderer.technique = traced
    try:
        renderer.render(camera, seconds)
    finally:
        renderer.technique = technique
    mesh, draws = renderer.resources.mesh, renderer.resources.draws
    assert mesh.vertices is not None
    assert mesh.indices is not None
    vertices, indices = mesh.vertices.read(), mesh.indices.read()
    objects = traced.numbers[..., 0].astype(np.int64) - 1
    rows, columns = np.nonzero(objects >= 0)
    pairs = np.stack([objects[rows, columns], traced.numbers[rows, columns, 1]], axis=1)
    triangles, which = np.unique(pairs, axis=0, return_inverse=True)
    drawn = draws[triangles[:, 0]]
    first = drawn["first"].astype(np.int64) + 3 * triangles[:, 1]
    corners = indices[first[:, None] + np.arange(3)] + drawn["base_vertex"].astype(np.int64)[:, None]

    shape, chunks = objects.shape, []
    number_of = renderer.resources.scene.materials["shader"][renderer.resources.scene.objects.material]
    for number, shader, bindings in traced.shaders:
        own = np.flatnonzero(number_of[pairs[:, 0]] == number)
        run = sl.run_vertex(shader, vertices[corners], instance_index=triangles[:, :1], dtype=np.float64, **bindings)
        chunks += [(own[begin : begin + _CHUNK], run, shader, bindings) for begin in range(0, len(own), _CHUNK)]
    levels, positions = np.zeros((*shape, 3)), np.zeros((*shape, 3))
    depth, distances = np.zeros(shape), np.full(shape, np.inf)
    for part, run, shader, bindings in chunks:
        frames = run.position[..., [0, 1, 3]].swapaxes(-1, -2)  # (t, 3, 3): x, y and w of the corners
        y, x, chosen = rows[part], columns[part], which.reshape(-1)[part]
        quad_y = (y // 2 * 2)[:, None, None] + np.arange(2)[:, None]
        quad_x = (x // 2 * 2)[:, None, None] + np.arange(2)
        quad_x, quad_y = np.broadcast_arrays(quad_x, quad_y)
        covered = (quad_x == x[:, None, None]) & (quad_y == y[:, None, None])
        ndc = np.stack(
            [(quad_x + 0.5) / shape[1] * 2.0 - 1.0, 1.0 - (quad_y + 0.5) / shape[0] * 2.0, np.ones(quad_x.shape)], -1
        )
        weights = np.linalg.solve(frames[chosen], ndc.reshape(len(y), 4, 3).swapaxes(-1, -2))  # (n, 3, 4)
        inverse_w = weights.sum(axis=1)
        weights = (weights / inverse_w[:, None]).swapaxes(-1, -2).reshape(len(y), 2, 2, 3)
        mixed = {}
        for name, values in run.varyings.items():
            at_corners = values[chosen]
            if values.dtype.kind == "f":
                flat = at_corners.reshape(len(y), 3, -1)
                mixed[name] = np.einsum("nijc,nck->nijk", weights, flat).reshape(len(y), 2, 2, *values.shape[2:])
            else:
                mixed[name] = at_corners[:, None, None, 0]
        clip_z = np.einsum("nijc,nc->nij", weights, run.position[chosen, :, 2])
        inverse = inverse_w.reshape(-1, 2, 2)
        place = np.stack([quad_x + 0.5, quad_y + 0.5, clip_z * inverse, inverse], -1)
        shaded = sl.run_fragment(
            shader, mixed, covered=covered, fragment_coordinate=place, dtype=np.float64, **bindings
        )
        (color,) = shaded.outputs.values()
        levels[y, x] = encode_levels(color[covered][:, :3])
        depth[y, x] = place[covered][:, 2]
        positions[y, x] = mixed["position"][covered]
        is_parallel = isinstance(camera.projection, Orthographic)  # whose w is 1 everywhere
        distances[y, x] = positions[y, x] @ camera.forward if is_parallel else 1.0 / place[covered][:, 3]
    return ExactPicture(levels, objects, depth, distances, positions)


def encode_levels(linear: Floats) -> Floats:
    """Return linear light as sRGB in levels of 255, not rounded."""
    light = np.clip(linear, 0.0, 1.0)
    return 255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def decode_levels(levels: NDArray[Any]) -> Floats:
    """Return the linear light of sRGB in levels of 255."""
    color = np.asarray(levels, np.float64) / 255.0
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
