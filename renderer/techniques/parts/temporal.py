"""Temporal anti-aliasing: each pixel is the mean of the samples that many frames have taken of it (Yang, Liu and Salvi
2020, *A Survey of Temporal Antialiasing Techniques*).

A frame's samples are all at one offset from the middles of their pixels (`TemporalSettings`). They are added to the
*history*: the means of the frames before, read where each surface was in the last frame.

1. `motion` draws the objects that have moved by themselves, and stores how far each pixel's surface has moved on the
   screen. Where nothing is drawn, motion follows from depth and the two cameras.
2. `temporal anti-aliasing` reads the history along the motion of the nearest of 3 × 3 surfaces, so that edges move with
   what is in front. The n-th frame of a surface counts 1/n, at least 1 / `frames`.
3. `temporal image` writes the new history to the image.

The history is rejected where it is of no use: beyond the screen's edge, and where no pixel near it was as far away as
the surface was (disocclusion). All else is clipped to the colors around the pixel: to a box around their mean, as wide
as their standard deviation times `deviations`, in YCoCg of the square roots of light (Salvi 2016). So light and shadows
that change leave no ghosts. A view in which nothing at all changes needs no clipping: it becomes the mean of its
frames, as if each pixel had as many samples.

Tones are mapped before, so a sample weighs no more than white, as with several samples per pixel.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer.frame import Frame, FrameEffects, FramePass, Target, draw_group_states
from renderer.frame.drawing import NOT_BEHIND
from renderer.frame.mirrors import split_doubles
from renderer.frame.motion import UNDEFORMED, MovedObject, SceneMotion
from renderer.frame.resources import DRAW_GROUPS
from renderer.frame.temporal import TemporalHistory
from renderer.scene import Camera
from renderer.scene.arrays import Floats
from renderer.shaders.depth import PositionVertex
from renderer.shaders.pixels import BackgroundScreen, nearness_to_distance
from renderer.shaders.structs import Object, ObjectPosition, ViewConstants, relative_position
from renderer.techniques.parts.ambient_occlusion import DepthSurface
from renderer.techniques.parts.variants import bind, draw_full_screen, shader_variant
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Format

_HISTORY: Final = "temporal_history"
_DISTANCES: Final = "temporal_distances"
_MOTION: Final = "motion"
_FORMATS: Final = {16: Format.RGBA16F, 32: Format.RGBA32F}
_FAR: Final = 1e7
"""The distance of the background in metres: the eye's own motion doesn't move it."""
_NEAREST: Final = 1e-12
"""The least distance in metres, to divide by."""
_BEYOND: Final = 60000.0
"""A motion in pixels that leads beyond the edge of any image."""
_NEARER: Final = 1.1
"""How many times the nearness of a pixel another surface has."""
_SAME_DISTANCE: Final = 0.02
"""The share of its distance by which a surface may differ from the history's."""
_SAME_PIXEL: Final = 1.0 / 512.0
"""The motion in pixels that counts as none: the rounding of its computation."""


class MotionConstants(sl.Struct):
    """The last frame's camera, and this frame's samples.

    `reprojection` leads from positions relative to the eye to the last clip space; `matrix`, `eye_high` and `eye_low`
    are the last camera's, as of `ViewConstants`. A position's distance along the last view is the product with
    `forward`, plus `advance`; `direction` is that of this frame's view. `offset` is that of this frame's samples, and
    `size` that of the image, both in pixels.
    """

    reprojection: sl.mat4
    matrix: sl.mat4
    eye_high: sl.vec3
    eye_low: sl.vec3
    forward: sl.vec3
    advance: float
    direction: sl.vec3
    offset: sl.vec2
    size: sl.vec2


class BlendConstants(sl.Struct):
    """The largest number of frames in a mean, the width of the box of colors in standard deviations, and whether there
    is a history and whether it is read unchanged (1, or 0)."""

    frames: float
    deviations: float
    has_history: float
    is_still: float


@sl.function
def to_pixel(clip: sl.vec4, size: sl.vec2) -> sl.vec2:
    """Return where a clip position is in an image, in pixels."""
    return (sl.vec2(clip.x, -clip.y) / clip.w * 0.5 + 0.5) * size


