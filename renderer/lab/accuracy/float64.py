"""Images of forward shading in float64: what the device's image would be without rounding.

The device tells which triangle it has drawn to each pixel. NumPy computes the rest: the vertex stage for the
corners of those triangles, their varyings at the pixel's centre, and the fragment stage. A fragment has a
quad of its own, in which the other three are helpers of the same triangle, so derivatives are those that the
device has. Buffers hold float32 in both cases. So only arithmetic differs, also at edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, BoundProgram, Frame, FrameEffects, FramePass, Target, TechniqueDrawer
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic
from renderer.scene.arrays import Floats
from renderer.shaders import Object, ObjectPosition, Vertex, ViewConstants, relative_position
from renderer.techniques import Forward
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import bind, list_shaders, shader_variant
from rhi import Format, StorageBuffer, Texture, TextureKind, UniformBuffer

_TRIANGLES: Final = "triangles"
_CHUNK: Final = 1 << 14
"""Fragments that are shaded at once, each with three helpers."""


class TriangleIdVarying(sl.Struct):
    """The varyings of `TriangleIdShader`."""

    clip: sl.vec4
    object_index: int


class TriangleIdShader(sl.Shader):
    """Draws an object's index + 1 and the number of its triangle."""

    view: sl.Uniform[ViewConstants]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> TriangleIdVarying:
        object_index = sl.instance_index()
        position = self.objects[object_index].linear @ v.position + relative_position(
            self.object_positions[object_index], self.view
        )
        return TriangleIdVarying(
            clip=self.view.relative_view_projection @ sl.vec4(position, 1.0), object_index=object_index
        )

    def fragment(self, v: TriangleIdVarying) -> sl.uvec2:
        return sl.uvec2(sl.uint(v.object_index + 1), sl.uint(sl.primitive_index()))


class ForwardWithTriangleIds:
    """Forward shading that also records the triangle of each pixel, and the shaders and bindings of
    materials."""

    name: Final = "forward"

    def __init__(self) -> None:
        self.numbers: NDArray[np.uint32] = np.zeros((0, 0, 2), np.uint32)
        self.shaders: list[
            tuple[int, type[Any], dict[str, Any]]
        ] = []  # shaders of materials, by their numbers

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The passes of forward shading, one that draws the triangles' numbers, and one that reads them."""
        contents = Target(_TRIANGLES, Format.RG32UI), Target("depth of triangles", DEPTH_FORMAT)
        return (
            *Forward().declare(effects),
            FramePass("triangles", _draw_triangle_ids, "was asked for", reads=("image",), writes=contents),
            FramePass("read back", self._read, "was asked for", reads=(_TRIANGLES,), has_side_effects=True),
        )

    def _read(self, frame: Frame) -> None:
        self.numbers = frame.targets[_TRIANGLES].read()
        images = frame.resources.images
        samplers = {} if images is None else dict(zip(images.arrays, images.samplers, strict=True))
        self.shaders = []
        for number, bases, parameters in list_shaders(frame):
            shader = shader_variant(frame, *bases, ForwardShader)
            bindings = bind(frame, frame.program(shader), parameters)
            self.shaders.append(
                (number, shader, {name: _take(binding, samplers) for name, binding in bindings.items()})
            )


def _draw_triangle_ids(frame: Frame) -> None:
    resources = frame.resources
    arrays = resources.scene_arrays(frame.view.buffer)
    bindings = {"view": arrays.view, "objects": arrays.objects, "object_positions": arrays.object_positions}
    frame.draw_visible(
        TechniqueDrawer(
            frame.device,
            resources,
            frame.view,
            [BoundProgram(frame.program(TriangleIdShader), bindings)],
            color=frame.targets[_TRIANGLES],
            depth=frame.targets["depth of triangles"],
            clear=(0, 0, 0, 0),
        )
    )


def _take(binding: Any, samplers: Mapping[Any, Any]) -> Any:
    """The data behind a binding, as NumPy's stages take it."""
    if isinstance(binding, UniformBuffer):
        (element,) = binding.owner.read()
        return _rebuild(binding.type, element)
    if isinstance(binding, StorageBuffer):
        return binding.read()
    if isinstance(binding, sl.TableBinding):
        return sl.HostTextureTable.from_device(binding)
    assert isinstance(binding, sl.TextureBinding)
    texture = binding if isinstance(binding, Texture) else binding.owner
    assert isinstance(texture, Texture)
    layers = texture.descriptor.layers if texture.descriptor.kind is TextureKind.D2_ARRAY else 1
    levels = [
        np.stack([texture.read(level, layer) for layer in range(layers)])
        for level in range(texture.descriptor.levels)
    ]
    if texture.format.components == 1:
        levels = [level[..., None] for level in levels]
    return sl.HostTexture(levels, texture.format, texture.descriptor.kind, samplers.get(binding))


