"""Textures, samplers, and the parts of a texture that are bound or rendered to.

- Row 0 of every array is the top row. `read` and `write` use the format's own dtype; nothing is converted
  silently.
- A `Texture` can be bound directly, with a default sampler for its format. `sampled(...)` binds it with another
  sampler, `image(...)` binds one level for loads and stores, and `at(...)` is one level and layer as a render target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import (
    Access,
    Filter,
    Id,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
)
from rhi.contract.formats import Format
from rhi.device.core.core import Core
from rhi.device.resources.lifetime import Resource
from rhi.device.resources.locks import Lock
from rhi.errors.arguments import Arguments, Fields
from rhi.errors.rules import (
    DEVICE_CAPABILITY,
    TEXTURE_DATA,
    TEXTURE_FORMAT,
    TEXTURE_LEVELS,
    TEXTURE_REGION,
    TEXTURE_SAMPLES,
    TEXTURE_SIZE,
)
from rhi.shading.language.bindings import ImageBinding, TextureBinding

__rhi_internal__ = True

_LINEAR = SamplerDescriptor()
_NEAREST = SamplerDescriptor(minify=Filter.NEAREST, magnify=Filter.NEAREST, mip=Filter.NEAREST)


@dataclass(frozen=True, slots=True)
class Sampler:
    """A sampler: filtering, wrapping and comparison of texture reads. Equal descriptors share one id."""

    id: Id
    descriptor: SamplerDescriptor

    def __post_init__(self) -> None:
        fields = Fields(self)
        fields.wholes("id", least=1)
        fields.instance("descriptor", self.descriptor, SamplerDescriptor, "an rhi.SamplerDescriptor")


@dataclass(frozen=True, slots=True)
class TextureTarget:
    """One mip level and layer of a texture as the target of a render pass."""

    texture: Texture
    level: int = 0
    layer: int = 0

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the level."""
        return self.texture.descriptor.level_size(self.level)


