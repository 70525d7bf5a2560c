// Textures and images in lane code; rhi.shading.opencl.opencl_textures describes the design.
//
// FLOAT, INT and UINT are scalars or vectors of a kernel's width. A condition is an INT: all bits set where
// it holds in a vector, 1 in a scalar. ANY, NOT, BOTH, EITHER and SELECT operate on conditions. Texel
// coordinates and addresses are always clamped to the texture, so that inactive lanes can read without a
// mask.
//
// A texel is four UINT words: the bits of floats, or integers. PoCL unrolls only loops with a pragma.

// -- formats -----------------------------------------------------------------------------------------------

// Converts half floats: a product adjusts the exponent, which is exact and also right for denormals.
static RHI_INLINE FLOAT rhi_from_half(UINT bits) {
#ifdef RHI_FROM_HALF
    return RHI_FROM_HALF(bits);
#else
    UINT magnitude = (bits & 0x7fffu) << 13u;
    FLOAT value = as_FLOAT(magnitude) * 0x1p112f;
    UINT huge = SELECT((UINT)0u, (UINT)0x7f800000u, value >= 65536.0f);
    return as_FLOAT(as_UINT(value) | huge | (bits & 0x8000u) << 16u);
#endif
}

// Decodes a stored sRGB value, 0 … 255 (IEC 61966-2-1): within 2e-6; FAST within 1.3e-3, like llvmpipe.
static RHI_INLINE FLOAT rhi_from_srgb(FLOAT c) {
    FLOAT curve = RHI_FAST ? FAST_SRGB_CURVE : SRGB_CURVE;
    float slope = 1.0f / (RHI_FAST ? 12.6f * 255.0f : 12.92f * 255.0f);
    return SELECT(curve, c * slope, c < (RHI_FAST ? 15.5f : 10.5f));
}

// Converts an unsigned float, given by the bits of a half float without its sign.
static RHI_FUSED UINT rhi_unsigned_float(UINT bits) { return as_UINT(rhi_from_half(bits)); }

// Decodes stored words to one word per channel.
static RHI_INLINE void rhi_decode(int stored, int channels, UINT *r) {
    switch (stored) {
    case RHI_UNORM8:
    case RHI_SRGB8:
    case RHI_SNORM8:
    case RHI_INTEGER8: {
        UINT raw = r[0];
        r[0] = raw & 255u;
        r[1] = raw >> 8u & 255u;
        r[2] = raw >> 16u & 255u;
        r[3] = raw >> 24u;
        break;
    }
    case RHI_UNORM16:
    case RHI_HALF:
    case RHI_INTEGER16:
        r[3] = r[1] >> 16u;
        r[2] = r[1] & 65535u;
        r[1] = r[0] >> 16u;
        r[0] &= 65535u;
        break;
    }
    switch (stored) {
    case RHI_UNORM8:
        _Pragma("unroll") for (int c = 0; c < 4; ++c) r[c] = as_UINT(convert_FLOAT(r[c]) * (1.0f / 255.0f));
        break;
    case RHI_SRGB8:
        for (int c = 0; c < 3; ++c) r[c] = as_UINT(rhi_from_srgb(convert_FLOAT(r[c])));
        r[3] = as_UINT(convert_FLOAT(r[3]) * (1.0f / 255.0f));
        break;
    case RHI_SNORM8:
        for (int c = 0; c < 4; ++c) {
            FLOAT value = convert_FLOAT(as_INT(r[c] << 24u) >> 24) * (1.0f / 127.0f);
            r[c] = as_UINT(SELECT(value, (FLOAT)-1.0f, value < -1.0f));
        }
        break;
    case RHI_UNORM16:
        for (int c = 0; c < 4; ++c) r[c] = as_UINT(convert_FLOAT(r[c]) * (1.0f / 65535.0f));
        break;
    case RHI_HALF: _Pragma("unroll") for (int c = 0; c < 4; ++c) r[c] = as_UINT(rhi_from_half(r[c])); break;
    case RHI_UFLOAT11: {
        UINT raw = r[0];
        r[0] = rhi_unsigned_float((raw & 2047u) << 4u);
        r[1] = rhi_unsigned_float((raw >> 11u & 2047u) << 4u);
        r[2] = rhi_unsigned_float((raw >> 22u) << 5u);
        break;
    }
    case RHI_UNORM10:
    case RHI_INTEGER10: {
        UINT raw = r[0];
        for (int c = 0; c < 4; ++c) r[c] = raw >> (uint)(10 * c) & 1023u;
        if (stored == RHI_INTEGER10) break;
        for (int c = 0; c < 3; ++c) r[c] = as_UINT(convert_FLOAT(r[c]) * (1.0f / 1023.0f));
        r[3] = as_UINT(convert_FLOAT(r[3]) * (1.0f / 3.0f));
        break;
    }
    }
    if (channels < 4) r[3] = (UINT)(stored >= RHI_INTEGER8 ? 1u : 0x3f800000u);
}

// Reads texel number `i` of each lane.
static RHI_FUSED void rhi_texel(rhi_texture p, rhi_description w, INT i, UINT *r) {
    r[1] = r[2] = r[3] = (UINT)0u;
    switch (w[RHI_TEXEL_BYTES]) {
    case 1: r[0] = rhi_gather8(p, i); break;
    case 2: r[0] = rhi_gather16(p, i); break;
    case 4: r[0] = rhi_gather32(p, i); break;
    case 8: rhi_pair(p, i * 2, r, r + 1); break;
    default: rhi_long_pair(p, i * 2, r, r + 2);
    }
    rhi_decode(w[RHI_ENCODING], w[RHI_CHANNELS], r);
}

// The same, not inlined: for callers that read several texels.
static RHI_CALLED void rhi_fetch(rhi_texture p, rhi_description w, INT i, UINT *r) { rhi_texel(p, w, i, r); }

// -- coordinates -------------------------------------------------------------------------------------------

static RHI_INLINE INT rhi_within(INT i, int size) {
    i = SELECT(i, (INT)0, i < 0);
    return SELECT(i, (INT)(size - 1), i >= size);
}

static RHI_INLINE FLOAT rhi_wrap(int wrap, FLOAT u) {
    if (wrap == RHI_REPEAT) u -= rhi_floor(u);
    if (wrap == RHI_MIRROR) u = fabs(u - 2.0f * rhi_floor(fma(u, (FLOAT)0.5f, (FLOAT)0.5f)));
    return u;
}

