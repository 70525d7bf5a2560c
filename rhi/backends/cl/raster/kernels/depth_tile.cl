// Depth while a tile is rasterised. A kernel has one of two kinds, which have the same functions:
//
// - With one sample and no stencil (CACHES_DEPTH), the depths of the tile are staged: read and written once
//   per tile. With BOUNDS_DEPTH, parts and blocks have bounds, behind which nothing is rasterised.
// - In all other kernels, depth and stencil are read and written in memory for each block (merger.cl).
//
// Depths of covered samples are clamped to the range of the corners' depths: texels next to an edge may lie
// outside of the triangle whose corners aren't rounded.

#define TESTS_BEFORE_SHADING (TEST_ORDER != TEST_LATE || !SHADES)
#define WRITES_BEFORE_SHADING (TEST_ORDER == TEST_EARLY || !SHADES)
#define PART_BLOCKS 16  // blocks of a part

// The depth of a block's fragments.
typedef struct {
    float16 z;        // at the texels' centres; behind the fragment stage, clamped where they are covered
    float16 *staged;  // the staged block
    float16 fresh, stored;  // depths to write, and those staged before
} BlockDepth;

#if CACHES_DEPTH
// The tile's depths are staged part by part and block by block: a block is one vector, in the L1 cache. The
// plane's rows are read and written once per tile, 16 texels of 4 rows at a time.
#define TILE_BLOCKS (PARTS * PARTS * PART_BLOCKS)

// Each part and each block has a bound: no stored depth is farther. A primitive behind the bounds of all
// parts that its box touches is culled before its edges are evaluated. Bounds are recomputed after some
// writes. The final ones are left in memory for set-up, which culls later primitives behind them.
#define WRITES_BEFORE_BOUND 16  // number of blocks
#define NEAR_IS_LESS (DEPTH_COMPARISON < 4)
// A comparison is cheaper than fmax. A stored NaN lets nothing pass; as `b` it is ignored.
#define FARTHER(a, b) (NEAR_IS_LESS ? ((b) > (a) ? (b) : (a)) : ((b) < (a) ? (b) : (a)))
#define BEHIND(depth, bound) (NEAR_IS_LESS ? (depth) > (bound) : (depth) < (bound))
#define NEARER (NEAR_IS_LESS ? -INFINITY : INFINITY)  // nearer than all depths
#define GETS_NEARER(slope) (NEAR_IS_LESS ? (slope) < 0.0f : (slope) > 0.0f)

REDUCTION(reduce_farthest, float, FARTHER)

