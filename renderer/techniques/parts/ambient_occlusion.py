"""Ambient occlusion on the screen: the share of ambient light that reaches each visible surface, computed from
depth alone.

1. `ambient occlusion` looks along slices through the view ray of each pixel (Jimenez et al. 2016, *Practical
   Realtime Strategies for Accurate Indirect Occlusion*). On both sides of a slice it steps over the depth
   buffer and keeps the horizon: the largest angle, from the surface up, that the surfaces it meets have taken. The
   cosine-weighted visibility between two horizons has a closed form; the mean over the slices is the result.
   A sample counts less the farther it is away, and not at all from the radius of the scene's
   `AmbientOcclusion` on.
2. `smooth ambient occlusion` takes the mean of 4 × 4 pixels: slices and steps of each pixel are turned by one
   of 16 amounts, and this mean has all of them. Pixels of other surfaces don't count.

Surfaces are shaded with the result afterwards, so depth is drawn in a pass of its own, unless a technique
does so anyway. Normals are those of the depth buffer's surface, so every technique has the same occlusion, and
normal maps don't change it.

What isn't in the image takes no light: what is outside, and what is hidden. And what is in front of a pixel
may be thinner than its depth can tell: all of its slice behind it counts as taken.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.frame import Effect, Frame, FrameEffects, FramePass, Target
from renderer.frame.occlusion import OCCLUSION, OcclusionSettings
from renderer.shaders.pixels import (
    BackgroundScreen,
    ViewRayShader,
    depth_to_nearness,
    nearness_to_distance,
    pixel_position,
)
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Format

_TURNED: Final = "turned_occlusion"
_FORMATS: Final = {8: Format.R8, 16: Format.R16}
_HALF_TURN: Final = 3.141592653589793
_QUARTER_TURN: Final = 0.5 * _HALF_TURN
_OPEN: Final = (1.0, 1.0, 1.0, 1.0)  # all of the light arrives
_FLATNESS: Final = 0.1
"""Pixels of the mean are up to this share of the radius away from the plane of the surface."""


class OcclusionConstants(sl.Struct):
    """The radius in metres."""

    radius: float


class DepthSurface(ViewRayShader):
    """The base of shaders that read surfaces from the depth buffer."""

    depth: sl.Texture2D

    def load_nearness(self, pixel: sl.ivec2) -> float:
        """Return the nearness of a pixel; 0 for the background, and for pixels beyond the edge."""
        if pixel != sl.clamp(pixel, sl.ivec2(0), self.depth.size() - 1):
            return 0.0
        return depth_to_nearness(self.rays, self.depth.load(pixel).x)

    def locate(self, pixel: sl.ivec2, nearness: float) -> sl.vec3:
        """Return the position of a pixel's surface, relative to the eye."""
        distance = nearness_to_distance(self.rays, nearness)
        return pixel_position(self.rays, sl.vec2(pixel) + 0.5, distance)

    def compute_tangent(self, pixel: sl.ivec2, position: sl.vec3, nearness: float, step: sl.ivec2) -> sl.vec3:
        """Return the way to the neighbour along `step` or against it, whichever nearness differs less: that
        one is more likely to be on the same surface."""
        after = self.load_nearness(pixel + step)
        before = self.load_nearness(pixel - step)
        after_differs = sl.abs(after - nearness) if after > 0.0 else 1e30
        before_differs = sl.abs(before - nearness) if before > 0.0 else 1e30
        if sl.min(after_differs, before_differs) > 1e29:  # a pixel alone: it faces the eye
            return self.rays.across @ sl.vec3(sl.vec2(step), 0.0)
        if after_differs <= before_differs:
            return self.locate(pixel + step, after) - position
        return position - self.locate(pixel - step, before)

    def compute_normal(self, pixel: sl.ivec2, position: sl.vec3, nearness: float, to_eye: sl.vec3) -> sl.vec3:
        """Return the unit normal of a pixel's surface, on the side of the eye."""
        right = self.compute_tangent(pixel, position, nearness, sl.ivec2(1, 0))
        down = self.compute_tangent(pixel, position, nearness, sl.ivec2(0, 1))
        normal = sl.cross(right / sl.length(right), down / sl.length(down))
        normal = normal / sl.max(sl.length(normal), 1e-20)
        return normal if sl.dot(normal, to_eye) >= 0.0 else -normal


