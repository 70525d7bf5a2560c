"""The capabilities of an OpenCL device, as far as this backend supports them."""

from __future__ import annotations

from typing import Final

from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.memory.planes import alignment
from rhi.contract.backend import SAMPLE_COUNTS, Capabilities

_MAX_UNIFORM_BYTES: Final = 65536
_MAX_POINT_SIZE: Final = 1024.0  # MAX_POINT_SIZE in kernels/polygon.cl
_MAX_LINE_WIDTH: Final = 256.0
MAX_STORAGE_SLOTS: Final = 16  # kernels find buffers by address, so any number would do
_MAX_ANISOTROPY: Final = 16.0
_MAX_GROUPS: Final = (
    1 << 31
) - 1  # PoCL counts the groups of a dispatch, and ends the process if that overflows
_MAX_VERTEX_STRIDE: Final = 1 << 14
_MAX_VARYINGS: Final = 1 << 10
_MAX_TEXTURE_SIZE: Final = 8192  # the largest window position that kernels represent, see kernels/common.cl


def query_capabilities(context: ClContext, draws: bool) -> Capabilities:
    """Return the capabilities of a device; `draws`: whether the rasteriser works on it."""
    device = context.device
    grain = alignment(device)
    x, y, z = (int(size) for size in (*device.max_work_item_sizes, 1, 1)[:3])
    return Capabilities(
        backend="cl",
        device=str(device.name).strip(),
        driver=f"{' '.join(device.platform.version.split())}, {device.driver_version}",
        rejected_devices=context.rejected_devices,
        max_uniform_bytes=min(_MAX_UNIFORM_BYTES, int(device.max_mem_alloc_size)),
        max_storage_bytes=min((1 << 32) - 1, int(device.max_mem_alloc_size)),
        max_work_group=(x, y, z),
        max_dispatch_groups=_MAX_GROUPS,
        max_work_group_invocations=int(device.max_work_group_size),
        max_shared_bytes=int(device.local_mem_size),
        uniform_alignment=grain,
        storage_alignment=grain,
        max_storage_slots=MAX_STORAGE_SLOTS,
        max_texture_size=_MAX_TEXTURE_SIZE,
        max_volume_size=_MAX_TEXTURE_SIZE,
        max_vertex_stride=_MAX_VERTEX_STRIDE,
        max_varyings=_MAX_VARYINGS,
        sample_counts=SAMPLE_COUNTS,
        max_anisotropy=_MAX_ANISOTROPY,
        draws=draws,
        texture_buffer_copies=True,
        max_point_size=_MAX_POINT_SIZE if draws else 1.0,
        max_line_width=_MAX_LINE_WIDTH if draws else 1.0,
        layered_rendering=draws,
        wireframe=draws,
        indirect_count=draws,
        occlusion_queries=draws,
        sample_counter=draws,
        conditional_rendering=draws,
        alpha_test=draws,
    )
