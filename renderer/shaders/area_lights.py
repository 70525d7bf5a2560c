"""Local lights that are rectangles or tubes, by linearly transformed cosines.

A rectangle shines from its front, as strongly in each direction as the cosine to its normal; a tube, a cylinder
without ends, from its side. A light of intensity I gives I / d² from afar, in front of a rectangle or beside a
tube.

- **Scattered light** is exact: the integral of n·l over a polygon is a sum over its edges (Lambert, 1760), and the
  polygon is cut exactly at the horizon. In the metallic-roughness model, what isn't scattered at grazing angles
  is that of the direction of this sum.
- **Mirrored light** comes from the same sum. A lobe is about a clamped cosine that a matrix M has stretched, so
  its integral over a polygon is that of the cosine over the polygon that M⁻¹ has stretched (Heitz, Dupuy, Hill
  and Neubelt, Real-Time Polygonal-Light Shading with Linearly Transformed Cosines, 2016). M and the energy of the
  lobe are in a table by roughness and angle of view, which `scripts/fit_lobes.py` fits to both models.
- **A tube** is the rectangle through its axis that faces the point, as wide as the tube looks from there. A thin
  one thus gives what the integral over a line does (Heitz and Hill, Linear-Light Shading with Linearly
  Transformed Cosines, 2017), and a mirror shows its width.

A polygon that fills a small angle is lit as from its middle: the sum over its edges would lose all digits.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.light_kinds.incidence import safe_normalize
from renderer.shaders.metals import MIN_ROUGHNESS
from renderer.shaders.structs import TABLE_WIDTH, SurfacePoint

FIT_SIZE: Final = 32
"""The rows and columns of the table of lobes: of roughness, and of the angle of view."""
FLATTEST_VIEW: Final = 1e-3
"""The least cosine of the angle of view in the table."""
_SHINIEST: Final = 0.06
"""The roughness of the first row of the specular model: that of a shininess of 150,000."""

_PI: Final = 3.14159265
_SMALL: Final = 4e-4
"""The square of the angle in radians below which a polygon is lit as from its middle: there both are off by about
a ten-thousandth."""


def fit_roughness(number: Any, *, is_metallic: bool) -> Any:
    """The roughness of a row of the table; that of a shininess s is √α with α² = 2 / (s + 2)."""
    least = MIN_ROUGHNESS if is_metallic else _SHINIEST
    return least + (1.0 - least) * number / (FIT_SIZE - 1)


def fit_view_cosine(number: Any) -> Any:
    """The cosine of the angle of view of a column of the table."""
    return 1.0 - (number / (FIT_SIZE - 1)) ** 2


class SourceShape(sl.Struct):
    """The shape of a light's source: half of a rectangle's sides, or half of a tube's axis as `right`.

    Attributes:
        right, up: perpendicular, in metres; both 0 if the source is a point or a sphere. A rectangle shines along
            `cross(right, up)`.
        radius: of a tube; below 0 for rectangles.
        strength: π times the radiance of a light of intensity 1.
    """

    right: sl.vec3
    up: sl.vec3
    radius: float
    strength: float


class LobeFit(sl.Struct):
    """A linearly transformed cosine: the numbers of M⁻¹, the energy of the lobe, and that of its white part."""

    xx: float
    xz: float
    zx: float
    zz: float
    yy: float
    energy: float
    white: float


class GatheredLight(sl.Struct):
    """The light of a rectangle in the space of a surface: its mean direction, and the shares of it that a white
    surface scatters and that the lobe mirrors."""

    direction: sl.vec3
    scattered: float
    mirrored: float


@sl.function
def edge_integral(begin: sl.vec3, end: sl.vec3) -> sl.vec3:
    """The part of an edge in the integral of directions over a polygon: the angle between its ends, along the normal
    of the plane through them and the eye."""
    a = safe_normalize(begin)
    b = safe_normalize(end)
    normal = sl.cross(a, b)
    sine = sl.length(normal)
    return normal * (sl.atan2(sine, sl.dot(a, b)) / sl.max(sine, 1e-20))


@sl.function
def cross_horizon(above: sl.vec3, below: sl.vec3) -> sl.vec3:
    """The point of an edge at z = 0."""
    share = above.z / sl.max(above.z - below.z, 1e-37)
    return sl.vec3(above.xy + (below.xy - above.xy) * share, 0.0)


@sl.function
def is_small(center: sl.vec3, right: sl.vec3, up: sl.vec3) -> bool:
    """Test whether a rectangle around `center`, of these half sides, fills a small angle."""
    widest = sl.max(sl.dot(right, right), sl.dot(up, up))
    return widest < _SMALL * sl.dot(center, center)


@sl.function
def small_integral(center: sl.vec3, right: sl.vec3, up: sl.vec3) -> float:
    """The share of the cosine around z that a small rectangle fills."""
    distance = sl.max(sl.length(center), 1e-15)
    direction = center / distance
    facing = -sl.dot(sl.cross(right / distance, up / distance), direction)
    return 4.0 / _PI * sl.max(facing, 0.0) * sl.max(direction.z, 0.0)


@sl.function
def turn_tube(center: sl.vec3, axis: sl.vec3, radius: float) -> sl.vec3:
    """Half of the side across the tube's axis of the rectangle that looks like the tube. `center` leads to the
    tube's middle."""
    across = sl.cross(axis, center)
    squared_distance = sl.dot(across, across) / sl.max(sl.dot(axis, axis), 1e-37)
    filled = sl.min(radius * radius / sl.max(squared_distance, 1e-37), 0.99)
    return safe_normalize(across) * (radius / sl.sqrt(1.0 - filled))