class HorizonOcclusion(BackgroundScreen, DepthSurface):
    """Finds the share of ambient light that is left by the horizons of slices."""

    precision = sl.Precision.FAST
    slices = 2
    steps = 4

    occlusion: sl.Uniform[OcclusionConstants]

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        nearness = self.load_nearness(pixel)
        if nearness == 0.0:
            sl.discard()
        position = self.locate(pixel, nearness)
        to_eye = self.direction_to_eye(position)
        normal = self.compute_normal(pixel, position, nearness, to_eye)
        distance = nearness_to_distance(self.rays, nearness)
        width = self.rays.projection.y - self.rays.projection.w * distance
        right = self.rays.across @ sl.vec3(1.0, 0.0, 0.0)
        down = self.rays.across @ sl.vec3(0.0, 1.0, 0.0)
        reach = self.occlusion.radius / (sl.length(right) * width)  # in pixels
        if reach < 1.0:
            return sl.vec4(1.0)
        # 16 pixels of 4 × 4 have as many turns of the slices, and 4 offsets of the steps.
        turn = float(((pixel.x + pixel.y) & 3) * 4 + (pixel.x & 3)) / 16.0
        offset = float((pixel.y - pixel.x) & 3) / 4.0 + 0.125
        visible = sl.vec2(0.0)
        for number in range(self.slices):
            angle = (float(number) + turn) * (_HALF_TURN / float(self.slices))
            along = sl.vec2(sl.cos(angle), sl.sin(angle))
            visible += self.integrate_slice(
                pixel, position, normal, to_eye, right * along.x + down * along.y, along * reach, offset
            )
        return sl.vec4(sl.saturate(visible.x / visible.y))  # few slices have more light than others

    def integrate_slice(
        self,
        pixel: sl.ivec2,
        position: sl.vec3,
        normal: sl.vec3,
        to_eye: sl.vec3,
        direction: sl.vec3,
        reach: sl.vec2,
        offset: float,
    ) -> sl.vec2:
        """Return the visibility in the slice of `direction`, which is `reach` long in pixels on each side, and
        what it would be with nothing in it."""
        across = direction - to_eye * sl.dot(direction, to_eye)
        across = across / sl.max(sl.length(across), 1e-20)
        axis = sl.cross(across, to_eye)
        projected = normal - axis * sl.dot(normal, axis)
        length = sl.max(sl.length(projected), 1e-6)
        cosine = sl.clamp(sl.dot(projected, to_eye) / length, 0.0, 1.0)
        tilt = sl.acos(cosine)
        if sl.dot(projected, across) < 0.0:
            tilt = -tilt
        # On each side, the highest sine above the surface so far, and the visibility up to it.
        after = sl.vec2(0.0, self.integrate_arc(tilt + _QUARTER_TURN, tilt))
        before = sl.vec2(0.0, self.integrate_arc(tilt - _QUARTER_TURN, tilt))
        unoccluded = after.y + before.y
        visible = unoccluded
        extent = sl.max(sl.abs(reach.x), sl.abs(reach.y))
        last = 0.0
        for number in range(self.steps):
            share = (float(number) + offset) / float(self.steps)
            away = sl.max(share * share * extent, 1.0)  # in pixels: no sample is of the pixel itself
            step = sl.ivec2(sl.round(reach * (away / extent)))
            # What raises the horizon begins somewhere between the last sample and this one.
            middle = 0.5 + 0.5 * last / away
            last = away
            sample = self.measure_occluder(pixel + step, position, normal, middle) / sl.vec2(length, 1.0)
            if sample.x > after.x and sample.y > 0.0:
                arc = self.integrate_arc(sl.max(tilt + sl.acos(sl.min(sample.x, 1.0)), 0.0), tilt)
                visible -= sample.y * (after.y - arc)
                after = sl.vec2(sample.x, arc)
            sample = self.measure_occluder(pixel - step, position, normal, middle) / sl.vec2(length, 1.0)
            if sample.x > before.x and sample.y > 0.0:
                arc = self.integrate_arc(sl.min(tilt - sl.acos(sl.min(sample.x, 1.0)), 0.0), tilt)
                visible -= sample.y * (before.y - arc)
                before = sl.vec2(sample.x, arc)
        return length * sl.vec2(visible, unoccluded)

    def measure_occluder(self, pixel: sl.ivec2, position: sl.vec3, normal: sl.vec3, middle: float) -> sl.vec2:
        """Return the height of a pixel's surface above the plane of the surface at `position`, as the sine of
        the angle, and the share of light that a surface takes at `middle` of its distance. A plane has a sine
        of 0 in all of its pixels, wherever they are beside the slice."""
        nearness = self.load_nearness(pixel)
        if nearness == 0.0:
            return sl.vec2(0.0)
        way = self.locate(pixel, nearness) - position
        square = sl.dot(way, way)
        taken = 1.0 - square * middle * middle / (self.occlusion.radius * self.occlusion.radius)
        return sl.vec2(sl.dot(way, normal) / sl.sqrt(sl.max(square, 1e-30)), sl.max(taken, 0.0))

    def integrate_arc(self, horizon: float, tilt: float) -> float:
        """Return the cosine-weighted visibility between the view ray and a horizon, both angles signed: the
        integral of sin θ cos(θ - tilt)."""
        return 0.25 * (sl.cos(tilt) + 2.0 * horizon * sl.sin(tilt) - sl.cos(2.0 * horizon - tilt))