class MotionVarying(sl.Struct):
    """The varyings of `MotionShader`: where a point was in the last clip space, and its distances then and now along
    the two views."""

    clip: sl.vec4
    last: sl.vec4
    distances: sl.vec2


class MotionShader(sl.Shader):
    """Draws how far it is, in pixels, to where surfaces were on the screen, with their distance then as a share of that
    now, and 1: where nothing is drawn there is 0."""

    lean = True
    has_deformed = False
    stride = 8

    view: sl.Uniform[ViewConstants]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    moved: sl.Storage[MovedObject]
    last_vertices: sl.Storage[float]
    movement: sl.Uniform[MotionConstants]

    def vertex(self, v: PositionVertex) -> MotionVarying:
        row = self.moved[sl.instance_index()]
        position = self.objects[row.object_index].linear @ v.position + relative_position(
            self.object_positions[row.object_index], self.view
        )
        last_vertex = v.position
        if self.has_deformed and row.vertex_shift != UNDEFORMED:
            at = (sl.vertex_index() + row.vertex_shift) * self.stride
            last_vertex = sl.vec3(
                self.last_vertices[at], self.last_vertices[at + 1], self.last_vertices[at + 2]
            )
        last = row.linear @ last_vertex + (row.high - self.movement.eye_high)
        last += row.low - self.movement.eye_low
        clip = self.view.relative_view_projection @ sl.vec4(position, 1.0)
        return MotionVarying(
            clip=clip,
            last=self.movement.matrix @ sl.vec4(last, 1.0),
            distances=sl.vec2(sl.dot(self.movement.forward, last), sl.dot(self.movement.direction, position)),
        )

    def fragment(self, v: MotionVarying) -> sl.vec4:
        motion = sl.vec2(_BEYOND)
        if v.last.w > 0.0:
            here = sl.fragment_coordinate().xy + self.movement.offset
            motion = sl.clamp(to_pixel(v.last, self.movement.size) - here, -_BEYOND, _BEYOND)
        return sl.vec4(motion, v.distances.x / sl.max(v.distances.y, _NEAREST), 1.0)


class TemporalTexels(sl.Struct):
    """The history of a pixel: its mean color and the number of frames in it; and 1 / the distance of its surface."""

    history: sl.vec4
    distance: sl.vec4


