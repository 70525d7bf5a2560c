"""What the renderer's shaders share with the CPU and with each other.

Lengths are metres, colours linear. Positions are relative to the eye, with the world's axes: float32 is then
as fine far from the world's origin as near it. Structs that mirror an array of `renderer.scene` have its
std430 layout, so that the array is uploaded as it stands.
"""

from __future__ import annotations

from rhi.shading import Struct, function, ivec3, mat3, mat4, uint, vec2, vec3, vec4


class View(Struct):
    """A camera: from positions relative to the eye to clip space, and where in the world the eye is: at
    `eye_high` + `eye_low`, two floats for each double."""

    relative_view_projection: mat4
    eye_high: vec3
    eye_low: vec3


class Ambient(Struct):
    """Light from everywhere: `sky` from above, `ground` from below."""

    sky: vec3
    ground: vec3


class Haze(Struct):
    """Air that lets e^-density of light through a metre, and shows `color` instead."""

    color: vec3
    density: float


class Object(Struct):
    """All of an object's transform but the position, its material and its lights.

    `normal` is the cofactor matrix of `linear`, which keeps normals upright under nonuniform scale. The
    object's lights are `light_rows[lights_begin:points_end]`, rows of the point lights, and
    `light_rows[points_end:lights_end]`, rows of the spot lights.
    """

    linear: mat3
    normal: mat3
    material: int
    lights_begin: int
    points_end: int
    lights_end: int


class ObjectPosition(Struct):
    """Where in the world an object is, and which mesh: at `high` + `low`, two floats for each double.

    `mirrored` is 1 where the object's transform turns its triangles round.
    """

    high: vec3
    mesh: int
    low: vec3
    mirrored: int


class MeshPart(Struct):
    """A mesh: its box in mesh space, and what a draw of it takes from the arrays that all meshes share."""

    lower: vec3
    first: uint
    upper: vec3
    count: uint
    base_vertex: int


@function
def relative_position(place: ObjectPosition, view: View) -> vec3:
    """Where an object's origin is from the eye: as exact near the eye as doubles are, far from the world's
    origin too."""
    return (place.high - view.eye_high) + (place.low - view.eye_low)


class Material(Struct):
    """`renderer.scene.MATERIAL`."""

    base_color: vec4
    specular_color: vec3
    shininess: float
    rim_strength: float
    rim_power: float
    texture: int
    emission: float


class DirectionalLight(Struct):
    """`renderer.scene.DIRECTIONAL`; `direction` is the way the light travels, unit length."""

    direction: vec3
    intensity: float
    color: vec3


class PointLight(Struct):
    """`renderer.scene.RELATIVE_POINT`."""

    position: vec3
    range: float
    color: vec3
    intensity: float


class SpotLight(Struct):
    """`renderer.scene.RELATIVE_SPOT`."""

    position: vec3
    range: float
    color: vec3
    intensity: float
    direction: vec3
    cos_inner: float
    cos_outer: float


class Vertex(Struct):
    """A mesh's vertex (`renderer.scene.VERTEX`), in mesh space; v = 0 is an image's top row."""

    position: vec3
    normal: vec3
    uv: vec2


class SurfaceVarying(Struct):
    """From vertex to fragment."""

    clip: vec4
    position: vec3
    normal: vec3
    uv: vec2
    material: int
    lights: ivec3


class Surface(Struct):
    """A point to be lit; `normal` and `to_eye` are unit vectors."""

    position: vec3
    normal: vec3
    to_eye: vec3
    base_color: vec3
    specular_color: vec3
    shininess: float
