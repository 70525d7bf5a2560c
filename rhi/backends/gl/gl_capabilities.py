"""The capabilities of a context. Limits are queried; formats are tested by creating textures and
framebuffers."""

from __future__ import annotations

import ctypes
from collections.abc import Container, Sequence
from typing import Final

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_formats import PIXEL_FORMATS
from rhi.backends.gl.platform_states import DepthClamp
from rhi.contract.backend import SAMPLE_COUNTS, Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.driver_faults import limit_anisotropy
from rhi.contract.formats import COLOR_FORMATS, Format
from rhi.contract.states import MAX_TARGETS

_PROBE_SIZE: Final = 4
_MAX_SAMPLE_COUNTS: Final = 16


def query_capabilities(gl: EntryPoints, version: int, extensions: Container[str]) -> Capabilities:
    """Return the capabilities of the current context; `version` is 450 for GL 4.5."""

    def has(extension: str) -> bool:
        return version >= 460 or extension in extensions

    def smallest(*names: int) -> int:
        return min(map(gl.get_integer, names))

    unsupported, unrenderable = _probe_formats(gl)
    timestamp_bits = ctypes.c_int()
    gl.GetQueryiv(enums.TIMESTAMP, enums.QUERY_COUNTER_BITS, ctypes.byref(timestamp_bits))
    most_samples = smallest(enums.MAX_COLOR_TEXTURE_SAMPLES, enums.MAX_DEPTH_TEXTURE_SAMPLES)
    samples = _query_samples(gl, [f for f in Format if f not in unrenderable]) & {*range(most_samples + 1)}
    groups = [gl.get_integer(enums.MAX_COMPUTE_WORK_GROUP_SIZE, axis) for axis in range(3)]
    dispatches = [gl.get_integer(enums.MAX_COMPUTE_WORK_GROUP_COUNT, axis) for axis in range(3)]
    device = gl.GetString(enums.RENDERER).decode()
    driver = "OpenGL " + gl.GetString(enums.VERSION).decode()
    has_anisotropy = has("GL_EXT_texture_filter_anisotropic")
    anisotropy, disabled_features = limit_anisotropy(
        device, driver, gl.get_float(enums.MAX_TEXTURE_MAX_ANISOTROPY) if has_anisotropy else 1.0
    )
    return Capabilities(
        backend="gl",
        device=device,
        driver=driver,
        max_texture_size=gl.get_integer(enums.MAX_TEXTURE_SIZE),
        max_texture_layers=smallest(enums.MAX_ARRAY_TEXTURE_LAYERS, enums.MAX_3D_TEXTURE_SIZE),
        max_volume_size=gl.get_integer(enums.MAX_3D_TEXTURE_SIZE),
        max_color_targets=min(smallest(enums.MAX_DRAW_BUFFERS, enums.MAX_COLOR_ATTACHMENTS), MAX_TARGETS),
        sample_counts=tuple(count for count in SAMPLE_COUNTS if count == 1 or count in samples),
        max_vertex_attributes=gl.get_integer(enums.MAX_VERTEX_ATTRIBS),
        max_vertex_stride=gl.get_integer(enums.MAX_VERTEX_ATTRIB_STRIDE),
        max_varyings=gl.get_integer(enums.MAX_VARYING_VECTORS) - 1,
        max_uniform_bytes=gl.get_integer(enums.MAX_UNIFORM_BLOCK_SIZE),
        max_storage_bytes=gl.get_integer(enums.MAX_SHADER_STORAGE_BLOCK_SIZE),
        max_uniform_slots=smallest(
            enums.MAX_VERTEX_UNIFORM_BLOCKS,
            enums.MAX_FRAGMENT_UNIFORM_BLOCKS,
            enums.MAX_COMPUTE_UNIFORM_BLOCKS,
        ),
        max_storage_slots=smallest(
            enums.MAX_FRAGMENT_SHADER_STORAGE_BLOCKS, enums.MAX_COMPUTE_SHADER_STORAGE_BLOCKS
        ),
        max_texture_slots=smallest(
            enums.MAX_VERTEX_TEXTURE_IMAGE_UNITS,
            enums.MAX_TEXTURE_IMAGE_UNITS,
            enums.MAX_COMPUTE_TEXTURE_IMAGE_UNITS,
        ),
        max_image_slots=smallest(
            enums.MAX_FRAGMENT_IMAGE_UNIFORMS, enums.MAX_COMPUTE_IMAGE_UNIFORMS, enums.MAX_IMAGE_UNITS
        ),
        max_work_group=(groups[0], groups[1], groups[2]),
        max_work_group_invocations=gl.get_integer(enums.MAX_COMPUTE_WORK_GROUP_INVOCATIONS),
        max_dispatch=(dispatches[0], dispatches[1], dispatches[2]),
        max_shared_bytes=gl.get_integer(enums.MAX_COMPUTE_SHARED_MEMORY_SIZE),
        max_anisotropy=anisotropy,
        disabled_features=disabled_features,
        uniform_alignment=gl.get_integer(enums.UNIFORM_BUFFER_OFFSET_ALIGNMENT),
        storage_alignment=gl.get_integer(enums.SHADER_STORAGE_BUFFER_OFFSET_ALIGNMENT),
        indirect_count="GL_ARB_indirect_parameters" in extensions,
        sample_counter=True,
        texture_buffer_copies=True,
        max_point_size=_largest(gl, enums.POINT_SIZE_RANGE),
        max_line_width=_largest(gl, enums.ALIASED_LINE_WIDTH_RANGE),
        layered_rendering="GL_ARB_shader_viewport_layer_array" in extensions,
        wireframe=True,
        platform_states=frozenset({DepthClamp}),
        compressed_formats=_list_compressed_formats(extensions),
        timestamps=timestamp_bits.value > 0,
        alpha_test=True,
        depth_bias_clamp=has("GL_ARB_polygon_offset_clamp"),
        precise_triangles=False,  # GL promises neither; docs/backends-gl.md has llvmpipe's worst cases
        precise_clipping="llvmpipe" in device,  # GL promises it, but NVIDIA's driver doesn't keep it
        unsupported_formats=unsupported,
        unrenderable_formats=unrenderable,
    )