class TemporalResolve(BackgroundScreen, DepthSurface):
    """Adds the samples of a frame to the history."""

    precision = sl.Precision.FAST
    lean = True
    has_motion = False

    samples: sl.Texture2D
    history: sl.Texture2D
    last_distances: sl.Texture2D
    motion: sl.Texture2D
    movement: sl.Uniform[MotionConstants]
    blending: sl.Uniform[BlendConstants]

    def fragment(self) -> TemporalTexels:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        color = self.samples.load(pixel).rgb
        own = self.load_nearness(pixel)
        distance = sl.vec4(self.invert_distance(own), 0.0, 0.0, 0.0)
        if self.blending.has_history < 0.5:
            return TemporalTexels(history=sl.vec4(color, 1.0), distance=distance)
        if self.blending.is_still > 0.5:
            mean = self.history.load(pixel)
            frames = sl.min(mean.w + 1.0, self.blending.frames)
            return TemporalTexels(
                history=sl.vec4(sl.mix(mean.rgb, color, 1.0 / frames), frames), distance=distance
            )
        nearest = self.search_nearest(pixel)
        movement = self.measure_motion(nearest)
        motion = movement.xy
        if sl.max(sl.abs(motion.x), sl.abs(motion.y)) < _SAME_PIXEL:
            motion = sl.vec2(0.0)
        source = sl.vec2(pixel) + 0.5 + motion
        texel = sl.ivec2(sl.floor(source))
        last = self.samples.size() - 1
        if texel != sl.clamp(texel, sl.ivec2(0), last) or self.is_disoccluded(texel, movement.z):
            return TemporalTexels(history=sl.vec4(color, 1.0), distance=distance)
        mean_color = self.clip_color(pixel, self.sample_history(source))
        frames = sl.min(self.history.load(texel).w + 1.0, self.blending.frames)
        return TemporalTexels(
            history=sl.vec4(sl.mix(mean_color, color, 1.0 / frames), frames), distance=distance
        )

    def invert_distance(self, nearness: float) -> float:
        """Return 1 / the distance along the view, in 1/m; 0 for the background."""
        if nearness == 0.0:
            return 0.0
        return 1.0 / sl.max(nearness_to_distance(self.rays, nearness), _NEAREST)

    def search_nearest(self, pixel: sl.ivec2) -> sl.ivec2:
        """Return the pixel of 3 × 3 with the nearest surface, if that isn't the surface in the middle."""
        nearest = pixel
        most = self.load_nearness(pixel) * _NEARER
        for y in range(-1, 2):
            for x in range(-1, 2):
                neighbour = pixel + sl.ivec2(x, y)
                nearness = self.load_nearness(neighbour)
                if nearness > most:
                    most = nearness
                    nearest = neighbour
        return nearest

    def measure_motion(self, pixel: sl.ivec2) -> sl.vec3:
        """Return the way in pixels to where the surface of a pixel was, and 1 / its distance then."""
        if self.has_motion:
            moved = self.motion.load(pixel)
            if moved.w > 0.5:
                now = self.invert_distance(self.load_nearness(pixel))
                return sl.vec3(moved.xy, now / sl.max(moved.z, _NEAREST))
        nearness = self.load_nearness(pixel)
        if nearness == 0.0:
            position = self.locate_far(pixel)
            return sl.vec3(self.reproject(pixel, position), 0.0)
        position = self.locate(pixel, nearness)
        distance = sl.dot(self.movement.forward, position) + self.movement.advance
        return sl.vec3(self.reproject(pixel, position), 1.0 / sl.max(distance, _NEAREST))

    def locate_far(self, pixel: sl.ivec2) -> sl.vec3:
        """Return the position of a pixel's background."""
        at = sl.vec2(pixel) + 0.5
        distance = sl.min(self.rays.far, _FAR)
        width = self.rays.projection.y - self.rays.projection.w * distance
        return self.rays.across @ sl.vec3(at, 1.0) * width + (self.rays.along * distance + self.rays.start)

    def reproject(self, pixel: sl.ivec2, position: sl.vec3) -> sl.vec2:
        """Return the way in pixels from a pixel's sample to where that position was."""
        clip = self.movement.reprojection @ sl.vec4(position, 1.0)
        if clip.w <= 0.0:
            return sl.vec2(_BEYOND)  # behind the eye
        return to_pixel(clip, self.movement.size) - (sl.vec2(pixel) + 0.5 + self.movement.offset)

    def is_disoccluded(self, texel: sl.ivec2, inverse_distance: float) -> bool:
        """Return whether no pixel near a texel of the history had a surface at that distance."""
        last = self.samples.size() - 1
        least = 1e30
        most = 0.0
        for y in range(-1, 2):
            for x in range(-1, 2):
                neighbour = sl.clamp(texel + sl.ivec2(x, y), sl.ivec2(0), last)
                value = self.last_distances.load(neighbour).x
                least = sl.min(least, value)
                most = sl.max(most, value)
        # A surface at an angle goes on as it does between these pixels.
        margin = 0.5 * (most - least) + _SAME_DISTANCE * inverse_distance
        return inverse_distance < least - margin or inverse_distance > most + margin

    def sample_history(self, source: sl.vec2) -> sl.vec3:
        """Return the history at a position in pixels, by a bicubic filter that keeps edges sharp (Catmull-Rom)."""
        first = sl.floor(source - 0.5)
        part = source - 0.5 - first
        texel = sl.ivec2(first)
        if sl.max(part.x, part.y) < _SAME_PIXEL:
            return self.load_history(texel)
        across = self.weigh_cubic(part.x)
        down = self.weigh_cubic(part.y)
        color = sl.vec3(0.0)
        for y in range(4):
            row = sl.vec3(0.0)
            for x in range(4):
                row += self.load_history(texel + sl.ivec2(x - 1, y - 1)) * across[x]
            color += row * down[y]
        return sl.max(color, 0.0)

    def weigh_cubic(self, part: float) -> sl.vec4:
        """Return the weights of four texels for a position between the middle two of them."""
        square = part * part
        cube = square * part
        return 0.5 * sl.vec4(
            2.0 * square - cube - part,
            3.0 * cube - 5.0 * square + 2.0,
            4.0 * square - 3.0 * cube + part,
            cube - square,
        )

    def load_history(self, texel: sl.ivec2) -> sl.vec3:
        """Return the mean color of a texel; beyond the edge, of the nearest one."""
        return self.history.load(sl.clamp(texel, sl.ivec2(0), self.samples.size() - 1)).rgb

    def clip_color(self, pixel: sl.ivec2, color: sl.vec3) -> sl.vec3:
        """Return a color of the history, moved towards the mean of the pixels around until it is among them."""
        last = self.samples.size() - 1
        sum = sl.vec3(0.0)
        squares = sl.vec3(0.0)
        for y in range(-1, 2):
            for x in range(-1, 2):
                neighbour = sl.clamp(pixel + sl.ivec2(x, y), sl.ivec2(0), last)
                sample = self.encode(self.samples.load(neighbour).rgb)
                sum += sample
                squares += sample * sample
        mean = sum / 9.0
        extent = sl.sqrt(sl.max(squares / 9.0 - mean * mean, 0.0)) * self.blending.deviations + 1.0 / 512.0
        away = self.encode(color) - mean
        ratio = sl.abs(away) / extent
        largest = sl.max(ratio.x, sl.max(ratio.y, ratio.z))
        if largest <= 1.0:
            return color
        return self.decode(mean + away / largest)

    def encode(self, color: sl.vec3) -> sl.vec3:
        """Return the YCoCg of the square roots of a color: about as bright and colorful as they look."""
        root = sl.sqrt(color)
        return sl.vec3(
            0.25 * root.x + 0.5 * root.y + 0.25 * root.z,
            0.5 * root.x - 0.5 * root.z,
            0.5 * root.y - 0.25 * root.x - 0.25 * root.z,
        )

    def decode(self, encoded: sl.vec3) -> sl.vec3:
        """Return the color that `encode` encodes so."""
        below = encoded.x - encoded.z
        root = sl.max(sl.vec3(below + encoded.y, encoded.x + encoded.z, below - encoded.y), 0.0)
        return root * root


