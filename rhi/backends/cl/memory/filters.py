"""Kernels that average texels in linear light: mip level generation and multi-sample resolve.

- One program serves all formats: the storage type of a channel is a kernel argument, uniform over all
  work-items, so nothing is compiled per format.
- sRGB is converted by tables, since PoCL's pow takes 100 ns.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.planes import TexelPlane
from rhi.backends.cl.pocl.program_residency import EvictableProgram
from rhi.contract.formats import Format
from rhi.contract.texels import from_srgb
from rhi.shading.ir.texture_words import ChannelEncoding, channel_encoding

_SOURCE: Final = """
enum { STORED_VALUES };  // the storage types of a channel; from UNORM10 on they are packed

// sRGB: the linear value of each stored number, and the thresholds between consecutive numbers.
__constant float LINEAR[256] = {LINEAR_VALUES};
__constant float EDGES[255] = {EDGE_VALUES};

uchar to_srgb(float value) {
    int place = 0;
    for (int step = 128; step > 0; step /= 2)
        if (EDGES[place + step - 1] <= value) place += step;
    return place;
}

// A packed texel is one element of memory: channel c begins at bit 10 c or 11 c.
uint channel_bits(int stored, int channel) {
    return stored == UNORM10 && channel == 3 ? 2 : stored == UFLOAT11 && channel < 2 ? 11 : 10;
}
int channel_start(int stored, int channel) { return channel * (stored == UNORM10 ? 10 : 11); }

float load_packed(uint texel, int stored, int channel) {
    uint bits = channel_bits(stored, channel), number = texel >> channel_start(stored, channel) & ((1u << bits) - 1u);
    if (stored == UNORM10) return number / (float)((1u << bits) - 1u);
    uint fraction = bits - 5u, word = number << (23u - fraction);
    return number >> fraction == 31u ? as_float(word | 0x7F800000u) : as_float(word) * 0x1p112f;
}

uint make_packed(float value, int stored, int channel) {
    uint bits = channel_bits(stored, channel), fraction = bits - 5u, shift = 23u - fraction, word = as_uint(value);
    if (stored == UNORM10) return value * ((1u << bits) - 1u) + 0.5f;
    if (word >= 0x7F800000u) return 31u << fraction | (word > 0x7F800000u);
    if (word < 0x38800000u) return as_uint(value + 512.0f / (1u << fraction)) - as_uint(512.0f / (1u << fraction));
    return (word - 0x38000000u + ((1u << (shift - 1u)) - 1u) + (word >> shift & 1u)) >> shift;
}

float load(__global const void *texels, size_t place, int stored, int channel) {
    switch (stored) {
    case UNORM10:
    case UFLOAT11: return load_packed(((__global const uint *)texels)[place], stored, channel);
    case UNORM8: return ((__global const uchar *)texels)[place] * (1.0f / 255.0f);
    case UNORM16: return ((__global const ushort *)texels)[place] * (1.0f / 65535.0f);
    case SNORM8: return max(((__global const char *)texels)[place] * (1.0f / 127.0f), -1.0f);
    case SRGB8: return LINEAR[((__global const uchar *)texels)[place]];
    case HALF: return vload_half(place, (__global const half *)texels);
    default: return ((__global const float *)texels)[place];
    }
}

// A mean lies between the loaded values, so it needs no clamping.
void store(__global void *texels, size_t place, int stored, int channel, float value) {
    switch (stored) {
    case UNORM10:
    case UFLOAT11: {  // channels are stored in order
        __global uint *texel = (__global uint *)texels + place;
        *texel = (channel ? *texel : 0u) | make_packed(value, stored, channel) << channel_start(stored, channel);
        break;
    }
    case UNORM8: ((__global uchar *)texels)[place] = value * 255.0f + 0.5f; break;
    case UNORM16: ((__global ushort *)texels)[place] = value * 65535.0f + 0.5f; break;
    case SNORM8: ((__global char *)texels)[place] = floor(value * 127.0f + 0.5f); break;
    case SRGB8: ((__global uchar *)texels)[place] = to_srgb(value); break;
    case HALF: vstore_half_rte(value, place, (__global half *)texels); break;
    default: ((__global float *)texels)[place] = value;
    }
}

// The storage type of a channel: alpha is linear in sRGB formats.
int channel_type(int stored, int channel) { return stored == SRGB8 && channel == 3 ? UNORM8 : stored; }

// Returns how many texels along an axis a texel of the next level covers (2, or 3 for an odd size), and their weights.
int taps(int place, int size, int target, float *weights) {
    if (size == target) { weights[0] = 1.0f; return 1; }
    if (size % 2 == 0) { weights[0] = weights[1] = 0.5f; return 2; }
    weights[0] = (float)(target - place) / size;
    weights[1] = (float)target / size;
    weights[2] = (float)(place + 1) / size;
    return 3;
}

