"""The rule of what changes nothing: bounds say that no channel of an 8-bit image differs by more than half a
level without it, whatever the view.

It is left out as if it weren't in the scene: no command, no pass, no part of a shader. Here are the bounds of
objects and materials, and of the light that surfaces reflect. Those of lights are in `Lights.without_dark`,
those of the air in `renderer.frame.thin_air`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.images import ImagePixels, has_high_range, read_values
from renderer.scene.materials import AlphaMode, ShadingModel
from renderer.scene.objects import Objects

_ROUNDING: Final = 2.0**-15
"""By so much alpha may be below a cutoff and still count as equal to it; shaders allow half of that."""


LEAST_LIGHT: Final = 5e-4
"""Linear light of which a pixel may have more or less, and be the same to half a level: tone mapping and sRGB
together raise an 8-bit level by at most 255 · 3.84 for each unit of light, at a light of 0.015."""

_CLEAR: Final = 1e-10
"""The largest alpha that covers nothing: of 100,000 such layers the sum is less than half a level."""

_METALLIC_PEAK: Final = 1e6
"""More than the metallic-roughness model reflects to any direction, for a color of 1 and the least roughness
that counts: the lobe is 1 / 0.1⁴ high, and its masking less than 1 / (4 · 0.1²)."""


class SurfaceBounds:
    """Bounds of what textures and vertices multiply the colors of materials by.

    Attributes:
        min_alpha, max_alpha: those of the vertices of all meshes.
        max_color: the largest channel of a vertex color.
        peaks: (t + 1,) the largest color of each texture, at least 1; 1 in the last row, which -1 selects.
    """

    def __init__(
        self, textures: NDArray[Any], images: Sequence[ImagePixels], colors: NDArray[Any] | None = None
    ) -> None:
        """`colors` (v, 4) are those of vertices, None if meshes have none."""
        self._textures, self._images = textures, images
        self._ranges: dict[tuple[int, int], tuple[float, float]] = {}
        colors = np.ones((1, 4)) if colors is None else colors
        self.min_alpha = float(colors[:, 3].min(initial=1.0))
        self.max_alpha = float(colors[:, 3].max(initial=1.0))
        self.max_color = float(colors[:, :3].max(initial=1.0))
        self.peaks = np.ones(len(textures) + 1)
        for texture, image in enumerate(textures["image"].tolist()):
            if image < len(images) and has_high_range(images[image]):
                self.peaks[texture] = max(
                    1.0, *(self._find_range(texture, channel)[1] for channel in range(3))
                )

    def texel_minimum(self, texture: int, channel: int) -> float:
        """Return the least value, 0 to 1, of a channel of all texels of a texture."""
        return self._find_range(texture, channel)[0]

    def flag_ones(self) -> NDArray[np.bool_]:
        """Return of which textures each channel is 1 everywhere, (t + 1, 4); the last row, which -1 selects, is
        False. Multiplying by such a channel changes nothing."""
        ones = np.zeros((len(self._textures) + 1, 4), bool)
        for texture, image in enumerate(self._textures["image"].tolist()):
            if image < len(self._images):
                first_texel = np.resize(read_values(self._images[image][0, 0], is_color=False), 4)
                for channel in np.flatnonzero(first_texel == 1.0).tolist():  # mostly none: no image is read
                    ones[texture, channel] = self._find_range(texture, channel) == (1.0, 1.0)
        return ones

    def _find_range(self, texture: int, channel: int) -> tuple[float, float]:
        """Return the least and the largest value of a channel of a texture; each image is read once."""
        image = int(self._textures["image"][texture])
        if (image, channel) not in self._ranges:
            pixels = self._images[image] if image < len(self._images) else np.array([[[0], [255]]], np.uint8)
            values = pixels[..., min(channel, pixels.shape[-1] - 1)]
            ends = np.array((values.min(), values.max()))
            least, largest = read_values(ends, is_color=False).tolist()
            self._ranges[image, channel] = least, largest
        return self._ranges[image, channel]

    def least_alphas(self, materials: NDArray[Any]) -> Floats:
        """Return the least alpha (k,) that materials have anywhere."""
        return self._bound_alphas(materials, self.min_alpha, 0)

    def largest_alphas(self, materials: NDArray[Any]) -> Floats:
        """Return the largest alpha (k,) that materials have anywhere."""
        return self._bound_alphas(materials, self.max_alpha, 1)

    def _bound_alphas(self, materials: NDArray[Any], of_vertices: float, end: int) -> Floats:
        alphas: Floats = materials["base_color"][:, 3].astype(np.float64) * of_vertices
        for row in np.flatnonzero(
            (materials["alpha_mode"] != AlphaMode.OPAQUE) & (materials["texture"] >= 0)
        ):
            alphas[row] *= self._find_range(int(materials["texture"][row]), 3)[end]
        return alphas


def flag_blended(materials: NDArray[Any], bounds: SurfaceBounds) -> NDArray[np.bool_]:
    """Return which materials (k,) let something through: blended ones, unless their alpha is 1 everywhere."""
    blends = materials["alpha_mode"] == AlphaMode.BLEND
    if blends.any():
        rows = np.flatnonzero(blends & (materials["shader"] == 0))
        blends[rows] = bounds.least_alphas(materials[rows]) < 1.0
    return np.asarray(blends)


def flag_cut(materials: NDArray[Any], bounds: SurfaceBounds) -> NDArray[np.bool_]:
    """Return which materials (k,) are cut somewhere: masks, unless no alpha is below their cutoff."""
    cuts = materials["alpha_mode"] == AlphaMode.MASK
    if cuts.any():
        rows = np.flatnonzero(cuts & (materials["shader"] == 0))
        cuts[rows] = bounds.least_alphas(materials[rows]) < materials["alpha_cutoff"][rows]
    return np.asarray(cuts)


def flag_bent(materials: NDArray[Any], bounds: SurfaceBounds) -> NDArray[np.bool_]:
    """Return which materials (k,) have normal maps that bend normals: those of scale 0 don't, if no normal
    of theirs points into the surface."""
    bends = materials["normal_texture"] >= 0
    for row in np.flatnonzero(bends & (materials["normal_scale"] == 0.0)):
        bends[row] = bounds.texel_minimum(int(materials["normal_texture"][row]), 2) <= _UPRIGHT
    return np.asarray(bends)


_UPRIGHT: Final = 0.51
"""A texel's blue above which its normal points out of the surface, and is long enough to have a direction."""