// Whether a coordinate lies in a reflected part, where the next texel is the one before. Such a coordinate is
// brought to the part that isn't reflected, a step down, so that a texel's center follows the one before.
static RHI_INLINE INT rhi_reflect(int wrap, FLOAT *u) {
    if (wrap != RHI_MIRROR) return (INT)0;
    FLOAT whole = rhi_floor(*u);
    INT back = whole - 2.0f * rhi_floor(whole * 0.5f) > 0.5f;
    *u = SELECT(*u, rhi_wrap(wrap, *u) * 0x1.fffffep-1f, back);
    return back;
}

// Clamps a coordinate in texels that is far outside or NaN.
static RHI_INLINE FLOAT rhi_near(FLOAT x, float low, float high) {
    x = SELECT((FLOAT)low, x, x > low);
    return SELECT((FLOAT)high, x, x < high);
}

// Returns the texel that contains a coordinate.
static RHI_INLINE INT rhi_nearest(int wrap, int size, FLOAT u) {
    INT i = convert_INT(rhi_floor(rhi_near(rhi_wrap(wrap, u) * (float)size, -1.0f, size)));
    return wrap == RHI_BORDER ? i : rhi_within(i, size);
}

// Finds the texel before a coordinate; returns the weight of the next one. Far outside, both lie outside.
static RHI_INLINE FLOAT rhi_before(int wrap, int size, FLOAT u, INT *i) {
    FLOAT x = rhi_near(fma(rhi_wrap(wrap, u), (FLOAT)(float)size, (FLOAT)-0.5f), -2.0f, size),
          whole = rhi_floor(x);
    *i = convert_INT(whole);
    return x - whole;
}

// Applies the wrap mode to the texel before a coordinate, and to the next one.
static RHI_INLINE void rhi_edge(int wrap, int size, INT *i0, INT *i1) {
    INT i = *i0, j = i + 1;
    if (wrap == RHI_REPEAT) {
        i = SELECT(i, (INT)(size - 1), i < 0);
        j = SELECT(j, (INT)0, as_UINT(j) >= (uint)size);
    } else if (wrap != RHI_BORDER && wrap != RHI_SEAM) {
        i = rhi_within(i, size);
        j = rhi_within(j, size);
    }
    *i0 = i;
    *i1 = j;
}

// Whether a texel and the next one lie inside, in all lanes.
static RHI_INLINE int rhi_inside(int size, INT i) { return !ANY(as_UINT(i) >= (uint)(size - 1)); }

// Finds the two texels around a coordinate; returns the weight of the second.
static RHI_FUSED FLOAT rhi_around(int wrap, int size, FLOAT u, INT *i0, INT *i1) {
    FLOAT at = rhi_before(wrap, size, u, i0);
    rhi_edge(wrap, size, i0, i1);
    return at;
}

// Projects a direction on a cube's face: (s, t), and m along the face's axis. OpenGL 4.3, table 8.19, with t
// down.
static RHI_FUSED void rhi_project(
    INT is_y, INT is_z, INT negative, FLOAT x, FLOAT y, FLOAT z, FLOAT *s, FLOAT *t, FLOAT *m
) {
    FLOAT along = SELECT(SELECT(x, y, is_y), z, is_z);
    *s = SELECT(SELECT(SELECT(-z, z, negative), x, is_y), SELECT(x, -x, negative), is_z);
    *t = SELECT(-y, SELECT(z, -z, negative), is_y);
    *m = SELECT(along, -along, negative);
}

// Finds the major axis (x if neither y nor z), and whether the direction is negative along it.
static RHI_FUSED void rhi_axis(FLOAT x, FLOAT y, FLOAT z, INT *is_y, INT *is_z, INT *negative) {
    FLOAT ax = fabs(x), ay = fabs(y), az = fabs(z);
    *is_z = BOTH(az >= ax, az >= ay);
    *is_y = BOTH(ay >= ax, NOT(*is_z));
    *negative = SELECT(SELECT(x, y, *is_y), z, *is_z) < 0.0f;
}

// Returns the face of a cube that a direction hits, and replaces (u, v) by the coordinates there, 0 … 1.
static RHI_INLINE INT rhi_face(FLOAT *u, FLOAT *v, FLOAT z) {
    INT is_y, is_z, negative;
    FLOAT s, t, m;
    rhi_axis(*u, *v, z, &is_y, &is_z, &negative);
    rhi_project(is_y, is_z, negative, *u, *v, z, &s, &t, &m);
    *u = s / m * 0.5f + 0.5f;
    *v = t / m * 0.5f + 0.5f;
    return SELECT(SELECT((INT)0, (INT)2, is_y), (INT)4, is_z) + SELECT((INT)0, (INT)1, negative);
}

// Replaces texels beyond an edge of their face by those of the next face that the direction of their center
// hits.
static RHI_CALLED void rhi_cross(int size, INT *face, INT *i, INT *j) {
    float texel = 1.0f / size;
    FLOAT s = convert_FLOAT(*i * 2 + 1 - size) * texel, t = convert_FLOAT(*j * 2 + 1 - size) * texel;
    INT axis = *face >> 1;
    FLOAT sign = SELECT((FLOAT)1.0f, (FLOAT)-1.0f, (*face & 1) != 0);
    FLOAT x = SELECT(SELECT(s, sign, axis == 0), s * sign, axis == 2);
    FLOAT y = SELECT(-t, sign, axis == 1);
    FLOAT z = SELECT(SELECT(-s * sign, t * sign, axis == 1), sign, axis == 2);
    INT outside = EITHER(EITHER(*i < 0, *i >= size), EITHER(*j < 0, *j >= size));
    INT next = rhi_face(&x, &y, z);
    *face = SELECT(*face, next, outside);
    *i = SELECT(*i, rhi_within(convert_INT(x * (float)size), size), outside);
    *j = SELECT(*j, rhi_within(convert_INT(y * (float)size), size), outside);
}

// Returns an array's layer, or a cube's face (0 … 5).
static RHI_INLINE INT rhi_layer(rhi_description w, rhi_description level, FLOAT z) {
    if (w[RHI_SHAPE] == RHI_FLAT) return (INT)0;
    FLOAT last = (FLOAT)(level[RHI_DEPTH] - 1);
    z = rhi_floor(z + 0.5f);
    z = SELECT((FLOAT)0.0f, z, z > 0.0f);
    return convert_INT(SELECT(last, z, z < last));
}

// -- one level ---------------------------------------------------------------------------------------------

