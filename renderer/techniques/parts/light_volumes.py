"""Light volumes: the point and spot lights in view, drawn as the spaces that they reach, each pixel of them
once.

A sphere encloses a light's range, and a cone that of a spot light whose outer angle is at most 60°; the
shader cuts off what lies between the light's reach and the volume. Of a volume only the **back faces** are
drawn, with a depth test that passes where they are behind the geometry. So a pixel is lit once, whether the
eye is outside or inside, a volume cut by the near plane needs nothing, and neither the background nor what is
behind the volume is lit. One instanced draw lights all lights of a kind (two if there are narrow and wide
spot lights).

What lies in front of a volume passes this test. **Stencil masking** leaves that out, too, as in Wilks (2019):
each light is drawn twice, first both faces into the stencil buffer (plus 1 where a back face is behind the
geometry, minus 1 where a front face is: what remains is inside), then the back faces where the buffer isn't
0, which also sets it back. It evaluates fewer lights and takes two draws for each;
docs/measurements/lighting-measured.md has the figures.

Back faces beyond a far plane would be clipped. A volume that reaches it is moved to the depth of the
background as a whole, which never hides a lit pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import LOCAL_LIGHTS, Effect, Frame, FrameEffects, FramePass, Target
from renderer.frame.drawing import NEARER
from renderer.frame.pixel_rays import far_distance
from renderer.light_kinds.generation import define, for_kind
from renderer.light_kinds.incidence import Incidence, is_within_range
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.volumes import FARTHEST_CORNER, VolumeCorner
from renderer.light_kinds.volumes import VolumeVarying as VolumeVarying
from renderer.lights.hulls import make_cone, make_sphere
from renderer.shaders.area_lights import AreaLightReader
from renderer.shaders.pixels import PixelRays, nearness_to_distance
from renderer.shaders.spheres import SphereLightReader
from renderer.shaders.structs import ViewConstants
from renderer.shadows import ShadowReceiver
from renderer.techniques.parts.full_screen import BEHIND
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS
from renderer.techniques.parts.variants import bind, local_light_effects, shader_variant
from rhi import (
    BlendFunction,
    ColorWrite,
    Comparison,
    CullMode,
    DepthTest,
    DepthWrite,
    Device,
    Mesh,
    State,
    StencilBack,
    StencilFront,
    StencilOperation,
    StencilTest,
)

_MARGIN: Final = 1.001
"""The factor by which volumes are wider than they must be, for the rounding of what is drawn."""


class VolumeShader(SphereLightReader, AreaLightReader, ShadowReceiver):
    """Base of shaders that draw light volumes; `volume_lights` are the indices of the lights. A
    technique's fragment stage is combined with the volumes of one kind of lights, some of which may be
    spheres, rectangles or tubes."""

    has_spheres = False
    has_areas = False
    has_parallel_rays = False

    view: sl.Uniform[ViewConstants]
    rays: sl.Uniform[PixelRays]
    volume_lights: sl.Storage[int]

    def is_reached(self, position: sl.vec3, light: int) -> bool:
        """True if a position is in the range of the light of this index."""
        return False

    def light_incidence(self, position: sl.vec3, light: int) -> Incidence:
        """Direction and irradiance of the light of this index at a position."""
        return Incidence(direction=sl.vec3(0.0), irradiance=sl.vec3(0.0))

    def offset_to_light(self, position: sl.vec3, light: int) -> sl.vec3:
        """Vector from a position to the middle of the light of this index."""
        return sl.vec3(0.0)

    def squared_angular_size(self, position: sl.vec3, light: int) -> float:
        """Squared angular size (radius²/distance²) of the light of this index, seen from `position`."""
        return 0.0

    def apply_shadow(
        self, light: sl.vec3, position: sl.vec3, geometric_normal: sl.vec3, light_index: int
    ) -> sl.vec3:
        """The part of `light` that isn't shadowed at a surface."""
        return light

    def volume_range(self, position: sl.vec3, range: float) -> float:
        """The range of a light's volume: no more than it takes to hold all that a parallel view shows. The
        triangles of a longer volume would be so large that devices lose pixels of them."""
        if not self.has_parallel_rays:
            return range
        rays = self.rays
        half = 0.5 * rays.size
        middle = sl.length(rays.across @ sl.vec3(half, 1.0) + rays.start)
        first = sl.length(rays.across @ sl.vec3(half, 0.0))
        second = sl.length(rays.across @ sl.vec3(half.x, -half.y, 0.0))
        depth = sl.max(sl.abs(nearness_to_distance(rays, 1.0)), sl.abs(rays.far))
        farthest = middle + sl.max(first, second) + sl.length(rays.along) * depth
        return sl.min(range, sl.length(position) + farthest)

    @staticmethod
    def project_volume(
        center: sl.vec3, offset: sl.vec3, reach: float, view: ViewConstants, rays: PixelRays
    ) -> sl.vec4:
        """Clip position of a corner, `offset` from the light, of a volume that extends at most `reach`
        from it."""
        clip = view.relative_view_projection @ sl.vec4(center + offset, 1.0)
        if sl.dot(center, rays.forward) + reach > rays.far:
            clip.z = rays.farthest * clip.w
        return clip


