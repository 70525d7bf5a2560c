// The output merger: tests, blends and writes a block of shaded fragments to the targets of a pass.
//
// - A block is 4×4 texels in 16 lanes, lane = x + 4 y. A mask is an int16 of 0 and −1.
// - Targets are linear planes of memory whose pitch is a multiple of 4 texels, so a block is loaded as 4
//   aligned rows.
// - Numbers are converted as in rhi.contract.texels: clamp, scale, round to nearest even, NaN to 0.
// - Formats, whether a target blends, the depth function, the order of tests and shading are macros, written
//   by merger.py. In a kernel for one combination of them they are constants. In a general kernel they are
//   fields of the batch's `Merger`, and the same text branches on them. MAX_SAMPLES and MAX_COLORS, the sizes
//   of arrays, are always constants.
// - All other states are words of the draw's state block, read here as scalars: branches on them are uniform
//   over all blocks of a draw.

#define MERGER static inline __attribute__((always_inline, overloadable))

#define EACH(c, first, last) \
    _Pragma("unroll") for (int c = first; c <= last; ++c)  // PoCL unrolls only loops with a pragma

typedef struct {
    global uchar *first;  // texel 0, 0 of sample 0
    ulong pitch, layer;   // distances in bytes from row to row, and from sample to sample
} Surface;

typedef struct {
    global const Merger *merger;
    Surface color[MAX_COLORS + 1];  // OpenCL C has no empty arrays
    Surface depth, stencil;
} Targets;

MERGER void open_surface(global uchar *memory, global const ulong *layout, Surface *surface) {
    surface->first = memory + layout[0];
    surface->pitch = layout[1];
    surface->layer = layout[2];
}

MERGER global uchar *locate(const Surface *surface, int x, int y, int sample, const int bytes) {
    global uchar *row = surface->first + y * surface->pitch;
    if (MAX_SAMPLES > 1) row += sample * surface->layer;
    return row + x * bytes;
}

// -- blocks in memory: a texel of 1, 2, 4, 8 or 16 bytes takes 1, 1, 1, 2 or 4 words of each lane
// --------------------

MERGER void load_block(global const uchar *block, ulong pitch, const int bytes, uint16 *words) {
    global const uchar *a = block, *b = a + pitch, *c = b + pitch, *d = c + pitch;
#define ROWS(type) \
    *(global const type *)a, *(global const type *)b, *(global const type *)c, *(global const type *)d
    if (bytes == 1) words[0] = convert_uint16((uchar16)(ROWS(uchar4)));
    if (bytes == 2) words[0] = convert_uint16((ushort16)(ROWS(ushort4)));
    if (bytes == 4) words[0] = (uint16)(ROWS(uint4));
    if (bytes == 8) {
        uint8 rows[4] = {ROWS(uint8)};
        words[0] = (uint16)(rows[0].even, rows[1].even, rows[2].even, rows[3].even);
        words[1] = (uint16)(rows[0].odd, rows[1].odd, rows[2].odd, rows[3].odd);
    }
    if (bytes == 16) {
        uint16 rows[4] = {ROWS(uint16)};
        words[0] = (uint16)(rows[0].s048c, rows[1].s048c, rows[2].s048c, rows[3].s048c);
        words[1] = (uint16)(rows[0].s159d, rows[1].s159d, rows[2].s159d, rows[3].s159d);
        words[2] = (uint16)(rows[0].s26ae, rows[1].s26ae, rows[2].s26ae, rows[3].s26ae);
        words[3] = (uint16)(rows[0].s37bf, rows[1].s37bf, rows[2].s37bf, rows[3].s37bf);
    }
#undef ROWS
}