// Reads a texel, or the border color where it lies outside.
static RHI_CALLED void rhi_tap(
    rhi_texture t, rhi_description w, rhi_description level, INT x, INT y, INT layer, UINT *r
) {
    int width = level[RHI_WIDTH], height = level[RHI_HEIGHT], depth = level[RHI_DEPTH];
    INT i = rhi_within(x, width), j = rhi_within(y, height), k = rhi_within(layer, depth);
    rhi_fetch(rhi_start(t, level), w, k * level[RHI_LAYER] + j * level[RHI_ROW] + i, r);
    if (w[RHI_HAS_BORDER]) {
        INT inside = BOTH(BOTH(i == x, j == y), k == layer);
        for (int c = 0; c < 4; ++c) r[c] = SELECT((UINT)(uint)w[RHI_BORDER_COLOR + c], r[c], inside);
    }
}

static RHI_INLINE FLOAT rhi_clamped(FLOAT reference) {
    reference = SELECT((FLOAT)1.0f, reference, reference < 1.0f);
    return SELECT((FLOAT)0.0f, reference, reference > 0.0f);
}

// Compares a reference with a depth: 1 or 0, or the depth itself without a comparison.
static RHI_INLINE FLOAT rhi_passes(rhi_description w, FLOAT reference, FLOAT depth) {
    if (w[RHI_CLAMPS_REFERENCE]) reference = rhi_clamped(reference);
    FLOAT yes = (FLOAT)1.0f, no = (FLOAT)0.0f;
    switch (w[RHI_COMPARISON]) {
    case RHI_NEVER: return no;
    case RHI_LESS: return SELECT(no, yes, reference < depth);
    case RHI_EQUAL: return SELECT(no, yes, reference == depth);
    case RHI_LESS_EQUAL: return SELECT(no, yes, reference <= depth);
    case RHI_GREATER: return SELECT(no, yes, reference > depth);
    case RHI_NOT_EQUAL: return SELECT(no, yes, reference != depth);
    case RHI_GREATER_EQUAL: return SELECT(no, yes, reference >= depth);
    case RHI_ALWAYS: return yes;
    }
    return depth;
}

// Reads the four texels around a point in one layer: (0, 0), (1, 0), (0, 1), (1, 1), or compares them with
// the reference; `near` gets the weights of the second column and row. Inside the layer, adjacent texels of 4
// or 8 bytes are one load.
static RHI_CALLED void rhi_taps(
    rhi_texture t, rhi_description w, rhi_description level, FLOAT u, FLOAT v, INT layer, int compared,
    FLOAT reference, UINT *taps, FLOAT *near
) {
    INT x[2], y[2];
    int width = level[RHI_WIDTH], height = level[RHI_HEIGHT], row = level[RHI_ROW],
        texel = w[RHI_TEXEL_BYTES];
    near[0] = rhi_before(w[RHI_WRAP_U], width, u, x);
    near[1] = rhi_before(w[RHI_WRAP_V], height, v, y);
    rhi_texture p = rhi_start(t, level);
    INT first = layer * level[RHI_LAYER];
    int inside = rhi_inside(width, x[0]) && rhi_inside(height, y[0]);
    int seams = RHI_CUBES && w[RHI_WRAP_U] == RHI_SEAM && !inside;
    if (RHI_SOLIDS && w[RHI_HAS_BORDER]) inside = 0;  // the layer may lie outside
    if (inside && texel >= 4) {
        first += y[0] * row + x[0];
        rhi_texture q = p + texel * row;
        switch (texel) {
        case 4:
            for (int word = 0; word < 16; ++word) taps[word] = (UINT)0u;
            rhi_pair(p, first, taps, taps + 4);
            rhi_pair(q, first, taps + 8, taps + 12);
            break;
        case 8:
            for (int tap = 0; tap < 4; ++tap) taps[4 * tap + 2] = taps[4 * tap + 3] = (UINT)0u;
            rhi_long_pair(p, first, taps, taps + 4);
            rhi_long_pair(q, first, taps + 8, taps + 12);
            break;
        default:
            for (int right = 0; right < 2; ++right) {
                rhi_long_pair(p + 16 * right, first * 2, taps + 4 * right, taps + 4 * right + 2);
                rhi_long_pair(q + 16 * right, first * 2, taps + 4 * right + 8, taps + 4 * right + 10);
            }
        }
        for (int tap = 0; tap < 4; ++tap) rhi_decode(w[RHI_ENCODING], w[RHI_CHANNELS], taps + 4 * tap);
    } else {
        rhi_edge(w[RHI_WRAP_U], width, x, x + 1);
        rhi_edge(w[RHI_WRAP_V], height, y, y + 1);
        for (int tap = 0; tap < 4; ++tap) {
            INT i = x[tap & 1], j = y[tap >> 1], k = layer;
            if (seams) rhi_cross(width, &k, &i, &j);
            if (seams || w[RHI_HAS_BORDER]) rhi_tap(t, w, level, i, j, k, taps + 4 * tap);
            else rhi_fetch(p, w, first + j * row + i, taps + 4 * tap);
        }
    }
    if (RHI_COMPARES && compared) {
        for (int tap = 0; tap < 4; ++tap) {
            taps[4 * tap] = as_UINT(rhi_passes(w, reference, as_FLOAT(taps[4 * tap])));
        }
    }
    if (seams) {  // three texels meet at a cube's corner: the fourth is their mean
        for (int tap = 0; tap < 4; ++tap) {
            INT i = x[tap & 1], j = y[tap >> 1];
            INT corner = BOTH(EITHER(i < 0, i >= width), EITHER(j < 0, j >= height));
            if (!ANY(corner)) continue;
            for (int c = 0; c < 4; ++c) {
                FLOAT sum = (FLOAT)0.0f;
                for (int other = 1; other < 4; ++other) sum += as_FLOAT(taps[4 * (tap ^ other) + c]);
                taps[4 * tap + c] = SELECT(taps[4 * tap + c], as_UINT(sum * (1.0f / 3.0f)), corner);
            }
        }
    }
}

static RHI_INLINE FLOAT rhi_mix(FLOAT a, FLOAT b, FLOAT at) { return fma(at, b - a, a); }

