"""The right eye's picture made from the left one's: each pixel moves along its row by the parallax of its depth.

The parallax is a linear function of depth, with each lens: a perspective lens has depths that are linear in 1/z, and so
is its parallax; with a parallel one both are linear in z. So a pixel's way takes one multiplication, of numbers that
are computed in float64. Pixels are moved as they are, four bytes each: no colour is decoded.

An invocation has a row. `MovePixels` walks along it from left to right. Of several pixels that land on one the last
wins, which is the nearest: it has moved farther to the left than those before it. Where nothing lands there is a
*hole*: what the left eye doesn't see. `FillPixels` fills it with what is to its right, which is what was hidden, since
near things move to the left.

What a surface reflects is what the left eye sees of it, highlights included.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, Pass, Target, Targets
from renderer.frame.mirrors import MirroredValue
from renderer.frame.passes import FARTHEST
from renderer.scene import Camera, Depth
from renderer.shaders.pixels import BackgroundScreen
from renderer.stereo.words import Words, find_pitch
from renderer.techniques.parts.full_screen import bind_rays, make_triangle
from renderer.visibility.repeated import RepeatedCommands, clear, copy
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, Encoder, StorageBuffer

_ROWS: Final = 16  # of a work-group
_AHEAD: Final = np.array([(0.0, 0.0, -1.0, 1.0), (0.0, 0.0, -2.0, 1.0)])  # two points before the left eye


class Shift(sl.Struct):
    """The distance by which pixels move to the right: `least` + `rate` times their nearness, in pixels. `size` is that
    of the picture, whose rows are `pitch` pixels apart, `farthest` the depth of the background."""

    size: sl.ivec2
    pitch: int
    least: float
    rate: float
    farthest: float


class MovePixels(sl.Shader):
    """Moves the pixels of each row."""

    work_group = (_ROWS,)
    shift: sl.Uniform[Shift]
    depth: sl.Storage[float]
    picture: sl.Storage[sl.uint]
    moved: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        size = self.shift.size
        if sl.global_id().x >= size.y:
            return
        row = sl.global_id().x * self.shift.pitch
        for x in range(size.x):
            nearness = sl.abs(self.depth[row + x] - self.shift.farthest)
            to = int(sl.floor(float(x) + 0.5 + (self.shift.least + self.shift.rate * nearness)))
            if to >= 0 and to < size.x:
                self.moved[row + to] = self.picture[row + x]


class FillPixels(sl.Shader):
    """Fills each hole with the next pixel to its right, and those at the right edge with the last one of the row."""

    work_group = (_ROWS,)
    shift: sl.Uniform[Shift]
    moved: sl.Storage[sl.uint]
    picture: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        size = self.shift.size
        if sl.global_id().x >= size.y:
            return
        end = sl.global_id().x * self.shift.pitch + size.x
        pixel = sl.uint(0)
        for i in range(1, size.x + 1):
            pixel = self.moved[end - i]
            if pixel != sl.uint(0):
                break
        for i in range(1, size.x + 1):
            here = self.moved[end - i]
            if here != sl.uint(0):
                pixel = here
            self.picture[end - i] = pixel


class EncodeDepth(sl.Shader):
    """Makes depths pixels that aren't 0, which stands for a hole."""

    work_group = (64,)
    depth: sl.Storage[float]
    picture: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.depth):
            self.picture[i] = sl.float_bits_to_uint(self.depth[i]) + sl.uint(1)


class MovedDepth(sl.Struct):
    """The depth of a moved pixel."""

    depth: sl.FragmentDepth


class TakeDepth(BackgroundScreen):
    """Writes the moved depth: that of a surface is the same for both eyes."""

    shift: sl.Uniform[Shift]
    picture: sl.Storage[sl.uint]

    def fragment(self) -> MovedDepth:
        place = sl.ivec2(sl.fragment_coordinate().xy)
        return MovedDepth(depth=sl.uint_bits_to_float(self.picture[place.y * self.shift.pitch + place.x] - sl.uint(1)))