MERGER void store_block(global uchar *block, ulong pitch, const int bytes, const uint16 *words) {
#define ROWS(type, whole) \
    { \
        *(global type *)block = whole.s0123; \
        *(global type *)(block + pitch) = whole.s4567; \
        *(global type *)(block + 2 * pitch) = whole.s89ab; \
        *(global type *)(block + 3 * pitch) = whole.scdef; \
    }
    if (bytes == 1) {
        uchar16 texels = convert_uchar16(words[0]);
        ROWS(uchar4, texels)
    }
    if (bytes == 2) {
        ushort16 texels = convert_ushort16(words[0]);
        ROWS(ushort4, texels)
    }
    if (bytes == 4) {
        uint16 texels = words[0];
        ROWS(uint4, texels)
    }
#undef ROWS
#define ROW(y, quarter) \
    { \
        uint8 low, high; \
        if (bytes == 8) { \
            low.even = words[0].quarter; \
            low.odd = words[1].quarter; \
            *(global uint8 *)(block + y * pitch) = low; \
        } \
        if (bytes == 16) { \
            low.even = words[0].quarter; \
            low.odd = words[2].quarter; \
            high.even = words[1].quarter; \
            high.odd = words[3].quarter; \
            uint16 row; \
            row.even = low; \
            row.odd = high; \
            *(global uint16 *)(block + y * pitch) = row; \
        } \
    }
    if (bytes > 4) {
        ROW(0, s0123)
        ROW(1, s4567)
        ROW(2, s89ab)
        ROW(3, scdef)
    }
#undef ROW
}

// -- numbers: conversion to and from a channel's stored bits
// ----------------------------------------------------------

// NaN becomes `low`. Comparisons compile to one instruction each; fmin and fmax take more, to handle NaN.
MERGER float16 clamp_to(float16 value, float low, float high) {
    value = value > low ? value : (float16)(low);
    return value < high ? value : (float16)(high);
}

// In [2^23, 2^24) floats are integers, so the addition rounds, and the low bits are the result.
MERGER uint16 round_unsigned(float16 value, float scale) {
    return as_uint16(fma(value, (float16)(scale), (float16)(8388608.0f))) - 0x4B000000u;
}
MERGER int16 round_signed(float16 value, float scale) {
    return as_int16(fma(value, (float16)(scale), (float16)(12582912.0f))) - 0x4B400000;
}

// Half floats are converted by shifts, since PoCL calls a function per lane for OpenCL's own conversions.
// After Fabian Giesen's float_to_half_fast3_rtne and half_to_float.
MERGER uint16 make_half(float16 value) {
    uint16 bits = as_uint16(value), sign = bits & 0x80000000u, size = bits ^ sign;
    uint16 tiny = as_uint16(as_float16(size) + 0.5f) -
        0x3F000000u;  // the addition rounds at a denormal half's step
    uint16 usual = (size - 0x38000000u + 0xFFFu + ((size >> 13) & 1u)) >> 13;
    uint16 beyond = size > 0x7F800000u ? (uint16)(0x7E00u) : (uint16)(0x7C00u);
    uint16 result = size < 0x38800000u ? tiny : usual;
    return (size >= 0x47800000u ? beyond : result) | (sign >> 16);
}
MERGER float16 read_half(uint16 half_bits) {
    uint16 size = (half_bits & 0x7FFFu) << 13, exponent = size & 0x0F800000u;
    uint16 usual = size + 0x38000000u, endless = size + 0x70000000u;
    float16 tiny = as_float16(size + 0x38800000u) - 0x1p-14f;
    uint16 result = exponent == 0x0F800000u ? endless : usual;
    result = exponent == 0u ? as_uint16(tiny) : result;
    return as_float16(result | ((half_bits & 0x8000u) << 16));
}

// Floats without a sign: 5 bits of exponent, `fraction` bits behind it. Finite numbers stay finite.
MERGER uint16 make_unsigned_float(float16 value, const uint fraction) {
    const uint shift = 23u - fraction, endless = 31u << fraction;
    const float grain = 512.0f / (1u << fraction);  // the addition rounds at the step of the smallest numbers
    uint16 bits = as_uint16(value), size = bits & 0x7FFFFFFFu;
    uint16 tiny = as_uint16(as_float16(size) + grain) - as_uint(grain);
    uint16 result = (size - 0x38000000u + ((1u << (shift - 1u)) - 1u) + (size >> shift & 1u)) >> shift;
    result = min(result, (uint16)(endless - 1u));
    result = size < 0x38800000u ? tiny : result;
    result = size == 0x7F800000u ? (uint16)(endless) : result;
    result = bits == size ? result : (uint16)(0u);
    return size > 0x7F800000u ? (uint16)(endless | 1u) : result;
}

// IEC 61966-2-1. The powers 5/12 and 2.4 are polynomials, computed by merger.py: pow takes 100 ns in PoCL.
MERGER float16 encode_srgb(float16 linear) {
    float16 root = sqrt(sqrt(linear));
    return linear <= 0.0031308f ? linear * 12.92f
                                : fma(ENCODE_SRGB(root), (float16)(1.055f), (float16)(-0.055f));
}
MERGER float16 decode_srgb(float16 stored) {
    float16 base = (stored + 0.055f) * (1.0f / 1.055f), root = sqrt(base);
    return stored <= 0.04045f ? stored * (1.0f / 12.92f) : base * base * DECODE_SRGB(root);
}