// Bilinear filter for four channels of 8 bits without a border: two adjacent texels are one load.
static RHI_FUSED void rhi_bilinear8(
    rhi_texture t, rhi_description w, rhi_description level, FLOAT u, FLOAT v, INT layer, UINT *r
) {
    INT x, y, right, below;
    int width = level[RHI_WIDTH], height = level[RHI_HEIGHT], row = level[RHI_ROW];
    FLOAT at_x = rhi_before(w[RHI_WRAP_U], width, u, &x), at_y = rhi_before(w[RHI_WRAP_V], height, v, &y);
    rhi_texture p = rhi_start(t, level);
    INT first = layer * level[RHI_LAYER];
    UINT a, b, c, d;
    int inside = rhi_inside(width, x);
    if (inside && rhi_inside(height, y)) {
        first += y * row + x;
        rhi_pair(p, first, &a, &b);
        rhi_pair(p + 4 * row, first, &c, &d);
    } else {
        rhi_edge(w[RHI_WRAP_V], height, &y, &below);
        INT above = first + y * row;
        below = first + below * row;
        if (inside) {
            rhi_pair(p, above + x, &a, &b);
            rhi_pair(p, below + x, &c, &d);
        } else {
            rhi_edge(w[RHI_WRAP_U], width, &x, &right);
            a = rhi_gather32(p, above + x);
            b = rhi_gather32(p, above + right);
            c = rhi_gather32(p, below + x);
            d = rhi_gather32(p, below + right);
        }
    }
    int curved = w[RHI_ENCODING] == RHI_SRGB8;
    _Pragma("unroll") for (uint k = 0; k < 4; ++k) {
        uint shift = 8u * k;
        FLOAT e = convert_FLOAT(as_INT(a >> shift & 255u)), f = convert_FLOAT(as_INT(b >> shift & 255u));
        FLOAT g = convert_FLOAT(as_INT(c >> shift & 255u)), h = convert_FLOAT(as_INT(d >> shift & 255u));
        float scale = 1.0f / 255.0f;
        if (curved && k < 3) {
            e = rhi_from_srgb(e);
            f = rhi_from_srgb(f);
            g = rhi_from_srgb(g);
            h = rhi_from_srgb(h);
            scale = 1.0f;
        }
        r[k] = as_UINT(rhi_mix(rhi_mix(e, f, at_x), rhi_mix(g, h, at_x), at_y) * scale);
    }
}

// The same for four half floats; a block of pixels that lies inside reads whole rows.
static RHI_FUSED void rhi_bilinear_half(
    rhi_texture t, rhi_description w, rhi_description level, FLOAT u, FLOAT v, INT layer, UINT *r
) {
    INT x, y;
    int width = level[RHI_WIDTH], height = level[RHI_HEIGHT], row = level[RHI_ROW];
    FLOAT at_x = rhi_before(w[RHI_WRAP_U], width, u, &x), at_y = rhi_before(w[RHI_WRAP_V], height, v, &y);
    rhi_texture p = rhi_start(t, level);
    INT first = layer * level[RHI_LAYER];
    UINT a[2], b[2], c[2], d[2];
    if (rhi_inside(width, x) && rhi_inside(height, y)) {
        first += y * row;
#ifdef RHI_GRID
        if (RHI_GRID(p, row, first, x, at_x, at_y, r)) return;
#endif
        first += x;
        rhi_long_pair(p, first, a, b);
        rhi_long_pair(p + 8 * row, first, c, d);
    } else {
        INT right, below;
        rhi_edge(w[RHI_WRAP_U], width, &x, &right);
        rhi_edge(w[RHI_WRAP_V], height, &y, &below);
        INT above = first + y * row;
        below = first + below * row;
        rhi_pair(p, (above + x) * 2, a, a + 1);
        rhi_pair(p, (above + right) * 2, b, b + 1);
        rhi_pair(p, (below + x) * 2, c, c + 1);
        rhi_pair(p, (below + right) * 2, d, d + 1);
    }
    _Pragma("unroll") for (int k = 0; k < 4; ++k) {
        uint shift = 16u * (k & 1);
        FLOAT e = rhi_from_half(a[k >> 1] >> shift & 65535u), f = rhi_from_half(b[k >> 1] >> shift & 65535u);
        FLOAT g = rhi_from_half(c[k >> 1] >> shift & 65535u), h = rhi_from_half(d[k >> 1] >> shift & 65535u);
        r[k] = as_UINT(rhi_mix(rhi_mix(e, f, at_x), rhi_mix(g, h, at_x), at_y));
    }
}

// Compares a reference with four depths, and filters the results: the bits of rhi_passes and rhi_mix.
static RHI_FUSED FLOAT
rhi_passed(rhi_description w, FLOAT reference, UINT a, UINT b, UINT c, UINT d, FLOAT at_x, FLOAT at_y) {
    FLOAT e = as_FLOAT(a), f = as_FLOAT(b), g = as_FLOAT(c), h = as_FLOAT(d);
    if (w[RHI_CLAMPS_REFERENCE]) reference = rhi_clamped(reference);
#define RHI_PASS(condition) \
    do { \
        FLOAT yes = (FLOAT)1.0f, no = (FLOAT)0.0f; \
        e = SELECT(no, yes, reference condition e), f = SELECT(no, yes, reference condition f); \
        g = SELECT(no, yes, reference condition g), h = SELECT(no, yes, reference condition h); \
    } while (0)
    switch (w[RHI_COMPARISON]) {
    case RHI_NEVER: return (FLOAT)0.0f;
    case RHI_LESS: RHI_PASS(<); break;
    case RHI_EQUAL: RHI_PASS(==); break;
    case RHI_LESS_EQUAL: RHI_PASS(<=); break;
    case RHI_GREATER: RHI_PASS(>); break;
    case RHI_NOT_EQUAL: RHI_PASS(!=); break;
    case RHI_GREATER_EQUAL: RHI_PASS(>=); break;
    case RHI_ALWAYS: return (FLOAT)1.0f;
    }
#undef RHI_PASS
    return rhi_mix(rhi_mix(e, f, at_x), rhi_mix(g, h, at_x), at_y);
}

