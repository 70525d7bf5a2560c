"""Light volumes: the point and spot lights in view, drawn as the spaces that they reach, each pixel of them once.

A sphere encloses a light's range, and a cone that of a spot light whose outer angle is at most 60°; the shader cuts off
what lies between the light's reach and the volume. Of a volume only the **back faces** are drawn, with a depth test
that passes where they are behind the geometry. So a pixel is lit once, whether the eye is outside or inside, a volume
cut by the near plane needs nothing, and neither the background nor what is behind the volume is lit. One instanced draw
lights all lights of a kind (two if there are narrow and wide spot lights).

What lies in front of a volume passes this test. **Stencil masking** leaves that out, too, as in Wilks (2019): each
light is drawn twice, first both faces into the stencil buffer (plus 1 where a back face is behind the geometry, minus 1
where a front face is: what remains is inside), then the back faces where the buffer isn't 0, which also sets it back.
It evaluates fewer lights and takes two draws for each; docs/lighting-measured.md has the figures.

Back faces beyond a far plane would be clipped. A volume that reaches it is moved to the depth of the background
as a whole, which never hides a lit pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import LAMPS, Effect, Frame, Needs, Pass, Target
from renderer.frame.passes import NEARER
from renderer.lights.hulls import make_cone, make_sphere
from renderer.shaders.lighting import is_near, point_incidence, spot_incidence
from renderer.shaders.pixels import PixelRays
from renderer.shaders.spheres import SourceReader
from renderer.shaders.structs import Incidence, ViewConstants
from renderer.shadows import ShadowReceiver
from renderer.techniques.parts.full_screen import BEHIND, find_far
from renderer.techniques.parts.resolve import EXACT_BITS, SUM_FORMATS
from renderer.techniques.parts.variants import bind, find_variant, list_lamps
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

WIDEST_CONE: Final = np.pi / 3
"""The largest outer half angle for which a cone is drawn: about there, a sphere is as small."""

_MARGIN: Final = 1.001
"""The factor by which volumes are wider than they must be, for the rounding of what is drawn."""
FARTHEST_CORNER: Final = 1.5
"""More than the distance of any corner from the light, in ranges or in the widths of a cone's base."""


class VolumeCorner(sl.Struct):
    """A corner of a volume, whose `z` is along the axis; `cone` is 1 for cones, whose width follows from their
    angle, and 0 for spheres."""

    position: sl.vec3
    cone: float


class VolumeVarying(sl.Struct):
    """The varyings of light volumes."""

    clip: sl.vec4
    light: int


@sl.function
def project_volume(center: sl.vec3, offset: sl.vec3, reach: float, view: ViewConstants, rays: PixelRays) -> sl.vec4:
    """Return the clip position of a corner, `offset` from the light, of a volume that reaches at most `reach` far."""
    clip = view.relative_view_projection @ sl.vec4(center + offset, 1.0)
    if sl.dot(center, rays.forward) + reach > rays.far:
        clip.z = rays.farthest * clip.w
    return clip


