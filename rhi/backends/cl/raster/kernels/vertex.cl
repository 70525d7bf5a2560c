// Vertex processing: 16 vertices at a time through the program's vertex stage, and to window positions.
//
// - Each work-item processes some groups. A group's attributes are gathered as words and transposed.
// - Output per vertex: its window position {x, y in subtexels, depth, 1/w} and its varyings. A vertex without
//   a window position (in front of the near or behind the far plane, or too far outside) is marked by 1/w =
//   -1, and its x holds the planes that it lies behind. Clip positions of all vertices are stored as well,
//   since any of them may belong to a primitive that is clipped. They can't be derived from window positions,
//   whose rounding tilts planes that reach to the horizon.
// - The stage and the macros of kernel_structs.py precede this text: INPUT_WORDS, VARYING_WORDS, FETCH,
//   BINDINGS.

DEFINE_DRAW_SEARCH(search_vertex_draw, vertex_group)

// Load one word or up to four words of 16 vertices, which INDEX locates in memory. Up to 12 bytes beyond the
// last word are read.
#define GATHER(INDEX) \
    if (count == 1) { \
        words[0] = (uint16)(WORD(INDEX, 0), WORD(INDEX, 1), WORD(INDEX, 2), WORD(INDEX, 3), WORD(INDEX, 4), \
                            WORD(INDEX, 5), WORD(INDEX, 6), WORD(INDEX, 7), WORD(INDEX, 8), WORD(INDEX, 9), \
                            WORD(INDEX, 10), WORD(INDEX, 11), WORD(INDEX, 12), WORD(INDEX, 13), \
                            WORD(INDEX, 14), WORD(INDEX, 15)); \
    } else { \
        uint16 rows[4]; \
        UNROLL_FOR (int i = 0; i < 4; ++i) \
            rows[i] = (uint16)(FOUR(INDEX, i), FOUR(INDEX, i + 4), FOUR(INDEX, i + 8), FOUR(INDEX, i + 12)); \
        transpose4(rows, words); \
    }
#define WORD(INDEX, lane) *(global const uint *)(attribute + INDEX(lane) * stride)
#define FOUR(INDEX, lane) *(global const word_uint4 *)(attribute + INDEX(lane) * stride)

INLINE void gather(
    global const uchar *attribute, const int *vertices, const long stride, const int count, uint16 *words
){
#define INDEXED(lane) vertices[lane]
    GATHER(INDEXED)
}

// The same for consecutive vertices, whose offsets are known at compile time.
INLINE
    void gather_consecutive(global const uchar *attribute, const long stride, const int count, uint16 *words){
#define CONSECUTIVE(lane) (lane)
        GATHER(CONSECUTIVE)
    }

// Load the same words for all lanes.
INLINE void spread(global const uchar *attribute, uint16 *words) {
    UNROLL_FOR (int i = 0; i < 4; ++i) words[i] = (uint16)(((global const uint *)attribute)[i]);
}

// Extract components from packed words.
#define FIELD(word, shift, bits) ((word) >> (shift) & ((1u << (bits)) - 1u))
#define SIGNED(word, shift, bits) (as_int16((word) << (32 - (shift) - (bits))) >> (32 - (bits)))
#define UNORM(word, shift, bits) \
    as_uint16(convert_float16(FIELD(word, shift, bits)) * (1.0f / ((1u << (bits)) - 1u)))
#define SNORM(word, shift, bits) \
    as_uint16(max(convert_float16(SIGNED(word, shift, bits)) * (1.0f / ((1u << ((bits) - 1)) - 1u)), -1.0f))

INLINE uint16 read_half_bits(uint16 word, const int shift) {
    uint16 stored = FIELD(word, shift, 16), size = (stored & 0x7FFFu) << 13, exponent = size & 0x0F800000u;
    float16 tiny = as_float16(size + 0x38800000u) - 0x1p-14f;
    uint16 value = exponent == 0x0F800000u ? size + 0x70000000u : size + 0x38000000u;
    value = exponent == 0u ? as_uint16(tiny) : value;
    return value | (stored & 0x8000u) << 16;
}