def _define_volumes(kind: LocalLightKind) -> type[VolumeShader]:
    """Define the shader of a kind's volumes: its own vertex stage, and methods that are the same for all
    kinds."""
    text = for_kind(
        """
class ${Element}Volumes(KindVolume, VolumeShader):
    def is_reached(self, position: sl.vec3, light: int) -> bool:
        return is_within_range(
            position, self.${kind}_lights[light].position, self.${kind}_lights[light].range
        )

    def light_incidence(self, position: sl.vec3, light: int) -> Incidence:
        return $incidence(position, self.${kind}_lights[light])

    def offset_to_light(self, position: sl.vec3, light: int) -> sl.vec3:
        return self.${kind}_lights[light].position - position

    def squared_angular_size(self, position: sl.vec3, light: int) -> float:
        return self.squared_angular_sizes(self.${kind}_lights[light].position - position, light).$component

    def apply_shadow(
        self, light: sl.vec3, position: sl.vec3, geometric_normal: sl.vec3, light_index: int
    ) -> sl.vec3:
        return self.shadow_${kind}_light(light, position, geometric_normal, light_index)
""",
        kind,
    )
    shader: type[VolumeShader] = define(
        text,
        f"{kind.element.__name__}Volumes",
        __name__,
        KindVolume=kind.volume,
        VolumeShader=VolumeShader,
        Incidence=Incidence,
        is_within_range=is_within_range,
        sl=sl,
    )
    return shader


VOLUMES: Final = {effect: _define_volumes(row.kind) for effect, row in LOCAL_LIGHTS.items()}
"""The shader of each kind's volumes."""


def _make_sphere(device: Device) -> Mesh:
    """Create the sphere around a light's range."""
    return _make_mesh(device, "light spheres", *make_sphere(), cone=0.0)


def _make_cone(device: Device) -> Mesh:
    """Create the cone of a narrow spot light."""
    return _make_mesh(device, "light cones", *make_cone(), cone=1.0)


def _make_mesh(
    device: Device, label: str, corners: NDArray[np.float64], triangles: NDArray[np.uint32], cone: float
) -> Mesh:
    vertices = np.zeros(len(corners), VolumeCorner.dtype)
    vertices["position"], vertices["cone"] = corners * _MARGIN, cone
    return device.mesh(vertices, triangles.reshape(-1), label=label)


def declare_lights(
    effects: FrameEffects,
    buffers: Sequence[str],
    reads: tuple[str, ...],
    run: Callable[..., None],
    scale: float = 1.0,
    bits: int = DEFAULT_LIGHT_BITS,
    *,
    are_written: bool = False,
    reason: str = "",
) -> tuple[list[FramePass[Frame]], list[str]]:
    """The passes that add each kind of lights in view to light buffers, and the buffers' names after the
    last pass; both empty without such lights.

    Args:
        scale: the size of the buffers in that of the frame.
        bits: those of a channel, of `SUM_FORMATS`.
        are_written: whether an earlier pass has written the buffers, to which the light is added.
        reason: the first part of why the passes run.
        run: issues the commands; is given the frame and, by name, `effect`, the names of the `targets`, and
            whether it `clears` them.
    """
    passes: list[FramePass[Frame]] = []
    last = list(buffers) if are_written else []
    for effect in local_light_effects(effects):
        names = [f"{buffer} with {effect.value}" for buffer in buffers] if last else list(buffers)
        passes.append(
            FramePass(
                effect.value,
                partial(run, effect=effect, targets=names, clears=not last),
                reason + effects.explain(effect),
                reads=reads,
                writes=() if last else tuple(Target(name, SUM_FORMATS[bits], scale) for name in names),
                changes=dict(zip(last, names, strict=True)) if last else {},
            )
        )
        last = names
    return passes, last


