"""Light-indexed deferred rendering: a texture says which lights reach each pixel, then one forward pass reads it
(Trebilco, Light Indexed Deferred Rendering, ShaderX7, 2009).

1. A depth pass.
2. The volume of each light in view is drawn as the rectangle around it. Where the surface at a pixel's depth is in the
   light, its number is packed into `light indices`.
3. The forward pass, where depth is equal. A fragment unpacks its lights; materials may have any model of lighting.

Numbers are packed by blending, without reading the target. A number has 12 bits, 3 in each channel of RGBA32F, and
blending multiplies what is there by 8 and adds the new bits. A float has 24 bits, so that a pixel holds 8 lights. The
ninth brings at least one channel to 2²⁴, because no number is 0, and so do lights beyond the 4,095 in view that have a
number. Such a pixel says so (`count_overflowing`), and its fragments use the list of their object's lights instead: it
costs more, and looks the same.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.lights.rectangles import bound_cones, bound_spheres
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import PixelConstants, nearness_of, position_at
from renderer.techniques.depth import draw_depth
from renderer.techniques.forward import Forward, bind_forward
from renderer.techniques.forward_multipass import LAMPS
from renderer.techniques.forward_shader import LIGHT_BITS, LIGHT_MASK, LIGHTS_FULL
from renderer.techniques.full_screen import bind_pixels
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    Texture,
)
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    Uniform,
    discard,
    dot,
    fragment_coordinate,
    instance_index,
    ivec2,
    vec2,
    vec3,
    vec4,
    vertex_index,
)

INDICES: Final = "light indices"
"""The contents that hold the numbers of each pixel's lights."""
MOST_LIGHTS: Final = (1 << 4 * LIGHT_BITS) - 1
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


class LightVolume(Struct):
    """The volume of a light: the rectangle around it in the image, its place relative to the eye, and the value that
    is packed for it. A point light has a cone of -2, which holds all directions."""

    rectangle: vec4
    packed: vec4
    position: vec3
    range: float
    direction: vec3
    cos_outer: float


class VolumeVarying(Struct):
    """The varyings of `PackIndices`."""

    clip: vec4
    volume: int


class PackIndices(Shader):
    """Writes the numbers of the lights that reach the surface at each pixel; an instance is a light."""

    volumes: Storage[LightVolume]
    depth: Texture2D
    pixels: Uniform[PixelConstants]

    def vertex(self) -> VolumeVarying:
        corner = vertex_index()
        volume = instance_index()
        sides = self.volumes[volume].rectangle
        x = sides.z if ((22 >> corner) & 1) == 1 else sides.x  # the corners of the two triangles:
        y = sides.w if ((52 >> corner) & 1) == 1 else sides.y  # 00 10 11, 00 11 01
        return VolumeVarying(clip=vec4(vec2(x, y), 0.5, 1.0), volume=volume)

    def fragment(self, v: VolumeVarying) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.depth.load(ivec2(place)).x, self.pixels)
        if nearness == 0.0:
            discard()
        light = self.volumes[v.volume]
        away = position_at(place, nearness, self.pixels) - light.position
        if dot(away, away) >= light.range * light.range:
            discard()
        if dot(safe_normalize(away), light.direction) <= light.cos_outer:
            discard()
        return light.packed


class VolumeMesh:
    """Keeps the corners of a light's rectangle."""

    def __init__(self, device: Device) -> None:
        self.mesh = device.mesh(_CORNERS, label="light volume")

    def destroy(self) -> None:
        """Destroy the mesh."""
        self.mesh.destroy()


class LightIndexed:
    """Draws depth, the lights of each pixel, then the scene lit by them; without lamps in view, as `Forward` does."""

    name: Final = "light_indexed"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the three passes."""
        lamps = [effect for effect in LAMPS if effect in needs.effects]
        if not lamps:
            return Forward().declare(needs)
        because = "; ".join(needs.explain(effect) for effect in lamps)
        return (
            Pass(
                "depth",
                draw_depth,
                "finds the surface that lights reach at each pixel",
                writes=(Target("depth", DEPTH_FORMAT),),
            ),
            Pass(
                INDICES,
                _pack_indices,
                f"writes the numbers of each pixel's lights; {because}",
                reads=("depth",),
                writes=(Target(INDICES, Format.RGBA32F),),
            ),
            Pass(
                "forward",
                _draw_lit,
                "draws the visible objects, lit by the lights of each pixel",
                reads=(INDICES, "depth"),
                writes=(Target("image", IMAGE_FORMAT),),
            ),
        )


def count_overflowing(indices: Texture) -> int:
    """Return the number of pixels with more lights than the contents `light indices` can hold. Waits for the device."""
    return int((indices.read() >= LIGHTS_FULL).any(-1).sum())


def _pack_indices(frame: Frame) -> None:
    device = frame.device
    volumes = list_volumes(frame)
    with (
        device.render_pass(frame.targets[INDICES], clear=(0.0, 0.0, 0.0, 0.0)),
        device.states(*_PACKED),
    ):
        device.draw(
            device.program(PackIndices),
            frame.resources.workspace(VolumeMesh).mesh,
            len(volumes),
            volumes=device.transient.storage(LightVolume, volumes),
            depth=frame.targets["depth"],
            pixels=bind_pixels(frame),
        )


def list_volumes(frame: Frame) -> NDArray[Any]:
    """Return the volumes (l,) of `LightVolume` of the lights in view: point lights, then spot lights."""
    needs, lights, eye = frame.needs, frame.resources.scene.lights, frame.camera.position
    points, spots = lights.point[needs.point_rows], lights.spot[needs.spot_rows]
    volumes: Any = np.zeros(len(points) + len(spots), LightVolume.dtype)
    first, last = volumes[: len(points)], volumes[len(points) :]
    first["cos_outer"] = -2.0
    last["cos_outer"], last["direction"] = np.cos(spots["outer"]), spots["direction"]
    for part, some in ((first, points), (last, spots)):
        part["position"], part["range"] = some["position"] - eye, some["range"]
    ranges, outer = spots["range"].astype(np.float64), spots["outer"].astype(np.float64)
    centers, radii = bound_cones(spots["position"], spots["direction"].astype(np.float64), ranges, outer)
    volumes["rectangle"] = bound_spheres(
        frame.camera,
        np.concatenate([points["position"], centers]),
        np.concatenate([points["range"].astype(np.float64), radii]),
    )
    volumes["packed"] = pack_numbers(np.arange(1, len(volumes) + 1))
    return volumes


def pack_numbers(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what is packed (l, 4) for lights with these numbers; those that are too large fill a pixel."""
    packed = numbers[:, None] >> LIGHT_BITS * np.arange(4) & LIGHT_MASK
    packed[numbers > MOST_LIGHTS] = int(LIGHTS_FULL)
    return packed


def _draw_lit(frame: Frame) -> None:
    needs, targets = frame.needs, frame.targets
    numbered = np.concatenate([needs.point_rows, ~needs.spot_rows]).astype(np.int32)
    parts = {Effect.POINT_LIGHTS: "indexed_points", Effect.SPOT_LIGHTS: "indexed_spots"}
    program, bindings = bind_forward(
        frame,
        "ambient",
        *(part for effect, part in parts.items() if effect in needs.effects),
        light_indices=targets[INDICES],
        numbered=frame.device.transient.storage(int, numbered),
    )
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=targets["image"],
            depth=targets["depth"],
            clear=(*frame.resources.scene.background, 1.0),
            states=(DepthFunction.EQUAL, DepthWrite.OFF),
            clears=False,
        )
    )
