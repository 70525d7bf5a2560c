"""The capabilities of a device: its limits and features, and the uses of its formats."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from rhi.backends.webgpu.implementation import FormatUses, Host, Implementation
from rhi.backends.webgpu.webgpu_flags import GpuTextureUsage
from rhi.contract.backend import SAMPLE_COUNTS, Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import TextureKind
from rhi.contract.driver_faults import (
    allows_slow_anisotropy,
    is_fourth_uniform_faulty,
    limit_anisotropy,
    list_block_faults,
)
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, FLOAT32_FORMATS, Format
from rhi.contract.states import MAX_TARGETS
from rhi.errors.shared_caches import make_shared_lock

_MAX_STORAGE: Final = 16
_MAX_TEXTURES: Final = 32
_VERTEX_ALIGNMENT: Final = 4
_SMALLEST_ALIGNMENT: Final = 32
_ANISOTROPY: Final = 16.0


def query_capabilities(implementation: Implementation, host: Host, formats: FormatUses) -> Capabilities:
    """Return the capabilities of a device. They are computed once for each adapter, since an implementation
    may have to try the uses of its formats. Other threads wait for them."""
    key = host.key, allows_slow_anisotropy()
    with _LOCK:
        capabilities = _cached.get(key)
        if capabilities is None:
            capabilities = _cached[key] = _compute_capabilities(implementation, host, formats)
    return replace(capabilities, rejected_devices=host.rejected_devices)


_cached: Final[dict[object, Capabilities]] = {}
_LOCK: Final = make_shared_lock()


def _is_target(formats: FormatUses, format: Format, samples: int) -> bool:
    """True if textures of a format and a number of samples can be targets."""
    return bool(formats.usage(format, TextureKind.D2, samples) & GpuTextureUsage.RENDER_ATTACHMENT)


def _compute_capabilities(implementation: Implementation, host: Host, formats: FormatUses) -> Capabilities:
    limits = host.limits
    info = host.info
    features = host.features
    unsupported = frozenset(format for format in Format if not formats.usage(format, TextureKind.D2, 1))
    unrenderable = frozenset(f for f in COLOR_FORMATS if not _is_target(formats, f, 1))
    targets = [
        format for format in (*COLOR_FORMATS, *DEPTH_FORMATS) if format not in unrenderable | unsupported
    ]
    supported = [format for format in Format if format not in unsupported]
    single = frozenset(format for format in supported if not _is_target(formats, format, 4))
    many = [format for format in targets if format not in single]
    stage = "per-shader-stage"
    driver = f"{info['backend_type']} {info['description']}, {implementation.version}".replace("  ", " ")
    anisotropy, disabled_features = limit_anisotropy(info["device"], driver, _ANISOTROPY)
    blocks, block_faults = "texture-compression-bc" in features, list_block_faults(info["device"])
    return Capabilities(
        backend=implementation.name,
        device=info["device"],
        driver=driver,
        max_texture_size=limits["max-texture-dimension-2d"],
        max_texture_layers=min(limits["max-texture-array-layers"], limits["max-texture-dimension-3d"]),
        max_volume_size=limits["max-texture-dimension-3d"],
        max_color_targets=min(limits["max-color-attachments"], MAX_TARGETS),
        max_target_bytes=limits["max-color-attachment-bytes-per-sample"],
        sample_counts=tuple(
            n for n in SAMPLE_COUNTS if n in (1, 4) or all(_is_target(formats, f, n) for f in many)
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
