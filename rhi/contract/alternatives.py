"""Alternatives to a capability that a device lacks: the tips of the rules `device-capability` and
`state-capability`.

A row belongs to a field of `Capabilities`. Each alternative works on every device of the profile `webgpu`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_ANOTHER_FORMAT: Final = "choose a format that this field of device.capabilities doesn't list"

ALTERNATIVES: Final[Mapping[str, str]] = {
    "max_texture_size": "draw to tiles, each with a projection of its own",
    "max_texture_layers": "spread the layers over several textures, or over an atlas",
    "max_color_targets": "draw to the other targets in a second pass",
    "max_target_bytes": "use narrower formats, or draw to some targets in a second pass",
    "max_varyings": "put several numbers into one vec4",
    "max_vertex_stride": "put fields that this program doesn't read into another mesh",
    "vertex_alignment": "add padding fields, or align the dtype: np.dtype(…, align=True)",
    "max_vertex_attributes": "read attributes from a Storage binding by vertex_index()",
    "max_uniform_slots": "put several structs into one, or into a Storage array",
    "max_storage_slots": "put several arrays into one, each at an offset of its own",
    "max_texture_slots": "put several textures into a 2D array, one in each layer",
    "max_image_slots": "put several images into a 2D array, or dispatch several times",
    "max_work_group": "use a smaller work_group and dispatch more of them",
    "max_shared_bytes": "share fewer bytes, or use a Storage buffer",
    "max_anisotropy": "use mip levels with Filter.LINEAR, which needs no anisotropy",
    "max_point_size": "draw points as quads: an instance for each point, its corner from vertex_index()",
    "max_line_width": "draw lines as quads: an instance for each line, its corner from vertex_index()",
    "compute": "compute in a fragment stage and draw the result to a texture, or use another backend",
    "draws": "use another backend for draws: this device only computes",
    "indirect_count": "draw all slots of the list: those whose count of vertices is 0 draw nothing",
    "occlusion_queries": "use device.occlusion_query(emulated=True) where capabilities.sample_counter is True",
    "sample_counter": "use device.occlusion_query(), or compare depth in a compute stage",
    "conditional_rendering": "read the query and branch, or draw indirectly with counts from a compute stage",
    "timestamps": "measure with time.perf_counter() around device.finish()",
    "stencil": "draw the mask to a texture, and read it in the fragment stage",
    "stencil_per_face": "draw twice, with front faces culled and then back faces",
    "alpha_test": "call discard() in the fragment stage",
    "alpha_to_coverage": "call discard() in the fragment stage, or blend sorted surfaces",
    "depth_bias_clamp": "use PolygonOffset without a clamp, and a smaller slope",
    "blend_per_target": "draw targets that blend differently in passes of their own",
    "layered_rendering": "draw a pass for each layer: texture.at(layer=…)",
    "wireframe": "draw the edges with Primitive.LINES and indices of their ends",
    "draw_index": "give each draw a base_instance, and read the index from an instance attribute",
    "early_depth": "draw depth first, and return early where fragment_coordinate().z lies behind the depth texture",
    "aliased_writes": "copy what is read first: buffer.copy_to(…), texture.copy_to(…)",
    "resolve_feedback": "resolve to another texture, or read it after the pass",
    "vertex_writes": "write the memory in a compute stage before the draw",
    "border_colors": "use Wrap.CLAMP, and select the border's color where a coordinate is below 0 or above 1",
    "texture_buffer_copies": "copy in a compute stage that loads texels and stores them in the buffer",
    "compressed_formats": "decompress on the CPU: device.texture(…) of the texels",
    "unsupported_formats": _ANOTHER_FORMAT,
    "unrenderable_formats": _ANOTHER_FORMAT,
    "unfilterable_formats": f"{_ANOTHER_FORMAT}, or use Filter.NEAREST",
    "unblendable_formats": f"{_ANOTHER_FORMAT}, or blend in the shader",
    "single_sampled_formats": f"{_ANOTHER_FORMAT}, or draw at twice the size",
    "unresolvable_formats": "read each sample of a Texture2DSamples in a fragment stage",
    "unloadable_formats": "keep the numbers in a StorageRW buffer, or load from a copy of the image",
    "unstorable_formats": "store to a StorageRW buffer, or choose R32F, R32I or R32UI",
}
"""By the name of a field of `Capabilities`."""
