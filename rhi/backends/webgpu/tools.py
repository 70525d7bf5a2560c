"""The backend's own programs, for copies that WebGPU lacks.

- Depth is read by a compute stage, since copies of 24-bit depth don't exist; stencil too.
- A part of a depth texture is copied by drawing it. Stencil has no output, so it is drawn bit by bit: bits
  are zeroed, then replaced where a fragment finds a one.
- Mip levels are drawn from the level above, if the format can be drawn to; images are drawn to windows.
- Arguments of indirect draws are listed tightly, with no instances beyond the count.
- Indices of quads are expanded to triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.webgpu.implementation import GpuObject
from rhi.backends.webgpu.webgpu_buffers import Buffers
from rhi.backends.webgpu.webgpu_flags import GpuBufferUsage
from rhi.contract.descriptors import Region
from rhi.contract.interrupts import DeferredInterrupts

DEPTH_READ: Final = """
@group(0) @binding(0) var source: texture_depth_2d_array;
@group(0) @binding(1) var<storage, read_write> out: array<f32>;
@group(0) @binding(2) var<uniform> p: array<vec4<u32>, 2>;  // x, y, width, height; first word, words of a row
@compute @workgroup_size(8, 8) fn main(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= p[0].z || id.y >= p[0].w) { return; }
  out[p[1].x + (id.z * p[0].w + id.y) * p[1].y + id.x] = textureLoad(source, vec2<i32>(p[0].xy + id.xy), i32(id.z), 0);
}
"""
STENCIL_READ: Final = (
    DEPTH_READ.replace("texture_depth_2d_array", "texture_2d_array<u32>")
    .replace("array<f32>", "array<u32>")
    .replace("i32(id.z), 0)", "i32(id.z), 0).x")
)
_TRIANGLE: Final = """
@vertex fn vs(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(i32(i & 1u) * 4 - 1), f32(i32(i >> 1u) * 4 - 1), 0.0, 1.0);
}
"""
_DEPTH_COPY: Final = f"""
@group(0) @binding(0) var source: texture_depth_2d;
@group(0) @binding(1) var<uniform> p: vec4<i32>;  // the way from the target to the source
{_TRIANGLE}
@fragment fn fs(@builtin(position) at: vec4<f32>) -> @builtin(frag_depth) f32 {{
  return textureLoad(source, vec2<i32>(at.xy) + p.xy, 0);
}}
"""
_STENCIL_COPY: Final = f"""
@group(0) @binding(0) var source: texture_2d<u32>;
@group(0) @binding(1) var<uniform> p: vec4<i32>;  // the way to the source, the bit, whether it is set everywhere
{_TRIANGLE}
@fragment fn fs(@builtin(position) at: vec4<f32>) {{
  if (((textureLoad(source, vec2<i32>(at.xy) + p.xy, 0).x & u32(p.z)) | u32(p.w)) == 0u) {{ discard; }}
}}
"""
_HALVE: Final = f"""
@group(0) @binding(0) var source: texture_2d<f32>;
{_TRIANGLE}
fn taps(at: u32, size: u32) -> vec3<f32> {{  // weights of the texels from 2 at on: a box as wide as the target's texel
  if (size == 1u) {{ return vec3<f32>(1.0, 0.0, 0.0); }}
  if (size % 2u == 0u) {{ return vec3<f32>(0.5, 0.5, 0.0); }}
  let half = size / 2u;
  return vec3<f32>(f32(half - at), f32(half), f32(at + 1u)) / f32(size);
}}
@fragment fn fs(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {{
  let size = textureDimensions(source);
  let to = vec2<u32>(at.xy);
  let across = taps(to.x, size.x);
  let down = taps(to.y, size.y);
  var sum = vec4<f32>();
  for (var y = 0u; y < 3u; y++) {{
    for (var x = 0u; x < 3u; x++) {{
      let weight = across[x] * down[y];
      if (weight > 0.0) {{ sum += weight * textureLoad(source, vec2<i32>(2u * to + vec2<u32>(x, y)), 0); }}
    }}
  }}
  return sum;
}}
"""
_BLIT: Final = f"""
@group(0) @binding(0) var source: texture_2d<f32>;
@group(0) @binding(1) var<uniform> p: vec4<u32>;  // the target's size
{_TRIANGLE}
@fragment fn fs(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {{
  let texel = vec2<f32>(textureDimensions(source)) * at.xy / vec2<f32>(p.xy);
  return vec4<f32>(textureLoad(source, vec2<i32>(texel), 0).rgb, 1.0);
}}
"""
LIST_DRAWS: Final = """
@group(0) @binding(0) var<storage, read> source: array<u32>;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> out: array<u32>;
@group(0) @binding(3) var<uniform> p: array<vec4<u32>, 2>;  // offset, stride, draws, words; the count's index, if any
@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= p[0].z) { return; }
  let keep = p[1].y == 0u || id.x < counts[p[1].x];
  for (var i = 0u; i < p[0].w; i++) {
    out[id.x * p[0].w + i] = select(source[p[0].x + id.x * p[0].y + i], 0u, i < 2u && !keep);
  }
}
"""
_QUADS: Final = """
@group(0) @binding(0) var<storage, read> source: array<u32>;
@group(0) @binding(1) var<storage, read_write> out: array<u32>;
@group(0) @binding(2) var<uniform> p: vec4<u32>;  // the first index, how many, whether they have 16 bits
@group(0) @binding(3) var<storage, read_write> restarts: atomic<u32>;  // whether one of them restarts
fn index_of(i: u32) -> u32 {
  let at = p.x + i;
  if (p.z == 0u) { return source[at]; }
  return (source[at / 2u] >> (16u * (at % 2u))) & 0xffffu;
}
fn write_quad(at: u32, corners: vec4<u32>) {
  out[at] = corners.x;
  out[at + 1u] = corners.y;
  out[at + 2u] = corners.z;
  out[at + 3u] = corners.x;
  out[at + 4u] = corners.z;
  out[at + 5u] = corners.w;
}
fn is_restart(index: u32) -> bool { return index == select(0xffffffffu, 0xffffu, p.z != 0u); }
"""
EXPAND_QUADS: Final = (
    _QUADS
    + """
