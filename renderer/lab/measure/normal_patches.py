"""The image of a highlight whose normals were stored in few bits (Russell 2011, Figure 3.3.2.a).

A polished sphere has a highlight that is narrower than a step between two stored normals of 8 bits, so it breaks into
patches. The sphere is drawn from stored normals of each number of bits, and by forward shading, which stores none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import sphere
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, scaling
from renderer.techniques import Deferred, Forward, Technique
from renderer.techniques.parts.geometry_buffer import NORMAL_BITS
from rhi import Device

SIDE: Final = 240
"""Width and height of each image in pixels."""
_SEGMENTS: Final = 192
_ROUGHNESS: Final = 0.18


@dataclass(frozen=True, eq=False, slots=True)
class NormalPatches:
    """Images (`SIDE`, `SIDE`, 3) of the highlight in sRGB.

    Attributes:
        by_bits: from stored normals, by their bits.
        exact: from normals that aren't stored.
    """

    by_bits: dict[int, NDArray[np.uint8]]
    exact: NDArray[np.uint8]

    def join(self) -> NDArray[np.uint8]:
        """All images side by side: those of the fewest bits first, the exact one last."""
        return np.concatenate([*self.by_bits.values(), self.exact], axis=1)

    def measure_errors(self) -> dict[int, int]:
        """The largest difference to the exact image in levels of 255, by bits."""
        exact = self.exact.astype(np.int64)
        return {bits: int(np.abs(image - exact).max()) for bits, image in self.by_bits.items()}


def make_polished_sphere() -> tuple[Scene, Camera]:
    """Make the sphere, and a camera that sees its highlight."""
    builder = SceneBuilder("polished sphere")
    material = builder.add_material(base_color=(0.12, 0.02, 0.02, 1.0), roughness=_ROUGHNESS)
    builder.add_objects(
        builder.add_node(scaling((4.0, 4.0, 4.0))), builder.add_mesh(sphere(_SEGMENTS)), material
    )
    builder.lights.add_point((1.5, 2.0, 4.0), 20.0, (60.0, 60.0, 60.0))
    camera = Camera.look_at((0.0, 0.0, 5.0), (0.35, 0.5, 1.9), projection=Perspective(fov=0.35))
    return builder.build(), camera


def draw_patches(device: Device) -> NormalPatches:
    """Draw the sphere with each number of bits of `Deferred`, and by `Forward`."""
    scene, camera = make_polished_sphere()

    def draw(technique: Technique) -> NDArray[np.uint8]:
        with Renderer(
            device, scene, technique=technique, visibility="frustum", size=(SIDE, SIDE)
        ) as renderer:
            pixels: NDArray[np.uint8] = renderer.render(camera).image.read()[..., :3]
        return pixels

    by_bits = {bits: draw(Deferred(normal_bits=bits)) for bits in sorted(NORMAL_BITS)}
    return NormalPatches(by_bits, draw(Forward()))
