"""Light-indexed deferred rendering: a texture says which lights reach each pixel, then one forward pass reads
it (Trebilco, Light Indexed Deferred Rendering, ShaderX7, 2009).

1. A depth pass.
2. The volume of each light in view is drawn as the rectangle around it. Where the surface at a pixel's depth
   is in the light, its number is packed into `light indices`.
3. The forward pass, where depth is equal. A fragment unpacks its lights; materials may have any model of
   lighting.

Numbers are packed by blending, without reading the target. A number has 12 bits, 3 in each channel of
RGBA32F, and blending multiplies what is there by 8 and adds the new bits. A float has 24 bits, so that a
pixel holds 8 lights. The ninth brings at least one channel to 2²⁴, because no number is 0, and so do lights
beyond the 4,095 in view that have a number. Such a pixel says so (`count_overflowing`), and its fragments use
the list of their object's lights instead: it costs more, and looks the same.

With several samples per pixel, a surface may cover samples of a pixel, but not its centre: depth of one sample doesn't
bound what is lit. So a pixel then has the numbers of all lights whose rectangle touches it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer import rules
from renderer.frame import LOCAL_LIGHTS, Frame, FrameEffects, FramePass, Target, Targets
from renderer.frame.pixel_rays import bind_rays
from renderer.light_kinds.bounds import LightBounds
from renderer.light_kinds.generation import define
from renderer.light_kinds.incidence import safe_normalize, versine
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.lights.rectangles import bound_spheres
from renderer.scene.arrays import Indices
from renderer.shaders.pixels import PixelRays, depth_to_nearness, nearness_to_distance, pixel_position
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS, draw_once, forward_passes
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import Lighting, explain_local_lights, local_light_effects
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    CullMode,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    Mesh,
)

INDICES: Final = "light_indices"
"""The resource that holds the numbers of each pixel's lights."""
LIGHT_BITS: Final = 3
"""Bits of a light's number in each of the four channels of a texture of light indices."""
LIGHT_MASK: Final = (1 << LIGHT_BITS) - 1
LIGHTS_PER_PIXEL: Final = 24 // LIGHT_BITS
"""The lights whose numbers a pixel of light indices can hold: a float has 24 bits."""
OVERFLOW_VALUE: Final = float(1 << 24)
"""A channel of this or more says that a pixel has too many lights."""
MAX_INDEXED_LIGHTS: Final = (1 << 4 * LIGHT_BITS) - 1
"""The lights in view that have a number."""

_SHIFT: Final = float(1 << LIGHT_BITS)
_PACKED: Final = (
    CullMode.NONE,
    DepthTest.OFF,
    DepthWrite.OFF,
    BlendFunction(BlendFactor.ONE, BlendFactor.CONSTANT),
    BlendColor(_SHIFT, _SHIFT, _SHIFT, _SHIFT),
)
_CORNERS: Final = 6  # of the two triangles of a rectangle


class IndexedVolume(sl.Struct):
    """The volume of a light: its rectangle in the image, its position relative to the eye, and the value
    that is packed for it. The versine of a light without a cone is 3, which contains all directions."""

    rectangle: sl.vec4
    packed: sl.vec4
    position: sl.vec3
    range: float
    direction: sl.vec3
    outer_versine: float


class IndexVarying(sl.Struct):
    """The varyings of `PackIndices`."""

    clip: sl.vec4
    volume: int


