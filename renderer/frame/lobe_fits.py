"""The table of lobes by which area lights are lit, on a device."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.shaders.area_lights import FIT_SIZE
from rhi import Device, Format, SamplerDescriptor, Texture
from rhi.shading import TextureBinding

FIT_FILE: Final = Path(__file__).with_name("lobe_fits.npy")
"""The table (2, `FIT_SIZE`, `FIT_SIZE`, 8), float16: of the specular and of the metallic-roughness model, by roughness
and `fit_view_cosine`, the numbers xx, xz, zx, zz and yy of M⁻¹, the lobe's energy, that of its white part, and 0."""


@cache
def read_fits() -> NDArray[np.float16]:
    """The texels (4 `FIT_SIZE`, `FIT_SIZE`, 4) of the table: for the specular model, then for the metallic-roughness
    model, the first and the last four numbers of its rows."""
    table: NDArray[np.float16] = np.load(FIT_FILE)
    texels = table.reshape(2, FIT_SIZE, FIT_SIZE, 2, 4).transpose(0, 3, 1, 2, 4)
    return np.ascontiguousarray(texels.reshape(4 * FIT_SIZE, FIT_SIZE, 4))


class LobeTable:
    """The table as a texture, created when a frame lights by it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._texture: Texture | None = None
        self._binding: TextureBinding | None = None

    @property
    def binding(self) -> TextureBinding:
        """The texture as it is sampled."""
        if self._texture is None or self._binding is None:
            self._texture = self._device.texture(read_fits(), Format.RGBA16F, label="lobe fits")
            self._binding = self._texture.sampled(SamplerDescriptor())
        return self._binding

    def release(self) -> None:
        """Destroy the texture; the next use of `binding` creates it again."""
        if self._texture is not None:
            self._texture.destroy()
        self._texture = self._binding = None

    def destroy(self) -> None:
        """Destroy the texture."""
        self.release()