def list_volumes(frame: Frame, effect: Effect) -> list[tuple[Mesh, NDArray[np.int64]]]:
    """The meshes of one kind of lights in view, each with the indices of its lights."""
    volume_lights = frame.effects.in_view[effect]
    kind = LOCAL_LIGHTS[effect].kind
    narrow = kind.fits_cone(frame.resources.lights.of_kind(kind)[volume_lights])
    volumes = ((_make_cone, volume_lights[narrow]), (_make_sphere, volume_lights[~narrow]))
    return [
        (frame.resources.workspace(make), light_indices)
        for make, light_indices in volumes
        if len(light_indices)
    ]


def draw_volumes(
    frame: Frame,
    effect: Effect,
    shader: type[VolumeShader],
    targets: Sequence[str],
    *,
    shader_bindings: Mapping[str, Any] = {},
    switches: Mapping[str, Any] = {},
    depth: str = "depth",
    clears: bool,
    is_masked: bool = False,
    states: tuple[State, ...] = (),
) -> None:
    """Draw the volumes of one kind of lights in view, and add what the shader returns to the targets.

    Args:
        shader: lights what is in a volume, with its `shader_bindings` and its `switches`.
        targets, depth: names of resources.
        clears: whether they are cleared to 0 first.
        is_masked: whether each light is masked in the stencil buffer; otherwise all are one draw.
        states: states instead of those that light what is in a volume.
    """
    device = frame.device
    row, enabled = LOCAL_LIGHTS[effect], frame.effects.enabled
    switches = {**switches, "has_spheres": row.spheres in enabled, "has_areas": row.areas in enabled}
    program: Any = frame.program(shader_variant(frame, shader, VOLUMES[effect], **switches))
    mask: Any = device.program(VOLUMES[effect]) if is_masked else None
    behind, nearer = (table[frame.camera.projection.depth] for table in (BEHIND, NEARER))
    with (
        device.render_pass(
            [frame.targets[target] for target in targets],
            frame.targets[depth],
            clear=(0.0, 0.0, 0.0, 0.0) if clears else None,
            clear_stencil=None if mask is None else 0,
        ),
        device.states(*(states or (DepthWrite.OFF, CullMode.FRONT, behind, BlendFunction.ADDITIVE))),
    ):
        for mesh, volume_lights in list_volumes(frame, effect):
            volume_bindings = {
                **shader_bindings,
                "volume_lights": device.transient.storage(int, volume_lights.astype(np.int32)),
            }
            bindings = bind(frame, program, volume_bindings)
            if mask is None:
                device.draw(program, mesh, len(volume_lights), **bindings)
                continue
            draws = mesh.draws(base_instance=np.arange(len(volume_lights)))
            crosses = crosses_far_plane(frame, effect, volume_lights)
            device.draw_many(program, mesh, draws[crosses], **bindings)
            for draw in draws[~crosses, None]:
                with device.states(CullMode.NONE, nearer, ColorWrite.OFF, *_MARKING):
                    device.draw_many(mask, mesh, draw, **bind(frame, mask, volume_bindings))
                with device.states(DepthTest.OFF, *_MARKED):
                    device.draw_many(program, mesh, draw, **bindings)


def crosses_far_plane(frame: Frame, effect: Effect, volume_lights: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The lights of `volume_lights` (k,) whose volumes may cross the far plane. They can't be
    masked: moved to the background's depth, their front faces would cancel the marks of their back faces."""
    camera, lights = frame.camera, frame.resources.lights.of_kind(LOCAL_LIGHTS[effect].kind)[volume_lights]
    distances = (lights["position"] - camera.position) @ camera.forward
    # The base of a cone is at most √3 ranges wide.
    reach = 2.0 * FARTHEST_CORNER * lights["range"]
    crosses: NDArray[np.bool_] = distances + reach > 0.999 * far_distance(camera)
    return crosses


_MARKING: Final = (
    StencilTest.ON,
    StencilFront(depth_fail=StencilOperation.DECREMENT_WRAP),
    StencilBack(depth_fail=StencilOperation.INCREMENT_WRAP),
)
_MARKED: Final = (
    StencilTest.ON,
    StencilBack(Comparison.NOT_EQUAL, both_pass=StencilOperation.ZERO),
)