// Return the bounds of a part's blocks: the farthest depth of each of 16 vectors.
INLINE float16 compute_block_bounds(const float16 *blocks) {
    float16 halves[8], quarters[4], eighths[2];
    UNROLL_FOR (int i = 0; i < 8; ++i) {
        float16 a = blocks[2 * i], b = blocks[2 * i + 1];
        float16 low = SHUFFLE(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
        float16 high = SHUFFLE(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
        halves[i] = FARTHER(low, high);
    }
    UNROLL_FOR (int i = 0; i < 4; ++i) {
        float16 low = SHUFFLE(
            halves[2 * i], halves[2 * i + 1], 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27
        );
        float16 high = SHUFFLE(
            halves[2 * i], halves[2 * i + 1], 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31
        );
        quarters[i] = FARTHER(low, high);
    }
    UNROLL_FOR (int i = 0; i < 2; ++i) {
        float16 low = SHUFFLE(
            quarters[2 * i], quarters[2 * i + 1], 0, 1, 4, 5, 8, 9, 12, 13, 16, 17, 20, 21, 24, 25, 28, 29
        );
        float16 high = SHUFFLE(
            quarters[2 * i], quarters[2 * i + 1], 2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23, 26, 27, 30, 31
        );
        eighths[i] = FARTHER(low, high);
    }
    float16 even = SHUFFLE(eighths[0], eighths[1], 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    float16 odd = SHUFFLE(eighths[0], eighths[1], 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
    return FARTHER(even, odd);
}

// Copy between the plane and a tile's blocks. `width`, `height`: the part of the tile inside the plane, in
// whole blocks.
INLINE void copy_depth_tile(
    const Targets *targets, int x, int y, int width, int height, float16 *blocks, const bool back
) {
    const ulong pitch = targets->depth.pitch;
    for (int row = 0; row < height; row += 4) {
        global float *line = (global float *)locate(&targets->depth, x, y + row, 0, 4);
        float16 *block = blocks + row / PART * (PARTS * PART_BLOCKS) +
            row % PART;  // a row of blocks is 4 texels high
        int column = 0;
        for (; column + 16 <= width; column += 16, line += 16, block += PART_BLOCKS) {
            float16 rows[4], four[4];
            if (back) {
                UNROLL_FOR (int i = 0; i < 4; ++i) four[i] = block[i];
                exchange_quarters(four, rows);
                UNROLL_FOR (int i = 0; i < 4; ++i)
                    vstore16(rows[i], 0, (global float *)((global uchar *)line + i * pitch));
            } else {
                UNROLL_FOR (int i = 0; i < 4; ++i)
                    rows[i] = vload16(0, (global float *)((global uchar *)line + i * pitch));
                exchange_quarters(rows, four);
                UNROLL_FOR (int i = 0; i < 4; ++i) block[i] = four[i];
            }
        }
        for (; column < width; column += 4, ++block) {
            if (back) store_depth(targets, x + column, y + row, 0, *block);
            else *block = load_depth(targets, x + column, y + row, 0);
        }
    }
}

// Set all staged depths to one value.
INLINE void fill_blocks(float16 *blocks, int width, int height, float depth) {
    for (int row = 0; row < height; row += 4) {
        float16 *block = blocks + row / PART * (PARTS * PART_BLOCKS) + row % PART;
        for (int column = 0; column < width; column += 4)
            block[column / PART * PART_BLOCKS + column % PART / 4] = depth;
    }
}

// Bounds of the parts of a tile and of their blocks.
typedef struct {
    float16 blocks[PARTS * PARTS];
    float parts[PARTS * PARTS] __attribute__((aligned(64)));
    uchar writes[PARTS * PARTS];  // number of blocks written since the bound was computed
} DepthBounds;

// Return the bound of a part in memory, which set-up and later batches read.
INLINE global float *locate_bound(const Tile *tile, int part) {
    const int pitch = tile->batch->tiles_x * PARTS;
    global float *first = AT(float, tile->batch->bounds) + (tile->y >> PART_BITS) * pitch +
        (tile->x >> PART_BITS);
    return first + part / PARTS * pitch + part % PARTS;
}

INLINE void compute_bounds(const float16 *blocks, int part, DepthBounds *bounds) {
    bounds->blocks[part] = compute_block_bounds(blocks + part * PART_BLOCKS);
    bounds->parts[part] = reduce_farthest(bounds->blocks[part]);
    bounds->writes[part] = 0;
}

// Leave bounds of a tile that nothing has been drawn to.
INLINE void reset_bounds(const Tile *tile) {
    if (!BOUNDS_DEPTH || tile->batch->bounded) return;
    for (int part = 0; part < PARTS * PARTS; ++part) *locate_bound(tile, part) = -NEARER;
}

// Stage the depths of a tile, and load their bounds. `clears`: fill them with `clear_depth` instead of
// reading them.
INLINE void begin_depth(
    const Targets *targets, const Tile *tile, bool clears, float clear_depth, float16 *blocks,
    DepthBounds *bounds
) {
    // Depths outside of the target must not affect bounds.
    if (BOUNDS_DEPTH && (tile->width < TILE || tile->height < TILE))
        for (int i = 0; i < TILE_BLOCKS; ++i) blocks[i] = (float16)(NEARER);
    if (clears) fill_blocks(blocks, tile->width, tile->height, clear_depth);
    else copy_depth_tile(targets, tile->x, tile->y, tile->width, tile->height, blocks, false);
    if (!BOUNDS_DEPTH) return;
    for (int part = 0; part < PARTS * PARTS; ++part) {
        if (!clears && !tile->batch->bounded) {
            compute_bounds(blocks, part, bounds);
            continue;
        }
        bounds->parts[part] = clears ? clear_depth : *locate_bound(tile, part);
        bounds->blocks[part] = bounds->parts[part];
        bounds->writes[part] = 0;
    }
}

// Write the staged depths of a tile back to memory, and their bounds.
INLINE void end_depth(const Targets *targets, const Tile *tile, float16 *blocks, DepthBounds *bounds) {
    if (DEPTH_WRITES) copy_depth_tile(targets, tile->x, tile->y, tile->width, tile->height, blocks, true);
    if (!BOUNDS_DEPTH) return;
    for (int part = 0; part < PARTS * PARTS; ++part) {
        if (bounds->writes[part]) compute_bounds(blocks, part, bounds);
        *locate_bound(tile, part) = bounds->parts[part];
    }
}

// Return those of a set of parts that a record's nearest depth isn't behind.
INLINE uint cull_parts(const Tile *tile, const Record *record, const DepthBounds *bounds, uint parts) {
    if (!BOUNDS_DEPTH) return parts;
    const float closest = as_float(record->words[NEAR_IS_LESS ? LOWEST : HIGHEST]);
    const float step = tile->batch->depth_step;
    const float16 bound = *(const float16 *)bounds->parts;
    return parts & ~bits_of(BEHIND(NEAR_IS_LESS ? closest - step : closest + step, bound));
}

// Return those of a set of parts in which a record's plane of depth isn't behind the bound.
INLINE uint
cull_parts_by_plane(const Tile *tile, const Record *record, const DepthBounds *bounds, uint parts) {
    if (!BOUNDS_DEPTH || !(parts & (parts - 1))) return parts;
    // The nearest depth of the plane in each part, with a margin for rounding.
    const int away_x = tile->x - record->box_x, away_y = tile->y - record->box_y;
    const float depth_x = record->depth_x, depth_y = record->depth_y, step = tile->batch->depth_step;
    const float slope_x = fabs(depth_x), slope_y = fabs(depth_y), middle = (PART - 1) / 2.0f;
    float reach = (slope_x + slope_y) * middle + 1e-6f + tile->batch->depth_step +
        0x1p-20f * (slope_x * (abs(away_x) + TILE) + slope_y * (abs(away_y) + TILE));
    float start = record->depth_start + depth_x * (away_x + middle) + depth_y * (away_y + middle);
    float16 nearest = start + record->lane_depth * PART;
    nearest = clamp_to(
        NEAR_IS_LESS ? nearest - reach : nearest + reach, record->lowest - step, record->highest + step
    );
    return parts & ~bits_of(BEHIND(nearest, *(const float16 *)bounds->parts));
}

// Return those of a part's blocks that a record isn't behind. `depths`: at the first texel of each block.
INLINE uint cull_blocks(
    const Targets *targets, const Record *record, const DepthBounds *bounds, int part, uint blocks,
    float16 depths
) {
    // Without writes, most blocks have the bound of their part, which was tested.
    if (!BOUNDS_DEPTH || !DEPTH_WRITES) return blocks;
    const float depth_x = record->depth_x, depth_y = record->depth_y;
    // Difference between the depth of a block's first texel and that of its nearest corner.
    const float to_nearest =
        fma(depth_x, GETS_NEARER(depth_x) ? 3.0f : 0.0f, depth_y * (GETS_NEARER(depth_y) ? 3.0f : 0.0f));
    const float16 nearest =
        round_depth(targets, clamp_to(depths + to_nearest, record->lowest, record->highest));
    return blocks & ~bits_of(BEHIND(nearest, bounds->blocks[part]));
}

// Note that blocks of a part are going to be written.
INLINE void note_writes(const Targets *targets, int part, uint blocks, DepthBounds *bounds) {
    if (BOUNDS_DEPTH && DEPTH_WRITES) bounds->writes[part] += popcount(blocks);
}

// Compute the bounds of a part again after some writes.
INLINE void update_bounds(const Targets *targets, const float16 *blocks, int part, DepthBounds *bounds) {
    if (BOUNDS_DEPTH && DEPTH_WRITES && bounds->writes[part] >= WRITES_BEFORE_BOUND)
        compute_bounds(blocks, part, bounds);
}

// Test a block's depths, and write those that pass, as far as both come before shading. Return the lanes that
// remain.
INLINE int16 test_before_shading(
    const Targets *targets, const Record *record, const Rare *rare, int x, int y, BlockDepth *depth,
    CurrentDraw *draw, int16 covered, int16 *masks
) {
    depth->stored = *depth->staged;
    depth->fresh = round_depth(targets, clamp_to(depth->z, record->lowest, record->highest));
    if (!TESTS_BEFORE_SHADING) return covered;
    covered &= compare_depth(targets, depth->fresh, depth->stored);
    masks[0] = covered;
    if (!WRITES_BEFORE_SHADING) return covered;
    if (DEPTH_WRITES) {
        if (SHADES && !bits_of(covered)) return covered;
        *depth->staged = covered ? depth->fresh : depth->stored;
    }
    draw->passed -= covered;
    return covered;
}

// Test and write the depth of a sample behind shading, unless that has been done. `shaded`: the depth that
// the fragment stage outputs. Return the lanes of `mask` that pass.
INLINE int16 test_after_shading(
    const Targets *targets, const Record *record, const Rare *rare, int x, int y, int sample,
    BlockDepth *depth, float16 shaded, CurrentDraw *draw, int16 mask
) {
    if (TEST_ORDER == TEST_EARLY) return mask;
    depth->fresh = GIVES_DEPTH ? quantize_depth(targets, shaded) : depth->fresh;
    mask &= compare_depth(targets, depth->fresh, depth->stored);
    if (DEPTH_WRITES) *depth->staged = mask ? depth->fresh : depth->stored;
    draw->passed -= mask;
    return mask;
}

#else

#define TILE_BLOCKS 1
typedef int DepthBounds;

INLINE void reset_bounds(const Tile *tile) {}

INLINE void begin_depth(
    const Targets *targets, const Tile *tile, bool clears, float clear_depth, float16 *blocks,
    DepthBounds *bounds
) {}

INLINE void end_depth(const Targets *targets, const Tile *tile, float16 *blocks, DepthBounds *bounds) {}

INLINE uint cull_parts(const Tile *tile, const Record *record, const DepthBounds *bounds, uint parts) {
    return parts;
}

INLINE uint
cull_parts_by_plane(const Tile *tile, const Record *record, const DepthBounds *bounds, uint parts) {
    return parts;
}

INLINE uint cull_blocks(
    const Targets *targets, const Record *record, const DepthBounds *bounds, int part, uint blocks,
    float16 depths
) {
    return blocks;
}

INLINE void note_writes(const Targets *targets, int part, uint blocks, DepthBounds *bounds) {}

INLINE void update_bounds(const Targets *targets, const float16 *blocks, int part, DepthBounds *bounds) {}

// Return the depth of a sample in the block at texel x, y.
INLINE float16 sample_depth(
    const Targets *targets, const Record *record, const Rare *rare, global const View *view, int x, int y,
    int sample, float16 z, int16 mask
) {
    const float16 at_sample = UNLIKELY(record->thin && SAMPLES > 1)
        ? thin_depth(view, record->words, rare, x, y, SAMPLE_X(sample), SAMPLE_Y(sample), mask)
        : z + (record->depth_x * (SAMPLE_X(sample) / 256.0f) + record->depth_y * (SAMPLE_Y(sample) / 256.0f));
    return clamp_to(at_sample, record->lowest, record->highest);
}

INLINE int16 test_before_shading(
    const Targets *targets, const Record *record, const Rare *rare, int x, int y, BlockDepth *depth,
    CurrentDraw *draw, int16 covered, int16 *masks
) {
    if (!TESTS_BEFORE_SHADING || !bits_of(covered)) return covered;
    global const uint *state = draw->state;
    covered = (int16)(0);
    UNROLL_FOR (int sample = 0; sample < SAMPLES; ++sample) {
        const float16 z =
            sample_depth(targets, record, rare, draw->view, x, y, sample, depth->z, masks[sample]);
        if (WRITES_BEFORE_SHADING) {
            masks[sample] =
                merge_depth_stencil(targets, state, x, y, sample, record->front, masks[sample], z);
            draw->passed -= masks[sample];
        } else
            masks[sample] = test_depth_stencil(targets, state, x, y, sample, record->front, masks[sample], z);
        covered |= masks[sample];
    }
    return covered;
}

INLINE int16 test_after_shading(
    const Targets *targets, const Record *record, const Rare *rare, int x, int y, int sample,
    BlockDepth *depth, float16 shaded, CurrentDraw *draw, int16 mask
) {
    if (TEST_ORDER == TEST_EARLY) return mask;
    const float16 z =
        GIVES_DEPTH ? shaded : sample_depth(targets, record, rare, draw->view, x, y, sample, depth->z, mask);
    mask = merge_depth_stencil(targets, draw->state, x, y, sample, record->front, mask, z);
    draw->passed -= mask;
    return mask;
}
#endif