def _rebuild(kind: Any, element: Any) -> Any:
    """The struct of an element of a buffer, with the structs inside it."""
    values = {}
    hints = get_type_hints(kind)
    for name in element.dtype.names:
        value, hint = element[name], hints[name]
        inside = [
            inner_type
            for inner_type in (hint, *get_args(hint))
            if isinstance(inner_type, type) and issubclass(inner_type, sl.Struct)
        ]
        if inside:
            is_array = bool(np.ndim(value))
            value = [_rebuild(inside[0], item) for item in value] if is_array else _rebuild(inside[0], value)
        values[name] = value[:, :3] if hint is sl.mat3 else value  # in memory its rows are as wide as a vec4
    return kind(**values)


@dataclass(frozen=True, eq=False, slots=True)
class Float64Image:
    """An image in float64, and what its pixels show.

    Attributes:
        levels: (h, w, 3), sRGB in levels of 255, not rounded; 0 where there is nothing.
        objects: (h, w) the object of each pixel, -1 where there is nothing.
        depth: (h, w) as the depth buffer has it.
        distances: (h, w) from the plane of the eye.
        positions: (h, w, 3), relative to the eye.
    """

    levels: Floats
    objects: NDArray[np.int64]
    depth: Floats
    distances: Floats
    positions: Floats


def shade_in_float64(renderer: Renderer, camera: Camera, seconds: float = 0.0) -> Float64Image:
    """Shade the image in float64 as forward shading would with the renderer's settings and light lists.
    Transparent surfaces are left out."""
    traced = _render_triangle_ids(renderer, camera, seconds)
    image = _make_empty_image(traced.numbers[..., 0].astype(np.int64) - 1)
    rows, columns = np.nonzero(image.objects >= 0)
    pairs = np.stack(
        [image.objects[rows, columns], traced.numbers[rows, columns, 1]], axis=1
    )  # object and triangle
    triangles, triangle_of_pixel = np.unique(pairs, axis=0, return_inverse=True)
    triangle_of_pixel = triangle_of_pixel.reshape(-1)
    corners = _read_corners(renderer, triangles)
    scene = renderer.resources.scene
    shader_of_object = scene.materials["shader"][scene.objects.material]
    shader_of_pixel = shader_of_object[pairs[:, 0]]
    for number, shader, bindings in traced.shaders:
        pixels = np.flatnonzero(shader_of_pixel == number)
        run = sl.run_vertex(shader, corners, instance_index=triangles[:, :1], dtype=np.float64, **bindings)
        for begin in range(0, len(pixels), _CHUNK):
            chunk = pixels[begin : begin + _CHUNK]
            quads = _Quads(image.objects.shape, rows[chunk], columns[chunk], run, triangle_of_pixel[chunk])
            _shade_quads(image, quads, shader, bindings, camera)
    return image


def _render_triangle_ids(renderer: Renderer, camera: Camera, seconds: float) -> ForwardWithTriangleIds:
    """Render a frame with a technique that tells which triangle each pixel shows, and restore the renderer's
    own."""
    technique, traced = renderer.technique, ForwardWithTriangleIds()
    renderer.technique = traced
    try:
        renderer.render(camera, seconds)
    finally:
        renderer.technique = technique
    return traced


def _make_empty_image(objects: NDArray[np.int64]) -> Float64Image:
    """An image that shows nothing yet, of the size of an array of objects."""
    shape = objects.shape
    return Float64Image(
        levels=np.zeros((*shape, 3)),
        objects=objects,
        depth=np.zeros(shape),
        distances=np.full(shape, np.inf),
        positions=np.zeros((*shape, 3)),
    )


def _read_corners(renderer: Renderer, triangles: NDArray[np.int64]) -> NDArray[Any]:
    """The vertices (n, 3) of triangles, each an object and the triangle's number in its mesh."""
    mesh = renderer.resources.mesh
    assert mesh.vertices is not None
    assert mesh.indices is not None
    vertices, indices = mesh.vertices.read(), mesh.indices.read()
    resources = renderer.resources
    draws = resources.get_draws(triangles[:, 0], resources.detail_limit)
    first = draws["first"].astype(np.int64) + 3 * triangles[:, 1]
    corners: NDArray[Any] = vertices[
        indices[first[:, None] + np.arange(3)] + draws["base_vertex"].astype(np.int64)[:, None]
    ]
    return corners