// Store the outputs of a stage, given as a vector of 16 vertices for each word. `width`: words per vertex, a
// multiple of 4.
INLINE void store_words(global uint *memory, const uint16 *words, const int width) {
    UNROLL_FOR (int i = 0; i < width; i += 4) {
        uint16 rows[4];
        transpose4(words + i, rows);
        if (width == 4) {
            uint16 whole[4];
            exchange_quarters(rows, whole);
            UNROLL_FOR (int j = 0; j < 4; ++j) ((global uint16 *)memory)[j] = whole[j];
            return;
        }
        UNROLL_FOR (int j = 0; j < 4; ++j) {
            vstore4(rows[j].s0123, 0, memory + j * width + i);
            vstore4(rows[j].s4567, 0, memory + (j + 4) * width + i);
            vstore4(rows[j].s89ab, 0, memory + (j + 8) * width + i);
            vstore4(rows[j].scdef, 0, memory + (j + 12) * width + i);
        }
    }
}

#ifdef VERTEX_FAULTS
// Record the first number of a vertex or instance that a checked program doesn't have
// (rhi.shading.ir.faults).
#define REPORT(wrong, number, last) \
    if ((wrong) && atomic_cmpxchg((volatile global int *)VERTEX_FAULTS, 0, VERTEX_LINE) == 0) { \
        VERTEX_FAULTS[1] = number; \
        VERTEX_FAULTS[2] = last + 1; \
    }
#endif

// Load the attributes of 16 vertices of an instance, and return their numbers. The last group repeats the
// last vertex. Numbers beyond the buffers, which indices and bases may give, read the nearest vertex or
// instance there is.
INLINE int16 fetch(global const Draw *draw, global const ulong *row, int part, int numbered, uint16 *inputs) {
    const int last = draw->vertices - 1 - part * GROUP;
    int16 vertex = part * GROUP + min(LANES, last);
    if (draw->vertex_indices) vertex = load_indices(draw->vertex_indices, draw->vertex_index_bytes, vertex);
    vertex += draw->first_vertex;
    const int first = draw->first_vertex + part * GROUP;
    const bool consecutive = last >= GROUP - 1 && !draw->vertex_indices && first >= 0 &&
        first <= draw->last_vertex - (GROUP - 1);
    int vertices[GROUP];
    vstore16(clamp(vertex, 0, draw->last_vertex), 0, vertices);
#ifdef VERTEX_FAULTS
    int named[GROUP];
    vstore16(vertex, 0, named);
    for (int i = 0; i < GROUP; ++i) REPORT(vertices[i] != named[i], named[i], draw->last_vertex)
    REPORT(numbered > draw->last_instance || numbered < 0, numbered, draw->last_instance)
#endif
    FETCH
    return vertex;
}

INLINE global const ulong *bound_words(global const Batch *batch, global const Draw *draw) {
    return AT(const ulong, batch->bindings) + (long)draw->binding_index * batch->binding_words;
}

#ifdef RHI_BOXED
// Before an instance is transformed, the box of its vertices' attributes is. If the clip position is an
// affine function of up to four words, all vertices lie within the hull of the box's corners, which are
// computed by the same stage, one per lane. The result is exact up to rounding, and the stage also returns a
// bound for that (rhi.shading.lowering.bounds).

#define COUNT_WORD(word) +(VERTEX_WORDS >> word & 1)
#define COUNT_OTHER(word) +(~VERTEX_WORDS >> word & 1)
enum { BOX_WORDS = 0 RHI_BOXED(COUNT_WORD), OTHER_WORDS = 0 RHI_BOXED(COUNT_OTHER), MAX_BOX_WORDS = 4 };