def strongest_response(materials: NDArray[Any], bounds: SurfaceBounds) -> float:
    """Return more light than any surface of the materials (k,) sends to the eye for each unit of irradiance."""
    colors = materials["base_color"][:, :3].max(axis=1, initial=0.0).astype(np.float64) * bounds.max_color
    specular = materials["specular_color"].max(axis=1, initial=0.0).astype(np.float64)
    glossy = specular * (materials["shininess"].astype(np.float64) + 8.0) * 0.125
    is_metal = materials["model"] == ShadingModel.METALLIC_ROUGHNESS
    rims = materials["rim_strength"].astype(np.float64)  # of ambient light
    strongest = np.where(is_metal, _METALLIC_PEAK * np.maximum(colors, 1.0), colors + glossy + rims)
    return float(strongest.max(initial=0.0))


def flag_unseen_materials(materials: NDArray[Any], bounds: SurfaceBounds) -> NDArray[np.bool_]:
    """Return which materials (k,) cover nothing: blended ones of alpha 0 or nearly, and masks whose alpha is
    below their cutoff."""
    mode, alpha = materials["alpha_mode"], bounds.largest_alphas(materials)
    is_clear = (mode == AlphaMode.BLEND) & (alpha <= _CLEAR)
    is_cut = (mode == AlphaMode.MASK) & (alpha < materials["alpha_cutoff"] - _ROUNDING)
    return np.asarray((is_clear | is_cut) & (materials["shader"] == 0))


def flag_points(transforms: Floats) -> NDArray[np.bool_]:
    """Return which transforms (k, 4, 4) leave no area of any triangle: a scale of 0 along two axes or
    more."""
    linear = transforms[:, :3, :3]
    is_zero = np.einsum("kij,kij->kj", linear, linear) == 0.0
    if not is_zero.any():
        return np.zeros(len(transforms), bool)
    return np.asarray(is_zero.sum(axis=1) >= 2)


def select_placed(objects: Objects) -> tuple[Indices, Indices]:
    """Return the indices of the objects that are boxes of their own node: those that can't move, and those
    that may. Those within declared bounds aren't among them: theirs may be the transforms of an earlier time."""
    is_placed = (objects.boxes.node == objects.node) & (objects.node >= 0)
    return np.flatnonzero(is_placed & ~objects.dynamic), np.flatnonzero(is_placed & objects.dynamic)
