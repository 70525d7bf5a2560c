"""The last frame's depth as this frame's camera would see it, at a quarter of the resolution (Deferred+,
1.3.1).

- A texel covers 4 × 4 pixels and holds the farthest of them. Where a size isn't a multiple of 4, the last
  texels cover fewer pixels and are used like the others: the grid of texels begins at the image's top left
  corner and reaches beyond its other edges (Listing 1.1 drops these pixels).
- Each texel's point is moved to where the camera sees it now; of several points the nearest wins. Motion
  tears holes: where no point landed, the point seen there before is written, at its present distance from the
  camera. (Listing 1.1 writes it everywhere. But a wall that the camera passes shows a nearer part of itself
  at a pixel in each next frame, so it would hide itself.)
- A point that is now behind the eye, or in front of the near plane, isn't moved; it fills its hole unchanged.
- The mapping from clip space to clip space is one matrix, computed in float64: no world coordinate is ever in
  float32.

The result is a guess. The image becomes right by a second test, with this frame's depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene import Camera, Depth, Projection
from renderer.scene.arrays import Floats
from renderer.visibility.command_cache import clear
from renderer.visibility.gpu.farthest_depth import FAR, SCALE, DepthPyramid, depth_variant
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Encoder,
    Format,
    Program,
    StorageBuffer,
    Texture,
)

_GROUP: Final = 8
_IDENTITY: Final[Floats] = np.eye(4)


class Motion(sl.Struct):
    """The matrix from the last frame's clip space to this one's, and the image's size in pixels and in
    texels."""

    matrix: sl.mat4
    pixels: sl.vec2
    texels: sl.ivec2


class Scatter(sl.Shader):
    """Writes each point to where it is seen now. A nearer point has a larger key; 0 means that there is no
    point."""

    work_group = (_GROUP, _GROUP)
    motion: sl.Uniform[Motion]
    farthest: sl.Storage[float]
    keys: sl.StorageRW[sl.uint]
    is_reversed = True
    fills_holes = False

    def compute(self) -> None:
        at = sl.global_id().xy
        texels = self.motion.texels
        pixels = self.motion.pixels
        if at.x >= texels.x or at.y >= texels.y:
            return
        here = at.y * texels.x + at.x
        depth = self.farthest[here]
        if depth == (0.0 if self.is_reversed else 1.0):
            return  # the sky hides nothing
        middle = (sl.vec2(at) + 0.5) * (2.0 * SCALE) / pixels - 1.0
        clip = self.motion.matrix @ sl.vec4(middle.x, -middle.y, depth, 1.0)
        is_ahead = clip.w > 0.0 and clip.z >= 0.0 and clip.z <= clip.w
        if is_ahead:
            depth = clip.z / clip.w
        bits = sl.float_bits_to_uint(depth)
        key = bits if self.is_reversed else ~bits
        if self.fills_holes:
            if self.keys[here] == sl.uint(0):
                self.keys[here] = key
        elif is_ahead and max(sl.abs(clip.x), sl.abs(clip.y)) < clip.w:
            to = sl.ivec2((sl.vec2(clip.x, -clip.y) / clip.w + 1.0) * pixels / (2.0 * SCALE))
            sl.atomic_max(self.keys[to.y * texels.x + to.x], key)


class FillHoles(Scatter):
    """Writes the point that was seen at a texel before, at its present distance, where no point landed."""

    fills_holes = True


class DepthOutput(sl.Struct):
    """The output of a fragment shader that writes only depth."""

    depth: sl.FragmentDepth


class WriteDepth(sl.Shader):
    """Writes the depths that the keys stand for to a depth target."""

    motion: sl.Uniform[Motion]
    keys: sl.Storage[sl.uint]
    is_reversed = True

    def vertex(self) -> sl.vec4:
        corner = sl.vertex_index()
        return sl.vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> DepthOutput:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        key = self.keys[at.y * self.motion.texels.x + at.x]
        if key == sl.uint(0):
            return DepthOutput(depth=0.0 if self.is_reversed else 1.0)
        return DepthOutput(depth=sl.uint_bits_to_float(key if self.is_reversed else ~key))


class ReprojectedDepth:
    """Keeps a frame's depth, and reprojects it for the next frame's camera.

    Without `fills_holes`, the depth is far where no point lands: that is for images of the holes (Figure 1.2).
    """

    def __init__(self, device: Device, *, fills_holes: bool = True) -> None:
        self._device = device
        self._shaders = (Scatter, FillHoles) if fills_holes else (Scatter,)
        self._triangle = device.mesh(3, label="whole target")
        self._motion = device.uniform(Motion(matrix=np.eye(4), pixels=(1.0, 1.0), texels=(1, 1)))
        self._resources: _SizedResources | None = None
        self._camera: Camera | None = None  # the camera of the depth that is kept
        self._inverted: Projection | None = None
        self._inverse: Floats = _IDENTITY  # of the matrix of the projection `_inverted`
        self._is_valid = False  # whether that depth is of use for the present camera

    def aim(self, camera: Camera, size: tuple[int, int]) -> tuple[Floats, tuple[object, ...]]:
        """Write the constants of a frame in which `camera` sees an image of `size`, and whose depth is kept.

        Returns the matrix (4, 4) from the eye's axes to the clip space of `render_pass`, and what the frame's
        commands depend on.
        """
        sized, last, direction = self._fit(size), self._camera, camera.projection.depth
        self._is_valid = last is not None and last.projection.depth is direction
        matrix = _matrix(camera)
        if self._is_valid:
            assert last is not None
            if last.projection is not self._inverted:
                self._inverse = np.asarray(np.linalg.inv(last.projection.matrix), np.float64)
                self._inverted = last.projection
            moved = _IDENTITY.copy()  # turned by the last camera's inverse rotation, its transpose
            moved[:3, :3] = last.rotation.T
            moved[:3, 3] = last.position - camera.position
            self._motion.write(sized.motion(matrix @ moved @ self._inverse))
        self._camera = camera
        return sized.to_texels @ matrix, (sized, self._is_valid)

    def store(self, encoder: Encoder, depth: Texture, direction: Depth) -> None:
        """Keep `depth`, which was drawn with the camera of `aim`. Must be called outside of passes."""
        assert self._resources is not None, "aim must be called first"
        self._resources.farthest.build(encoder, depth, direction)

    def read(self) -> NDArray[np.float32]:
        """The depths (h, w) that the last `render_pass` began with, and what was drawn in it since."""
        assert self._resources is not None, "aim must be called first"
        depths: NDArray[np.float32] = self._resources.target.read()
        return depths

    @contextmanager
    def render_pass(self, encoder: Encoder, direction: Depth) -> Iterator[None]:
        """Open a pass whose depth target holds the last frame's depth as the camera of `aim` sees it.

        Where nothing is known, the depth is far.
        """
        sized, device = self._resources, self._device
        assert sized is not None, "aim must be called first"
        if not self._is_valid:
            with encoder.render_pass(depth=sized.target, clear_depth=FAR[direction]):
                yield
            return
        clear(encoder, sized.keys)
        for shader in self._shaders:
            encoder.dispatch(
                device.program(depth_variant(shader, direction)),
                sized.groups,
                motion=self._motion,
                farthest=sized.farthest.farthest,
                keys=sized.keys,
            )
        with encoder.render_pass(depth=sized.target):
            with encoder.states(CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS):
                write: Program[...] = device.program(depth_variant(WriteDepth, direction))
                encoder.draw(write, self._triangle, motion=self._motion, keys=sized.keys)
            yield

    def _fit(self, size: tuple[int, int]) -> _SizedResources:
        """Return the resources for images of `size`. A depth kept for another size is discarded."""
        sized = self._resources
        if sized is None or sized.size != size:
            old, sized = sized, _SizedResources(self._device, size)
            self._camera = None  # what is kept is of another size
            self._resources = sized
            if old is not None:
                old.destroy()
        return sized

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._triangle.destroy()
        self._motion.destroy()
        if self._resources is not None:
            self._resources.destroy()
            self._resources = None


class _SizedResources:
    """The resources for an image of `size` pixels, which has `texels` in each direction: depths, keys and
    target."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        self.size = size
        self.farthest = DepthPyramid(device, size, levels=1)
        width, height = self.texels = self.farthest.sizes[1]
        self.groups = (-(-width // _GROUP), -(-height // _GROUP))
        self.keys: StorageBuffer[sl.uint] = device.storage(
            sl.uint, width * height, label="reprojected depths"
        )
        self.target = device.texture(self.texels, Format.D32F, label="reprojected depth")
        x, y = size[0] / (SCALE * width), size[1] / (SCALE * height)
        self.to_texels = np.diag([x, y, 1.0, 1.0])  # the image is only a part of the grid of texels
        self.to_texels[0, 3], self.to_texels[1, 3] = x - 1.0, 1.0 - y

    def motion(self, matrix: Floats) -> Motion:
        """Return the shader constants for a mapping between clip spaces."""
        return Motion(matrix=matrix, pixels=self.size, texels=self.texels)

    def destroy(self) -> None:
        for resource in (self.farthest, self.keys, self.target):
            resource.destroy()


def _matrix(camera: Camera) -> Floats:
    """Return the matrix (4, 4) float64 from the eye's axes to clip space."""
    turned = _IDENTITY.copy()
    turned[:3, :3] = camera.rotation
    return camera.projection.matrix @ turned
