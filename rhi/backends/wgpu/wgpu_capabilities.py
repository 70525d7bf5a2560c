"""The capabilities of a device: its limits, and the uses of its formats, found by trying."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import wgpu

from rhi.backends.wgpu.adapters import Host
from rhi.backends.wgpu.native import GpuObject
from rhi.backends.wgpu.wgpu_formats import FORMATS
from rhi.backends.wgpu.wgpu_textures import Textures
from rhi.contract.backend import SAMPLE_COUNTS, Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import TextureDescriptor, TextureKind
from rhi.contract.driver_faults import (
    allows_slow_anisotropy,
    is_fourth_uniform_faulty,
    limit_anisotropy,
    list_block_faults,
)
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, FLOAT32_FORMATS, ChannelKind, Format
from rhi.contract.states import MAX_TARGETS

_MAX_STORAGE: Final = 16
_MAX_TEXTURES: Final = 32
_VERTEX_ALIGNMENT: Final = 4
_SMALLEST_ALIGNMENT: Final = 32
_ANISOTROPY: Final = 16.0
_TRIANGLE: Final = """
@vertex fn vs() -> @builtin(position) vec4<f32> { return vec4<f32>(); }
@fragment fn fs() -> @location(0) vec4<f32> { return vec4<f32>(); }
"""
_ALWAYS_BLEND: Final = frozenset(
    {
        Format.R8,
        Format.RG8,
        Format.RGBA8,
        Format.RGBA8_SRGB,
        Format.R16F,
        Format.RG16F,
        Format.RGBA16F,
        Format.RGB10A2,
    }
)


def query_capabilities(host: Host, textures: Textures) -> Capabilities:
    """Return the capabilities of a device. They are found once for each adapter: wgpu-native keeps whatever
    it refuses, and with refused commands their device."""
    key = host.key, allows_slow_anisotropy()
    capabilities = _cached.get(key)
    if capabilities is None:
        capabilities = _cached[key] = _find_capabilities(host, textures)
    return replace(capabilities, rejected_devices=host.rejected_devices)


_cached: Final[dict[object, Capabilities]] = {}


def _find_capabilities(host: Host, textures: Textures) -> Capabilities:
    limits = host.limits
    info = host.info
    features = host.features
    formats = _Formats(host.device, textures)
    unsupported = frozenset(format for format in Format if not textures.usage(format, TextureKind.D2, 1))
    unrenderable = frozenset(f for f in COLOR_FORMATS if not formats.is_target(f, 1))
    targets = [
        format for format in (*COLOR_FORMATS, *DEPTH_FORMATS) if format not in unrenderable | unsupported
    ]
    supported = [format for format in Format if format not in unsupported]
    single = frozenset(format for format in supported if not formats.is_target(format, 4))
    many = [format for format in targets if format not in single]
    stage = "per-shader-stage"
    driver = f"{info['backend_type']} {info['description']}, wgpu {wgpu.__version__}".replace("  ", " ")
    anisotropy, disabled_features = limit_anisotropy(info["device"], driver, _ANISOTROPY)
    blocks, block_faults = "texture-compression-bc" in features, list_block_faults(info["device"])
    return Capabilities(
        backend="wgpu",
        device=info["device"],
        driver=driver,
        max_texture_size=limits["max-texture-dimension-2d"],
        max_texture_layers=min(limits["max-texture-array-layers"], limits["max-texture-dimension-3d"]),
        max_volume_size=limits["max-texture-dimension-3d"],
        max_color_targets=min(limits["max-color-attachments"], MAX_TARGETS),
        max_target_bytes=limits["max-color-attachment-bytes-per-sample"],
        sample_counts=tuple(
            n for n in SAMPLE_COUNTS if n in (1, 4) or all(formats.is_target(f, n) for f in many)
        ),
        max_vertex_attributes=min(16, limits["max-vertex-attributes"]),
        max_vertex_stride=limits["max-vertex-buffer-array-stride"],
        max_varyings=limits["max-inter-stage-shader-variables"] - 1,
        max_uniform_bytes=limits["max-uniform-buffer-binding-size"],
        max_storage_bytes=limits["max-storage-buffer-binding-size"],
        max_uniform_slots=min(
            limits[f"max-uniform-buffers-{stage}"] - is_fourth_uniform_faulty(info["device"]),
            limits["max-dynamic-uniform-buffers-per-pipeline-layout"],
        ),
        max_storage_slots=min(limits[f"max-storage-buffers-{stage}"], _MAX_STORAGE),
        max_texture_slots=min(
            limits[f"max-sampled-textures-{stage}"], limits[f"max-samplers-{stage}"], _MAX_TEXTURES
        ),
        max_image_slots=min(limits[f"max-storage-textures-{stage}"], 8),
        max_work_group=(
            limits["max-compute-workgroup-size-x"],
            limits["max-compute-workgroup-size-y"],
            limits["max-compute-workgroup-size-z"],
        ),
        max_work_group_invocations=limits["max-compute-invocations-per-workgroup"],
        max_dispatch=(limits["max-compute-workgroups-per-dimension"],) * 3,
        max_shared_bytes=limits["max-compute-workgroup-storage-size"],
        max_anisotropy=anisotropy,
        disabled_features=disabled_features + block_faults,
        uniform_alignment=max(_SMALLEST_ALIGNMENT, limits["min-uniform-buffer-offset-alignment"]),
        storage_alignment=max(_SMALLEST_ALIGNMENT, limits["min-storage-buffer-offset-alignment"]),
        copy_alignment=4,
        copy_offset_alignment=4,
        copy_row_alignment=256,
        texture_buffer_copies=True,
        indirect_count=True,
        conditional_rendering=False,
        timestamps="timestamp-query-inside-encoders" in features,
        stencil_per_face=False,
        alpha_test=True,
        precise_triangles=False,
        precise_clipping=False,
        precise_lines=False,
        wireframe="polygon-mode-line" in features,
        border_colors=False,
        draw_index="shader-draw-index" in features,
        aliased_writes=False,
        resolve_feedback=False,
        vertex_writes="vertex-writable-storage" in features,
        early_depth="shader-early-depth-test" in features,
        compressed_size_step=4,
        vertex_alignment=_VERTEX_ALIGNMENT,
        compressed_formats=frozenset(CompressedFormat) if blocks and not block_faults else frozenset(),
        unsupported_formats=unsupported,
        unrenderable_formats=unsupported & frozenset(COLOR_FORMATS) | unrenderable,
        unfilterable_formats=frozenset() if "float32-filterable" in features else FLOAT32_FORMATS,
        unblendable_formats=frozenset(f for f in targets if not f.is_depth and not formats.blends(f)),
        single_sampled_formats=single,
        unresolvable_formats=frozenset(f for f in many if not f.is_depth and not formats.resolves(f)),
        unstorable_formats=frozenset(f for f in COLOR_FORMATS if not formats.is_image(f, "write-only")),
        unloadable_formats=frozenset(f for f in COLOR_FORMATS if not formats.is_image(f, "read-write")),
    )


class _Formats:
    """The uses of formats on a device."""

    def __init__(self, device: GpuObject, textures: Textures) -> None:
        self._device = device
        self._textures = textures
        self._module: GpuObject | None = None

    def _works(self, make: Callable[[], object]) -> bool:
        try:
            make()
        except wgpu.GPUError:
            return False
        return True

    def is_target(self, format: Format, samples: int) -> bool:
        """Whether textures of a format and a number of samples can be targets."""
        return bool(
            self._textures.usage(format, TextureKind.D2, samples) & wgpu.TextureUsage.RENDER_ATTACHMENT
        )

    def blends(self, format: Format) -> bool:
        """Whether draws can blend with a format; not for integer formats."""
        return format.is_integer or format in _ALWAYS_BLEND or self._works(lambda: self._blend(format))

    def _blend(self, format: Format) -> None:
        if self._module is None:
            self._module = self._device.create_shader_module(code=_TRIANGLE)
        part = {"operation": "add", "src_factor": "one", "dst_factor": "one"}
        target: dict[str, Any] = {"format": FORMATS[format], "blend": {"color": part, "alpha": part}}
        self._device.create_render_pipeline(
            layout="auto",
            vertex={"module": self._module, "entry_point": "vs"},
            fragment={"module": self._module, "entry_point": "fs", "targets": [target]},
        )

    def resolves(self, format: Format) -> bool:
        """Whether four samples of a format can be resolved."""
        return format.kind in (ChannelKind.UNORM, ChannelKind.SRGB) or self._works(
            lambda: self._resolve(format)
        )

    def _resolve(self, format: Format) -> None:
        usage = wgpu.TextureUsage.RENDER_ATTACHMENT
        source, target = (
            self._textures.make(TextureDescriptor((4, 4), format, samples=n), usage) for n in (4, 1)
        )
        color = {
            "view": source.create_view(),
            "resolve_target": target.create_view(),
            "load_op": "clear",
            "store_op": "store",
        }
        encoder = self._device.create_command_encoder()
        encoder.begin_render_pass(color_attachments=[color]).end()
        self._device.queue.submit([encoder.finish()])  # wgpu-native keeps commands that aren't submitted

    def is_image(self, format: Format, access: str) -> bool:
        """Whether images of a format allow this access."""
        usage = self._textures.usage(format, TextureKind.D2, 1)
        if not usage & wgpu.TextureUsage.STORAGE_BINDING:
            return False
        image = {"access": access, "format": FORMATS[format], "view_dimension": "2d"}
        entry = {"binding": 0, "visibility": wgpu.ShaderStage.COMPUTE, "storage_texture": image}
        return self._works(lambda: self._device.create_bind_group_layout(entries=[entry]))