def _query_samples(gl: EntryPoints, formats: Sequence[Format]) -> set[int]:
    """Return the sample counts that textures of all formats support.

    GL rounds other counts up: llvmpipe uses 4 for 2, and queries then count twice as many samples."""
    common: set[int] | None = None
    count, counts = ctypes.c_int(), (ctypes.c_int * _MAX_SAMPLE_COUNTS)()
    for texel in formats:
        query = enums.TEXTURE_2D_MULTISAMPLE, PIXEL_FORMATS[texel].internal
        gl.GetInternalformativ(*query, enums.NUM_SAMPLE_COUNTS, 1, ctypes.byref(count))
        gl.GetInternalformativ(*query, enums.SAMPLES, _MAX_SAMPLE_COUNTS, ctypes.byref(counts))
        reported = set(counts[: min(count.value, _MAX_SAMPLE_COUNTS)])
        common = reported if common is None else common & reported
    return common or set()


def _list_compressed_formats(extensions: Container[str]) -> frozenset[CompressedFormat]:
    """Return the compressed formats: RGTC and BPTC are part of OpenGL 4.2, S3TC is an extension."""
    has_s3tc = "GL_EXT_texture_compression_s3tc" in extensions
    has_srgb = has_s3tc and (
        "GL_EXT_texture_sRGB" in extensions or "GL_EXT_texture_compression_s3tc_srgb" in extensions
    )
    lacking = {format for format in CompressedFormat if format.name.startswith(("BC1", "BC2", "BC3"))}
    if has_s3tc:
        lacking = {format for format in lacking if format.name.endswith("_SRGB") and not has_srgb}
    return frozenset(CompressedFormat) - lacking


def _largest(gl: EntryPoints, range_of_sizes: int) -> float:
    """Return the upper end of a range of sizes in texels."""
    sizes = (ctypes.c_float * 2)()
    gl.GetFloatv(range_of_sizes, sizes)
    return max(1.0, sizes[1])


def _probe_formats(gl: EntryPoints) -> tuple[frozenset[Format], frozenset[Format]]:
    """Try each format; return those that textures don't support, and those that color targets don't
    support."""
    unsupported, unrenderable = set(), set()
    framebuffer = gl.create(gl.CreateFramebuffers)
    for texel in Format:
        texture = gl.create(gl.CreateTextures, enums.TEXTURE_2D)
        gl.TextureStorage2D(texture, 1, PIXEL_FORMATS[texel].internal, _PROBE_SIZE, _PROBE_SIZE)
        if gl.GetError() != enums.NO_ERROR:
            unsupported.add(texel)
        elif texel in COLOR_FORMATS:
            gl.NamedFramebufferTexture(framebuffer, enums.COLOR_ATTACHMENT0, texture, 0)
            status = gl.CheckNamedFramebufferStatus(framebuffer, enums.FRAMEBUFFER)
            if status != enums.FRAMEBUFFER_COMPLETE:
                unrenderable.add(texel)
        gl.delete(gl.DeleteTextures, texture)
    gl.delete(gl.DeleteFramebuffers, framebuffer)
    return frozenset(unsupported), frozenset(unsupported | unrenderable)