#define LARGEST(bits) (~0u >> (32 - (bits)))

// `bits` of a packed format are those of its first channel: 10 stands for 10, 10, 10 and 2, 11 for 11, 11
// and 10.
#define TEXEL_BYTES(channels, bits) ((bits) == 10 || (bits) == 11 ? 4 : (channels) * (bits) / 8)
#define CHANNEL_BITS(channel, bits) \
    ((bits) == 10 && (channel) == 3 ? 2 : (bits) == 11 && (channel) == 2 ? 10 : (bits))

// Convert a shader's value to the stored bits of one channel. `value` is a word: the bits of a float, or an
// integer.
MERGER uint16 make_bits(uint16 value, const int bits, const int kind) {
    float16 number = as_float16(value);
    const uint largest = LARGEST(bits);
    switch (kind) {
    case KIND_SRGB: return round_unsigned(encode_srgb(clamp_to(number, 0.0f, 1.0f)), largest);
    case KIND_UNORM: return round_unsigned(clamp_to(number, 0.0f, 1.0f), largest);
    case KIND_SNORM: {
        number = number == number ? number : (float16)(0.0f);
        return as_uint16(round_signed(clamp_to(number, -1.0f, 1.0f), largest >> 1)) & largest;
    }
    case KIND_UINT: return min(value, largest);
    case KIND_INT: return value;  // only 32-bit formats exist
    default:
        return bits == 16 ? make_half(number) : bits < 16 ? make_unsigned_float(number, bits - 5) : value;
    }
}

// Convert stored bits to a number in linear light; not for integers.
MERGER float16 read_bits(uint16 stored, const int bits, const int kind) {
    const uint largest = LARGEST(bits);
    switch (kind) {
    case KIND_SRGB: return decode_srgb(convert_float16(as_int16(stored)) * (1.0f / largest));
    case KIND_UNORM: return convert_float16(as_int16(stored)) * (1.0f / largest);
    case KIND_SNORM: {
        float16 value = convert_float16(as_int16(stored << (32 - bits)) >> (32 - bits)) *
            (1.0f / (largest >> 1));
        return clamp_to(value, -1.0f, 1.0f);
    }
    default: return bits <= 16 ? read_half(bits < 16 ? stored << (15 - bits) : stored) : as_float16(stored);
    }
}

// Alpha is linear in sRGB formats.
#define KIND_OF(channel, kind) ((kind) == KIND_SRGB && (channel) == 3 ? KIND_UNORM : (kind))

// -- comparisons: the bits 1, 2, 4 pass less, equal, greater ---------------------------------------------

#define COMPARE(type) \
    MERGER int16 compare(type new, type stored, uint passes) { \
        switch (passes) { \
        case 0: return (int16)(0); \
        case 1: return new < stored; \
        case 2: return new == stored; \
        case 3: return new <= stored; \
        case 4: return new > stored; \
        case 5: return new != stored; \
        case 6: return new >= stored; \
        default: return (int16)(-1); \
        } \
    }
COMPARE(float16)
COMPARE(uint16)
#undef COMPARE

// -- depth and stencil
// ---------------------------------------------------------------------------------------------

// Round a depth of 0…1 to the format's values: floats that represent multiples of 1/65535 or 1/(2^24 − 1).
MERGER float16 round_depth(const Targets *targets, float16 z) {
    if (DEPTH_BITS == 16) return convert_float16(as_int16(round_unsigned(z, 65535.0f))) / 65535.0f;
    if (DEPTH_BITS != 24) return z;
    // Beyond 1/2 the product is an integer already.
    float16 coarse = z * 16777215.0f;
    float16 fine = fma(z, (float16)(16777215.0f), (float16)(8388608.0f)) - 8388608.0f;
    float16 steps = z > 0.5f ? coarse : fine;
    return fma(steps, (float16)(0x1p-24f), steps * 0x1.000002p-48f);  // 1/(2^24 − 1) = 2^-24 + 2^-48 + 2^-72…
}

MERGER float16 quantize_depth(const Targets *targets, float16 z) {
    return round_depth(targets, clamp_to(z, 0.0f, 1.0f));
}