// Bound of the rounding error of a window position, here and in transform, relative to its terms: 16 times
// 2^-24, including divisions of 2.5 units; then doubled.
#define WINDOW_ROUNDING 0x1p-19f

// Return how far window positions or depths of vertices may lie outside of those of the corners. `ratio`: p /
// w of a corner. With errors dp and dw, a vertex is off by (dp - p / w dw) / w, which grows slower than p /
// w, so corners bound all of them.
INLINE float16
rounding_slack(float16 ratio, float slack, float slack_w, float min_w, float scale, float shift) {
    return (slack + fabs(ratio) * slack_w) / min_w * (fabs(scale) * 1.001f) +
        WINDOW_ROUNDING * (fabs(ratio * scale) + fabs(shift));
}

// Find an upper bound of the extent of an instance's vertices.
void bound_extent(global const View *view, const uint16 *outputs, Extent *extent) {
    float16 x = as_float16(outputs[0]), y = as_float16(outputs[1]), z = as_float16(outputs[2]);
    float16 w = as_float16(outputs[3]);
    float slack_x = as_float(outputs[4].s0), slack_y = as_float(outputs[5].s0);
    float slack_z = as_float(outputs[6].s0);
    float slack_w = as_float(outputs[7].s0);
    extent->behind = reduce_and(
        ((z < -slack_z) & 1) | ((w - z < -(slack_z + slack_w)) & 2) | ((w + x < -(slack_x + slack_w)) & 4) |
        ((w - x < -(slack_x + slack_w)) & 8) | ((w + y < -(slack_y + slack_w)) & 16) |
        ((w - y < -(slack_y + slack_w)) & 32)
    );
    float min_w = reduce_min(w) - 2.0f * slack_w;
    extent->fit = min_w > 2.0f * slack_w && reduce_min(z) > slack_z && reduce_min(w - z) > slack_z + slack_w;
    if (!extent->fit) return;
    float16 ratio_x = x / w, ratio_y = y / w, ratio_z = z / w;
    float16 window_x = ratio_x * view->scale[0] + view->shift[0];
    float16 window_y = ratio_y * view->scale[1] + view->shift[1];
    float16 depth = ratio_z * view->scale[2] + view->shift[2];
    float16 aside_x = rounding_slack(ratio_x, slack_x, slack_w, min_w, view->scale[0], view->shift[0]);
    float16 aside_y = rounding_slack(ratio_y, slack_y, slack_w, min_w, view->scale[1], view->shift[1]);
    float16 aside = rounding_slack(ratio_z, slack_z, slack_w, min_w, view->scale[2], view->shift[2]);
    float low_x = (reduce_min(window_x - aside_x) - 0.5f) * SUBTEXELS - 2.0f;
    float low_y = (reduce_min(window_y - aside_y) - 0.5f) * SUBTEXELS - 2.0f;
    float high_x = (reduce_max(window_x + aside_x) - 0.5f) * SUBTEXELS + 2.0f;
    float high_y = (reduce_max(window_y + aside_y) - 0.5f) * SUBTEXELS + 2.0f;
    extent->fit = low_x > -POSITION_LIMIT && low_y > -POSITION_LIMIT && high_x < POSITION_LIMIT &&
        high_y < POSITION_LIMIT;
    if (!extent->fit) return;
    extent->low_x = (int)low_x;
    extent->low_y = (int)low_y;
    extent->high_x = (int)high_x;
    extent->high_y = (int)high_y;
    extent->low = reduce_min(depth - aside);
    extent->high = reduce_max(depth + aside);
}

