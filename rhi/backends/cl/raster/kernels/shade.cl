// Shading of a block: weights of the corners, varyings, the fragment stage, and its outputs to the merger.
//
// The fragment stage's text, varyings.cl and the macros of kernel_structs.py precede this one: BINDINGS,
// VARYING_WORDS, VARYINGS. In a kernel that many programs share, CALLS_STAGE is defined, and the stage is a function
// at an address (stage.cl). Weights of covered texels are clamped: texels next to an edge may lie outside of the
// triangle whose corners aren't rounded.

#if FRAGMENT
// Clamp weights to 0…1 where the texel is covered. Elsewhere they stay linear, for derivatives. Corners
// behind the eye may have any weight without perspective.
INLINE void clamp_weights(float16 *weight1, float16 *weight2, int16 inside) {
    float16 first = clamp_to(*weight1, 0.0f, 1.0f), second = *weight2, most = 1.0f - first;
    second = second > 0.0f ? second : (float16)(0.0f);
    second = second < most ? second : most;
    *weight1 = inside ? first : *weight1;
    *weight2 = inside ? second : *weight2;
}

INLINE void compute_weights(global const float *planes, float16 x, float16 y, Weights *weights) {
    weights->inverse_w = planes[0] * x + planes[1] * y + planes[2];
    float16 w = 1.0f / weights->inverse_w;
    float16 part1 = planes[3] * x + planes[4] * y + planes[5];
    float16 part2 = planes[6] * x + planes[7] * y + planes[8];
    weights->weight1 = part1 * w;
    weights->weight2 = part2 * w;
    weights->linear1 = part1 * planes[CORNER_W];
    weights->linear2 = part2 * planes[CORNER_W + 1];
}

// Compute the weights of a thin triangle in the block at texel x, y.
NOINLINE void compute_thin_weights(const Rare *rare, int x, int y, int16 inside, Weights *weights) {
    const Outline *outline = &rare->outline;
    double16 parts[3];
    compute_corner_parts(&rare->precise, (x + LANE_X) * SUBTEXELS, (y + LANE_Y) * SUBTEXELS, inside, parts);
    double16 whole = parts[0] + parts[1] + parts[2], straight = (double16)(0.0);
    for (int i = 0; i < 3; ++i) straight += parts[i] * outline->exact[i].z;
    weights->inverse_w = convert_float16(whole);
    weights->weight1 = convert_float16(parts[1] / whole);
    weights->weight2 = convert_float16(parts[2] / whole);
    weights->linear1 = convert_float16(parts[1] * outline->exact[1].z / straight);
    weights->linear2 = convert_float16(parts[2] * outline->exact[2].z / straight);
}

// Read where a record's planes and its corners' varyings lie. `index`: the record's.
INLINE void load_shading(const Targets *targets, global const Batch *batch, long index, Record *record) {
    record->planes = AT(const float, batch->planes) + index * 16;
    global const uint *varyings = AT(const uint, batch->varyings),
                      *slots = (global const uint *)record->planes + SLOTS;
    if (!VARYING_WORDS) return;
    const long words = VARYING_WORDS;
    record->corner0 = varyings + (SHADES ? slots[0] * words : 0);
    record->corner1 = varyings + (SHADES ? slots[1] * words : 0);
    record->corner2 = varyings + (SHADES ? slots[2] * words : 0);
}

// Compute the weights of the corners in the block at texel x, y. `inside`: the texels whose centres are
// covered.
INLINE void weigh_corners(
    const Record *record, const Rare *rare, int x, int y, int16 inside, Weights *weights
) {
    float16 away_x = (float)(x - record->box_x) + LANE_FX, away_y = (float)(y - record->box_y) + LANE_FY;
    if (UNLIKELY(record->thin)) compute_thin_weights(rare, x, y, inside, weights);
    else compute_weights(record->planes, away_x, away_y, weights);
    const int weight_flags = as_int(record->planes[WEIGHT_FLAGS]);
    clamp_weights(&weights->weight1, &weights->weight2, inside & -(weight_flags & 1));
    clamp_weights(&weights->linear1, &weights->linear2, inside & -(weight_flags >> 1));
}

// Shade the block at texel x, y and merge its samples. `inside`: the texels whose centres are covered;
// `covered`: those that have a covered sample; `masks`: the covered lanes of each sample.
FUSED void shade_block(
    const Targets *targets, const Record *record, const Rare *rare, int x, int y, int16 inside, int16 covered,
    const int16 *masks, BlockDepth *depth, CurrentDraw *draw
) {
    Weights weights;
    weigh_corners(record, rare, x, y, inside, &weights);
    uint16 outputs[OUTPUT_WORDS];
    UNROLL_FOR (int i = 0; i < OUTPUT_WORDS; ++i) outputs[i] = (uint16)(0u);
    depth->z = inside ? clamp_to(depth->z, record->lowest, record->highest) : depth->z;
    float16 shaded_depth = depth->z;
#ifdef CALLS_STAGE
    Fragments fragments;
    fragments.x = (float)x + LANE_FX + 0.5f;
    fragments.y = (float)y + LANE_FY + 0.5f;
    fragments.depth = depth->z;
    fragments.weights = weights;
    fragments.covered = covered;
    fragments.bindings = draw->bindings;
    fragments.corner0 = record->corner0;
    fragments.corner1 = record->corner1;
    fragments.corner2 = record->corner2;
    fragments.outputs = outputs;
    fragments.front = record->front;
    fragments.primitive = as_int(record->planes[NUMBER]);
    call_function(draw->stage, &fragments);
    int16 coverage = fragments.covered;
    shaded_depth = fragments.depth;
#else
    uint16 inputs[VARYING_WORDS + 1];
    uint flat[VARYING_WORDS + 1];
    interpolate_varyings(record->corner0, record->corner1, record->corner2, &weights, inputs, flat);
    global const ulong *row = draw->bindings;  // of BINDINGS
    int16 coverage = rhi_fragment(
        BINDINGS inputs, flat, (float)x + LANE_FX + 0.5f, (float)y + LANE_FY + 0.5f, depth->z,
        weights.inverse_w, record->front, as_int(record->planes[NUMBER]), weights.weight1, weights.weight2,
        covered, outputs, &shaded_depth
    );
#endif
    coverage = test_alpha(targets, draw->state, coverage, outputs);
    UNROLL_FOR (int sample = 0; sample < SAMPLES; ++sample) {
        int16 mask = masks[sample] & coverage;
        if (MAX_SAMPLES > 1) mask = cover_by_alpha(targets, mask, outputs, sample);
        mask = test_after_shading(targets, record, rare, x, y, sample, depth, shaded_depth, draw, mask);
        if (COLOR_COUNT && (MAX_SAMPLES == 1 || bits_of(mask)))
            merge_colors(targets, draw->state, x, y, sample, mask, outputs);
    }
}
#endif