MERGER int16 compare_depth(const Targets *targets, float16 z, float16 stored) {
    return compare(z, stored, DEPTH_COMPARISON);
}

MERGER float16 load_depth(const Targets *targets, int x, int y, int sample) {
    uint16 words[1];
    load_block(locate(&targets->depth, x, y, sample, 4), targets->depth.pitch, 4, words);
    return as_float16(words[0]);
}

MERGER void store_depth(const Targets *targets, int x, int y, int sample, float16 z) {
    uint16 words[1] = {as_uint16(z)};
    store_block(locate(&targets->depth, x, y, sample, 4), targets->depth.pitch, 4, words);
}

MERGER uint16 change_stencil(uint16 stored, uint reference, uint operation) {
    switch (operation & 15u) {
    case STENCIL_ZERO: return (uint16)(0);
    case STENCIL_REPLACE: return (uint16)(reference);
    case STENCIL_INCREMENT: return min(stored + 1u, 255u);
    case STENCIL_INCREMENT_WRAP: return stored + 1u & 255u;
    case STENCIL_DECREMENT: return stored - min(stored, 1u);
    case STENCIL_DECREMENT_WRAP: return stored - 1u & 255u;
    case STENCIL_INVERT: return stored ^ 255u;
    default: return stored;
    }
}

// Return the lanes of `mask` that pass the stencil and depth tests. With `writes` both planes are updated.
MERGER int16 test_depth_stencil(
    const Targets *targets, global const uint *state, int x, int y, int sample, int front, int16 mask,
    float16 z, const bool writes
) {
    int16 near = mask;
    float16 stored_z = (float16)(0.0f);
    if (HAS_DEPTH) {
        z = quantize_depth(targets, z);
        stored_z = load_depth(targets, x, y, sample);
        near &= compare_depth(targets, z, stored_z);
    }
    if (HAS_STENCIL) {
        global const uint *side = state + (front ? STENCIL_STATE : STENCIL_STATE + 2);
        uint rules = side[0], reference = side[1] & 255u, read_mask = side[1] >> 8 & 255u;
        uint write_mask = side[1] >> 16;
        uint16 stored;
        global uchar *block = locate(&targets->stencil, x, y, sample, 1);
        load_block(block, targets->stencil.pitch, 1, &stored);
        int16 equal = mask & compare((uint16)(reference & read_mask), stored & read_mask, rules & 7u);
        near &= equal;
        if (writes) {
            uint16 value = equal ? change_stencil(stored, reference, rules >> 8)
                                 : change_stencil(stored, reference, rules >> 4);
            value = near ? change_stencil(stored, reference, rules >> 12) : value;
            value = bitselect(stored, value, as_uint16(mask) & write_mask);
            store_block(block, targets->stencil.pitch, 1, &value);
        }
    }
    if (HAS_DEPTH && DEPTH_WRITES && writes) store_depth(targets, x, y, sample, near ? z : stored_z);
    return near;
}

MERGER int16 test_depth_stencil(
    const Targets *targets, global const uint *state, int x, int y, int sample, int front, int16 mask,
    float16 z
) {
    return test_depth_stencil(targets, state, x, y, sample, front, mask, z, false);
}

MERGER int16 merge_depth_stencil(
    const Targets *targets, global const uint *state, int x, int y, int sample, int front, int16 mask,
    float16 z
) {
    return test_depth_stencil(targets, state, x, y, sample, front, mask, z, true);
}

// -- alpha of the first output
// -------------------------------------------------------------------------------------

MERGER int16 test_alpha(const Targets *targets, global const uint *state, int16 mask, const uint16 *outputs) {
    if (!ALPHA_TEST) return mask;
    return mask &
        compare(as_float16(outputs[3]), (float16)(as_float(state[ALPHA_STATE + 1])), state[ALPHA_STATE]);
}

// Cover a number of samples in proportion to alpha, rounded to nearest.
MERGER int16 cover_by_alpha(const Targets *targets, int16 mask, const uint16 *outputs, int sample) {
    if (!ALPHA_TO_COVERAGE) return mask;
    return mask & (as_float16(outputs[3]) * SAMPLES >= sample + 0.5f);
}

// -- color
// ---------------------------------------------------------------------------------------------------------

