"""The last frame's depth as this frame's camera would see it, at a quarter of the resolution (Deferred+, 1.3.1).

- A texel is 4 × 4 pixels, and takes the farthest of them. Where a size isn't a multiple of 4, the last texels have
  fewer pixels and are as good as the others: the texels' grid is laid out from the image's top left corner, and
  reaches beyond its other edges (Listing 1.1 drops the rest).
- Each texel's point is moved to where the camera sees it now, and the nearest wins. Motion tears holes: where nothing
  came to lie, what was seen there before is written, at its distance from the camera now. (Listing 1.1 writes it
  everywhere. But a wall that one passes shows a nearer part of itself to each next frame: it would hide itself.)
- A point that is now behind the eye, or before the near plane, isn't moved; it fills its hole as it was.
- The way from clip space to clip space is one matrix, made in float64: no world coordinate gets near a float32.

What comes out is a guess: the image is made right by a second look, with this frame's depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from renderer.scene import Camera, Depth
from renderer.scene.arrays import Floats
from renderer.visibility.gpu.farthest_depth import FAR, SCALE, FarthestDepth
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    StorageBuffer,
    Texture,
)
from rhi.shading import (
    FragmentDepth,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Uniform,
    abs,
    atomic_max,
    float_bits_to_uint,
    fragment_coordinate,
    global_id,
    ivec2,
    mat4,
    uint,
    uint_bits_to_float,
    vec2,
    vec4,
    vertex_index,
)

__rhi_internal__ = True

_GROUP: Final = 8


class Motion(Struct):
    """From the last clip space to this one; the image's size in pixels, and in texels."""

    matrix: mat4
    pixels: vec2
    texels: ivec2


class Scatter(Shader):
    """Writes what was seen to where it is seen now. A key is larger the nearer, and 0 where nothing is."""

    work_group = (_GROUP, _GROUP)
    motion: Uniform[Motion]
    farthest: Storage[float]
    keys: StorageRW[uint]
    is_reversed = True
    fills_holes = False

    def compute(self) -> None:
        at = global_id().xy
        texels = self.motion.texels
        pixels = self.motion.pixels
        if at.x >= texels.x or at.y >= texels.y:
            return
        here = at.y * texels.x + at.x
        depth = self.farthest[here]
        if depth == (0.0 if self.is_reversed else 1.0):
            return  # the sky hides nothing
        middle = (vec2(at) + 0.5) * (2.0 * SCALE) / pixels - 1.0
        clip = self.motion.matrix @ vec4(middle.x, -middle.y, depth, 1.0)
        is_ahead = clip.w > 0.0 and clip.z >= 0.0 and clip.z <= clip.w
        if is_ahead:
            depth = clip.z / clip.w
        bits = float_bits_to_uint(depth)
        key = bits if self.is_reversed else ~bits
        if self.fills_holes:
            if self.keys[here] == uint(0):
                self.keys[here] = key
        elif is_ahead and max(abs(clip.x), abs(clip.y)) < clip.w:
            to = ivec2((vec2(clip.x, -clip.y) / clip.w + 1.0) * pixels / (2.0 * SCALE))
            atomic_max(self.keys[to.y * texels.x + to.x], key)


class FillHoles(Scatter):
    """Where nothing was written, writes what was seen there, as far away as it is now."""

    fills_holes = True


class ScatterStandard(Scatter):
    """For depth that grows with distance."""

    is_reversed = False


class FillHolesStandard(FillHoles):
    """For depth that grows with distance."""

    is_reversed = False


class OnlyDepth(Struct):
    """Of a fragment."""

    depth: FragmentDepth


class WriteDepth(Shader):
    """Copies the keys to a depth target."""

    motion: Uniform[Motion]
    keys: Storage[uint]
    is_reversed = True

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> OnlyDepth:
        at = ivec2(fragment_coordinate().xy)
        key = self.keys[at.y * self.motion.texels.x + at.x]
        if key == uint(0):
            return OnlyDepth(depth=0.0 if self.is_reversed else 1.0)
        return OnlyDepth(depth=uint_bits_to_float(key if self.is_reversed else ~key))