class TemporalImage(BackgroundScreen):
    """Draws the colors of the history."""

    precision = sl.Precision.FAST

    history: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return sl.vec4(self.history.load(sl.ivec2(sl.fragment_coordinate().xy)).rgb, 1.0)


TEMPORAL_SHADERS: Final[tuple[type[sl.Shader], ...]] = (MotionShader, TemporalResolve, TemporalImage)
"""The shaders of `temporal_passes`."""


def temporal_passes(effects: FrameEffects, image: str) -> tuple[FramePass[Frame], ...]:
    """The passes that draw the mean of a view's frames over the resource `image`; none without temporal
    anti-aliasing."""
    settings = effects.temporal
    if not settings.is_on:
        return ()
    moves = effects.has_movable_objects
    resolve = FramePass(
        "temporal anti-aliasing",
        partial(_resolve, image=image),
        f"adds the frame's samples to those of up to {settings.frames} frames",
        reads=(image, "depth", *((_MOTION,) if moves else ())),
        writes=(Target(_HISTORY, _FORMATS[settings.bits]), Target(_DISTANCES, Format.R32F)),
        reads_previous=(_HISTORY, _DISTANCES),
    )
    motion: FramePass[Frame] = FramePass(
        "motion",
        _draw_motion,
        "stores how far objects have moved on the screen",
        reads=("depth",),
        writes=(Target(_MOTION, Format.RGBA16F),),
    )
    show: FramePass[Frame] = FramePass(
        "temporal image",
        partial(_show_history, image=f"temporal {image}"),
        "shows the mean of the frames",
        reads=(_HISTORY,),
        changes={image: f"temporal {image}"},
    )
    return (motion, resolve, show) if moves else (resolve, show)