@sl.function
def unstretch(fit: LobeFit, v: sl.vec3) -> sl.vec3:
    """M⁻¹ times a vector."""
    return sl.vec3(fit.xx * v.x + fit.xz * v.z, fit.yy * v.y, fit.zx * v.x + fit.zz * v.z)


@sl.function
def gather_rectangle(center: sl.vec3, right: sl.vec3, up: sl.vec3, fit: LobeFit) -> GatheredLight:
    """The light of a rectangle of radiance 1 / π in the space of a surface, whose normal is z.

    Each edge is cut at the horizon twice, before and after it is stretched. What a cut leaves open is closed along
    the horizon by an edge of its own.
    """
    total = sl.vec3(0.0)
    lobe = 0.0
    down = sl.vec3(0.0)
    rise = sl.vec3(0.0)
    stretched_down = sl.vec3(0.0)
    stretched_rise = sl.vec3(0.0)
    last = center - right - up
    for corner in range(5):
        begin = last
        end = center + (right if corner == 0 or corner == 1 else -right)
        end += up if corner == 1 or corner == 2 else -up
        last = end
        if corner == 4:
            begin = down
            end = rise
        elif begin.z < 0.0 and end.z < 0.0:
            begin = sl.vec3(0.0)
            end = sl.vec3(0.0)
        elif end.z < 0.0:
            end = cross_horizon(begin, end)
            down = end
        elif begin.z < 0.0:
            begin = cross_horizon(end, begin)
            rise = begin
        total -= edge_integral(begin, end)
        begin = unstretch(fit, begin)
        end = unstretch(fit, end)
        if begin.z >= 0.0 or end.z >= 0.0:
            if end.z < 0.0:
                end = cross_horizon(begin, end)
                stretched_down = end
            elif begin.z < 0.0:
                begin = cross_horizon(end, begin)
                stretched_rise = begin
            lobe -= edge_integral(begin, end).z
    lobe -= edge_integral(stretched_down, stretched_rise).z
    stretched = unstretch(fit, center)
    stretched_right = unstretch(fit, right)
    stretched_up = unstretch(fit, up)
    share = sl.max(lobe, 0.0) * (0.5 / _PI)
    if is_small(stretched, stretched_right, stretched_up):
        share = small_integral(stretched, stretched_right, stretched_up)
    direction = total
    scattered = sl.max(total.z, 0.0) * (0.5 / _PI)
    if is_small(center, right, up):
        direction = center
        scattered = small_integral(center, right, up)
    return GatheredLight(direction=safe_normalize(direction), scattered=scattered, mirrored=share)