// Return whether an instance needn't be transformed reason set-up would cull it.
bool is_box_invisible(
    global const Batch *batch, global const Draw *draw, global const View *view, global const ulong *row,
    int numbered
) {
    if (BOX_WORDS > MAX_BOX_WORDS) return false;
    global const float *box = AT(const float, draw->box & ~1ul);
    uint16 inputs[INPUT_WORDS + 1], outputs[8];
    uint reaches[INPUT_WORDS + 1];
    if (OTHER_WORDS) fetch(draw, row, 0, numbered, inputs);  // the attributes of instances
    int side = 0;
#define PUT_CORNERS(word) \
    if (~VERTEX_WORDS >> word & 1) reaches[word] = as_uint(fabs(as_float(inputs[word].s0))); \
    else { \
        float low = box[2 * side], high = box[2 * side + 1]; \
        inputs[word] = as_uint16((LANES >> side & 1) == 0 ? (float16)(low) : (float16)(high)); \
        reaches[word] = as_uint(fmax(fabs(low), fabs(high))); \
        ++side; \
    }
    RHI_BOXED(PUT_CORNERS)
    rhi_bounds(BINDINGS inputs, reaches, (int16)(0), numbered, draw->number, (int16)(-1), outputs);
    Extent extent;
    bound_extent(view, outputs, &extent);
    return is_invisible(batch, draw, view, &extent);
}

// Measure the box of a draw's attributes, word by word; NaN if one of them isn't finite.
SINGLE measure(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    global const Draw *draw = AT(const Draw, batch->draws) + get_global_id(0);
    if (BOX_WORDS > MAX_BOX_WORDS || !(draw->box & 1)) return;
    global const ulong *row = bound_words(batch, draw);
    float16 lows[MAX_BOX_WORDS], highs[MAX_BOX_WORDS];
    UNROLL_FOR (int i = 0; i < MAX_BOX_WORDS; ++i) {
        lows[i] = (float16)(INFINITY);
        highs[i] = (float16)(-INFINITY);
    }
    int16 finite = (int16)(-1);
    for (int part = 0; part < draw->vertex_groups; ++part) {
        uint16 inputs[INPUT_WORDS + 1];
        fetch(draw, row, part, 0, inputs);
        int side = 0;
#define ADD_WORD(word) \
    if (VERTEX_WORDS >> word & 1) { \
        float16 value = as_float16(inputs[word]); \
        finite &= fabs(value) < INFINITY; \
        lows[side] = value < lows[side] ? value : lows[side]; \
        highs[side] = value > highs[side] ? value : highs[side]; \
        side = side + 1 & MAX_BOX_WORDS - 1; \
    }
        RHI_BOXED(ADD_WORD)
    }
    global float *box = AT(float, draw->box & ~1ul);
    const bool bounded = reduce_and(finite) != 0;
    UNROLL_FOR (int i = 0; i < MAX_BOX_WORDS; ++i) {
        box[2 * i] = bounded ? reduce_min(lows[i]) : NAN;
        box[2 * i + 1] = bounded ? reduce_max(highs[i]) : NAN;
    }
}
#endif