class PackIndices(sl.Shader):
    """Writes the numbers of the lights that reach the surface at each pixel, one instance per light."""

    lean = True
    are_surfaces_known = True
    """Whether the surface at the pixel's depth is all that is lit."""

    volumes: sl.Storage[IndexedVolume]
    depth: sl.Texture2D
    rays: sl.Uniform[PixelRays]

    def vertex(self) -> IndexVarying:
        corner = sl.vertex_index()
        volume = sl.instance_index()
        sides = self.volumes[volume].rectangle
        x = sides.z if ((22 >> corner) & 1) == 1 else sides.x  # the corners of the two triangles:
        y = sides.w if ((52 >> corner) & 1) == 1 else sides.y  # 00 10 11, 00 11 01
        return IndexVarying(clip=sl.vec4(sl.vec2(x, y), 0.5, 1.0), volume=volume)

    def fragment(self, v: IndexVarying) -> sl.vec4:
        light = self.volumes[v.volume]
        if self.are_surfaces_known:
            pixel = sl.fragment_coordinate().xy
            nearness = depth_to_nearness(self.rays, self.depth.load(sl.ivec2(pixel)).x)
            if nearness == 0.0:
                sl.discard()
            away = (
                pixel_position(self.rays, pixel, nearness_to_distance(self.rays, nearness)) - light.position
            )
            if sl.dot(away, away) >= light.range * light.range:
                sl.discard()
            if versine(safe_normalize(away), light.direction) >= light.outer_versine:
                sl.discard()
        return light.packed


class PackTouched(PackIndices):
    """Writes the numbers of the lights whose rectangle touches each pixel."""

    are_surfaces_known = False


@sl.function
def next_light(packed: sl.uvec4) -> int:
    """Number of the first light in a pixel's packed numbers; 0 if there is none."""
    parts = packed & sl.uvec4(LIGHT_MASK)
    return int(
        parts.x | (parts.y << LIGHT_BITS) | (parts.z << (2 * LIGHT_BITS)) | (parts.w << (3 * LIGHT_BITS))
    )


class PixelLightReader(ForwardShader):
    """Base of `LitByIndices`."""

    light_indices: sl.Texture2D
    light_indices_by_number: sl.Storage[int]


def _shade_by_kind() -> str:
    """The source that adds the light of `light_index`, as `encode_indices` encodes it."""
    text, others = "", len(LOCAL_LIGHT_KINDS) - 1
    for number, kind in enumerate(LOCAL_LIGHT_KINDS):
        condition = f"self.has_{kind.name}_lights and light_index {'<' if number else '>='} 0"
        index = "~light_index" if number else "light_index"
        if number and others > 1:
            condition += f" and {index} % {others} == {number - 1}"
            index = f"{index} // {others}"
        text += f"            if {condition}:\n"
        text += f"                color += self.shade_{kind.name}_light(surface, {index})\n"
    return text


LitByIndices: Final[type[ForwardShader]] = define(
    f"""
class LitByIndices(PixelLightReader):
    def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> sl.vec3:
        indices = self.light_indices.load(sl.ivec2(sl.fragment_coordinate().xy))
        if sl.max(sl.max(indices.x, indices.y), sl.max(indices.z, indices.w)) >= OVERFLOW_VALUE:
            return super().shade_local_lights(surface, lights)
        packed = sl.uvec4(indices)
        color = sl.vec3(0.0)
        number = next_light(packed)
        while number > 0:
            light_index = self.light_indices_by_number[number - 1]
{_shade_by_kind()}
            packed = packed >> sl.uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color
""",
    "LitByIndices",
    __name__,
    PixelLightReader=PixelLightReader,
    LightBounds=LightBounds,
    SurfacePoint=SurfacePoint,
    LIGHT_BITS=LIGHT_BITS,
    OVERFLOW_VALUE=OVERFLOW_VALUE,
    next_light=next_light,
    sl=sl,
)
"""Finds the lights of a pixel in a texture. A pixel with too many lights uses its object's list."""


def _make_rectangle(device: Device) -> Mesh:
    return device.mesh(_CORNERS, label="light volume")