// Each work-item computes a row of the next level. `from` and `to` hold a level's start, row pitch and layer pitch,
// in elements: channels, or packed texels.
__kernel void halve(__global void *texels, ulong4 from, ulong4 to, int stored, int channels, int4 size, int4 target) {
    int y = get_global_id(0), z = get_global_id(1), packed = stored >= UNORM10, elements = packed ? 1 : channels;
    float u[3], v[3], w[3];
    int rows = taps(y, size.y, target.y, v), layers = taps(z, size.z, target.z, w);
    int top = rows == 1 ? y : 2 * y, first = layers == 1 ? z : 2 * z;
    size_t row = from.y, layer = from.z;
    size_t source = from.x + first * layer + top * row;
    size_t result = to.x + z * to.z + y * to.y;
    if (layers == 1 && rows == 2 && size.x == 2 * target.x && size.y % 2 == 0) {  // the usual 2 by 2 texels
        for (int x = 0; x < target.x; ++x)
            for (int channel = 0; channel < channels; ++channel) {
                int format = channel_type(stored, channel), element = packed ? 0 : channel;
                size_t above = source + 2 * x * elements + element, below = above + row;
                float mean = load(texels, above, format, channel) + load(texels, above + elements, format, channel);
                mean += load(texels, below, format, channel) + load(texels, below + elements, format, channel);
                mean *= 0.25f;
                store(texels, result + x * elements + element, format, channel, mean);
            }
        return;
    }
    for (int x = 0; x < target.x; ++x) {
        int columns = taps(x, size.x, target.x, u), left = columns == 1 ? x : 2 * x;
        for (int channel = 0; channel < channels; ++channel) {
            int format = channel_type(stored, channel), element = packed ? 0 : channel;
            float mean = 0.0f;
            for (int k = 0; k < layers; ++k)
                for (int j = 0; j < rows; ++j)
                    for (int i = 0; i < columns; ++i) {
                        size_t place = source + k * layer + j * row + (left + i) * elements + element;
                        mean += w[k] * v[j] * u[i] * load(texels, place, format, channel);
                    }
            store(texels, result + x * elements + element, format, channel, mean);
        }
    }
}

// Each work-item resolves one element: a channel, or a packed texel. The samples are consecutive planes.
__kernel void resolve(__global const void *samples, __global void *texels, int stored, int channels, int count) {
    size_t place = get_global_id(0), plane = get_global_size(0);
    int packed = stored >= UNORM10, first = packed ? 0 : place % channels, last = packed ? channels - 1 : first;
    for (int channel = first; channel <= last; ++channel) {
        int format = channel_type(stored, channel);
        // Two sums, each of at most four: equal samples have exactly their mean.
        float sum = 0.0f, other = 0.0f;
        for (int sample = 0, apart = count / 2; sample < apart; ++sample) {
            sum += load(samples, sample * plane + place, format, channel);
            other += load(samples, (sample + apart) * plane + place, format, channel);
        }
        store(texels, place, format, channel, (sum + other) / count);
    }
}
"""

_ROW_GROUP: Final = (1, 1)
"""The work-group of `halve`. PoCL generates machine code for each size of work-groups, a quarter of a second
for this kernel, and would choose another size for each level."""


class Filters:
    """The averaging kernels of one device, built on first use."""

    def __init__(self, context: ClContext) -> None:
        self._context = context
        self._program: EvictableProgram | None = None

    def halve(self, format: Format, above: TexelPlane, below: TexelPlane) -> None:
        """Compute the mip level `below` from the next larger one, in the same buffer."""
        planes = (above, below)
        layouts = [
            np.array([plane.start, plane.pitch, plane.layer_bytes, 0], np.uint64)
            // np.uint64(format.dtype.itemsize)
            for plane in planes
        ]
        sizes = [np.array([plane.width, plane.height, plane.layers, 0], np.int32) for plane in planes]
        self._run(
            "halve",
            (below.height, below.layers),
            _ROW_GROUP,
            above.memory,
            *layouts,
            np.int32(channel_encoding(format)),
            np.int32(format.channels),
            *sizes,
        )

    def resolve(self, format: Format, samples: TexelPlane, texels: TexelPlane) -> None:
        """Resolve each texel to the mean of its samples, or for integer formats its first sample. Samples are
        layers. Both planes have the same size, so the padding is resolved along with them."""
        if format.is_integer:
            size = texels.layer_bytes
            cl.enqueue_copy(self._context.queue, texels.memory, samples.memory, byte_count=size)
            return
        self._run(
            "resolve",
            (texels.layer_bytes // format.dtype.itemsize,),
            None,
            samples.memory,
            texels.memory,
            np.int32(channel_encoding(format)),
            np.int32(format.channels),
            np.int32(samples.layers),
        )

    def _run(self, name: str, size: tuple[int, ...], group: tuple[int, ...] | None, *arguments: Any) -> None:
        with translate_errors("the kernels of mip levels and resolves"):
            if self._program is None:
                self._program = self._context.compile(_write_source())
            kernel = self._program.find(name)
        kernel.set_args(*arguments)
        cl.enqueue_nd_range_kernel(self._context.queue, kernel, size, group)


def _write_source() -> str:
    numbers = {"LINEAR_VALUES": np.arange(256.0), "EDGE_VALUES": np.arange(255) + 0.5}
    types = ", ".join(f"{stored.name} = {stored}" for stored in ChannelEncoding)
    source = _SOURCE.replace("STORED_VALUES", types)
    for name, stored in numbers.items():
        values = from_srgb(np.asarray(stored / 255.0, np.float64)).astype(np.float32).tolist()
        source = source.replace(name, ", ".join(f"{value!r}f" for value in values))
    return source