def compute_reprojection(camera: Camera, previous: Camera) -> Floats:
    """The matrix (4, 4) float64 from positions relative to the eye of `camera`, along the world's axes, to the clip
    space of `previous`."""
    turned = np.eye(4)
    turned[:3, :3] = previous.rotation
    turned[:3, 3] = previous.rotation @ (camera.position - previous.position)
    matrix: Floats = previous.projection.matrix @ turned
    return matrix


def _bind_movement(frame: Frame, history: TemporalHistory) -> Any:
    """The constants of the motion since the last frame."""
    camera = history.camera
    assert camera is not None, "a frame with temporal anti-aliasing has begun its history"
    previous = history.previous or camera
    high, low = split_doubles(previous.position)
    constants = MotionConstants(
        reprojection=compute_reprojection(camera, previous),
        matrix=previous.relative_view_projection,
        eye_high=high,
        eye_low=low,
        forward=previous.forward,
        direction=camera.forward,
        advance=float(previous.forward @ (camera.position - previous.position)),
        offset=history.offset,
        size=frame.targets.size,
    )
    return frame.view.mirror(constants)


def _draw_motion(frame: Frame) -> None:
    """Draw the objects in view that have moved."""
    resources, history = frame.resources, frame.view.workspace(TemporalHistory)
    scene_motion = (frame.first or frame).view.workspace(SceneMotion)
    history.has_motion = False
    if history.previous is None or history.is_still:
        return
    moved = scene_motion.collect_moved(resources, frame.view.around)
    if not len(moved):
        return
    history.has_motion = True
    device, depth = frame.device, frame.targets["depth"]
    vertices = scene_motion.vertices
    switches = {} if vertices is None else {"has_deformed": True, "stride": scene_motion.stride}
    shader = shader_variant(frame, MotionShader, **switches)
    program: Any = frame.program(shader)
    bindings: dict[str, Any] = {
        "moved": device.transient.storage(MovedObject, moved),
        "movement": _bind_movement(frame, history),
    }
    if vertices is not None:
        bindings["last_vertices"] = vertices
    object_indices = moved["object_index"].astype(np.int64)
    draws = resources.get_draws(object_indices, resources.detail_limit)
    draws["base_instance"] = np.arange(len(draws))
    groups = resources.group[object_indices] % len(DRAW_GROUPS)
    not_behind = NOT_BEHIND[frame.camera.projection.depth]
    states = CullMode.BACK, DepthTest.ON, DepthWrite.OFF, not_behind, BlendFunction.OFF
    with (
        device.render_pass(frame.targets[_MOTION], depth, clear=(0.0, 0.0, 0.0, 0.0)),
        device.states(*states),
    ):
        for group in np.unique(groups).tolist():
            with device.states(*draw_group_states(group)):
                device.draw_many(
                    program, resources.mesh, draws[groups == group], **bind(frame, program, bindings)
                )


def _resolve(frame: Frame, image: str) -> None:
    """Add the frame's samples to the history."""
    settings, history = frame.effects.temporal, frame.view.workspace(TemporalHistory)
    for render in frame.scene_layers:
        render(frame.device, frame)
    targets = frame.targets
    last, distances = targets.previous(_HISTORY), targets.previous(_DISTANCES)
    has_history = history.previous is not None and last is not None and distances is not None
    samples = targets[image]
    constants = BlendConstants(
        frames=float(settings.still_frames if history.is_still else settings.frames),
        deviations=settings.deviations,
        has_history=float(has_history),
        is_still=float(history.is_still),
    )
    bindings: dict[str, Any] = {
        "samples": samples,
        "depth": targets["depth"],
        "history": last if has_history else samples,
        "last_distances": distances if has_history else samples,
        "movement": _bind_movement(frame, history),
        "blending": frame.view.mirror(constants),
    }
    if history.has_motion:
        bindings["motion"] = targets[_MOTION]
    draw_full_screen(
        frame,
        TemporalResolve,
        [targets[_HISTORY], targets[_DISTANCES]],
        bindings,
        switches={"has_motion": history.has_motion},
    )
    history.end_frame()


def _show_history(frame: Frame, image: str) -> None:
    draw_full_screen(frame, TemporalImage, frame.targets[image], {"history": frame.targets[_HISTORY]})