// Filters comparisons of depth, 2D or a 2D array, with one level. Nothing but depth is read, so that no texel is
// decoded, and the result isn't in memory.
static RHI_CALLED FLOAT
rhi_compare_depth(rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference) {
    INT x, y, layer = rhi_layer(w, w + RHI_LEVELS, z);
    rhi_description level = w + RHI_LEVELS;
    int width = level[RHI_WIDTH], height = level[RHI_HEIGHT], row = level[RHI_ROW];
    FLOAT at_x = rhi_before(w[RHI_WRAP_U], width, u, &x), at_y = rhi_before(w[RHI_WRAP_V], height, v, &y);
    rhi_texture p = rhi_start(t, level);
    INT first = layer * level[RHI_LAYER];
    UINT a, b, c, d;
    if (rhi_inside(width, x) && rhi_inside(height, y)) {
#ifdef RHI_WINDOW
        if (!RHI_WINDOW(p, row, first, x, y, &a, &b, &c, &d))
#endif
        {
            first += y * row + x;
            rhi_pair(p, first, &a, &b);
            rhi_pair(p + 4 * row, first, &c, &d);
        }
    } else {
        INT right, below;
        rhi_edge(w[RHI_WRAP_U], width, &x, &right);
        rhi_edge(w[RHI_WRAP_V], height, &y, &below);
        INT i = rhi_within(x, width), j = rhi_within(right, width);
        INT above = first + rhi_within(y, height) * row, under = first + rhi_within(below, height) * row;
        a = rhi_gather32(p, above + i);
        b = rhi_gather32(p, above + j);
        c = rhi_gather32(p, under + i);
        d = rhi_gather32(p, under + j);
        if (w[RHI_HAS_BORDER]) {
            UINT border = (UINT)(uint)w[RHI_BORDER_COLOR];
            INT near_x = i == x, far_x = j == right, near_y = rhi_within(y, height) == y,
                far_y = rhi_within(below, height) == below;
            a = SELECT(border, a, BOTH(near_x, near_y));
            b = SELECT(border, b, BOTH(far_x, near_y));
            c = SELECT(border, c, BOTH(near_x, far_y));
            d = SELECT(border, d, BOTH(far_x, far_y));
        }
    }
    return rhi_passed(w, reference, a, b, c, d, at_x, at_y);
}

// Filters one level, or comparisons of its texels. In 2D and arrays `z` is the layer, in a cube the face.
static RHI_CALLED void rhi_filter(
    rhi_texture t, rhi_description w, rhi_description level, int linear, int compared, FLOAT u, FLOAT v,
    FLOAT z, FLOAT reference, UINT *r
) {
    int solid = RHI_SOLIDS && w[RHI_SHAPE] == RHI_SOLID;
    if (!linear) {
        INT i = rhi_nearest(w[RHI_WRAP_U], level[RHI_WIDTH], u),
            j = rhi_nearest(w[RHI_WRAP_V], level[RHI_HEIGHT], v);
        INT k = solid ? rhi_nearest(w[RHI_WRAP_W], level[RHI_DEPTH], z) : rhi_layer(w, level, z);
        if (w[RHI_HAS_BORDER]) rhi_tap(t, w, level, i, j, k, r);
        else rhi_texel(rhi_start(t, level), w, k * level[RHI_LAYER] + j * level[RHI_ROW] + i, r);
        if (RHI_COMPARES && compared) r[0] = as_UINT(rhi_passes(w, reference, as_FLOAT(r[0])));
        return;
    }
    if (w[RHI_PLAIN8]) {
        rhi_bilinear8(t, w, level, u, v, rhi_layer(w, level, z), r);
        return;
    }
    if (w[RHI_PLAIN_HALF]) {
        rhi_bilinear_half(t, w, level, u, v, rhi_layer(w, level, z), r);
        return;
    }
    int channels = w[RHI_CHANNELS];
    UINT taps[16];
    INT slices[2];
    FLOAT near[2], at_z = (FLOAT)0.0f;
    if (solid) at_z = rhi_around(w[RHI_WRAP_W], level[RHI_DEPTH], z, slices, slices + 1);
    else slices[0] = rhi_layer(w, level, z);
    for (int slice = 0; slice <= solid; ++slice) {
        rhi_taps(t, w, level, u, v, slices[slice], compared, reference, taps, near);
        for (int c = 0; c < channels; ++c) {
            FLOAT above = rhi_mix(as_FLOAT(taps[c]), as_FLOAT(taps[4 + c]), near[0]);
            FLOAT below = rhi_mix(as_FLOAT(taps[8 + c]), as_FLOAT(taps[12 + c]), near[0]);
            FLOAT mean = rhi_mix(above, below, near[1]);
            r[c] = as_UINT(slice ? rhi_mix(as_FLOAT(r[c]), mean, at_z) : mean);
        }
    }
    for (int c = channels; c < 4; ++c) r[c] = taps[c];
}

// -- levels ------------------------------------------------------------------------------------------------

// Filters each level that any lane needs, for all lanes; a lane mixes two. A weight of 1 copies, so that
// integers and infinities are kept.
static RHI_CALLED void rhi_walk(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT lod,
    UINT *r
) {
    rhi_description level = w + RHI_LEVELS;
    int minify = w[RHI_MINIFY], magnify = w[RHI_MAGNIFY], mip = w[RHI_MIP], last = w[RHI_LEVEL_COUNT] - 1;
    if (RHI_CUBES && w[RHI_SHAPE] == RHI_CUBE) z = convert_FLOAT(rhi_face(&u, &v, z));
    INT magnified = NOT(lod > 0.0f);
    FLOAT at = SELECT(lod, (FLOAT)0.0f, magnified), end = (FLOAT)(mip == RHI_NO_MIP ? 0 : last);
    at = SELECT(at, end, at > end);
    FLOAT first = mip == RHI_LINEAR_MIP ? rhi_floor(at) : rhi_round(at);
    FLOAT part = mip == RHI_LINEAR_MIP ? at - first : (FLOAT)0.0f;
    UINT one[4];
    int number = rhi_reduce_min(convert_INT(first));
    level += number * RHI_LEVEL_WORDS;
    if (minify == magnify && !ANY(first > (float)number)) {  // all lanes are between the same two levels
        rhi_filter(t, w, level, minify, compared, u, v, z, reference, r);
        if (!ANY(part > 0.0f)) return;
        rhi_filter(t, w, level + RHI_LEVEL_WORDS, minify, compared, u, v, z, reference, one);
        _Pragma("unroll") for (int c = 0; c < 4; ++c) {
            UINT sum = as_UINT(fma(part, as_FLOAT(one[c]), (1.0f - part) * as_FLOAT(r[c])));
            r[c] = SELECT(r[c], sum, part > 0.0f);
        }
        return;
    }
    for (int c = 0; c < 4; ++c) r[c] = (UINT)0u;
    for (; number <= last && ANY(first >= (float)(number - 1)); ++number, level += RHI_LEVEL_WORDS) {
        FLOAT weight = SELECT((FLOAT)0.0f, 1.0f - part, first == (float)number);
        weight = SELECT(weight, part, first == (float)(number - 1));
        if (!ANY(weight > 0.0f)) continue;
        for (int pass = 0; pass < 2; ++pass) {  // first the lanes that minify, then those that magnify
            INT these = BOTH(weight > 0.0f, pass ? magnified : NOT(magnified));
            if (minify == magnify) {
                if (pass) break;
                these = weight > 0.0f;
            }
            if (!ANY(these)) continue;
            int linear = pass ? magnify : minify;
            rhi_filter(t, w, level, linear, compared, u, v, z, reference, one);
            _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                UINT sum = as_UINT(fma(weight, as_FLOAT(one[c]), as_FLOAT(r[c])));
                r[c] = SELECT(r[c], SELECT(sum, one[c], weight == 1.0f), these);
            }
        }
    }
}