// value *= factor, for the channels 0…2 or 3 alone. Bit 8 of a factor's code means one minus the factor.
MERGER void scale_channels(
    float16 *value, const float16 *source, const float16 *stored, const float *constant_color, uint code,
    const int first, const int last, const bool clamps
) {
    if (code == FACTOR_ONE) return;
    float16 factor[4];
    switch (code & 7u) {
    case FACTOR_SOURCE_COLOR:
        EACH (c, first, last) factor[c] = source[c];
        break;
    case FACTOR_SOURCE_ALPHA:
        EACH (c, first, last) factor[c] = source[3];
        break;
    case FACTOR_DESTINATION_COLOR:
        EACH (c, first, last) factor[c] = stored[c];
        break;
    case FACTOR_DESTINATION_ALPHA:
        EACH (c, first, last) factor[c] = stored[3];
        break;
    case FACTOR_CONSTANT:
        EACH (c, first, last) factor[c] = (float16)(constant_color[c]);
        break;
    case FACTOR_SOURCE_ALPHA_SATURATE: {
        float16 left = 1.0f - stored[3];
        left = source[3] < left ? source[3] : left;
        EACH (c, first, last) factor[c] = c == 3 ? (float16)(1.0f) : left;
        break;
    }
    default: EACH (c, first, last) factor[c] = (float16)(0.0f);
    }
    if (code & 8u)
        EACH (c, first, last) factor[c] = 1.0f - factor[c];
    if (clamps)
        EACH (c, first, last) factor[c] = clamp_to(factor[c], -1.0f, 1.0f);
    EACH (c, first, last) value[c] *= factor[c];
}

// `function`: source factor, destination factor and operation, 4 bits each.
MERGER void blend_channels(
    float16 *result, const float16 *source, const float16 *stored, const float *constant_color, uint function,
    const int first, const int last, const bool clamps
) {
    uint operation = function >> 8 & 15u;
    if (operation >= OPERATION_MINIMUM) {
        EACH (c, first, last) {
            int16 takes = operation == OPERATION_MINIMUM ? source[c] < stored[c] : source[c] > stored[c];
            result[c] = takes ? source[c] : stored[c];
        }
        return;
    }
    float16 left[4], right[4];
    EACH (c, first, last) {
        left[c] = source[c];
        right[c] = stored[c];
    }
    scale_channels(left, source, stored, constant_color, function & 15u, first, last, clamps);
    scale_channels(right, source, stored, constant_color, function >> 4 & 15u, first, last, clamps);
    switch (operation) {
    case OPERATION_SUBTRACT:
        EACH (c, first, last) result[c] = left[c] - right[c];
        break;
    case OPERATION_REVERSE_SUBTRACT:
        EACH (c, first, last) result[c] = right[c] - left[c];
        break;
    default: EACH (c, first, last) result[c] = left[c] + right[c];
    }
}

// Replace `color` by the blended color. For normalised targets all operands are clamped (OpenGL 4.5, 17.3.8).
MERGER void blend(
    uint16 *color, const uint16 *words, global const uint *state, global const uint *constants,
    const int channels, const int bits, const int kind
) {
    const bool is_signed = kind == KIND_SNORM, clamps = kind != KIND_FLOAT;
    float16 source[4], stored[4], result[4];
    float constant_color[4];
    EACH (c, 0, 3) {
        source[c] = as_float16(color[c]);
        constant_color[c] = as_float(constants[c]);
        if (clamps) {
            source[c] = clamp_to(source[c], is_signed ? -1.0f : 0.0f, 1.0f);
            constant_color[c] = clamp(constant_color[c], is_signed ? -1.0f : 0.0f, 1.0f);
        }
        const int first_bit = c * bits;
        stored[c] = (float16)(c == 3 ? 1.0f : 0.0f);
        if (c < channels)
            stored[c] = read_bits(
                words[first_bit / 32] >> first_bit % 32 & LARGEST(CHANNEL_BITS(c, bits)),
                CHANNEL_BITS(c, bits), KIND_OF(c, kind)
            );
    }
    blend_channels(result, source, stored, constant_color, state[0], 0, 2, is_signed);
    blend_channels(result, source, stored, constant_color, state[0] >> 12, 3, 3, is_signed);
    EACH (c, 0, 3) color[c] = as_uint16(result[c]);
}