class WriteDepthStandard(WriteDepth):
    """For depth that grows with distance."""

    is_reversed = False


_SHADERS: Final = {
    Depth.REVERSED: (Scatter, FillHoles, WriteDepth),
    Depth.STANDARD: (ScatterStandard, FillHolesStandard, WriteDepthStandard),
}


class ReprojectedDepth:
    """Keeps a frame's depth, and gives it to the next."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._triangle = device.mesh(3, label="whole target")
        self._motion = device.uniform(Motion(matrix=np.eye(4), pixels=(1.0, 1.0), texels=(1, 1)))
        self._sized: _Sized | None = None
        self._camera: Camera | None = None  # whose depth is kept

    def remember(self, camera: Camera, depth: Texture) -> None:
        """Keep `depth`, which `camera` saw; outside of passes."""
        self._fit(depth.size).farthest.build(depth, camera.projection.depth)
        self._camera = camera

    @contextmanager
    def render_pass(self, camera: Camera, size: tuple[int, int]) -> Iterator[Floats]:
        """A pass on what of the last frame's depth `camera` sees in an image of `size`; far where that isn't known.

        Gives the matrix (4, 4) from the eye's axes to the pass's clip space.
        """
        sized, device, direction = self._fit(size), self._device, camera.projection.depth
        last = self._camera
        if last is None or last.projection.depth is not direction:
            with device.render_pass(depth=sized.target, clear_depth=FAR[direction]):
                yield sized.to_texels @ _matrix(camera)
            return
        scatter, fill_holes, write_depth = _SHADERS[direction]
        moved = np.eye(4)
        moved[:3, 3] = last.position - camera.position
        self._motion.write(sized.motion(_matrix(camera) @ moved @ np.linalg.inv(_matrix(last))))
        sized.keys.clear()
        for shader in (scatter, fill_holes):
            device.dispatch(
                device.program(shader),
                sized.groups,
                motion=self._motion,
                farthest=sized.farthest.farthest,
                keys=sized.keys,
            )
        with device.render_pass(depth=sized.target):
            with device.states(CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS):
                device.draw(device.program(write_depth), self._triangle, motion=self._motion, keys=sized.keys)
            yield sized.to_texels @ _matrix(camera)

    def _fit(self, size: tuple[int, int]) -> _Sized:
        """What depends on the image's size; what was kept of another size is forgotten."""
        sized = self._sized
        if sized is None or sized.size != size:
            if sized is not None:
                sized.destroy()
            sized = self._sized = _Sized(self._device, size)
            self._camera = None
        return sized

    def destroy(self) -> None:
        """Give everything back that was made on the device."""
        self._triangle.destroy()
        self._motion.destroy()
        if self._sized is not None:
            self._sized.destroy()
            self._sized = None


class _Sized:
    """For an image of `size` pixels: the texels' depths, their keys and the target, of `texels` each way."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        self.size = size
        self.farthest = FarthestDepth(device, size, levels=1)
        width, height = self.texels = self.farthest.sizes[1]
        self.groups = (-(-width // _GROUP), -(-height // _GROUP))
        self.keys: StorageBuffer[uint] = device.storage(uint, width * height, label="reprojected depths")
        self.target = device.texture(self.texels, Format.D32F, label="reprojected depth")
        x, y = size[0] / (SCALE * width), size[1] / (SCALE * height)
        self.to_texels = np.diag([x, y, 1.0, 1.0])  # the image's part of the texels' grid, which is larger
        self.to_texels[0, 3], self.to_texels[1, 3] = x - 1.0, 1.0 - y

    def motion(self, matrix: Floats) -> Motion:
        """The constants of a motion between clip spaces."""
        return Motion(matrix=matrix, pixels=self.size, texels=self.texels)

    def destroy(self) -> None:
        for resource in (self.farthest, self.keys, self.target):
            resource.destroy()


def _matrix(camera: Camera) -> Floats:
    """(4, 4) float64, from the eye's axes to clip space."""
    turned = np.eye(4)
    turned[:3, :3] = camera.rotation
    return camera.projection.matrix @ turned