static RHI_FUSED void rhi_sampled(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT lod,
    UINT *r
) {
    if (RHI_COMPARES && compared && w[RHI_PLAIN_DEPTH]) {
        r[0] = as_UINT(rhi_compare_depth(t, w, u, v, z, reference));
        r[1] = r[2] = (UINT)0u;
        r[3] = (UINT)0x3f800000u;
    } else if (w[RHI_ONE_FILTER])
        rhi_filter(t, w, w + RHI_LEVELS, w[RHI_MINIFY], compared, u, v, z, reference, r);
    else rhi_walk(t, w, compared, u, v, z, reference, lod, r);
}

static RHI_INLINE void rhi_sample(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT lod, UINT *r
) {
    rhi_sampled(t, w, 0, u, v, z, u, lod, r);
}

static RHI_INLINE void rhi_sample_compare(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT lod, UINT *r
) {
    rhi_sampled(t, w, 1, u, v, z, reference, lod, r);
}

// log2 of positive numbers, within 1.2e-4, FAST within 0.087; large for infinity and NaN, small for 0.
static RHI_INLINE FLOAT rhi_level_log2(FLOAT x) {
    INT bits = as_INT(x);
    if (RHI_FAST) return fma(convert_FLOAT(bits), (FLOAT)0x1p-23f, (FLOAT)-127.0f);
    FLOAT m = as_FLOAT((bits & 0x7fffff) | 0x3f800000) - 1.0f;
    return convert_FLOAT((bits >> 23) - 127) + LOG2_CURVE;
}

// -- what a pixel covers -----------------------------------------------------------------------------------

// Replaces the steps to the next pixels, in coordinates, by those in texels of the largest level.
static RHI_INLINE void rhi_in_texels(
    rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT *ux, FLOAT *vx, FLOAT *zx, FLOAT *uy, FLOAT *vy,
    FLOAT *zy
) {
    rhi_description level = w + RHI_LEVELS;
    float width = level[RHI_WIDTH], height = level[RHI_HEIGHT];
    float depth = RHI_SOLIDS && w[RHI_SHAPE] == RHI_SOLID ? level[RHI_DEPTH] : 0;
    if (RHI_CUBES && w[RHI_SHAPE] == RHI_CUBE) {  // d(s / m) = (ds - s / m dm) / m, and a face is 2 wide
        INT is_y, is_z, negative;
        FLOAT s, t, m, ds, dt, dm;
        rhi_axis(u, v, z, &is_y, &is_z, &negative);
        rhi_project(is_y, is_z, negative, u, v, z, &s, &t, &m);
        FLOAT half_ = 0.5f / m;
        s /= m;
        t /= m;
        rhi_project(is_y, is_z, negative, *ux, *vx, *zx, &ds, &dt, &dm);
        *ux = (ds - s * dm) * half_;
        *vx = (dt - t * dm) * half_;
        rhi_project(is_y, is_z, negative, *uy, *vy, *zy, &ds, &dt, &dm);
        *uy = (ds - s * dm) * half_;
        *vy = (dt - t * dm) * half_;
    }
    *ux *= width, *vx *= height, *uy *= width, *vy *= height;
    *zx = depth > 0.0f ? *zx * depth : (FLOAT)0.0f;
    *zy = depth > 0.0f ? *zy * depth : (FLOAT)0.0f;
}

// Returns the level at which the longer of the steps to the next pixels is one texel.
static RHI_CALLED FLOAT rhi_level_of_detail(
    rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT ux, FLOAT vx, FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy,
    FLOAT bias
) {
    if (w[RHI_ONE_FILTER]) return (FLOAT)0.0f;  // the level is not used
    rhi_in_texels(w, u, v, z, &ux, &vx, &zx, &uy, &vy, &zy);
    FLOAT across = ux * ux + vx * vx, down = uy * uy + vy * vy;
    if (RHI_SOLIDS) across += zx * zx, down += zy * zy;
    return 0.5f * rhi_level_log2(SELECT(across, down, down > across)) + bias;
}

