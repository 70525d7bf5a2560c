"""The right eye's picture made from the left one's: each pixel is moved along its row by the parallax of its depth.

The parallax is a linear function of depth, with each lens: a perspective lens has depths that are linear in 1/z, and so
is its parallax; with a parallel one both are linear in z. So a pixel's way takes one multiplication, of numbers that
are computed in float64.

1. `MovePixels` writes the column of each pixel to where the right eye sees it. Of several that land on one pixel the
   last one of the row wins, which is the nearest one: it has moved farther to the left than those before it.
2. `TakePixels` makes the picture. Where nothing landed there is a *hole*: what the left eye doesn't see. It is filled
   with what is to its right, which is what was hidden, since near things move to the left.

What a surface reflects is what the left eye sees of it, highlights included.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, Pass, Target
from renderer.frame.passes import FARTHEST
from renderer.frame.resources import MirroredValue
from renderer.scene import Camera, Depth, measure_parallax
from renderer.shaders.pixels import FullScreen
from renderer.techniques.full_screen import Screen, bind_rays, draw_full_screen
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, StorageBuffer, Texture
from rhi.shading import (
    FragmentDepth,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    abs,
    atomic_max,
    floor,
    fragment_coordinate,
    global_id,
    ivec2,
    vec4,
)

__rhi_internal__ = True

_GROUP: Final = (64, 4)


class Shift(Struct):
    """How far pixels move to the right: `least` + `rate` times their nearness, in pixels. `farthest` is the depth of the
    background, `size` that of the picture."""

    size: ivec2
    least: float
    rate: float
    farthest: float


class MovePixels(Shader):
    """Writes the column of each pixel, plus 1, to the place where the other eye sees it."""

    work_group = _GROUP
    shift: Uniform[Shift]
    depth: Texture2D
    columns: StorageRW[int]

    def compute(self) -> None:
        at = global_id().xy
        size = self.shift.size
        if at.x >= size.x or at.y >= size.y:
            return
        nearness = abs(self.depth.load(ivec2(at)).x - self.shift.farthest)
        to = int(floor(float(at.x) + 0.5 + (self.shift.least + self.shift.rate * nearness)))
        if to >= 0 and to < size.x:
            atomic_max(self.columns[at.y * size.x + to], at.x + 1)


class TakePixels(FullScreen):
    """Takes each pixel from where it was, and fills holes with what is to their right."""

    picture: Texture2D
    columns: Storage[int]

    def fragment(self) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        return self.picture.load(ivec2(self.find_column(place), place.y))

    def find_column(self, place: ivec2) -> int:
        """Return the column that a pixel, or what fills it, comes from."""
        width = self.picture.size().x
        row = place.y * width
        column = self.columns[row + place.x]
        if column == 0:
            for x in range(place.x + 1, width):
                column = self.columns[row + x]
                if column != 0:
                    break
        if column == 0:  # nothing landed between here and the right edge
            for i in range(1, place.x + 1):
                column = self.columns[row + place.x - i]
                if column != 0:
                    break
        return column - 1 if column != 0 else place.x


class MovedDepth(Struct):
    """The depth of a moved pixel."""

    depth: FragmentDepth


class TakeDepth(TakePixels):
    """Takes the depth of each pixel from where it was: it is the same for both eyes."""

    def fragment(self) -> MovedDepth:
        place = ivec2(fragment_coordinate().xy)
        return MovedDepth(depth=self.picture.load(ivec2(self.find_column(place), place.y)).x)


class Columns:
    """What is kept to move the pixels of a view.

    Attributes:
        buffer: the column that each pixel comes from plus 1, 0 for holes; None before the first frame.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._size = (0, 0)
        self.buffer: StorageBuffer[int] | None = None
        self.shift = MirroredValue(device, Shift(size=(0, 0), least=0.0, rate=0.0, farthest=0.0))

    def fit(self, size: tuple[int, int]) -> StorageBuffer[int]:
        """Return the buffer for a picture of `size`, empty."""
        if self.buffer is None or size != self._size:
            self._destroy_buffer()
            self.buffer = self._device.storage(int, size[0] * size[1], label="columns")
            self._size = size
        else:
            self.buffer.clear()
        return self.buffer

    def _destroy_buffer(self) -> None:
        if self.buffer is not None:
            self.buffer.destroy()
            self.buffer = None

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._destroy_buffer()
        self.shift.destroy()


def find_shift(left: Camera, right: Camera, size: tuple[int, int]) -> Shift:
    """Return how the pixels of a picture of `size` move from one eye to the other. The eyes look in one direction."""
    depth, matrix = left.projection.depth, left.projection.matrix
    near = matrix[2] if depth is Depth.REVERSED else matrix[3] - matrix[2]
    z = np.array([1.0, 2.0])
    nearness = (near[3] - near[2] * z) / (matrix[3, 3] - matrix[3, 2] * z)
    points = left.position + z[:, None] * left.forward
    first, second = (0.5 * size[0] * measure_parallax((left, right), points)[:, 0]).tolist()
    rate = (second - first) / (nearness[1] - nearness[0])
    return Shift(size=size, least=first - rate * nearness[0], rate=rate, farthest=FARTHEST[depth])


def find_holes(right: Frame) -> NDArray[np.bool_]:
    """Return (height, width), which pixels of the right eye's picture are holes that were filled. Waits for the
    device."""
    width, height = right.targets.size
    columns = right.view.workspace(Columns).buffer
    if columns is None:
        return np.zeros((height, width), bool)
    return np.asarray(columns.read().reshape(height, width) == 0)


def _move(frame: Frame) -> None:
    left, device, size = _left_of(frame), frame.device, frame.targets.size
    kept = frame.view.workspace(Columns)
    kept.shift.write(find_shift(left.camera, frame.camera, size))
    groups = tuple(-(-side // group) for side, group in zip(size, _GROUP, strict=True))
    device.dispatch(
        device.program(MovePixels),
        groups,
        shift=kept.shift.buffer,
        depth=left.targets.depth,
        columns=kept.fit(size),
    )


def _take(frame: Frame) -> None:
    draw_full_screen(frame, TakePixels, frame.targets.image, _bind(frame, _left_of(frame).targets.image))


def _take_depth(frame: Frame) -> None:
    device = frame.device
    states = (CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS)
    program: Any = device.program(TakeDepth)
    triangle = frame.view.workspace(Screen).triangle
    with device.render_pass(None, frame.targets.depth), device.states(*states):
        device.draw(
            program, triangle, **bind_rays(frame), **_bind(frame, _left_of(frame).targets.depth)
        )


def _bind(frame: Frame, picture: Texture) -> dict[str, Any]:
    return {"picture": picture, "columns": frame.view.workspace(Columns).buffer}


def _left_of(frame: Frame) -> Frame:
    assert frame.first is not None, "the left eye's frame comes first"
    return frame.first


REPROJECTION: Final = (
    Pass("move pixels", _move, "the left eye's picture has most of it", writes=("columns",)),
    Pass(
        "take pixels",
        _take,
        "the right eye's picture is made of the left one's",
        reads=("columns",),
        writes=(Target("image", IMAGE_FORMAT),),
    ),
    Pass(
        "take depth",
        _take_depth,
        "layers are drawn over it",
        reads=("columns",),
        writes=(Target("depth", DEPTH_FORMAT),),
    ),
)
"""The passes of the right eye's frame. Without layers, only `image` is needed."""