@sl.function
def area_terms(
    surface: SurfacePoint, to_center: sl.vec3, shape: SourceShape, fit: LobeFit, is_metallic: bool
) -> sl.vec3:
    """The factors by which the surface's base colour, its specular colour and white reflect the light of a
    rectangle or a tube, each times its n·l. `to_center` leads to the source's middle."""
    up = shape.up
    if shape.radius >= 0.0:
        up = turn_tube(to_center, shape.right, shape.radius)
    if sl.dot(sl.cross(shape.right, up), to_center) >= 0.0:
        return sl.vec3(0.0)
    cosine = sl.dot(surface.normal, surface.to_eye)
    aside = surface.to_eye - surface.normal * cosine
    if sl.dot(aside, aside) < 1e-8:
        aside = sl.vec3(1.0, 0.0, 0.0) if sl.abs(surface.normal.x) < 0.7 else sl.vec3(0.0, 1.0, 0.0)
        aside -= surface.normal * sl.dot(surface.normal, aside)
    x = sl.normalize(aside)
    y = sl.cross(surface.normal, x)
    gathered = gather_rectangle(
        sl.vec3(sl.dot(x, to_center), sl.dot(y, to_center), sl.dot(surface.normal, to_center)),
        sl.vec3(sl.dot(x, shape.right), sl.dot(y, shape.right), sl.dot(surface.normal, shape.right)),
        sl.vec3(sl.dot(x, up), sl.dot(y, up), sl.dot(surface.normal, up)),
        fit,
    )
    terms = sl.vec3(gathered.scattered, gathered.mirrored * fit.energy, 0.0)
    if is_metallic:
        to_eye = sl.vec3(sl.sqrt(sl.max(1.0 - cosine * cosine, 0.0)), 0.0, cosine)
        beyond = 1.0 - sl.saturate(sl.dot(to_eye, safe_normalize(gathered.direction + to_eye)))
        p = beyond * beyond
        p = p * p * beyond
        terms = sl.vec3(
            gathered.scattered * (1.0 - p),
            gathered.mirrored * (fit.energy - fit.white),
            gathered.mirrored * fit.white,
        )
    return terms * shape.strength


class AreaLightReader(sl.Shader):
    """The base of shaders that light surfaces by local lights that may be rectangles and tubes. It reads the shapes
    of sources, two texels for each light, and the table of lobes."""

    lean = True

    source_shapes: sl.Texture2D
    lobe_fits: sl.Texture2D

    def source_shape(self, light_index: int) -> SourceShape:
        """The shape of the source of the light at this index."""
        texel = 2 * light_index
        column = texel % TABLE_WIDTH
        row = texel // TABLE_WIDTH
        right = self.source_shapes.load(sl.ivec2(column, row))
        up = self.source_shapes.load(sl.ivec2(column + 1, row))
        return SourceShape(right=right.xyz, up=up.xyz, radius=right.w, strength=up.w)

    def lobe_fit(self, surface: SurfacePoint, is_metallic: bool) -> LobeFit:
        """The fit of the surface's lobe."""
        roughness = sl.sqrt(sl.sqrt(2.0 / (sl.abs(surface.shininess) + 2.0)))
        least = _SHINIEST
        if is_metallic:
            roughness = -surface.shininess
            least = MIN_ROUGHNESS
        row = sl.saturate((roughness - least) / (1.0 - least)) * (FIT_SIZE - 1) + 0.5
        column = sl.sqrt(1.0 - sl.saturate(sl.dot(surface.normal, surface.to_eye)))
        u = (column * (FIT_SIZE - 1) + 0.5) / FIT_SIZE
        first = 2.0 * FIT_SIZE if is_metallic else 0.0
        numbers = self.lobe_fits.sample_lod(sl.vec2(u, (first + row) / (4 * FIT_SIZE)), 0.0)
        more = self.lobe_fits.sample_lod(sl.vec2(u, (first + FIT_SIZE + row) / (4 * FIT_SIZE)), 0.0)
        return LobeFit(
            xx=numbers.x, xz=numbers.y, zx=numbers.z, zz=numbers.w, yy=more.x, energy=more.y, white=more.z
        )