class Texture(TextureBinding, Resource):
    """A texture on the device.

    Attributes:
        id: the texture's id in the command stream.
        descriptor: size, format, kind, layers, levels and samples; these are also attributes of the texture.
    """

    __slots__ = ("core", "descriptor", "destroyed", "id")

    def __init__(self, core: Core, descriptor: TextureDescriptor) -> None:
        _check_descriptor(core, descriptor)
        self.core = core
        self.descriptor = descriptor
        self.destroyed = False
        integer_or_depth = descriptor.format.is_integer or descriptor.format.is_depth
        sampler = core.sampler(_NEAREST if integer_or_depth else _LINEAR)
        self.id = core.create_id()
        core.backend.create_texture(self.id, descriptor)
        super().__init__(self.id, sampler, self)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of level 0."""
        return self.descriptor.size

    @property
    def format(self) -> Format:
        """The texel format."""
        return self.descriptor.format

    @property
    def kind(self) -> TextureKind:
        """The texture's kind: 2D, 2D array, 3D or cube."""
        return self.descriptor.kind

    @property
    def layers(self) -> int:
        """Number of array layers, 6 for a cube, the depth of a 3D texture."""
        return self.descriptor.layers

    @property
    def levels(self) -> int:
        """Number of mip levels."""
        return self.descriptor.levels

    @property
    def samples(self) -> int:
        """Number of samples per texel; 1 unless the texture is multi-sampled."""
        return self.descriptor.samples

    @property
    def label(self) -> str:
        """The texture's name in messages and tools."""
        return self.descriptor.label

    def __repr__(self) -> str:
        width, height = self.size
        return f"Texture({self.label!r}, {width}×{height}, {self.format.name})"

    def destroy(self) -> None:
        """Destroy the texture once the GPU no longer uses it. A second call does nothing."""
        if not self.destroyed:
            self.core.check_thread("destroy")
            self.destroyed = True
            self.core.program = None
            self.core.timeline.retire(self.id)

    # -- parts -------------------------------------------------------------------------------------------

    def at(self, level: int = 0, layer: int = 0) -> TextureTarget:
        """Return one level and layer as a render target."""
        level, layer = self._check("Texture.at", level, layer)
        return TextureTarget(self, level, layer)

    def sampled(self, sampler: Sampler | SamplerDescriptor) -> TextureBinding:
        """Return a binding that reads this texture through another sampler."""
        core, call = self.core, "Texture.sampled"
        self._check(call)
        if isinstance(sampler, Sampler):
            descriptor = sampler.descriptor
            if core.sampler_descriptors.get(sampler.id) is descriptor:
                return TextureBinding(self.id, sampler.id, self)
        else:
            allowed = "a Sampler from device.sampler(…), or an rhi.SamplerDescriptor"
            descriptor = Arguments(call, core.refuse).instance("sampler", sampler, SamplerDescriptor, allowed)
        return TextureBinding(self.id, core.sampler(descriptor), self)

    def image(self, level: int = 0, layer: int | None = None) -> ImageBinding:
        """Return a binding of one level, with all layers or one, for a shader's loads and stores."""
        level, first = self._check("Texture.image", level, 0 if layer is None else layer)
        layer = None if layer is None else first
        return ImageBinding(self.id, level, layer, self)

    # -- memory ------------------------------------------------------------------------------------------

    def read(self, level: int = 0, layer: int = 0, region: Region | None = None) -> NDArray[Any]:
        """Return one layer: (height, width, channels), or (height, width) for one channel; top row first.

        Waits for the device. Depth is read as float32.
        """
        level, where = self._region("Texture.read", level, layer, region)
        texels = self._read("Texture.read", level, where, False)
        return texels[0, :, :, 0] if self.format.channels == 1 else texels[0]

    def read_layers(self, level: int = 0) -> NDArray[Any]:
        """Return all layers: (layers, height, width, channels). Waits for the device."""
        level, region = self._whole("Texture.read_layers", level, self.core)
        return self._read("Texture.read_layers", level, region, False)

    def read_stencil(self, level: int = 0, layer: int = 0, region: Region | None = None) -> NDArray[np.uint8]:
        """Return the stencil values of one layer: (height, width) uint8. Waits for the device."""
        call = "Texture.read_stencil"
        if not self.format.has_stencil:
            self.core.refuse(TEXTURE_FORMAT, call, self.format.name, "a format with stencil")
        level, where = self._region(call, level, layer, region)
        stencil: NDArray[np.uint8] = self._read(call, level, where, True)
        return stencil[0, :, :, 0]

    def write(self, texels: NDArray[Any], level: int = 0, layer: int = 0, x: int = 0, y: int = 0) -> None:
        """Replace texels from (x, y) on.

        `texels` is (height, width, channels), (height, width) for one channel, or (layers, height, width, channels)
        for several layers from `layer` on.

        Raises:
            ValidationError: `texture-data` for a wrong dtype or shape, `texture-region` beyond an edge,
                `texture-format` for depth, `texture-samples` for multi-sampled textures.
        """
        call = "Texture.write"
        check = Arguments(call, self.core.refuse)
        level, layer = self._check(call, level, layer)
        if self.format.is_depth:
            self.core.refuse(
                TEXTURE_FORMAT, call, self.format.name, "a color format", "depth is written by a render pass"
            )
        self._check_single_sample(call)
        self.core.check_ready()
        array = check.array("texels", texels)
        channels = self.format.channels
        if array.ndim == 2 and channels == 1:
            array = array[None, :, :, None]
        elif array.ndim == 3:
            array = array[None]
        if array.dtype != self.format.dtype or array.ndim != 4 or array.shape[3] != channels:
            allowed = f"(height, width, {channels}) of {self.format.dtype}"
            self.core.refuse(TEXTURE_DATA, call, f"shape {np.shape(texels)} of {array.dtype}", allowed)
        layers, height, width = array.shape[:3]
        region = Region(check.whole("x", x), check.whole("y", y), width, height, layer, layers)
        self._check_region(call, level, region)
        self.core.upload_bytes += array.nbytes
        self.core.backend.write_texture(
            self.id, level, region, np.ascontiguousarray(array).view(np.uint8).data
        )

    def generate_mipmaps(self) -> None:
        """Generate mip levels 1… from level 0 (2×2 box filter, sRGB in linear light)."""
        self._generate_mipmaps(self.core)

    def _generate_mipmaps(self, core: Core) -> None:
        """Send a `generate_mipmaps` to `core`: the texture's own, or a command buffer's."""
        call = "Texture.generate_mipmaps"
        self._check(call, core=core)
        if self.format.is_depth or self.format.is_integer:
            self.core.refuse(TEXTURE_FORMAT, call, self.format.name, "a color format that can be filtered")
        if self.levels > 1:
            core.check_ready()
            core.backend.generate_mipmaps(self.id)

    def copy_to(
        self,
        target: Texture,
        *,
        level: int = 0,
        region: Region | None = None,
        target_level: int = 0,
        x: int = 0,
        y: int = 0,
        layer: int = 0,
    ) -> None:
        """Copy a region (None: the whole level) to (x, y, layer) of `target_level`; the formats must be equal."""
        self._copy(self.core, target, level, region, target_level, x, y, layer)

    def _copy(
        self, core: Core, target: Texture, level: int, region: Region | None, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        """Send a `copy_to` to `core`."""
        call = "Texture.copy_to"
        check = Arguments(call, self.core.refuse)
        check.instance("target", target, Texture, "a Texture")
        level, source_region = self._whole(call, level, core, region)
        self._check_region(call, level, source_region, core)
        target_level, layer = target._check(call, target_level, layer, core)
        x, y = check.whole("x", x), check.whole("y", y)
        if target.format is not self.format:
            self.core.refuse(
                TEXTURE_FORMAT, call, f"{self.format.name} to {target.format.name}", "equal formats"
            )
        if target.samples != 1 or self.samples != 1:
            self.core.refuse(
                TEXTURE_SAMPLES, call, f"{self.samples} to {target.samples} samples", "1", "use resolve_to"
            )
        end = Region(x, y, source_region.width, source_region.height, layer, source_region.layers)
        target._check_region(call, target_level, end, core)
        if target is self and level == target_level and _overlap(source_region, end):
            self.core.refuse(TEXTURE_REGION, call, f"{source_region} to {end}", "regions that don't overlap")
        core.check_ready()
        core.backend.copy_texture(self.id, level, source_region, target.id, target_level, x, y, layer)

    def resolve_to(self, target: Texture) -> None:
        """Resolve this multi-sampled texture to `target`: average the samples; size and format must be equal."""
        self._resolve(self.core, target)

    def _resolve(self, core: Core, target: Texture) -> None:
        """Send a `resolve_to` to `core`."""
        call = "Texture.resolve_to"
        Arguments(call, self.core.refuse).instance("target", target, Texture, "a Texture")
        self._check(call, core=core)
        target._check(call, core=core)
        if self.samples == 1 or target.samples != 1:
            self.core.refuse(
                TEXTURE_SAMPLES, call, f"{self.samples} to {target.samples} samples", "several samples to 1"
            )
        has_average = not (self.format.is_depth or self.format.is_integer)
        if self.format is not target.format or self.size != target.size or not has_average:
            allowed = "equal sizes and equal color formats, not of integers"
            self.core.refuse(TEXTURE_FORMAT, call, f"{self!r} to {target!r}", allowed)
        core.check_ready()
        core.backend.resolve_texture(self.id, target.id)

    def lock(self, access: Access, level: int = 0, layer: int = 0, region: Region | None = None) -> Lock:
        """Create a lock: `with texture.lock(Access.WRITE) as texels:`, (height, width, channels), top row first."""
        call = "Texture.lock"
        Arguments(call, self.core.refuse).choice("access", access, Access)
        if self.format.is_depth and access.writes:
            self.core.refuse(TEXTURE_FORMAT, call, self.format.name, "a color format, or Access.READ")
        self._check_single_sample(call)
        level, where = self._region(call, level, layer, region)
        return Lock(
            self,
            access,
            read=lambda: self._read(call, level, where, False)[0].copy(),
            make=lambda: np.zeros((where.height, where.width, self.format.channels), self.format.dtype),
            write=lambda texels: self.write(texels, level, where.layer, where.x, where.y),
        )

    # -- checks ------------------------------------------------------------------------------------------

    def _check(
        self, call: str, level: int = 0, layer: int = 0, core: Core | None = None
    ) -> tuple[int, int]:
        """Refuse a texture that can't be used now, and return a level and layer that it has."""
        check = Arguments(call, self.core.refuse)
        level, layer = check.whole("level", level), check.whole("layer", layer)
        core = core or self.core
        core.check_open()
        core.check_usable(self, call)
        if not 0 <= level < self.levels:
            self.core.refuse(TEXTURE_LEVELS, call, f"level {level}", f"0 to {self.levels - 1}")
        layers = self.descriptor.level_layers(level)
        if not 0 <= layer < layers:
            self.core.refuse(TEXTURE_LEVELS, call, f"layer {layer}", f"0 to {layers - 1}")
        return level, layer

    def _check_single_sample(self, call: str) -> None:
        if self.samples != 1:
            self.core.refuse(
                TEXTURE_SAMPLES,
                call,
                f"{self.samples} samples",
                "1",
                "resolve it first: texture.resolve_to(…)",
            )

    def _check_region(self, call: str, level: int, region: Region, core: Core | None = None) -> None:
        self._check(call, level, region.layer, core)
        width, height = self.descriptor.level_size(level)
        layers = self.descriptor.level_layers(level)
        inside = (
            region.x >= 0
            and region.y >= 0
            and min(region.width, region.height, region.layers) > 0
            and region.x + region.width <= width
            and region.y + region.height <= height
            and region.layer + region.layers <= layers
        )
        if not inside:
            self.core.refuse(TEXTURE_REGION, call, str(region), f"inside {width}×{height}, {layers} layers")

    def _whole(
        self, call: str, level: int, core: Core, region: Region | None = None
    ) -> tuple[int, Region]:
        """Return a level, and the region of it that was given, or else all of its texels and layers."""
        level, _ = self._check(call, level, core=core)
        if region is not None:
            return level, self._as_region(call, region)
        width, height = self.descriptor.level_size(level)
        return level, Region(0, 0, width, height, 0, self.descriptor.level_layers(level))

    def _region(self, call: str, level: int, layer: int, region: Region | None) -> tuple[int, Region]:
        """Return a level, and the region of it that was given, or else all texels of the layer."""
        level, layer = self._check(call, level, layer)
        if region is None:
            return level, Region(0, 0, *self.descriptor.level_size(level), layer)
        region = self._as_region(call, region)
        self._check_region(call, level, region)
        return level, region

    def _as_region(self, call: str, region: Region) -> Region:
        allowed = "an rhi.Region(x, y, width, height), or None"
        return Arguments(call, self.core.refuse).instance("region", region, Region, allowed)

    def _read(self, call: str, level: int, region: Region, stencil: bool) -> NDArray[Any]:
        self._check_region(call, level, region)
        self._check_single_sample(call)
        self.core.check_ready()
        return self.core.backend.read_texture(self.id, level, region, stencil)


def full_levels(width: int, height: int, depth: int = 1) -> int:
    """Return the number of mip levels down to 1×1."""
    return max(width, height, depth).bit_length()


def _overlap(a: Region, b: Region) -> bool:
    return (
        a.x < b.x + b.width
        and b.x < a.x + a.width
        and a.y < b.y + b.height
        and b.y < a.y + a.height
        and a.layer < b.layer + b.layers
        and b.layer < a.layer + a.layers
    )


def _check_descriptor(core: Core, descriptor: TextureDescriptor) -> None:
    call = "device.texture"
    core.check_ready()
    limits = core.capabilities
    width, height = descriptor.size
    if not (0 < width <= limits.max_texture_size and 0 < height <= limits.max_texture_size):
        core.refuse(TEXTURE_SIZE, call, f"{width}×{height}", f"1 to {limits.max_texture_size} each way")
    if descriptor.format in limits.unsupported_formats:
        core.refuse(
            DEVICE_CAPABILITY, call, descriptor.format.name, "not among capabilities.unsupported_formats"
        )
    kind, layers = descriptor.kind, descriptor.layers
    allowed_layers = {TextureKind.D2: (1, 1), TextureKind.CUBE: (6, 6)}.get(
        kind, (1, limits.max_texture_layers)
    )
    if not allowed_layers[0] <= layers <= allowed_layers[1]:
        core.refuse(
            TEXTURE_SIZE,
            call,
            f"{layers} layers of {kind.name}",
            f"{allowed_layers[0]} to {allowed_layers[1]}",
        )
    if kind is TextureKind.CUBE and width != height:
        core.refuse(TEXTURE_SIZE, call, f"a cube of {width}×{height}", "square faces")
    most = full_levels(width, height, layers if kind is TextureKind.D3 else 1)
    if not 1 <= descriptor.levels <= most:
        core.refuse(TEXTURE_LEVELS, call, f"{descriptor.levels} levels", f"1 to {most}")
    samples = descriptor.samples
    if samples not in limits.sample_counts:
        core.refuse(
            TEXTURE_SAMPLES, call, f"{samples} samples", f"{', '.join(map(str, limits.sample_counts))} samples"
        )
    if samples > 1 and (descriptor.levels > 1 or kind is not TextureKind.D2):
        core.refuse(
            TEXTURE_SAMPLES,
            call,
            f"{samples} samples, {descriptor.levels} levels, {kind.name}",
            "2D, one level",
        )
    if descriptor.format.is_depth and kind is TextureKind.D3:
        core.refuse(TEXTURE_FORMAT, call, "a 3D depth texture", "2D, 2D array or cube")