class LightIndexed:
    """Draws depth, the light numbers of each pixel, then the scene lit by them. Without local lights in
    view, as `Forward`."""

    name: Final = "light_indexed"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        PackIndices,
        PackTouched,
        LitByIndices,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(self, samples: int = 1) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`."""
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "LightIndexed(samples=...)", samples)

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `depth`, `light indices` and `forward`, and those of transparent surfaces; with several samples
        also `depth samples` and `resolve`. Without local lights, those of `Forward`."""
        if not local_light_effects(effects):
            return forward_passes(effects, samples=self.samples)
        reason = "draws the visible objects, lit by the lights of each pixel"
        indices = FramePass(
            "light indices",
            partial(_pack_indices, are_surfaces_known=self.samples == 1),
            f"writes the numbers of each pixel's lights; {explain_local_lights(effects)}",
            reads=("depth",),
            writes=(Target(INDICES, Format.RGBA32F),),
        )
        first = (
            "finds the surface that lights reach at each pixel" if self.samples == 1 else "finds what is seen"
        )
        return draw_once(
            effects, LIT_BY_INDICES, reason, samples=self.samples, depth_first=first, lists=(indices,)
        )


def count_overflowing(targets: Targets) -> int | None:
    """Number of pixels of the last frame with more lights than can be packed; None if its plan has no
    light indices. Waits for the device."""
    indices = targets.get(INDICES)
    return None if indices is None else int((indices.read() >= OVERFLOW_VALUE).any(-1).sum())


def _pack_indices(frame: Frame, *, are_surfaces_known: bool) -> None:
    device = frame.device
    volumes = list_volumes(frame)
    program: Any = device.program(PackIndices if are_surfaces_known else PackTouched)
    bindings: dict[str, Any] = {}
    if are_surfaces_known:
        bindings = {"depth": frame.targets["depth"], "rays": bind_rays(frame)}
    else:  # samples beside a pixel's centre are up to half a pixel from it
        rectangles, size = volumes["rectangle"], np.array(frame.targets.size, np.float32)
        rectangles[:, :2] -= 1.0 / size
        rectangles[:, 2:] += 1.0 / size
    with (
        device.render_pass(frame.targets[INDICES], clear=(0.0, 0.0, 0.0, 0.0)),
        device.states(*_PACKED),
    ):
        device.draw(
            program,
            frame.resources.workspace(_make_rectangle),
            len(volumes),
            volumes=device.transient.storage(IndexedVolume, volumes),
            **bindings,
        )


def list_volumes(frame: Frame) -> NDArray[Any]:
    """Volumes (l,) of `IndexedVolume` of the local lights in view, kind by kind."""
    effects, eye = frame.effects, frame.camera.position
    parts: list[NDArray[Any]] = []
    centers: list[NDArray[Any]] = []
    radii: list[NDArray[Any]] = []
    for effect, row in LOCAL_LIGHTS.items():
        kind, lights = row.kind, frame.resources.lights.of_kind(row.kind)[effects.in_view[effect]]
        part: Any = np.zeros(len(lights), IndexedVolume.dtype)
        part["position"], part["range"] = lights["position"] - eye, lights["range"]
        part["outer_versine"] = kind.cone_versine(lights)
        if kind.has_direction:
            part["direction"] = lights["direction"]
        parts.append(part)
        for values, added in zip((centers, radii), kind.bounds(lights), strict=True):
            values.append(added)
    volumes: NDArray[Any] = np.concatenate(parts)
    volumes["rectangle"] = bound_spheres(frame.camera, np.concatenate(centers), np.concatenate(radii))
    volumes["packed"] = pack_numbers(np.arange(1, len(volumes) + 1))
    return volumes


def pack_numbers(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Packed values (l, 4) of these light numbers; numbers that are too large fill a pixel."""
    packed: NDArray[np.int64] = numbers[:, None] >> LIGHT_BITS * np.arange(4) & LIGHT_MASK
    packed[numbers > MAX_INDEXED_LIGHTS] = int(OVERFLOW_VALUE)
    return packed


def encode_indices(indices: Sequence[Indices]) -> NDArray[np.int32]:
    """Distinct numbers (l,) for the light indices of each kind: 0 and above for the first kind,
    interleaved below 0 for the others."""
    first, *others = indices
    encoded = [first, *(~(kind_indices * len(others) + number) for number, kind_indices in enumerate(others))]
    return np.concatenate(encoded).astype(np.int32)


def _bind_indices(frame: Frame) -> dict[str, Any]:
    light_indices_by_number = encode_indices([frame.effects.in_view[effect] for effect in LOCAL_LIGHTS])
    return {"light_indices_by_number": frame.device.transient.storage(int, light_indices_by_number)}


LIT_BY_INDICES: Final = Lighting((LitByIndices,), bind=_bind_indices, reads=(INDICES,))
