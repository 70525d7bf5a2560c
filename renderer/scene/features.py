"""The features that materials have, counted once and again where materials change.

What a scene lacks is neither in its shaders nor bound, so every frame asks which features there are.
Materials are a plain array that anybody may write to: changes are found by comparing, once a frame, and only
the materials that have changed are examined again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Indices
from renderer.scene.material_instances import CustomShader
from renderer.scene.materials import TEXTURES, ShadingModel
from renderer.scene.negligible import LEAST_LIGHT, SurfaceBounds, flag_bent, flag_blended, flag_cut
from rhi import SamplerDescriptor, Wrap
from rhi.math.indexing import count_indices

_Words = NDArray[np.uint64]

_FEATURES: Final = (
    "emission",
    "metals",
    "emissive colors",
    "normal maps",
    "roughness maps",
    "occlusion maps",
    "emissive maps",
    "light maps",
    "masks",
    "two sides",
    "mixed coordinates",
    "material shaders",
)
"""The features that a material has or lacks by itself."""

_CHANNELS: Final = {
    "metallic_roughness_texture": (1, 2),
    "occlusion_texture": (0,),
    "emissive_texture": (0, 1, 2),
}
"""The channels of textures that multiply a value of the material."""


class MaterialFeatures:
    """The features that the materials of a scene have, as of the last `refresh`.

    Attributes:
        counts: how many materials have each feature that a scene may lack; `images`, how many images base
            colours have; `second uvs`, how many textures are read by a second uv; and `texture transforms`,
            how many aren't read and repeated as they are.
        version: a number that grows when materials have changed.
    """

    def __init__(
        self,
        materials: NDArray[Any],
        textures: NDArray[Any],
        samplers: Sequence[SamplerDescriptor],
        shaders: Sequence[CustomShader],
        bounds: SurfaceBounds | None = None,
    ) -> None:
        """`bounds` are those of what textures and vertices multiply colors by; by default of none."""
        self._bends = np.array([False, *(custom.shader.reads_tangents for custom in shaders)], bool)
        self._bounds = SurfaceBounds(textures, ()) if bounds is None else bounds
        self._textures, self._ones = textures, self._bounds.flag_ones()
        self._repeats = np.array(
            [(sampler.wrap_u, sampler.wrap_v) == (Wrap.REPEAT, Wrap.REPEAT) for sampler in samplers], bool
        )
        plain = (textures["transform"] == np.eye(2, 3)).all(axis=(1, 2)) & self._repeats[textures["sampler"]]
        self._is_transformed: NDArray[np.bool_] = ~plain
        self.version = 0
        self._begin(materials)

    def _begin(self, materials: NDArray[Any]) -> None:
        """Examine all materials (k,)."""
        self._previous_materials = materials.copy()
        self._flags = self._examine(materials)
        self._totals = self._flags.sum(axis=0)
        self._base_reads, self._reads = self._count_reads(materials)
        self.counts: Mapping[str, int] = self._count()

    @property
    def kinds(self) -> Indices:
        """A number (k,) for each material: those with the same one have the same features."""
        return np.unique(self._flags, axis=0, return_inverse=True)[1].reshape(-1)

    def compute_flags(self) -> dict[str, NDArray[np.bool_]]:
        """Return which of the materials (k,) have each of the features of `counts`."""
        rows = np.stack([self._list_textures(self._previous_materials, name) for name in TEXTURES], axis=1)
        reads, textures = rows >= 0, self._textures
        flags = dict(zip(_FEATURES, self._flags.T, strict=True)) | {
            "images": self._read_colors(self._previous_materials) >= 0
        }
        for name, has in (
            ("second uvs", textures["uv_set"] > 0),
            ("texture transforms", self._is_transformed),
        ):
            flags[name] = (reads & np.append(has, False)[rows]).any(axis=1)
        return flags

    def refresh(self, materials: NDArray[Any]) -> None:
        """Bring the counts up to date with `materials` (k,)."""
        if len(materials) != len(self._previous_materials):  # another array in its place
            self._begin(materials)
            self.version += 1
            return
        if materials.tobytes() == self._previous_materials.tobytes():  # takes less than array operations
            return
        rows: Indices = np.flatnonzero(
            (_view_words(materials) != _view_words(self._previous_materials)).any(axis=1)
        )
        changed, flags = materials[rows], self._examine(materials[rows])
        self._totals += flags.sum(axis=0) - self._flags[rows].sum(axis=0)
        for reads, before, after in zip(
            (self._base_reads, self._reads),
            self._count_reads(self._previous_materials[rows]),
            self._count_reads(changed),
            strict=True,
        ):
            reads += after - before
        self._flags[rows], self._previous_materials[rows] = flags, changed
        self.version += 1
        self.counts = self._count()

    def _examine(self, materials: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which of the materials (k,) have which of `_FEATURES`, (k, features)."""
        is_metal = materials["model"] == ShadingModel.METALLIC_ROUGHNESS
        emitted = materials["base_color"][:, :3].max(axis=1) * materials["emission"].astype(np.float64)
        peaks = self._bounds.peaks[materials["emissive_texture"]]
        emits = materials["emissive"].max(axis=1) * peaks > LEAST_LIGHT
        has = {name: self._flag_changing(materials, name, channels) for name, channels in _CHANNELS.items()}
        tells_metal = (materials["metallic"] > 0.0) | (materials["roughness"] > 0.0)
        columns = {
            "emission": emitted * self._bounds.max_color > LEAST_LIGHT,
            "metals": is_metal,
            "emissive colors": emits,
            "normal maps": flag_bent(materials, self._bounds) | self._bends[materials["shader"]],
            "roughness maps": is_metal & has["metallic_roughness_texture"] & tells_metal,
            "occlusion maps": has["occlusion_texture"] & (materials["occlusion_strength"] > 0.0),
            "emissive maps": emits & has["emissive_texture"],
            "light maps": materials["light_map_texture"] >= 0,
            "masks": flag_cut(materials, self._bounds),
            "two sides": materials["double_sided"] != 0,
            "mixed coordinates": self._flag_mixed_coordinates(materials),
            "material shaders": materials["shader"] > 0,
        }
        return np.stack([columns[name] for name in _FEATURES], axis=1)

    def _read_colors(self, materials: NDArray[Any]) -> NDArray[np.int32]:
        """Return the texture (k,) of the base color of materials, -1 where the material is black or the texture
        white, and it covers all."""
        changes = self._flag_changing(materials, "texture", (0, 1, 2))
        shows = (materials["base_color"][:, :3].any(axis=1) & changes) | (materials["shader"] > 0)
        shows |= flag_cut(materials, self._bounds) | flag_blended(materials, self._bounds)
        return np.where(shows, materials["texture"], -1)

    def _flag_changing(
        self, materials: NDArray[Any], name: str, channels: tuple[int, ...]
    ) -> NDArray[np.bool_]:
        """Return which materials (k,) have a texture in a field, with channels that aren't 1 everywhere."""
        textures = materials[name]
        return np.asarray((textures >= 0) & ~self._ones[textures][:, channels].all(axis=1))

    def _list_textures(self, materials: NDArray[Any], name: str) -> NDArray[np.int32]:
        """Return the texture (k,) of materials that a field names, -1 where it isn't read."""
        rows: NDArray[np.int32] = self._read_colors(materials) if name == "texture" else materials[name]
        return rows

    def _flag_mixed_coordinates(self, materials: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which materials (k,) read textures at unlike places, or any that isn't repeated."""
        mixed, textures = np.zeros(len(materials), bool), self._textures
        rows = np.stack([materials[name] for name in TEXTURES], axis=1)
        first = rows.max(axis=1)
        for column in rows.T:
            read = np.flatnonzero(column >= 0)
            texture, first_texture = textures[column[read]], textures[first[read]]
            mixed[read] |= texture["uv_set"] != first_texture["uv_set"]
            mixed[read] |= (texture["transform"] != first_texture["transform"]).any(axis=(1, 2))
            mixed[read] |= ~self._repeats[texture["sampler"]]
        # A material's own shader reads its textures by the first texture coordinates.
        return np.asarray(mixed | ((materials["shader"] > 0) & (materials["light_map_texture"] >= 0)))

    def _count_reads(self, materials: NDArray[Any]) -> tuple[Indices, Indices]:
        """Return the number of materials that have each texture (t,) as a base colour, and at all."""
        used = [self._list_textures(materials, name) for name in TEXTURES]
        by_use = [count_indices(rows[rows >= 0], minlength=len(self._textures)) for rows in used]
        return by_use[list(TEXTURES).index("texture")], np.sum(by_use, axis=0)

    def _count(self) -> dict[str, int]:
        is_read = self._reads > 0
        return {
            "images": len(np.unique(self._textures["image"][self._base_reads > 0])),
            **dict(zip(_FEATURES, self._totals.tolist(), strict=True)),
            "second uvs": int(self._textures["uv_set"][is_read].sum()),
            "texture transforms": int((self._is_transformed & is_read).sum()),
        }


def _view_words(materials: NDArray[Any]) -> _Words:
    """Return the bytes of materials (k,), eight at a time, (k, words)."""
    return np.ascontiguousarray(materials).view(np.uint64).reshape(len(materials), -1)
