"""The capabilities that a null device presents: profiles of other devices.

The limits of the OpenGL profiles are the smallest that a specification allows (OpenGL 3.3 and 4.5 core,
tables of chapters 6 and 23; OpenGL ES 3.0.6, chapter 6), for a port that uses nothing beyond it. What runs
within them runs on every such driver. There are two exceptions: multi-sampled targets have 4 samples, which
the specifications guarantee for renderbuffers only, and buffer offsets are aligned to 256 bytes, the coarsest
alignment that a driver may require. `webgpu` is what every implementation of WebGPU guarantees (section
3.6.2, without optional features): the backend `wgpu` declares the same with `RHI_WGPU_PROFILE=core`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from rhi.contract import webgpu_formats
from rhi.contract.backend import Capabilities
from rhi.contract.formats import FLOAT32_FORMATS, ChannelKind, Format
from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT

_SNORM: Final = frozenset(form for form in Format if form.kind is ChannelKind.SNORM)
_UNORM16: Final = frozenset(f for f in Format if f.kind is ChannelKind.UNORM and f.channel_bits[0] == 16)
_FLOAT: Final = frozenset(form for form in Format if form.kind is ChannelKind.FLOAT)


def _device(name: str) -> Capabilities:
    """Return capabilities without the features that not every device has."""
    return Capabilities(
        backend="null",
        device=name,
        driver=f"NumPy {np.__version__}",
        shading=False,
        indirect_count=False,
        texture_buffer_copies=True,
        depth_bias_clamp=False,
        blend_per_target=False,
        unrenderable_formats=_SNORM,
    )


PROFILES: Final[Mapping[str, Capabilities]] = {
    "everything": Capabilities(
        backend="null",
        device="null",
        driver=f"NumPy {np.__version__}",
        shading=False,
        sample_counter=True,
        alpha_test=True,
        max_anisotropy=16.0,
        max_shared_bytes=1 << 16,
        texture_buffer_copies=True,
        max_point_size=64.0,
        max_line_width=64.0,
        layered_rendering=True,
        wireframe=True,
        max_storage_slots=16,
        max_volume_size=1 << 14,
        max_vertex_stride=1 << 14,
        max_varyings=1 << 10,
    ),
    "gl-4.5": replace(
        _device("gl-4.5"),
        max_texture_size=16384,
        max_texture_layers=2048,
        max_uniform_slots=14,
        sample_counter=True,
        blend_per_target=True,
    ),
    "gl-3.3": replace(
        _device("gl-3.3"),
        max_texture_size=1024,
        max_texture_layers=256,
        max_storage_bytes=0,
        max_storage_slots=0,
        max_image_slots=0,
        compute=False,
    ),
    "gles-3": replace(
        _device("gles-3"),
        max_texture_size=2048,
        max_texture_layers=256,
        max_color_targets=4,
        max_storage_bytes=0,
        max_storage_slots=0,
        max_image_slots=0,
        compute=False,
        occlusion_queries=False,
        conditional_rendering=False,
        timestamps=False,
        unsupported_formats=_UNORM16,
        unrenderable_formats=_SNORM | _UNORM16 | _FLOAT,
    ),
    "webgpu": replace(
        _device("webgpu"),
        max_texture_size=8192,
        max_texture_layers=256,
        max_uniform_bytes=1 << 16,
        max_image_slots=4,
        max_work_group=(256, 256, 64),
        max_work_group_invocations=256,
        max_shared_bytes=16384,
        max_anisotropy=16.0,
        max_target_bytes=32,
        max_uniform_slots=8,
        sample_counts=(1, 4),
        copy_alignment=4,
        copy_row_alignment=256,
        vertex_alignment=4,
        compressed_size_step=4,
        indirect_count=True,
        alpha_test=True,
        depth_bias_clamp=True,
        blend_per_target=True,
        conditional_rendering=False,
        timestamps=False,
        stencil_per_face=False,
        precise_triangles=False,
        precise_clipping=False,
        precise_lines=False,
        border_colors=False,
        draw_index=False,
        early_depth=False,
        vertex_writes=False,
        aliased_writes=False,
        resolve_feedback=False,
        unsupported_formats=webgpu_formats.UNSUPPORTED,
        unrenderable_formats=webgpu_formats.UNRENDERABLE,
        unfilterable_formats=FLOAT32_FORMATS,
        unblendable_formats=FLOAT32_FORMATS,
        unresolvable_formats=webgpu_formats.UNRESOLVABLE,
        single_sampled_formats=webgpu_formats.SINGLE_SAMPLED,
        unstorable_formats=webgpu_formats.UNSTORABLE,
        unloadable_formats=webgpu_formats.UNLOADABLE,
    ),
    "opencl-cpu": replace(
        _device("opencl-cpu"),
        sample_counts=(1,),
        max_uniform_bytes=1 << 16,
        max_work_group=(4096, 4096, 4096),
        max_work_group_invocations=4096,
        max_dispatch_groups=(1 << 31) - 1,
        uniform_alignment=128,
        storage_alignment=128,
        sample_counter=True,
        conditional_rendering=False,
        alpha_to_coverage=False,
    ),
}
"""Capabilities by profile name. `everything` is the default of a null device."""


def get_profile(profile: str | Capabilities) -> Capabilities:
    """Return a profile by its name, or adapt other capabilities to a null device, which never runs shaders.

    Raises:
        ValidationError: `device-argument` for an unknown name.
    """
    if isinstance(profile, Capabilities):
        return replace(profile, backend="null", shading=False)
    capabilities = PROFILES.get(profile) if isinstance(profile, str) else None
    if capabilities is None:
        from difflib import get_close_matches  # which only errors need

        close = get_close_matches(str(profile), PROFILES, 1)
        tip = f"did you mean {close[0]!r}?" if close else ""
        allowed = f"{', '.join(PROFILES)}, or a Capabilities"
        refuse(DEVICE_ARGUMENT, "profile=", repr(profile), allowed, tip)
    return capabilities