// Merge one target. `outputs`: the fragment stage's words for it; `state`: its blend function and write mask.
MERGER void merge_color(
    const Surface *surface, global const uint *state, global const uint *constants, int x, int y, int sample,
    int16 mask, const uint16 *outputs, const int components, const int channels, const int bits,
    const int kind, const bool blends
) {
    const int bytes = TEXEL_BYTES(channels, bits);
    global uchar *block = locate(surface, x, y, sample, bytes);
    uint16 words[4], color[4];
    load_block(block, surface->pitch, bytes, words);
    EACH (c, 0, 3)
        color[c] = c < components ? outputs[c]
                                  : (uint16)(c < 3                                       ? 0u
                                                 : kind == KIND_UINT || kind == KIND_INT ? 1u
                                                                                         : as_uint(1.0f));
    if (blends) blend(color, words, state, constants, channels, bits, kind);
    uint16 fresh[4] = {(uint16)(0), (uint16)(0), (uint16)(0), (uint16)(0)};
    EACH (c, 0, channels - 1)
        fresh[c * bits / 32] |= make_bits(color[c], CHANNEL_BITS(c, bits), KIND_OF(c, kind)) << c * bits % 32;
    EACH (word, 0, (bytes + 3) / 4 - 1)
        words[word] = bitselect(words[word], fresh[word], as_uint16(mask) & state[1 + word]);
    store_block(block, surface->pitch, bytes, words);
}

MERGER void merge_colors(
    const Targets *targets, global const uint *state, int x, int y, int sample, int16 mask,
    const uint16 *outputs
) {
#define MERGE(index, location, components, channels, bits, kind, blends) \
    merge_color( \
        &targets->color[index], state + COLOR_STATE(location), state + BLEND_STATE, x, y, sample, mask, \
        outputs + 4 * location, components, channels, bits, kind, blends \
    );
    COLOR_TARGETS(MERGE)
#undef MERGE
}

// Set all samples of a region of whole blocks to one texel, which is repeated to 4 words.
MERGER void clear_surface(
    const Surface *surface, global const uint *texel, int x, int y, int width, int height, const int bytes,
    int samples
) {
    const uint4 four = (uint4)(texel[0], texel[1], texel[2], texel[3]);
    const uint16 sixteen = (uint16)(four, four, four, four);
    const int words = width * bytes / 4;
    for (int sample = 0; sample < samples; ++sample)
        for (int row = 0; row < height; ++row) {
            global uint *line = (global uint *)locate(surface, x, y + row, sample, bytes);
            int word = 0;
            for (; word + 16 <= words; word += 16) vstore16(sixteen, 0, line + word);
            for (; word < words; ++word) line[word] = texel[word % 4];
        }
}

// The clear values follow the surfaces' layouts.
#define CLEAR_TEXEL(surface_layouts, surface) \
    ((global const uint *)(surface_layouts + 3 * (COLOR_COUNT + HAS_DEPTH + HAS_STENCIL)) + 4 * (surface))

// `surfaces`: those to clear, as bits.
MERGER void clear_targets(
    const Targets *targets, global const ulong *surface_layouts, uint surfaces, int x, int y, int width,
    int height
) {
#define CLEAR_ONE(index, surface, bytes) \
    if (surfaces >> (index) & 1) \
        clear_surface(surface, CLEAR_TEXEL(surface_layouts, index), x, y, width, height, bytes, SAMPLES);
#define CLEAR_COLOR(index, location, components, channels, bits, kind, blends) \
    CLEAR_ONE(index, &targets->color[index], TEXEL_BYTES(channels, bits))
    COLOR_TARGETS(CLEAR_COLOR)
    if (HAS_DEPTH) CLEAR_ONE(COLOR_COUNT, &targets->depth, 4)
    if (HAS_STENCIL) CLEAR_ONE(COLOR_COUNT + HAS_DEPTH, &targets->stencil, 1)
#undef CLEAR_ONE
#undef CLEAR_COLOR
}

// `surfaces`: the addresses of their memory; `surface_layouts`: where they lie in it.
MERGER void open_targets(
    global const Merger *merger, global const ulong *surfaces, global const ulong *surface_layouts,
    Targets *targets
) {
    targets->merger = merger;
#define OPEN_ONE(index, surface) \
    open_surface(AT(uchar, surfaces[index]), surface_layouts + 3 * (index), surface);
#define OPEN(index, ...) OPEN_ONE(index, &targets->color[index])
    COLOR_TARGETS(OPEN)
#undef OPEN
    if (HAS_DEPTH) OPEN_ONE(COLOR_COUNT, &targets->depth)
    if (HAS_STENCIL) OPEN_ONE(COLOR_COUNT + HAS_DEPTH, &targets->stencil)
#undef OPEN_ONE
}