// Averages samples along the longer axis of the ellipse that a pixel covers, at the level of the shorter one.
// Each stands for a cell as long as the shorter axis. Cells are laid from both ends, and what is left in the
// middle is one or two cells of less weight; so nothing jumps where one cell more is covered. The axes are
// the singular vectors of the matrix of both steps.
static RHI_CALLED void rhi_average(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT ux,
    FLOAT vx, FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    FLOAT ax = ux, ay = vx, az = zx, bx = uy, by = vy, bz = zy;
    rhi_in_texels(w, u, v, z, &ax, &ay, &az, &bx, &by, &bz);
    FLOAT across = ax * ax + ay * ay + az * az, down = bx * bx + by * by + bz * bz;
    FLOAT step = SELECT(across, down, down > across);
    INT regular =
        BOTH(step > 0x1p-100f, across + down < 0x1p100f);  // else one sample, at the level of the longer step
    FLOAT scale = 1.0f / SELECT((FLOAT)1.0f, step, regular);
    FLOAT half_ = (across - down) * 0.5f * scale, product = (ax * bx + ay * by + az * bz) * scale;
    FLOAT spread = sqrt(half_ * half_ + product * product), longest = (across + down) * 0.5f * scale + spread;
    FLOAT ox = (ay * bz - az * by) * scale, oy = (az * bx - ax * bz) * scale,
          oz = (ax * by - ay * bx) * scale;
    FLOAT most = (FLOAT)as_float(w[RHI_ANISOTROPY]), ratio = longest / sqrt(ox * ox + oy * oy + oz * oz);
    ratio = SELECT(most, ratio, ratio < most);
    longest *= step;  // the squares of the longer axis and of a cell; less than a texel shows nothing more
    FLOAT cell = longest / (ratio * ratio), least = SELECT((FLOAT)1.0f, longest, longest < 1.0f);
    cell = SELECT(least, cell, cell > least);
    ratio = SELECT((FLOAT)1.0f, sqrt(longest / cell), BOTH(regular, longest > cell));
    FLOAT lod = 0.5f * rhi_level_log2(SELECT(step, cell, regular)) + bias;
    FLOAT right = SELECT(product, half_ + spread, half_ > 0.0f),
          below = SELECT(spread - half_, product, half_ > 0.0f);
    FLOAT length_ = sqrt(right * right + below * below) * ratio;
    INT turned = BOTH(regular, length_ > 0.0f);
    right = SELECT((FLOAT)0.0f, right / length_, turned);
    below = SELECT((FLOAT)0.0f, below / length_, turned);
    ux = SELECT((FLOAT)0.0f, right * ux + below * uy, turned);  // from cell to cell
    vx = SELECT((FLOAT)0.0f, right * vx + below * vy, turned);
    zx = SELECT((FLOAT)0.0f, right * zx + below * zy, turned);
    UINT one[4];
    for (int c = 0; c < 4; ++c) r[c] = (UINT)0u;
    for (FLOAT left = ratio; ANY(left > 0.0f); left -= 2.0f) {  // a cell at each end of what is left
        FLOAT at = SELECT((FLOAT)0.0f, left * 0.5f - 0.5f, left > 1.0f);
        FLOAT weight = SELECT((FLOAT)1.0f, left * 0.5f, left < 2.0f);
        int single = !ANY(at > 0.0f);
        if (single) weight *= 2.0f;
        for (int side = single; side < 2; ++side, at = -at) {
            rhi_sampled(t, w, compared, fma(at, ux, u), fma(at, vx, v), fma(at, zx, z), reference, lod, one);
            _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                UINT sum = as_UINT(fma(weight, as_FLOAT(one[c]), as_FLOAT(r[c])));
                r[c] = SELECT(r[c], sum, weight > 0.0f);
            }
        }
    }
    for (int c = 0; c < 4; ++c) r[c] = as_UINT(as_FLOAT(r[c]) / ratio);
}

// Samples what a pixel covers, by the steps to the next pixels: as the sampler says, an ellipse or a square
// around it.
static RHI_FUSED void rhi_covered(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT ux,
    FLOAT vx, FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    if (w[RHI_ANISOTROPY]) {
        rhi_average(t, w, compared, u, v, z, reference, ux, vx, zx, uy, vy, zy, bias, r);
        return;
    }
    FLOAT lod = (FLOAT)0.0f;
    if (!w[RHI_ONE_FILTER]) lod = rhi_level_of_detail(w, u, v, z, ux, vx, zx, uy, vy, zy, bias);
    rhi_sampled(t, w, compared, u, v, z, reference, lod, r);
}

static RHI_INLINE void rhi_sample_grad(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT ux, FLOAT vx, FLOAT zx, FLOAT uy,
    FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    rhi_covered(t, w, 0, u, v, z, u, ux, vx, zx, uy, vy, zy, bias, r);
}

static RHI_INLINE void rhi_sample_compare_grad(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT ux, FLOAT vx,
    FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    rhi_covered(t, w, 1, u, v, z, reference, ux, vx, zx, uy, vy, zy, bias, r);
}

// -- single texels -----------------------------------------------------------------------------------------

// Reads one component of the four texels around a point: counterclockwise from the lower left, with v up.
static RHI_CALLED void rhi_square(
    rhi_texture t, rhi_description w, int component, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference,
    UINT *r
) {
    UINT taps[16];
    FLOAT near[2];
    rhi_description level = w + RHI_LEVELS;
    if (RHI_CUBES && w[RHI_SHAPE] == RHI_CUBE) z = convert_FLOAT(rhi_face(&u, &v, z));
    INT left = rhi_reflect(w[RHI_WRAP_U], &u), up = rhi_reflect(w[RHI_WRAP_V], &v);
    rhi_taps(t, w, level, u, v, rhi_layer(w, level, z), compared, reference, taps, near);
    UINT a = SELECT(taps[component], taps[4 + component], left);
    UINT b = SELECT(taps[4 + component], taps[component], left);
    UINT c = SELECT(taps[8 + component], taps[12 + component], left);
    UINT d = SELECT(taps[12 + component], taps[8 + component], left);
    r[0] = SELECT(c, a, up);
    r[1] = SELECT(d, b, up);
    r[2] = SELECT(b, d, up);
    r[3] = SELECT(a, c, up);
}

static RHI_INLINE void rhi_gather(
    rhi_texture t, rhi_description w, int component, FLOAT u, FLOAT v, FLOAT z, UINT *r
) {
    rhi_square(t, w, component, 0, u, v, z, u, r);
}

static RHI_INLINE void rhi_gather_compare(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, UINT *r
) {
    rhi_square(t, w, 0, 1, u, v, z, reference, r);
}

// Reads a texel; zeros outside the texture.
static RHI_CALLED void rhi_load_any(
    rhi_texture t, rhi_description w, INT x, INT y, INT z, int number, UINT *r
) {
    int count = w[RHI_LEVEL_COUNT];
    rhi_description level = w + RHI_LEVELS + RHI_LEVEL_WORDS * clamp(number, 0, count - 1);
    INT i = rhi_within(x, level[RHI_WIDTH]), j = rhi_within(y, level[RHI_HEIGHT]),
        k = rhi_within(z, level[RHI_DEPTH]);
    INT inside = BOTH(BOTH(i == x, j == y), k == z);
    if (number < 0 || number >= count) inside = (INT)0;
    rhi_texture p = rhi_start(t, level);
#ifdef RHI_BLOCK
    if (!RHI_BLOCK(p, w, level, x, y, k, r))
#endif
        rhi_texel(p, w, k * level[RHI_LAYER] + j * level[RHI_ROW] + i, r);
    _Pragma("unroll") for (int c = 0; c < 4; ++c) r[c] = SELECT((UINT)0u, r[c], inside);
}

// Gathers words, or loads them if they lie in a row.
static RHI_INLINE UINT rhi_row32(rhi_texture p, INT i) {
#ifdef RHI_LANES
    if (!ANY(i - i.s0 != RHI_LANES)) return *(global const rhi_words *)((global const uint *)p + i.s0);
#endif
    return rhi_gather32(p, i);
}