class Reprojector:
    """Moves the pixels of a view.

    Attributes:
        depth, picture, moved: the left eye's depth, what is moved and then filled, and what has holes between.
        depths: `picture` and `moved` of the depth, for layers.
    """

    def __init__(self, device: Device) -> None:
        self.shift = MirroredValue(device, Shift(size=(0, 0), pitch=0, least=0.0, rate=0.0, farthest=0.0))
        self.depth = Words(device, float)
        self.picture, self.moved = Words(device, sl.uint), Words(device, sl.uint)
        self.depths = Words(device, sl.uint), Words(device, sl.uint)
        self._commands = RepeatedCommands(device, "")
        self._device = device

    def move_picture(self, left: Targets, right: Targets) -> None:
        """Draw the right eye's picture. The left eye's depth stays in `depth`."""
        size, sources, image = right.size, (left.depth, left["image"]), right["image"]
        depth, picture, moved = (words.fit(size) for words in (self.depth, self.picture, self.moved))

        def issue(encoder: Encoder) -> None:
            for source, words in zip(sources, (depth, picture), strict=True):
                copy(encoder, source, words)
            self.move(encoder, size, picture, moved)
            copy(encoder, picture, image)

        self._commands.execute((*sources, depth, picture, moved, image), issue)

    def move(
        self, encoder: Encoder, size: tuple[int, int], picture: StorageBuffer[Any], moved: StorageBuffer[Any]
    ) -> None:
        """Move the pixels of `picture` to `moved`, and back to `picture` with all holes filled."""
        device, groups = self._device, -(-size[1] // _ROWS)
        clear(encoder, moved)
        given: dict[str, Any] = {"shift": self.shift.buffer, "picture": picture, "moved": moved}
        encoder.dispatch(device.program(MovePixels), groups, **given, depth=self.depth.buffer)
        encoder.dispatch(device.program(FillPixels), groups, **given)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        for one in (self.shift, self.depth, self.picture, self.moved, *self.depths):
            one.destroy()


def find_shift(left: Camera, right: Camera, size: tuple[int, int], pitch: int) -> Shift:
    """Return how the pixels of a picture of `size` move from one eye to the other, in rows that are `pitch` apart. The
    eyes look in one direction."""
    depth, matrix = left.projection.depth, left.projection.matrix
    near = matrix[2] if depth is Depth.REVERSED else matrix[3] - matrix[2]
    nearness = _AHEAD @ near / (_AHEAD @ matrix[3])
    aside = _AHEAD.copy()  # the same points as the right eye sees them
    aside[:, :3] += right.rotation @ (left.position - right.position)
    other = right.projection.matrix
    parallax = aside @ other[0] / (aside @ other[3]) - _AHEAD @ matrix[0] / (_AHEAD @ matrix[3])
    first, second = (0.5 * size[0] * parallax).tolist()
    rate = float((second - first) / (nearness[1] - nearness[0]))
    least = first - rate * float(nearness[0])
    return Shift(size=size, pitch=pitch, least=least, rate=rate, farthest=FARTHEST[depth])


def find_holes(right: Frame) -> NDArray[np.bool_]:
    """Return (height, width), which pixels of the right eye's picture are holes that were filled. Waits for the
    device."""
    width, height = right.targets.size
    moved = right.view.workspace(Reprojector).moved.buffer.read().reshape(height, -1)
    return np.asarray(moved[:, :width] == 0)


def _move_pixels(frame: Frame) -> None:
    left, kept = _left_of(frame), frame.view.workspace(Reprojector)
    size = frame.targets.size
    kept.shift.write(find_shift(left.camera, frame.camera, size, find_pitch(frame.device, size[0])))
    kept.move_picture(left.targets, frame.targets)


def _move_depth(frame: Frame) -> None:
    device, size = frame.device, frame.targets.size
    kept = frame.view.workspace(Reprojector)
    picture, moved = (words.fit(size) for words in kept.depths)
    device.dispatch(
        device.program(EncodeDepth), -(-len(kept.depth.buffer) // 64), depth=kept.depth.buffer, picture=picture
    )
    kept.move(device, size, picture, moved)
    states = (CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS)
    program: Any = device.program(TakeDepth)
    triangle = frame.view.workspace(make_triangle)
    with device.render_pass(None, frame.targets.depth), device.states(*states):
        given = {"shift": kept.shift.buffer, "picture": picture}
        device.draw(program, triangle, rays=bind_rays(frame), **given)


def _left_of(frame: Frame) -> Frame:
    assert frame.first is not None, "the left eye's frame comes first"
    return frame.first


REPROJECTION: Final = (
    Pass(
        "reprojection",
        _move_pixels,
        "the right eye's picture is made of the left one's",
        writes=(Target("image", IMAGE_FORMAT), "left depth"),
    ),
    Pass(
        "reprojected depth",
        _move_depth,
        "layers are drawn over it",
        reads=("left depth",),
        writes=(Target("depth", DEPTH_FORMAT),),
    ),
)
"""The passes of the right eye's frame. Without layers, only `image` is needed."""