class _Quads:
    """The quad of 2 × 2 pixels around each of n pixels, as derivatives need it, and one triangle's values
    there.

    Attributes:
        y, x: (n,) the pixels.
        fragment_coordinates: (n, 2, 2, 4): x, y and depth in the image, and 1 / w.
        covered: (n, 2, 2) which pixel of the quad is the pixel itself.
        varyings: (n, 2, 2, …) by name, interpolated with perspective; integers are flat.
    """

    def __init__(
        self,
        shape: Sequence[int],
        y: NDArray[np.int64],
        x: NDArray[np.int64],
        run: Any,
        triangle: NDArray[np.int64],
    ) -> None:
        self.y, self.x = y, x
        quad_y = (y // 2 * 2)[:, None, None] + np.arange(2)[:, None]
        quad_x = (x // 2 * 2)[:, None, None] + np.arange(2)
        quad_x, quad_y = np.broadcast_arrays(quad_x, quad_y)
        self.covered = (quad_x == x[:, None, None]) & (quad_y == y[:, None, None])
        ndc_x = (quad_x + 0.5) / shape[1] * 2.0 - 1.0
        ndc_y = 1.0 - (quad_y + 0.5) / shape[0] * 2.0
        weights, inverse_w = _solve_weights(
            run.position[triangle], np.stack([ndc_x, ndc_y, np.ones(ndc_x.shape)], -1)
        )
        self.varyings = {
            name: _interpolate(values[triangle], weights)
            if values.dtype.kind == "f"
            else values[triangle][:, None, None, 0]
            for name, values in run.varyings.items()
        }
        clip_z = np.einsum("nijc,nc->nij", weights, run.position[triangle, :, 2])
        self.fragment_coordinates = np.stack([quad_x + 0.5, quad_y + 0.5, clip_z * inverse_w, inverse_w], -1)


def _solve_weights(corners: Floats, ndc: Floats) -> tuple[Floats, Floats]:
    """The perspective-correct weights (n, 2, 2, 3) of triangles' corners at points, and 1 / w (n, 2, 2)
    there.

    Args:
        corners: (n, 3, 4) in clip space.
        ndc: (n, 2, 2, 3): normalized device coordinates, and 1.
    """
    count = len(ndc)
    matrices = corners[..., [0, 1, 3]].swapaxes(-1, -2)  # (n, 3, 3): x, y and w of the corners
    weights = np.linalg.solve(matrices, ndc.reshape(count, 4, 3).swapaxes(-1, -2))  # (n, 3, 4)
    inverse_w = weights.sum(axis=1)
    weights = (weights / inverse_w[:, None]).swapaxes(-1, -2).reshape(count, 2, 2, 3)
    return weights, inverse_w.reshape(-1, 2, 2)


def _interpolate(at_corners: Floats, weights: Floats) -> Floats:
    """Values (n, 2, 2, …) between those of the corners (n, 3, …)."""
    count = len(weights)
    flat = at_corners.reshape(count, 3, -1)
    values: Floats = np.einsum("nijc,nck->nijk", weights, flat)
    return values.reshape(count, 2, 2, *at_corners.shape[2:])


def _shade_quads(
    image: Float64Image, quads: _Quads, shader: type[Any], bindings: Mapping[str, Any], camera: Camera
) -> None:
    """Run the fragment stage of a shader for quads, and write their pixels to an image."""
    y, x, covered = quads.y, quads.x, quads.covered
    shaded = sl.run_fragment(
        shader,
        quads.varyings,
        covered=covered,
        fragment_coordinate=quads.fragment_coordinates,
        dtype=np.float64,
        **bindings,
    )
    (color,) = shaded.outputs.values()
    image.levels[y, x] = encode_levels(color[covered][:, :3])
    image.depth[y, x] = quads.fragment_coordinates[covered][:, 2]
    image.positions[y, x] = quads.varyings["position"][covered]
    if isinstance(camera.projection, Orthographic):  # w is 1 everywhere
        image.distances[y, x] = image.positions[y, x] @ camera.forward
    else:
        image.distances[y, x] = 1.0 / quads.fragment_coordinates[covered][:, 3]


def encode_levels(linear: Floats) -> Floats:
    """Encode linear light as sRGB in levels of 255, not rounded."""
    light = np.clip(linear, 0.0, 1.0)
    return 255.0 * np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    )


def decode_levels(levels: NDArray[Any]) -> Floats:
    """Decode sRGB in levels of 255 to linear light."""
    color = np.asarray(levels, np.float64) / 255.0
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