// The same, inline for texels of one float, such as depth: a call takes as long as the read.
static RHI_INLINE void rhi_load(rhi_texture t, rhi_description w, INT x, INT y, INT z, int number, UINT *r) {
#ifndef RHI_BLOCK
    if (w[RHI_TEXEL_BYTES] == 4 && w[RHI_ENCODING] == RHI_SINGLE) {
        int count = w[RHI_LEVEL_COUNT];
        rhi_description level = w + RHI_LEVELS + RHI_LEVEL_WORDS * clamp(number, 0, count - 1);
        INT i = rhi_within(x, level[RHI_WIDTH]), j = rhi_within(y, level[RHI_HEIGHT]),
            k = rhi_within(z, level[RHI_DEPTH]);
        INT inside = BOTH(BOTH(i == x, j == y), k == z);
        if (number < 0 || number >= count) inside = (INT)0;
        r[0] = SELECT(
            (UINT)0u, rhi_row32(rhi_start(t, level), k * level[RHI_LAYER] + j * level[RHI_ROW] + i), inside
        );
        r[1] = r[2] = (UINT)0u;
        r[3] = SELECT((UINT)0u, (UINT)0x3f800000u, inside);
        return;
    }
#endif
    rhi_load_any(t, w, x, y, z, number, r);
}

// Reads a texel from a different level in each lane.
static RHI_CALLED void rhi_load_each(
    rhi_texture t, rhi_description w, INT x, INT y, INT z, INT number, UINT *r
) {
    UINT one[4];
    for (int c = 0; c < 4; ++c) r[c] = (UINT)0u;
    for (int level = 0; level < w[RHI_LEVEL_COUNT]; ++level) {
        INT these = number == level;
        if (!ANY(these)) continue;
        rhi_load(t, w, x, y, z, level, one);
        for (int c = 0; c < 4; ++c) r[c] = SELECT(r[c], one[c], these);
    }
}

// Returns the size along an axis of a level, or of the nearest level that exists.
static RHI_INLINE INT rhi_size_each(rhi_description w, INT number, int axis) {
    INT level = rhi_within(number, w[RHI_LEVEL_COUNT]);
    return as_INT(rhi_gather32((rhi_texture)(w + RHI_LEVELS + RHI_WIDTH + axis), level * RHI_LEVEL_WORDS));
}

static RHI_INLINE UINT rhi_scaled(UINT value, float low, float scale) {
    FLOAT x = as_FLOAT(value);
    x = SELECT((FLOAT)low, x, x > low);  // NaN becomes `low`
    x = SELECT((FLOAT)1.0f, x, x < 1.0f);
    return as_UINT(convert_INT(rhi_round(x * scale)));
}

// Returns the bits of an unsigned float with 5 bits of exponent and `fraction` bits behind it, rounded to
// nearest even.
static RHI_INLINE UINT rhi_unsigned_bits(UINT bits, uint fraction) {
    uint shift = 23u - fraction, endless = 31u << fraction;
    UINT size = bits & 0x7fffffffu;
    float grain = 512.0f / (1u << fraction);  // the addition rounds at the step of the smallest numbers
    UINT tiny = as_UINT(as_FLOAT(size) + grain) - as_uint(grain);
    UINT usual = (size - 0x38000000u + ((1u << (shift - 1u)) - 1u) + (size >> shift & 1u)) >> shift;
    usual = SELECT(usual, (UINT)(endless - 1u), usual >= endless);  // finite numbers stay finite
    usual = SELECT(usual, tiny, size < 0x38800000u);
    usual = SELECT(usual, (UINT)endless, size == 0x7f800000u);
    usual = SELECT(usual, (UINT)0u, bits != size);
    return SELECT(usual, (UINT)(endless | 1u), size > 0x7f800000u);
}

// Writes a texel for the lanes of the mask whose coordinates lie inside.
static RHI_CALLED void rhi_store(
    rhi_image t, INT mask, rhi_description w, INT x, INT y, INT z, UINT r0, UINT r1, UINT r2, UINT r3
) {
    rhi_description level = w + RHI_LEVELS;
    rhi_image p = t + (size_t)(uint)level[RHI_START] * RHI_LEVEL_ALIGNMENT;
    INT i = rhi_within(x, level[RHI_WIDTH]), j = rhi_within(y, level[RHI_HEIGHT]),
        k = rhi_within(z, level[RHI_DEPTH]);
    mask = BOTH(mask, BOTH(BOTH(i == x, j == y), k == z));
    i += k * level[RHI_LAYER] + j * level[RHI_ROW];
    UINT r[4] = {r0, r1, r2, r3};
    for (int c = 0; c < 4; ++c) {
        switch (w[RHI_ENCODING]) {
        case RHI_UNORM8: r[c] = rhi_scaled(r[c], 0.0f, 255.0f); break;
        case RHI_SNORM8: r[c] = rhi_scaled(r[c], -1.0f, 127.0f) & 255u; break;
        case RHI_UNORM16: r[c] = rhi_scaled(r[c], 0.0f, 65535.0f); break;
        case RHI_HALF: r[c] = rhi_half_bits(as_FLOAT(r[c])); break;
        case RHI_UNORM10: r[c] = rhi_scaled(r[c], 0.0f, c < 3 ? 1023.0f : 3.0f) << (uint)(10 * c); break;
        case RHI_UFLOAT11:
            r[c] = c < 3 ? rhi_unsigned_bits(r[c], c < 2 ? 6u : 5u) << (uint)(11 * c) : (UINT)0u;
            break;
        case RHI_INTEGER10: r[c] = (r[c] & (c < 3 ? 1023u : 3u)) << (uint)(10 * c); break;
        case RHI_INTEGER8: r[c] &= 255u; break;
        case RHI_INTEGER16: r[c] &= 65535u; break;
        }
    }
    int texel = w[RHI_TEXEL_BYTES], channel = texel / w[RHI_CHANNELS], stored = w[RHI_ENCODING];
    if (stored == RHI_UNORM10 || stored == RHI_UFLOAT11 || stored == RHI_INTEGER10) {
        r[0] |= r[1] | r[2] | r[3];
        channel = 4;
    }
    if (channel == 1) r[0] |= r[1] << 8u | r[2] << 16u | r[3] << 24u;
    if (channel == 2) r[0] |= r[1] << 16u, r[1] = r[2] | r[3] << 16u;
    switch (texel) {
    case 1: rhi_scatter8(p, i, mask, r[0]); break;
    case 2: rhi_scatter16(p, i, mask, r[0]); break;
    default:
        for (int word = 0; word < texel / 4; ++word)
            rhi_scatter32(p + 4 * word, i * (texel / 4), mask, r[word]);
    }
}