@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3<u32>) {
  let begin = 4u * id.x;
  var corners = vec4<u32>();
  for (var i = 0u; i < 4u && begin + i < p.y; i++) {
    corners[i] = index_of(begin + i);
    if (is_restart(corners[i])) { atomicStore(&restarts, 1u); }
  }
  if (begin + 4u <= p.y) { write_quad(6u * id.x, corners); }
}
"""
)
"""Writes the triangles of quads that begin at every fourth index, and whether an index restarts."""
RESTART_QUADS: Final = (
    _QUADS
    + """
@compute @workgroup_size(1) fn main() {
  if (atomicLoad(&restarts) == 0u) { return; }
  var corners = vec4<u32>();
  var corner = 0u;
  var end = 0u;
  for (var i = 0u; i < p.y; i++) {
    let index = index_of(i);
    if (is_restart(index)) {
      corner = 0u;
    } else {
      corners[corner] = index;
      corner++;
      if (corner == 4u) {
        write_quad(end, corners);
        end += 6u;
        corner = 0u;
      }
    }
  }
  for (; end < p.y / 4u * 6u; end++) { out[end] = 0u; }
}
"""
)
"""Writes them again if an index restarts: quads then begin anywhere. What remains are triangles without
area."""


class Tools:
    """The programs, made on first use."""

    def __init__(self, device: GpuObject, buffers: Buffers) -> None:
        self.device = device
        self.buffers = buffers
        self._cache: dict[object, Any] = {}

    def get_or_create(self, key: object, make: Callable[[], Any]) -> Any:
        """Return the tool of this key, making it on first use."""
        if key not in self._cache:
            self._cache[key] = make()
        return self._cache[key]

    def constants(self, values: Sequence[int], kind: type[np.generic] = np.uint32) -> dict[str, GpuObject]:
        """Return constants as the resource of a group."""
        return {"buffer": self.buffers.filled(np.array(values, kind), GpuBufferUsage.UNIFORM)}

    def group(self, pipeline: GpuObject, resources: Sequence[object]) -> GpuObject:
        """Return a bind group with these resources."""
        entries = [{"binding": number, "resource": resource} for number, resource in enumerate(resources)]
        return self.device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)

    def compute(
        self, encoder: GpuObject, code: str, resources: Sequence[object], x: int, y: int = 1, z: int = 1
    ) -> None:
        """Run the compute program of this text on `x * y * z` work-groups."""
        pipeline = self.get_or_create(code, lambda: self._compute_pipeline(code))
        group = self.group(pipeline, resources)
        with DeferredInterrupts():  # a pass that isn't ended locks the encoder
            compute = encoder.begin_compute_pass()
            compute.set_pipeline(pipeline)
            compute.set_bind_group(0, group)
            compute.dispatch_workgroups(x, y, z)
            compute.end()

    def _compute_pipeline(self, code: str) -> GpuObject:
        module = self.device.create_shader_module(code=code)
        return self.device.create_compute_pipeline(
            layout="auto", compute={"module": module, "entry_point": "main"}
        )

    def halve(self, encoder: GpuObject, form: str, source: GpuObject, target: GpuObject) -> None:
        """Draw a level of a texture from the view of the one above."""
        self._draw(encoder, _HALVE, form, [source], target)

    def blit(self, encoder: GpuObject, source: GpuObject, target: GpuObject) -> None:
        """Draw a view over the whole of a texture of any size, opaque."""
        size = self.constants([*target.size[:2], 0, 0])
        self._draw(encoder, _BLIT, target.format, [source, size], target.create_view())

    def _draw(
        self, encoder: GpuObject, code: str, form: str, resources: Sequence[object], target: GpuObject
    ) -> None:
        pipeline = self.get_or_create(
            (code, form), lambda: self._render_pipeline(code, [{"format": form}], None)
        )
        color = {"view": target, "load_op": "clear", "store_op": "store"}
        group = self.group(pipeline, resources)
        with DeferredInterrupts():
            render = encoder.begin_render_pass(color_attachments=[color])
            render.set_pipeline(pipeline)
            render.set_bind_group(0, group)
            render.draw(3)
            render.end()

    def _render_pipeline(
        self, code: str, targets: Sequence[Any], depth: Mapping[str, Any] | None
    ) -> GpuObject:
        module = self.get_or_create(("module", code), lambda: self.device.create_shader_module(code=code))
        return self.device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "vs"},
            fragment={"module": module, "entry_point": "fs", "targets": targets},
            depth_stencil=depth,
        )

    def draw_depth(
        self,
        encoder: GpuObject,
        form: str,
        source: GpuObject,
        stencil: GpuObject | None,
        target: GpuObject,
        region: Region,
        x: int,
        y: int,
    ) -> None:
        """Copy a region of a depth texture to another by drawing it; with a view of its stencil, also
        that."""
        info = {"view": target, "depth_load_op": "load", "depth_store_op": "store"}
        if stencil is not None:
            info |= {"stencil_load_op": "load", "stencil_store_op": "store"}
        with DeferredInterrupts():
            render = encoder.begin_render_pass(color_attachments=[], depth_stencil_attachment=info)
            try:
                render.set_scissor_rect(x, y, region.width, region.height)
                self._draw_depth(render, form, source, stencil, (region.x - x, region.y - y))
            finally:
                render.end()

    def _draw_depth(
        self, render: GpuObject, form: str, source: GpuObject, stencil: GpuObject | None, way: tuple[int, int]
    ) -> None:
        def draw(pipeline: GpuObject, view: GpuObject, bit: int, everywhere: int) -> None:
            render.set_pipeline(pipeline)
            render.set_bind_group(
                0, self.group(pipeline, [view, self.constants([*way, bit, everywhere], np.int32)])
            )
            render.draw(3)

        draw(self.get_or_create(("depth", form), lambda: self._depth_pipeline(form)), source, 0, 0)
        if stencil is not None:
            render.set_stencil_reference(255)
            for bit in (1 << bit_index for bit_index in range(8)):
                for operation, everywhere in (("zero", 1), ("replace", 0)):
                    key = ("stencil", form, bit, operation)
                    make = lambda bit=bit, operation=operation: self._stencil_pipeline(form, bit, operation)  # noqa: E731
                    draw(self.get_or_create(key, make), stencil, bit, everywhere)

    def _depth_pipeline(self, form: str) -> GpuObject:
        depth = {"format": form, "depth_write_enabled": True, "depth_compare": "always"}
        return self._render_pipeline(_DEPTH_COPY, [], depth)

    def _stencil_pipeline(self, form: str, bit: int, operation: str) -> GpuObject:
        face = {"compare": "always", "pass_op": operation, "fail_op": "keep", "depth_fail_op": "keep"}
        depth = {
            "format": form,
            "depth_write_enabled": False,
            "depth_compare": "always",
            "stencil_front": face,
            "stencil_back": face,
            "stencil_write_mask": bit,
        }
        return self._render_pipeline(_STENCIL_COPY, [], depth)


def expand_fan(indices: NDArray[np.generic], restart: int | None) -> NDArray[np.uint32]:
    """Expand triangle fans to indices of triangles (n, 3). The first vertex of each provides flat varyings.

    Args:
        restart: the index that begins a new fan.
    """
    parts = [indices]
    if restart is not None:
        parts = np.split(indices, np.nonzero(indices == restart)[0])
        parts = [part[part != restart] for part in parts]
    triangles = [
        np.stack([part[1:-1], part[2:], np.full(len(part) - 2, part[0])], 1)
        for part in parts
        if len(part) > 2
    ]
    return np.concatenate(triangles).astype(np.uint32) if triangles else np.zeros((0, 3), np.uint32)
