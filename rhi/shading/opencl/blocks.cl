// What 16 lanes read together if they are a block of 4 × 4 pixels, whose texels lie beside each other: four
// rows are a few loads of whole vectors, where a load for each lane takes most of the time of a look-up. It
// is found out by the texels themselves, so whatever shader or texture they come from. Texels are the same
// bits as those of the usual way.

#define RHI_BLOCK rhi_block
static RHI_INLINE void rhi_decode(int stored, int channels, uint16 *r);
static RHI_INLINE float16 rhi_mix(float16 a, float16 b, float16 at);

// Reads texels of 4 or 8 bytes if they are a block; returns whether they are. Memory is padded to whole
// blocks.
static RHI_INLINE int rhi_block(
    rhi_texture p, rhi_description w, rhi_description level, int16 x, int16 y, int16 layer, uint16 *r
) {
    const int16 columns = (int16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3);
    const int16 lines = (int16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    int row = level[RHI_ROW], whole = level[RHI_LAYER], left = x.s0, top = y.s0, texel = w[RHI_TEXEL_BYTES];
    if ((texel != 4 && texel != 8) || left < 0 || left > row - 4) return 0;
    if (top < 0 || top >= level[RHI_HEIGHT] || (top + 4) * row > whole) return 0;
    if (rhi_any((x - columns != left) | (y - lines != top) | (layer != layer.s0))) return 0;
    global const uint *q = (global const uint *)(p + (long)(layer.s0 * whole + top * row + left) * texel);
    r[1] = r[2] = r[3] = (uint16)0u;
    if (texel == 4) {
        r[0] = (uint16)(vload4(0, q), vload4(0, q + row), vload4(0, q + 2 * row), vload4(0, q + 3 * row));
    } else {
        uint16 upper = (uint16)(vload8(0, q), vload8(0, q + 2 * row));
        uint16 lower = (uint16)(vload8(0, q + 4 * row), vload8(0, q + 6 * row));
        r[0] = (uint16)(upper.even, lower.even);
        r[1] = (uint16)(upper.odd, lower.odd);
    }
    rhi_decode(w[RHI_ENCODING], w[RHI_CHANNELS], r);
    return 1;
}

#if defined(__F16C__) && __has_builtin(__builtin_ia32_vpermi2varps512)
#define RHI_GRID rhi_grid
typedef __fp16 rhi_texels __attribute__((ext_vector_type(16), aligned(8)));

// Mixes the texel number `left` / 4 of eight and the next one. A result is the channels of four lanes.
static RHI_INLINE float16 rhi_across(rhi_texture p, int16 left, float16 at) {
    float16 low = __builtin_convertvector(*(global const rhi_texels *)p, float16);
    float16 high = __builtin_convertvector(*(global const rhi_texels *)(p + 32), float16);
    float16 first = __builtin_ia32_vpermi2varps512(low, left, high);
    return rhi_mix(first, __builtin_ia32_vpermi2varps512(low, left + 4, high), at);
}

static RHI_INLINE float16 rhi_line(rhi_texture p, int row, int16 left, float16 at_x, float16 at_y) {
    return rhi_mix(rhi_across(p, left, at_x), rhi_across(p + 8 * row, left, at_x), at_y);
}

// Filters four half floats if the lanes are in four rows and four columns, of which the last is at most six
// texels from the first, as they are where a picture is drawn at up to twice its size or down to half of it;
// returns whether they are. `first` is where a lane's row begins, in texels. Reads up to six texels behind
// the last one, and ignores them.
static RHI_INLINE int rhi_grid(
    rhi_texture p, int row, int16 first, int16 x, float16 at_x, float16 at_y, uint16 *r
) {
    int16 column = x - x.s0;
    int16 is_grid = (column == column.s0123012301230123) & (first == first.s000044448888cccc);
    if (rhi_any(~is_grid | (as_uint16(column) > 6u))) return 0;
    int16 left = column * 4 + (int16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    p += 8 * (long)x.s0;
    float16 a = rhi_line(p + 8 * (long)first.s0, row, left, at_x.s0123012301230123, at_y.s0123012301230123);
    float16 b = rhi_line(p + 8 * (long)first.s4, row, left, at_x.s4567456745674567, at_y.s4567456745674567);
    float16 c = rhi_line(p + 8 * (long)first.s8, row, left, at_x.s89ab89ab89ab89ab, at_y.s89ab89ab89ab89ab);
    float16 d = rhi_line(p + 8 * (long)first.sc, row, left, at_x.scdefcdefcdefcdef, at_y.scdefcdefcdefcdef);
    r[0] = as_uint16((float16)(a.s0123, b.s0123, c.s0123, d.s0123));
    r[1] = as_uint16((float16)(a.s4567, b.s4567, c.s4567, d.s4567));
    r[2] = as_uint16((float16)(a.s89ab, b.s89ab, c.s89ab, d.s89ab));
    r[3] = as_uint16((float16)(a.scdef, b.scdef, c.scdef, d.scdef));
    return 1;
}
#endif

#if defined(__AVX2__) && !defined(RHI_GATHER64) && __has_builtin(__builtin_ia32_permvarsf256) && \
    __has_builtin(__builtin_reduce_max)
#define RHI_WINDOW rhi_window

// Reads texels of one float around eight lanes, row by row from `q` on; `line` is a lane's row.
static RHI_INLINE void rhi_window8(
    global const float *q, int row, int8 column, int8 line, uint8 *a, uint8 *b, uint8 *c, uint8 *d
) {
    int last = __builtin_reduce_max(line) + 1, k = __builtin_reduce_min(line);
    int8 lower = (int8)0;
    *a = *b = *c = *d = (uint8)0u;
    for (; k <= last; ++k) {
        float8 texels = vload8(0, q + (long)k * row);
        uint8 near = as_uint8(__builtin_ia32_permvarsf256(texels, column));
        uint8 far = as_uint8(__builtin_ia32_permvarsf256(texels, column + 1));
        int8 upper = line == k;
        *a = select(*a, near, upper), *b = select(*b, far, upper);
        *c = select(*c, near, lower), *d = select(*d, far, lower);
        lower = upper;
    }
}

// Reads the texels of one float at (x, y), (x + 1, y), (x, y + 1) and (x + 1, y + 1) out of whole rows, if all lanes
// are near the first one: up to three columns beside it and seven rows from it; returns whether they are. Each row is
// a load and a few permutations, where 32 loads take most of the time of a look-up. All texels lie inside their layer.
static RHI_INLINE int rhi_window(
    rhi_texture p, int row, int16 first, int16 x, int16 y, uint16 *a, uint16 *b, uint16 *c, uint16 *d
) {
    int left = x.s0 - 3;
    int16 column = x - left, line = y - y.s0;
    if (left < 0 || left > row - 8) return 0;
    if (rhi_any((as_uint16(column) > 6u) | (as_uint16(line + 7) > 14u) | (first != first.s0))) return 0;
    global const float *q = (global const float *)p + (long)first.s0 + (long)y.s0 * row + left;
    uint8 e, f, g, h, i, j, k, l;
    rhi_window8(q, row, column.lo, line.lo, &e, &f, &g, &h);
    rhi_window8(q, row, column.hi, line.hi, &i, &j, &k, &l);
    *a = (uint16)(e, i), *b = (uint16)(f, j), *c = (uint16)(g, k), *d = (uint16)(h, l);
    return 1;
}
#endif