SINGLE transform(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    global const Draw *draws = AT(const Draw, batch->draws);
    int group = get_global_id(0) * batch->vertex_chunk;
    int end = min(group + batch->vertex_chunk, batch->vertex_groups);
    int draw_number = search_vertex_draw(draws, batch->draw_count, group);
    while (group < end) {
        while (group >= draws[draw_number + 1].vertex_group) ++draw_number;
        global const Draw *draw = draws + draw_number;
        if (is_dropped(draw)) {
            group = draws[draw_number + 1].vertex_group;
            continue;
        }
        global const View *view = AT(const View, batch->views) + draw->view;
        global const ulong *row = bound_words(batch, draw);
        int instance = (group - draw->vertex_group) / draw->vertex_groups;
        int part = (group - draw->vertex_group) - instance * draw->vertex_groups;
        int parts = min(draw->vertex_groups, part + end - group);
        int numbered = draw->base_instance + instance;
        global Extent *extent = AT(Extent, batch->extents) + group;
#ifdef RHI_BOXED
        if (draw->box && is_box_invisible(batch, draw, view, row, numbered)) {
            extent->behind = -1;
            group += parts - part;
            continue;
        }
#endif
        int16 low_x = (int16)(INT_MAX), low_y = low_x, high_x = (int16)(INT_MIN), high_y = high_x;
        int16 all_behind = (int16)(-1);
        float16 low = (float16)(INFINITY), high = -low;
        uint any_fit = 0, any_unfit = 0;
        for (; part < parts; ++part, ++group) {
            uint16 inputs[INPUT_WORDS + 1], outputs[4 + VARYING_WORDS];
            int16 vertex = fetch(draw, row, part, numbered, inputs);
            const int last = draw->vertices - 1 - part * GROUP;
            UNROLL_FOR (int i = 0; i < 4 + VARYING_WORDS; ++i) outputs[i] = (uint16)(0u);
            rhi_vertex(BINDINGS inputs, vertex, numbered, draw->number, LANES <= last, outputs);

            float16 x = as_float16(outputs[0]), y = as_float16(outputs[1]), z = as_float16(outputs[2]);
            float16 w = as_float16(outputs[3]), inverse_w = 1.0f / w;
            float16 window_x = fma(x * inverse_w, (float16)(view->scale[0]), (float16)(view->shift[0]));
            float16 window_y = fma(y * inverse_w, (float16)(view->scale[1]), (float16)(view->shift[1]));
            float16 depth = fma(z * inverse_w, (float16)(view->scale[2]), (float16)(view->shift[2]));
            float16 sub_x = (window_x - 0.5f) * SUBTEXELS, sub_y = (window_y - 0.5f) * SUBTEXELS;
            int16 fits = (w > 0.0f) & (z >= 0.0f) & (z <= w) & (fabs(sub_x) < POSITION_LIMIT) &
                (fabs(sub_y) < POSITION_LIMIT);
            int16 fixed_x = as_int16(sub_x + 12582912.0f) - 0x4B400000;
            int16 fixed_y = as_int16(sub_y + 12582912.0f) - 0x4B400000;
            long slot = (long)group * GROUP;
            low_x = min(low_x, fixed_x);
            low_y = min(low_y, fixed_y);
            high_x = max(high_x, fixed_x);
            high_y = max(high_y, fixed_y);
            low = depth < low ? depth : low;
            high = depth > high ? depth : high;
            const uint unfit = bits_of(~fits);
            any_unfit |= unfit;
            any_fit |= ~unfit & 0xFFFFu;
            if (unfit) {
                int16 behind = ((z < 0.0f) & 1) | ((z > w) & 2) | ((x < -w) & 4) | ((x > w) & 8) |
                    ((y < -w) & 16) | ((y > w) & 32);
                fixed_x = fits ? fixed_x : behind;
                inverse_w = fits ? inverse_w : (float16)(-1.0f);
                all_behind &= behind;
            }
            // Few clip positions are ever read, so they are stored by component, without a transposition.
            UNROLL_FOR (int i = 0; i < 4; ++i) AT(uint16, batch->clips)[4 * (long)group + i] = outputs[i];
            uint16 position[4] = {
                as_uint16(fixed_x), as_uint16(fixed_y), as_uint16(depth), as_uint16(inverse_w)
            };
            store_words(AT(uint, batch->positions) + slot * 4, position, 4);
#if VARYING_WORDS
            store_words(AT(uint, batch->varyings) + slot * VARYING_WORDS, outputs + 4, VARYING_WORDS);
#endif
        }
        extent->low_x = reduce_min(low_x);
        extent->low_y = reduce_min(low_y);
        extent->high_x = reduce_max(high_x);
        extent->high_y = reduce_max(high_y);
        extent->low = reduce_min(low);
        extent->high = reduce_max(high);
        extent->fit = !any_unfit;
        extent->behind = any_fit ? 0 : reduce_and(all_behind);
    }
}