class VolumeShader(SourceReader, ShadowReceiver):
    """The base of shaders that draw light volumes; `rows` are the rows of the lights to be drawn. A technique's
    fragment stage is combined with the volumes of one kind of lights, of which some may be spheres."""

    has_spheres = False

    view: sl.Uniform[ViewConstants]
    rays: sl.Uniform[PixelRays]
    rows: sl.Storage[int]

    def is_reached(self, position: sl.vec3, light: int) -> bool:
        """Return whether a position is within the range of the light of this row."""
        return False

    def find_incidence(self, position: sl.vec3, light: int) -> Incidence:
        """Return what arrives at a position of the light of this row."""
        return Incidence(direction=sl.vec3(0.0), irradiance=sl.vec3(0.0))

    def find_size(self, position: sl.vec3, light: int) -> float:
        """Return what `find_sizes` does of the light of this row at a position."""
        return 0.0

    def unblocked(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        """Return what arrives of the light of this row at a surface."""
        return light


class PointVolumes(VolumeShader):
    """Draws the spheres of point lights."""

    def vertex(self, v: VolumeCorner) -> VolumeVarying:
        row = self.rows[sl.instance_index()]
        light = self.point_lights[row]
        offset = v.position * light.range
        reach = light.range * FARTHEST_CORNER
        return VolumeVarying(clip=project_volume(light.position, offset, reach, self.view, self.rays), light=row)

    def is_reached(self, position: sl.vec3, light: int) -> bool:
        return is_near(position, self.point_lights[light].position, self.point_lights[light].range)

    def find_incidence(self, position: sl.vec3, light: int) -> Incidence:
        return point_incidence(position, self.point_lights[light])

    def find_size(self, position: sl.vec3, light: int) -> float:
        return self.find_sizes(self.point_lights[light].position - position, light).x

    def unblocked(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        return self.unblocked_point(light, position, plane, row)


class SpotVolumes(VolumeShader):
    """Draws the cones of narrow spot lights, or the spheres of wide ones."""

    def vertex(self, v: VolumeCorner) -> VolumeVarying:
        row = self.rows[sl.instance_index()]
        light = self.spot_lights[row]
        # A float32 is too coarse for the cosine of a small angle; light reaches up to two steps of it beyond the cone.
        cosine = sl.max(light.cos_outer - 1e-6, 1e-3)
        slope = sl.sqrt(sl.max(1.0 - cosine * cosine, 0.0)) / cosine
        width = light.range * (slope if v.cone > 0.0 else 1.0)
        up = sl.vec3(0.0, 1.0, 0.0) if sl.abs(light.direction.y) < 0.9 else sl.vec3(1.0, 0.0, 0.0)
        aside = sl.normalize(sl.cross(up, light.direction))
        across = sl.cross(light.direction, aside)
        offset = (aside * v.position.x + across * v.position.y) * width
        offset += light.direction * (v.position.z * light.range)
        reach = sl.max(light.range, width) * FARTHEST_CORNER
        return VolumeVarying(clip=project_volume(light.position, offset, reach, self.view, self.rays), light=row)

    def is_reached(self, position: sl.vec3, light: int) -> bool:
        return is_near(position, self.spot_lights[light].position, self.spot_lights[light].range)

    def find_incidence(self, position: sl.vec3, light: int) -> Incidence:
        return spot_incidence(position, self.spot_lights[light])

    def find_size(self, position: sl.vec3, light: int) -> float:
        return self.find_sizes(self.spot_lights[light].position - position, light).y

    def unblocked(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        return self.unblocked_spot(light, position, plane, row)


VOLUMES: Final[dict[Effect, type[VolumeShader]]] = {
    Effect.POINT_LIGHTS: PointVolumes,
    Effect.SPOT_LIGHTS: SpotVolumes,
}
"""The volumes of each kind of lights."""


def _make_sphere(device: Device) -> Mesh:
    """Make the sphere around a light's range."""
    return _make_mesh(device, "light spheres", *make_sphere(), cone=0.0)


def _make_cone(device: Device) -> Mesh:
    """Make the cone of a narrow spot light."""
    return _make_mesh(device, "light cones", *make_cone(), cone=1.0)


def _make_mesh(
    device: Device, label: str, corners: NDArray[np.float64], triangles: NDArray[np.uint32], cone: float
) -> Mesh:
    vertices = np.zeros(len(corners), VolumeCorner.dtype)
    vertices["position"], vertices["cone"] = corners * _MARGIN, cone
    return device.mesh(vertices, triangles.reshape(-1), label=label)


def declare_lights(
    needs: Needs,
    buffers: Sequence[str],
    reads: tuple[str, ...],
    run: Callable[..., None],
    scale: float = 1.0,
    bits: int = EXACT_BITS,
    *,
    are_written: bool = False,
    because: str = "",
) -> tuple[list[Pass[Frame]], list[str]]:
    """Return the passes that add the light of each kind of lights in view to light buffers, and their contents' names
    after the last pass: none if there are no such lights.

    Args:
        scale: the size of the buffers in that of the frame. bits: those of a channel, of `SUM_FORMATS`.
        are_written: whether an earlier pass has written the buffers, to which the light is added.
        because: what the passes do, before what needs them.
        run: issues the commands; is given the frame and, by name, `effect`, the names of the `targets`, and whether it
            `clears` them.
    """
    passes: list[Pass[Frame]] = []
    last = list(buffers) if are_written else []
    for effect in list_lamps(needs):
        names = [f"{buffer} with {effect.value}" for buffer in buffers] if last else list(buffers)
        passes.append(
            Pass(
                effect.value,
                partial(run, effect=effect, targets=names, clears=not last),
                because + needs.explain(effect),
                reads=reads,
                writes=() if last else tuple(Target(name, SUM_FORMATS[bits], scale) for name in names),
                changes=dict(zip(last, names, strict=True)) if last else {},
            )
        )
        last = names
    return passes, last


def list_volumes(frame: Frame, effect: Effect) -> list[tuple[Mesh, NDArray[np.int64]]]:
    """Return the meshes of the point or spot lights in view, each with the rows of its lights."""
    rows = frame.needs.in_view[effect]
    narrow = np.zeros(len(rows), bool)
    if effect is Effect.SPOT_LIGHTS:
        narrow = frame.resources.lights.spot["outer"][rows] <= WIDEST_CONE
    volumes = ((_make_cone, rows[narrow]), (_make_sphere, rows[~narrow]))
    return [(frame.resources.workspace(make), some) for make, some in volumes if len(some)]


def draw_volumes(
    frame: Frame,
    effect: Effect,
    shader: type[VolumeShader],
    targets: Sequence[str],
    *,
    own: Mapping[str, Any] = {},
    switches: Mapping[str, Any] = {},
    depth: str = "depth",
    clears: bool,
    is_masked: bool = False,
    states: tuple[State, ...] = (),
) -> None:
    """Draw the volumes of the point or spot lights in view, and add what the shader returns to contents.

    Args:
        shader: lights what is in a volume, with bindings of its `own` and its `switches`.
        targets, depth: the names of the contents. clears: whether they are cleared to 0 first.
        is_masked: whether each light is masked in the stencil buffer; otherwise all are one draw.
        states: states instead of those that light what is in a volume.
    """
    device = frame.device
    switches = {**switches, "has_spheres": LAMPS[effect].spheres in frame.needs.effects}
    program: Any = frame.program(find_variant(frame, shader, VOLUMES[effect], **switches))
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
        for mesh, rows in list_volumes(frame, effect):
            given = {**own, "rows": device.transient.storage(int, rows.astype(np.int32))}
            bindings = bind(frame, program, given)
            if mask is None:
                device.draw(program, mesh, len(rows), **bindings)
                continue
            draws = mesh.draws(base_instance=np.arange(len(rows)))
            cut = find_cut(frame, effect, rows)
            device.draw_many(program, mesh, draws[cut], **bindings)
            for draw in draws[~cut, None]:
                with device.states(CullMode.NONE, nearer, ColorWrite.OFF, *_MARKING):
                    device.draw_many(mask, mesh, draw, **bind(frame, mask, given))
                with device.states(DepthTest.OFF, *_MARKED):
                    device.draw_many(program, mesh, draw, **bindings)


def find_cut(frame: Frame, effect: Effect, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (k,) which lights of `rows` may have volumes that a far plane cuts. Those can't be masked: moved to the
    depth of the background, their front faces would undo what their back faces have marked."""
    camera, some = frame.camera, LAMPS[effect].find_rows(frame.resources.lights)[rows]
    distances = (some["position"] - camera.position) @ camera.forward
    # The base of a cone is at most √3 ranges wide.
    cut: NDArray[np.bool_] = distances + 2.0 * FARTHEST_CORNER * some["range"] > 0.999 * find_far(camera)
    return cut


_MARKING: Final = (
    StencilTest.ON,
    StencilFront(depth_fail=StencilOperation.DECREMENT_WRAP),
    StencilBack(depth_fail=StencilOperation.INCREMENT_WRAP),
)
_MARKED: Final = (
    StencilTest.ON,
    StencilBack(Comparison.NOT_EQUAL, both_pass=StencilOperation.ZERO),
)
