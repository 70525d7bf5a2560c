"""Contact shadows: the sun's light that what is near a surface takes from it, computed from depth alone.

Texels of a shadow map are wider than the gap below a pebble. So a short ray is followed from each pixel's surface
towards the sun, over the depth buffer: where a sample of the ray is behind a surface of the image, and not farther
behind it than that is thick, the ray is blocked. How thick it is the image doesn't tell: it is `contact_thickness`,
or a step's depth where steps are deeper. A surface doesn't block rays of its own plane. Towards the end of the ray
shadows fade.

To a sun with a size go several rays, spread over its disc on the spiral of the maps' filters, and the surface has the
mean of their light: a penumbra as wide as the blocker's distance calls for. Rays are the same for all pixels, so there
is no noise to blur; a straight edge takes a step for each ray.

What isn't in the image blocks nothing: what is outside, and what is hidden. And what is thicker than it is taken to be
lets rays through behind it, what is thinner blocks too many. Shadow maps have all of this; light has to pass both.
"""

from __future__ import annotations

from typing import Final

import numpy as np

import rhi.shading as sl
from renderer.frame import Effect, Frame, FrameEffects, FramePass, Target
from renderer.frame.occlusion import CONTACTS
from renderer.scene.arrays import Floats
from renderer.shaders.pixels import BackgroundScreen, nearness_to_distance
from renderer.shaders.structs import ViewConstants
from renderer.shadows import ShadowMaps
from renderer.shadows.filters import turn_by_golden_angle
from renderer.techniques.parts.ambient_occlusion import DepthSurface
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Format

_OPEN: Final = (1.0, 1.0, 1.0, 1.0)  # all of the light arrives
_FLATNESS: Final = 0.02
"""The sine of the angle above a surface's plane from which on others block its light."""
_NEAREST: Final = 0.9
"""The share of the way to the eye's plane that a ray may come near it."""


class ContactConstants(sl.Struct):
    """The unit direction to the light, the settings `contact_length` and `contact_thickness` in metres, and the halved
    axes of the light's disc, a metre away."""

    to_light: sl.vec3
    length: float
    across: sl.vec3
    thickness: float
    up: sl.vec3


class FollowContacts(BackgroundScreen, DepthSurface):
    """Follows rays to the sun from each pixel's surface."""

    precision = sl.Precision.FAST
    steps = 16
    ray_count = 1

    view: sl.Uniform[ViewConstants]
    contact: sl.Uniform[ContactConstants]

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        nearness = self.load_nearness(pixel)
        if nearness == 0.0:
            sl.discard()
        position = self.locate(pixel, nearness)
        normal = self.compute_normal(pixel, position, nearness, self.direction_to_eye(position))
        if sl.dot(normal, self.contact.to_light) <= 0.0:
            return sl.vec4(1.0)
        distance = nearness_to_distance(self.rays, nearness)
        lit = 0.0
        way = sl.vec2(1.0, 0.0)
        for number in range(self.ray_count):
            radius = sl.sqrt((float(number) + 0.5) / float(self.ray_count))
            aside = self.contact.across * (radius * way.x) + self.contact.up * (radius * way.y)
            to_source = sl.normalize(self.contact.to_light + aside)
            lit += self.follow(pixel, position, normal, distance, to_source)
            way = turn_by_golden_angle(way)
        return sl.vec4(lit / float(self.ray_count))

    def follow(
        self, pixel: sl.ivec2, position: sl.vec3, normal: sl.vec3, distance: float, to_source: sl.vec3
    ) -> float:
        """Return the share of the light of a point of the source that reaches `position`, the surface of a pixel at
        this distance."""
        width = self.rays.projection.y - self.rays.projection.w * distance
        texel = sl.length(self.rays.across @ sl.vec3(1.0, 0.0, 0.0)) * width  # in metres
        reach = self.contact.length
        away = sl.dot(to_source, self.rays.forward)
        if not self.has_parallel_rays and away < 0.0:
            reach = sl.min(reach, _NEAREST * distance / -away)
        thickness = sl.max(self.contact.thickness, sl.abs(away) * reach / float(self.steps))
        for number in range(self.steps):
            share = (float(number) + 0.5) / float(self.steps)
            step = to_source * (reach * share)
            clip = self.view.relative_view_projection @ sl.vec4(position + step, 1.0)
            at = sl.ivec2(sl.floor((clip.xy / clip.w * sl.vec2(0.5, -0.5) + 0.5) * self.rays.size))
            near = self.load_nearness(at)
            if near > 0.0 and at != pixel:
                behind = distance + away * reach * share - nearness_to_distance(self.rays, near)
                other = self.locate(at, near) - position
                height = sl.dot(other, normal) - 0.25 * texel
                if behind > 0.0 and behind < thickness and height > _FLATNESS * sl.length(other):
                    return sl.saturate(4.0 * share - 3.0)
        return 1.0


CONTACT_SHADERS: Final[tuple[type[sl.Shader], ...]] = (FollowContacts,)
"""The shaders of `contact_passes`."""


def contact_passes(effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
    """The pass that computes contact shadows from `depth`; none without them."""
    if Effect.CONTACT_SHADOWS not in effects.enabled:
        return ()
    reason = f"follows rays to the sun over the image; {effects.explain(Effect.CONTACT_SHADOWS)}"
    target = Target(CONTACTS, Format.R8)
    return (FramePass("contact shadows", _draw_contacts, reason, reads=("depth",), writes=(target,)),)


def make_axes(direction: Floats) -> Floats:
    """Return two unit vectors (2, 3) at right angles to a unit vector (3,) and to each other."""
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(direction, across)])


def _draw_contacts(frame: Frame) -> None:
    settings = frame.resources.workspace(ShadowMaps).settings
    light = frame.resources.lights.directional[frame.effects.contact_light]
    to_light = -light["direction"].astype(np.float64)
    axes = make_axes(to_light) * np.tan(0.5 * float(light["angular_diameter"]))
    constants = ContactConstants(
        to_light=to_light,
        length=settings.contact_length,
        across=axes[0],
        thickness=settings.contact_thickness,
        up=axes[1],
    )
    bindings = {"contact": frame.resources.mirror(constants)}
    ray_count = settings.contact_rays if light["angular_diameter"] > 0.0 else 1
    switches = {"steps": settings.contact_steps, "ray_count": ray_count}
    draw_full_screen(frame, FollowContacts, frame.targets[CONTACTS], bindings, clear=_OPEN, switches=switches)
