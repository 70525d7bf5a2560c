"""Structs that the renderer's shaders share with the CPU and with each other.

Lengths are in metres, colours linear. Positions are relative to the eye, along the world's axes: float32 is
then as fine far from the world's origin as near it. Structs that mirror an array of `renderer.scene` have its
std430 layout, so that the array is uploaded unchanged.
"""

from __future__ import annotations

from typing import Final

from renderer.light_kinds.bounds import BOUND_FIELDS, LightBounds
from rhi.shading import Struct, function, mat3, mat4, uint, vec2, vec3, vec4


class ViewConstants(Struct):
    """The constants of a view: the matrix from positions relative to the eye to clip space, and the eye's
    position.

    The position is `eye_high` + `eye_low`: two floats for each double.
    """

    relative_view_projection: mat4
    eye_high: vec3
    eye_low: vec3


class Ambient(Struct):
    """Ambient light: `sky` from above, `ground` from below."""

    sky: vec3
    ground: vec3


class Haze(Struct):
    """Haze: e^-density of the light passes a metre of air; the rest is replaced by `color`."""

    color: vec3
    density: float


class ObjectSurface(Struct):
    """An object's material and its transform, except its position.

    `normal` is the cofactor matrix of `linear`, which keeps normals upright under nonuniform scale.
    """

    linear: mat3
    normal: mat3
    material: int


class Object(ObjectSurface):
    """An object's material, lights and transform, except its position.

    The object's lights are the indices in `light_list` from `lights_begin` to `lights_end`; the other bounds
    say where the indices of each kind end (`BOUND_FIELDS`).
    """

    __annotations__ = dict.fromkeys(BOUND_FIELDS, int)


DRAW_LISTS: Final = 4
"""The parts of a list of draws: objects of one part are drawn with the same states."""


TABLE_WIDTH: Final = 64
"""The width in texels of textures that are indexed by local lights."""


class ObjectPosition(Struct):
    """An object's world position, `high` + `low` (two floats for each double), and its index, which lists of draws
    that the device makes have in another order.

    `draw_list` is the part of a list of draws that it is in where the device makes lists, `DRAW_LISTS` for
    each shader of materials: the sum of 1 if its transform mirrors it, which reverses the winding of its
    triangles, and 2 if its material has two sides. It is -1 if the object is transparent: those are not on a
    list, since they hide nothing and are drawn in an order of their own.
    """

    high: vec3
    object_index: int
    low: vec3
    draw_list: int


class ListEntry(Struct):
    """An object that a list of draws may have, and a mesh part that it may be drawn as."""

    object: uint
    mesh_part: int


class MeshPart(Struct):
    """A mesh, or a level of detail of one: the mesh's box in mesh space, and the range of the arrays that all share.

    The parts of meshes are in the order of these; those of levels are behind them, then those of meshlets. A mesh's
    levels are those from `first_level` on, ever coarser; each is at most `error` metres from the mesh, rounded up.
    """

    lower: vec3
    first: uint
    upper: vec3
    count: uint
    base_vertex: int
    first_level: int
    level_count: int
    error: float


class Meshlet(Struct):
    """The bounds of a mesh part's triangles in mesh space: their box, the sphere around its middle, and the cone of
    their normals.

    `cosine` is at most the least cosine of the angle between a normal and `axis`, below 0 for no cone. `drawn_as` is
    the mesh part whose levels of detail it belongs to: the mesh of a meshlet, and otherwise the part itself.
    """

    lower: vec3
    radius: float
    upper: vec3
    cosine: float
    axis: vec3
    drawn_as: int


@function
def relative_position(position: ObjectPosition, view: ViewConstants) -> vec3:
    """Return an object's position relative to the eye. Near the eye it is as exact as with doubles, even far
    from the world's origin."""
    return (position.high - view.eye_high) + (position.low - view.eye_low)


class Material(Struct):
    """A material, laid out as `renderer.scene.MATERIAL`."""

    base_color: vec4
    specular_color: vec3
    shininess: float
    rim_strength: float
    rim_power: float
    texture: int
    emission: float
    emissive: vec3
    emissive_texture: int
    metallic: float
    roughness: float
    metallic_roughness_texture: int
    model: int
    normal_texture: int
    normal_scale: float
    occlusion_texture: int
    occlusion_strength: float
    alpha_mode: int
    alpha_cutoff: float
    double_sided: int
    shader: int
    light_map_color: vec3
    light_map_texture: int


