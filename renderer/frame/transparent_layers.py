"""The number of layers that transparent objects may put over a pixel, and the rounding of each.

A target rounds each layer that is blended to it, and what lies over a layer dims its error by 1 - alpha. So
few layers, or layers that cover much, may be blended to the image itself. Many faint ones need a target that
can hold their sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer.scene import Scene
from renderer.scene.arrays import Floats, Indices
from rhi import Format

MAX_ROUNDING: Final = 1.5
"""The greatest error in levels of 255 that layers may have in the image; beyond it they have a target of
their own."""

MAX_WEIGHTED_LAYERS: Final = 64
"""So many layers of the largest weight fit into a sum in half floats."""

_ROUNDED_LEVELS: Final = {
    Format.RGBA8_SRGB: 0.5,
    Format.R11G11B10F: 2.0,
    Format.RGBA16F: 0.0625,
    Format.RGBA32F: 0.0,
}
"""The greatest error of one layer in levels of 255, by the format of the target."""


@dataclass(frozen=True, eq=False, slots=True)
class TransparentLayers:
    """The layers of a scene's transparent objects.

    Attributes:
        alphas: of each object (n,) the alpha of its layers; 0 for opaque objects.
        counts: how many layers of each object (n,) there may be over a pixel.
    """

    alphas: Floats
    counts: Floats

    @classmethod
    def count(cls, scene: Scene) -> TransparentLayers:
        """Count the layers of a scene. An alpha that a texture, a vertex or a shader may lower counts as
        0."""
        objects, transparent = scene.objects, scene.list_transparent()
        alphas, counts = np.zeros(len(objects)), np.zeros(len(objects))
        if len(transparent):
            materials, mesh = scene.materials[objects.material[transparent]], objects.mesh[transparent]
            varies = (materials["texture"] >= 0) | (materials["shader"] > 0)
            varies |= scene.count_features()["vertex colors"] > 0
            alphas[transparent] = np.where(varies, 0.0, np.clip(materials["base_color"][:, 3], 0.0, 1.0))
            meshes, of = np.unique(mesh, return_inverse=True)
            layers = np.array([scene.meshes.count_layers(number) for number in meshes.tolist()])[
                of.reshape(-1)
            ]
            deforms = objects.simulated[transparent] | np.isin(transparent, [*scene.tessellated])
            layers = np.where(deforms, scene.meshes.triangle_counts[mesh], layers)
            counts[transparent] = layers * np.where(materials["double_sided"] != 0, 2.0, 1.0)
        return cls(alphas, counts)

    def rounding(self, in_view: Indices) -> float:
        """Return the greatest error of a pixel in errors of one layer: where the faintest objects `in_view`
        (k,) are in front of the others."""
        order = np.argsort(self.alphas[in_view])
        alphas, counts = self.alphas[in_view][order], self.counts[in_view][order]
        remains = (1.0 - alphas) ** counts
        errors = np.where(alphas > 0.0, (1.0 - remains) / np.where(alphas > 0.0, alphas, 1.0), counts)
        return float((np.cumprod(np.append(1.0, remains))[:-1] * errors).sum())

    def sorted_target(self, in_view: Indices, image: Format, widest: Format) -> Format | None:
        """Return the format of the target that objects are blended to in their order, None for the image
        itself.

        Args:
            image: the format of the image. widest: that with the most bits which the device blends.
        """
        return widest if self.rounding(in_view) * _ROUNDED_LEVELS[image] > MAX_ROUNDING else None

    def weighted_target(self, in_view: Indices, image: Format, widest: Format) -> Format:
        """Return the format of the sums of weighted colors.

        Half floats end at 65504. Colors of an image of 8 bits are 1 at most, so that 64 layers of the largest
        weight fit. Light of an image that blooms may be of any strength.

        Args:
            image: the format of the image. widest: that with the most bits which the device blends.
        """
        if image is not Format.RGBA8_SRGB:
            return widest
        rounding = self.rounding(in_view) * _ROUNDED_LEVELS[Format.RGBA16F]
        fits = rounding <= MAX_ROUNDING and self.counts[in_view].sum() <= MAX_WEIGHTED_LAYERS
        return Format.RGBA16F if fits else widest