class SmoothOcclusion(BackgroundScreen, DepthSurface):
    """Takes the mean of 4 × 4 pixels of the same surface: of 5 × 5, whose outermost count half."""

    precision = sl.Precision.FAST

    turned_occlusion: sl.Texture2D
    occlusion: sl.Uniform[OcclusionConstants]

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        nearness = self.load_nearness(pixel)
        if nearness == 0.0:
            sl.discard()
        position = self.locate(pixel, nearness)
        normal = self.compute_normal(pixel, position, nearness, self.direction_to_eye(position))
        total = 0.0
        weights = 0.0
        for y in range(-2, 3):
            for x in range(-2, 3):
                neighbour = pixel + sl.ivec2(x, y)
                near = self.load_nearness(neighbour)
                if near > 0.0:
                    away = sl.abs(sl.dot(normal, self.locate(neighbour, near) - position))
                    weight = sl.saturate(1.0 - away / (_FLATNESS * self.occlusion.radius))
                    weight *= (0.5 if x * x == 4 else 1.0) * (0.5 if y * y == 4 else 1.0)
                    total += weight * self.turned_occlusion.load(neighbour).x
                    weights += weight
        return sl.vec4(total / sl.max(weights, 1e-6))


OCCLUSION_SHADERS: Final[tuple[type[sl.Shader], ...]] = (HorizonOcclusion, SmoothOcclusion)
"""The shaders of `occlusion_passes`."""


def occlusion_passes(effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
    """The passes that compute ambient occlusion from `depth`; none without it."""
    if Effect.AMBIENT_OCCLUSION not in effects.enabled:
        return ()
    settings, reason = effects.occlusion, effects.explain(Effect.AMBIENT_OCCLUSION)
    texture_format = _FORMATS[settings.bits]
    turned = _TURNED if settings.is_smooth else OCCLUSION
    passes: list[FramePass[Frame]] = [
        FramePass(
            "ambient occlusion",
            lambda frame: _draw_occlusion(frame, settings, turned),
            f"computes the share of ambient light that arrives; {reason}",
            reads=("depth",),
            writes=(Target(turned, texture_format),),
        )
    ]
    if settings.is_smooth:
        passes.append(
            FramePass(
                "smooth ambient occlusion",
                _smooth_occlusion,
                "takes the mean of the slices of neighbouring pixels",
                reads=("depth", _TURNED),
                writes=(Target(OCCLUSION, texture_format),),
            )
        )
    return tuple(passes)


def _bind_constants(frame: Frame) -> dict[str, object]:
    scene = frame.resources.scene
    assert scene.ambient_occlusion is not None, "only a scene with ambient occlusion has its passes"
    constants = OcclusionConstants(radius=scene.ambient_occlusion.radius)
    return {"occlusion": frame.resources.mirror(constants)}


def _draw_occlusion(frame: Frame, settings: OcclusionSettings, target: str) -> None:
    switches = {"slices": settings.slices, "steps": settings.steps}
    bindings = _bind_constants(frame)
    draw_full_screen(frame, HorizonOcclusion, frame.targets[target], bindings, clear=_OPEN, switches=switches)


def _smooth_occlusion(frame: Frame) -> None:
    draw_full_screen(frame, SmoothOcclusion, frame.targets[OCCLUSION], _bind_constants(frame), clear=_OPEN)