class Vertex(Struct):
    """A vertex in mesh space, laid out as `renderer.scene.VERTEX`; v = 0 is the top row of an image."""

    position: vec3
    normal: vec3
    uv: vec2


class SecondUv(Struct):
    """The second set of texture coordinates of a vertex, where the scene has one."""

    uv2: vec2


class Tangent(Struct):
    """The tangent of a vertex, and the sign of its bitangent, where the scene has normal maps."""

    tangent: vec4


class VertexColor(Struct):
    """The colour of a vertex, where the scene has such colours."""

    color: vec4


class TextureUse(Struct):
    """A texture of the scene: the array and the layer that hold its image, and how it is read.

    Its texture coordinates are those of the set `uv_set`, as (u, v, 1) times `u` and `v`.
    """

    u: vec3
    array: int  # type: ignore[assignment]  # hides Struct.array
    v: vec3
    layer: float
    uv_set: int


class SurfaceVarying(Struct):
    """The varyings of shaders that draw the scene's geometry. What no part of a shader reads isn't
    interpolated."""

    clip: vec4
    position: vec3
    normal: vec3
    uv: vec2
    uv2: vec2
    tangent: vec4
    color: vec4
    material: int
    lights: LightBounds


class SurfaceInput(Struct):
    """A point of a surface, which a material's shader describes.

    Attributes:
        position: relative to the eye, along the world's axes.
        normal: the unit normal of the side that is seen.
        uv: texture coordinates; to a material's own shader 0 to 1, whole numbers left off.
        uv2: the second set.
        uv_gradients: the changes of `uv` to the next pixel on the right (x, y), and to that below (z, w);
            those of a material's own shader, and where textures are read by a table.
        uv2_gradients: the same of `uv2`.
        tangent: the direction of the normal map's u in the world, of any length, where meshes have tangents;
            w is negative if that of v is `cross(tangent, normal)` instead of `cross(normal, tangent)`.
        color: that of vertices, white if they have none.
        material: the row of the material.
    """

    position: vec3
    normal: vec3
    uv: vec2
    uv2: vec2
    uv_gradients: vec4
    uv2_gradients: vec4
    tangent: vec4
    color: vec4
    material: int


class SurfaceParameters(Struct):
    """The properties of a surface at a point, as a material's shader computes them.

    Attributes:
        color: multiplies the material's `base_color`: 0 to 1, linear. With decals it holds the product instead.
        normal: of length 1, on the side that is seen.
        metallic, roughness: 0 to 1, of the metallic-roughness model.
        occlusion: the share of ambient light that arrives.
        emissive: multiplies the material's `emissive` colour: linear, 0 to 1 unless an image has texels above 1.
    """

    color: vec4
    normal: vec3
    metallic: float
    roughness: float
    occlusion: float
    emissive: vec3


class SurfacePoint(Struct):
    """A point of a surface to be lit; `normal`, `geometric_normal` and `to_eye` are unit vectors.
    `geometric_normal` is the normal of the surface itself, `normal` as maps bend it.

    In the specular model, `base_color` is what scatters light and `specular_color` what mirrors it;
    `shininess` is an exponent. In the metallic-roughness model they are the colours of the same two parts of
    its equation (`renderer.shaders.metals`), and `shininess` is minus the roughness.

    `occlusion` is the share of ambient light that reaches the surface; `emissive` multiplies the light that
    its material emits.

    `irradiance` is that of the light map, which replaces ambient light; negative without one.

    `stretch` is for anisotropic materials: at right angles to `normal`, along the direction in which highlights are
    drawn out, and as long as they are longer than round ones, less 1; else 0. Where surfaces may have lighting models
    of their own, it holds the index of the material and the number of its shader.
    """

    position: vec3
    normal: vec3
    geometric_normal: vec3
    to_eye: vec3
    base_color: vec3
    specular_color: vec3
    shininess: float
    occlusion: float
    emissive: vec3
    irradiance: vec3
    stretch: vec3
