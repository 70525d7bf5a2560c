"""Makes the right eye's image from the left eye's: each pixel moves along its row by the parallax of its
depth.

The parallax is a linear function of depth, with each projection: a perspective one has depths that are linear
in 1/z, and so is its parallax; with a parallel one both are linear in z. So a pixel's way takes one
multiplication, of numbers that are computed in float64. Pixels are moved as they are, four bytes each: no
colour is decoded.

An invocation has a row. `ShiftPixels` walks along it from left to right. Of several pixels that land on one
the last wins, which is the nearest: it has moved farther to the left than those before it. Where nothing
lands there is a *hole*: what the left eye doesn't see. `FillPixels` fills it with what is to its right, which
is what was hidden, since near things move to the left.

What a surface reflects is what the left eye sees of it, highlights included.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, FramePass, Target, Targets
from renderer.frame.drawing import FARTHEST
from renderer.frame.mirrors import MirroredValue
from renderer.frame.pixel_rays import bind_rays
from renderer.scene import Camera, Depth
from renderer.shaders.pixels import BackgroundScreen
from renderer.stereo.pixel_buffer import PixelBuffer, row_pitch
from renderer.techniques.parts.full_screen import make_triangle
from renderer.visibility.command_cache import CommandCache, clear, copy
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, Encoder, StorageBuffer

_ROWS: Final = 16  # of a work-group
_AHEAD: Final = np.array([(0.0, 0.0, -1.0, 1.0), (0.0, 0.0, -2.0, 1.0)])  # two points before the left eye


class Shift(sl.Struct):
    """The distance by which pixels move to the right: `base` + `rate` times their nearness, in pixels. `size`
    is that of the image, whose rows are `pitch` pixels apart, `farthest` the depth of the background."""

    size: sl.ivec2
    pitch: int
    base: float
    rate: float
    farthest: float


class ShiftPixels(sl.Shader):
    """Moves the pixels of each row."""

    work_group = (_ROWS,)
    shift: sl.Uniform[Shift]
    depth: sl.Storage[float]
    pixels: sl.Storage[sl.uint]
    shifted: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        size = self.shift.size
        if sl.global_id().x >= size.y:
            return
        row = sl.global_id().x * self.shift.pitch
        for x in range(size.x):
            nearness = sl.abs(self.depth[row + x] - self.shift.farthest)
            to = int(sl.floor(float(x) + 0.5 + (self.shift.base + self.shift.rate * nearness)))
            if to >= 0 and to < size.x:
                self.shifted[row + to] = self.pixels[row + x]


class FillPixels(sl.Shader):
    """Fills each hole with the next pixel to its right, and those at the right edge with the last one of the
    row."""

    work_group = (_ROWS,)
    shift: sl.Uniform[Shift]
    shifted: sl.Storage[sl.uint]
    pixels: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        size = self.shift.size
        if sl.global_id().x >= size.y:
            return
        end = sl.global_id().x * self.shift.pitch + size.x
        pixel = sl.uint(0)
        for i in range(1, size.x + 1):
            pixel = self.shifted[end - i]
            if pixel != sl.uint(0):
                break
        for i in range(1, size.x + 1):
            here = self.shifted[end - i]
            if here != sl.uint(0):
                pixel = here
            self.pixels[end - i] = pixel


class EncodeDepth(sl.Shader):
    """Encodes depths as pixels that are never 0, because 0 marks a hole."""

    work_group = (64,)
    depth: sl.Storage[float]
    pixels: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.depth):
            self.pixels[i] = sl.float_bits_to_uint(self.depth[i]) + sl.uint(1)


class ShiftedDepth(sl.Struct):
    """The depth of a moved pixel."""

    depth: sl.FragmentDepth


class WriteShiftedDepth(BackgroundScreen):
    """Writes the moved depth: that of a surface is the same for both eyes."""

    shift: sl.Uniform[Shift]
    pixels: sl.Storage[sl.uint]

    def fragment(self) -> ShiftedDepth:
        position = sl.ivec2(sl.fragment_coordinate().xy)
        return ShiftedDepth(
            depth=sl.uint_bits_to_float(self.pixels[position.y * self.shift.pitch + position.x] - sl.uint(1))
        )


class Reprojector:
    """Moves the pixels of a view.

    Attributes:
        shift: the uniform that says how far a pixel moves at each depth.
        depth: the left eye's depth.
        pixels: the image to move, and afterwards the moved image without holes.
        shifted: the moved image with its holes.
        depth_pixels: the same two buffers for the depth, which layers need.
    """

    def __init__(self, device: Device) -> None:
        self.shift = MirroredValue(device, Shift(size=(0, 0), pitch=0, base=0.0, rate=0.0, farthest=0.0))
        self.depth = PixelBuffer(device, float)
        self.pixels, self.shifted = PixelBuffer(device, sl.uint), PixelBuffer(device, sl.uint)
        self.depth_pixels = PixelBuffer(device, sl.uint), PixelBuffer(device, sl.uint)
        self._commands = CommandCache(device, "")
        self._device = device

    def reproject_image(self, left: Targets, right: Targets) -> None:
        """Draw the right eye's image. The left eye's depth stays in `depth`."""
        size, sources, image = right.size, (left.depth, left["image"]), right["image"]
        depth, pixels, shifted = (words.fit(size) for words in (self.depth, self.pixels, self.shifted))

        def issue(encoder: Encoder) -> None:
            for source, words in zip(sources, (depth, pixels), strict=True):
                copy(encoder, source, words)
            self.reproject_pixels(encoder, size, pixels, shifted)
            copy(encoder, pixels, image)

        self._commands.execute((*sources, depth, pixels, shifted, image), issue)

    def reproject_pixels(
        self, encoder: Encoder, size: tuple[int, int], pixels: StorageBuffer[Any], shifted: StorageBuffer[Any]
    ) -> None:
        """Move the pixels of `pixels` to `shifted`, and back to `pixels` with all holes filled."""
        device, groups = self._device, -(-size[1] // _ROWS)
        clear(encoder, shifted)
        bindings: dict[str, Any] = {"shift": self.shift.buffer, "pixels": pixels, "shifted": shifted}
        encoder.dispatch(device.program(ShiftPixels), groups, **bindings, depth=self.depth.buffer)
        encoder.dispatch(device.program(FillPixels), groups, **bindings)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        for resource in (self.shift, self.depth, self.pixels, self.shifted, *self.depth_pixels):
            resource.destroy()


def compute_shift(left: Camera, right: Camera, size: tuple[int, int], pitch: int) -> Shift:
    """Return the shift of the pixels of an image of `size` from one eye to the other, in rows that are `pitch`
    apart. The eyes look in one direction."""
    depth, matrix = left.projection.depth, left.projection.matrix
    near = matrix[2] if depth is Depth.REVERSED else matrix[3] - matrix[2]
    nearness = _AHEAD @ near / (_AHEAD @ matrix[3])
    aside = _AHEAD.copy()  # the same points as the right eye sees them
    aside[:, :3] += right.rotation @ (left.position - right.position)
    other = right.projection.matrix
    parallax = aside @ other[0] / (aside @ other[3]) - _AHEAD @ matrix[0] / (_AHEAD @ matrix[3])
    first, second = (0.5 * size[0] * parallax).tolist()
    rate = float((second - first) / (nearness[1] - nearness[0]))
    base = first - rate * float(nearness[0])
    return Shift(size=size, pitch=pitch, base=base, rate=rate, farthest=FARTHEST[depth])


def read_hole_mask(right: Frame) -> NDArray[np.bool_]:
    """Return (height, width), which pixels of the right eye's image are holes that were filled. Waits for the
    device."""
    width, height = right.targets.size
    shifted = right.view.workspace(Reprojector).shifted.buffer.read().reshape(height, -1)
    return np.asarray(shifted[:, :width] == 0)


def _reproject_image(frame: Frame) -> None:
    left, reprojector = _left_of(frame), frame.view.workspace(Reprojector)
    size = frame.targets.size
    reprojector.shift.write(compute_shift(left.camera, frame.camera, size, row_pitch(frame.device, size[0])))
    reprojector.reproject_image(left.targets, frame.targets)


def _reproject_depth(frame: Frame) -> None:
    device, size = frame.device, frame.targets.size
    reprojector = frame.view.workspace(Reprojector)
    pixels, shifted = (words.fit(size) for words in reprojector.depth_pixels)
    device.dispatch(
        device.program(EncodeDepth),
        -(-len(reprojector.depth.buffer) // 64),
        depth=reprojector.depth.buffer,
        pixels=pixels,
    )
    reprojector.reproject_pixels(device, size, pixels, shifted)
    states = (CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS)
    program: Any = device.program(WriteShiftedDepth)
    triangle = frame.view.workspace(make_triangle)
    with device.render_pass(None, frame.targets.depth), device.states(*states):
        bindings = {"shift": reprojector.shift.buffer, "pixels": pixels}
        device.draw(program, triangle, rays=bind_rays(frame), **bindings)


def _left_of(frame: Frame) -> Frame:
    assert frame.first is not None, "the left eye's frame comes first"
    return frame.first


REPROJECTION: Final = (
    FramePass(
        "reprojection",
        _reproject_image,
        "the right eye's image is made of the left one's",
        writes=(Target("image", IMAGE_FORMAT), "left depth"),
    ),
    FramePass(
        "reprojected depth",
        _reproject_depth,
        "layers are drawn over it",
        reads=("left depth",),
        writes=(Target("depth", DEPTH_FORMAT),),
    ),
)
"""The passes of the right eye's frame. Without layers, only `image` is needed."""
