// Rasterisation: a work-item per tile, which it alone writes, processes the tile's records in order.
//
// - A tile is 4 × 4 parts, a part 4 × 4 blocks, a block 4 × 4 texels: 16 lanes each, lane = x + 4 y. Of the parts and then
//   the blocks that a record's box touches, those outside of an edge are discarded 16 at a time. In the remaining blocks,
//   coverage, depth and shading are vectors of 16.
// - The edges of large primitives are computed at the tile in 64 bits. An edge with all of the tile on its inside is
//   dropped; one with all of the tile on its outside ends the record. The others fit in 32 bits. Lines and points have a
//   fourth edge and clipped triangles two more, those of the near and far planes: a mask.
// - What only these and thin triangles need is `Rare`: kept in memory, and computed by functions that are called, so that it
//   takes no registers from the loop over blocks.
// - Depths of covered samples are clamped to the range of the corners' depths: texels next to an edge may lie outside of the
//   triangle whose corners aren't rounded. Weights of covered texels are clamped for the same reason.
// - Multi-sampled targets have a coverage for each sample and one shading.
// - Depth of one sample without stencil is staged: read and written once per tile, and bounded (BOUNDS_DEPTH).
// - targets.cl, the fragment stage and the macros of tables.py precede this text: FRAGMENT, BINDINGS, VARYING_WORDS,
//   VARYINGS, GIVES_DEPTH, STAGES_DEPTH, BOUNDS_DEPTH. In a general kernel (targets.cl) depth isn't staged.

#define LANE_X (int16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define LANE_Y (int16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3)
#define LANE_FX (float16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define LANE_FY (float16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3)
#define AHEAD 12  // records to prefetch: memory latency divided by the time of a record

// Iterator over the records of a tile: those in its list, or without lists those whose boxes contain it.
typedef struct {
    global const uint *list, *boxes, *survivors;
    uint next, end, chunk, chunks, chunk_records, column, row;
} Records;

INLINE void find_records(global const Batch *batch, int tile, Records *records) {
    global const uint *starts = AT(const uint, batch->starts);
    bool listed = batch->listed && starts[batch->tiles] <= batch->list_size;
    records->list = listed ? AT(const uint, batch->list) : 0;
    records->boxes = AT(const uint, batch->boxes);
    records->survivors = AT(const uint, batch->survivors);
    records->next = listed ? starts[tile] : 0;
    records->end = listed ? starts[tile + 1] : 0;
    records->chunk = 0;
    records->chunks = listed ? 0 : batch->chunks;
    records->chunk_records = batch->chunk_records;
    records->column = tile % batch->tiles_x;
    records->row = tile / batch->tiles_x;
}

// Return the number of the next record, or -1.
INLINE int next_record(Records *records) {
    for (;;) {
        if (records->next < records->end) {
            uint place = records->next++;
            if (records->list) return records->list[place];
            uint box = records->boxes[place];
            if ((box & 255u) <= records->column && records->column <= (box >> 16 & 255u) &&
                (box >> 8 & 255u) <= records->row && records->row <= box >> 24)
                return place;
        } else {
            if (records->chunk == records->chunks) return -1;
            records->next = records->chunk * records->chunk_records;
            records->end = records->next + records->survivors[records->chunk++];
        }
    }
}

typedef struct {
    int a[3], b[3];        // per texel
    int x, y;              // the texel at which `c` is valid
    int c[MAX_SAMPLES][3];     // rounded down to whole texels
    int16 lanes[3];        // increments for the texels of a block
} Edges;

// From the texel's centre, in subtexels, for 1, 2, 4 and 8 samples. Two lie off both diagonals, whose edges cover both or none;
// four and eight are the standard patterns of Direct3D 11 and Vulkan.
constant int sample_x[15] = {0, -32, 32, -32, 96, -96, 32, 16, -16, 80, -48, -80, -112, 48, 112};
constant int sample_y[15] = {0, -96, 96, -96, -32, 32, 96, -48, 48, 16, -80, 80, -16, 112, -112};
#define SAMPLE_X(sample) sample_x[SAMPLES - 1 + (sample)]
#define SAMPLE_Y(sample) sample_y[SAMPLES - 1 + (sample)]

// Store an edge A x + B y per texel, valid at texel edges->x, edges->y, where its value is `start`. Return false if it has
// nothing of the tile from there on inside.
INLINE bool set_edge(const Targets *targets, Edges *edges, const int i, int a, int b, long start) {
    start += OWNS(a, b) - 1;
    // With a margin, since samples lie off the centres.
    long across = (long)TILE * (max(a, 0) + max(b, 0)) + abs(a) + abs(b), back = (long)TILE * (min(a, 0) + min(b, 0));
    if ((start >> 8) + across < 0) return false;
    bool holds = (start >> 8) + back - abs(a) - abs(b) >= 0;
    edges->a[i] = holds ? 0 : a;
    edges->b[i] = holds ? 0 : b;
    UNROLL for (int sample = 0; sample < SAMPLES; ++sample)
        edges->c[sample][i] = holds ? 0 : (int)((start + (long)a * SAMPLE_X(sample) + (long)b * SAMPLE_Y(sample)) >> 8);
    return true;
}

// The same for an edge from one corner to the next.
INLINE bool join_corners(const Targets *targets, Edges *edges, const int i, int2 from, int2 to) {
    int a = from.y - to.y, b = to.x - from.x;
    long start = (long)a * (edges->x * SUBTEXELS - from.x) + (long)b * (edges->y * SUBTEXELS - from.y);
    return set_edge(targets, edges, i, a, b, start);
}

// Compute the edges of a triangle of any size at texel x, y. Return false if it covers nothing of the tile from there on.
INLINE bool find_edges(const Targets *targets, const int2 *points, int x, int y, Edges *edges) {
    edges->x = x;
    edges->y = y;
    UNROLL for (int i = 0; i < 3; ++i)
        if (!join_corners(targets, edges, i, points[i], points[i < 2 ? i + 1 : 0])) return false;
    return true;
}

// The same for a line or a point, a parallelogram: two triangles would shade a texel twice whose samples both cover.
// `range`: the fourth edge.
INLINE bool find_parallelogram_edges(const Targets *targets, const int2 *points, int x, int y, Edges *edges, Edges *range) {
    edges->x = range->x = x;
    edges->y = range->y = y;
    UNROLL for (int i = 0; i < 3; ++i)
        if (!join_corners(targets, edges, i, points[i], points[i + 1])) return false;
    return join_corners(targets, range, 0, points[3], points[0]) && set_edge(targets, range, 1, 0, 0, 1l << 40);
}

// The same for a triangle that the view cuts. `range`: what the near and far planes cut, in two edges.
SEPARATE bool find_clipped_edges(
    const Targets *targets, const Contour *contour, int x, int y, Edges *edges, Edges *range
) {
    edges->x = range->x = x;
    edges->y = range->y = y;
    for (int i = 0; i < 5; ++i) {
        int a, b;
        long start = find_contour_edge(contour, i, x, y, &a, &b);
        if (!set_edge(targets, i < 3 ? edges : range, i % 3, a, b, start)) return false;
    }
    return true;
}

// Return the lanes of the block at texel x, y that the first two edges contain.
SEPARATE int16 find_within(const Edges *range, int x, int y, const int sample) {
    int16 innermost = (int16)(0);
    UNROLL for (int i = 0; i < 2; ++i)
        innermost |= range->a[i] * (x - range->x + LANE_X) + (range->b[i] * (y - range->y + LANE_Y) + range->c[sample][i]);
    return innermost >= 0;
}

// Sets of 4 × 4 squares as bits: the parts of a tile, or the blocks of a part. A square has 2^`bits` texels a side.

// Return the squares that a box touches, whose first and last texel are relative to the first square.
INLINE uint touch_squares(int x0, int y0, int x1, int y1, const int bits) {
    const uint columns = (2u << (x1 >> bits)) - (1u << (x0 >> bits));
    return columns * (((16u << (y1 >> bits) * 4) - (1u << (y0 >> bits) * 4)) & 0x1111u);
}

// Return the squares that don't lie outside of any edge; the first square begins at texel x, y. `starts`: the edges at each
// square's first texel.
INLINE uint cross_squares(const Edges *edges, int x, int y, const int bits, int16 *starts) {
    x -= edges->x;
    y -= edges->y;
    int16 innermost = (int16)(0);
    UNROLL for (int i = 0; i < 3; ++i) {
        const int a = edges->a[i], b = edges->b[i];
        starts[i] = (edges->lanes[i] << bits) + (edges->c[0][i] + a * x + b * y);
        int16 most = starts[i] + (max(a, 0) + max(b, 0)) * ((1 << bits) - 1);
        if (MAX_SAMPLES > 1) most = add_sat(most, (int16)(abs(a) + abs(b)));  // samples lie off the centres
        innermost |= most;
    }
    return bits_of(innermost >= 0);
}

// What lines, points, clipped and thin triangles need besides the edges and planes of others.
typedef struct {
    Outline outline;       // of a clipped or thin triangle
    Barycentrics precise;
    Edges edges, range;    // of a clipped triangle, a line or a point: three edges, and further ones
    bool has_range;
} Rare;

// Compute what a rare record needs at texel x, y. Return false if it covers nothing of the tile from there on.
SEPARATE bool find_rare(
    const Targets *targets, global const Batch *batch, global const View *view, global const int *record, int x, int y, Rare *rare
) {
    const int kind = record[FLAGS] & 3;
    rare->has_range = false;
    if (kind == POLYGON) {
        float4 clips[2];
        int2 points[MAX_CORNERS];
        UNROLL for (int i = 0; i < 2; ++i) clips[i] = load_clip(batch, record[CLIPPED_SLOTS + i]);
        const int primitive = record[POLYGON_PRIMITIVE];
        rare->has_range = true;
        const float size = primitive == POINTS ? load_point_size(batch, record[CLIPPED_SLOTS]) : view->line_width;
        return make_polygon(view, clips, primitive, size, points) &&
               find_parallelogram_edges(targets, points, x, y, &rare->edges, &rare->range);
    }
    uint corners[3];
    for (int i = 0; i < 3; ++i) corners[i] = record[(kind == CLIPPED ? CLIPPED_SLOTS : THIN_SLOTS) + i];
    load_outline(batch, view, corners, &rare->outline);
    find_barycentrics(&rare->outline, &rare->precise);
    if (kind != CLIPPED) return true;
    Contour contour;
    find_contour(&rare->outline, &rare->precise, &contour);
    rare->has_range = is_cut(&contour);
    return find_clipped_edges(targets, &contour, x, y, &rare->edges, &rare->range);
}

// Return the depth of a thin triangle in the block at texel x, y, at samples whose coverage is `inside`.
SEPARATE float16 find_thin_depth(
    global const View *view, global const int *record, const Rare *rare, int x, int y, int aside, int below, int16 inside
) {
    return find_depth(view, &rare->outline, &rare->precise, (x + LANE_X) * SUBTEXELS + aside,
                      (y + LANE_Y) * SUBTEXELS + below, inside) + as_float(record[OFFSET]);
}

#if FRAGMENT
// Weights of the corners at 16 places, which interpolate the varyings.
typedef struct {
    float16 near_w, weight1, weight2;  // with perspective
    float16 straight1, straight2;      // without perspective
} Weights;

// Clamp weights to 0…1 where the place is covered. Elsewhere they stay linear, for derivatives. Corners behind the eye may have
// any weight without perspective.
INLINE void clamp_weights(float16 *weight1, float16 *weight2, int16 inside) {
    float16 first = clamp_to(*weight1, 0.0f, 1.0f), second = *weight2, most = 1.0f - first;
    second = second > 0.0f ? second : (float16)(0.0f);
    second = second < most ? second : most;
    *weight1 = inside ? first : *weight1;
    *weight2 = inside ? second : *weight2;
}

INLINE void find_weights(global const float *planes, float16 x, float16 y, Weights *weights) {
    weights->near_w = planes[0] * x + planes[1] * y + planes[2];
    float16 w = 1.0f / weights->near_w;
    float16 part1 = planes[3] * x + planes[4] * y + planes[5], part2 = planes[6] * x + planes[7] * y + planes[8];
    weights->weight1 = part1 * w;
    weights->weight2 = part2 * w;
    weights->straight1 = part1 * planes[CORNER_W];
    weights->straight2 = part2 * planes[CORNER_W + 1];
}

// The same for a thin triangle, in the block at texel x, y.
SEPARATE void find_thin_weights(const Rare *rare, int x, int y, int16 inside, Weights *weights) {
    const Outline *outline = &rare->outline;
    double16 parts[3];
    find_parts(&rare->precise, (x + LANE_X) * SUBTEXELS, (y + LANE_Y) * SUBTEXELS, inside, parts);
    double16 whole = parts[0] + parts[1] + parts[2], straight = (double16)(0.0);
    for (int i = 0; i < 3; ++i) straight += parts[i] * outline->exact[i].z;
    weights->near_w = convert_float16(whole);
    weights->weight1 = convert_float16(parts[1] / whole);
    weights->weight2 = convert_float16(parts[2] / whole);
    weights->straight1 = convert_float16(parts[1] * outline->exact[1].z / straight);
    weights->straight2 = convert_float16(parts[2] * outline->exact[2].z / straight);
}
#define CORNER(k, word) as_float(corner##k[word])
#define INTERPOLATE(word, weight1, weight2) \
    inputs[word] = as_uint16(CORNER(0, word) + (CORNER(1, word) - CORNER(0, word)) * weight1 + \
                             (CORNER(2, word) - CORNER(0, word)) * weight2);
#define SMOOTH(word) INTERPOLATE(word, weights.weight1, weights.weight2)
#define STRAIGHT(word) INTERPOLATE(word, weights.straight1, weights.straight2)
#define FLAT(word) flat[word] = corner0[word];
#endif

#if STAGES_DEPTH
// The tile's depths are staged part by part and block by block: a block is one vector, in the L1 cache. The plane's rows
// are read and written once per tile, 16 texels of 4 rows at a time.
#define PART_BLOCKS 16

// Each part and each block has a bound: no stored depth is farther. A primitive behind the bounds of all parts that its box
// touches is culled before its edges are evaluated. Bounds are recomputed after some writes. The final ones are left in
// memory for set-up, which culls later primitives behind them.
#define WRITES_BEFORE_BOUND 16  // number of blocks
#define NEAR_IS_LESS (DEPTH_PASSES < 4)
// A comparison is cheaper than fmax. A stored NaN lets nothing pass; as `b` it is ignored.
#define FARTHER(a, b) (NEAR_IS_LESS ? ((b) > (a) ? (b) : (a)) : ((b) < (a) ? (b) : (a)))
#define BEHIND(depth, bound) (NEAR_IS_LESS ? (depth) > (bound) : (depth) < (bound))
#define NEARER (NEAR_IS_LESS ? -INFINITY : INFINITY)  // nearer than all depths
#define GETS_NEARER(slope) (NEAR_IS_LESS ? (slope) < 0.0f : (slope) > 0.0f)

REDUCTION(find_farthest, float, FARTHER)

// Return the bounds of a part's blocks: the farthest depth of each of 16 vectors.
INLINE float16 find_block_bounds(const float16 *blocks) {
    float16 halves[8], quarters[4], eighths[2];
    UNROLL for (int i = 0; i < 8; ++i) {
        float16 a = blocks[2 * i], b = blocks[2 * i + 1];
        float16 low = SHUFFLE(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
        float16 high = SHUFFLE(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
        halves[i] = FARTHER(low, high);
    }
    UNROLL for (int i = 0; i < 4; ++i) {
        float16 low = SHUFFLE(halves[2 * i], halves[2 * i + 1], 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27);
        float16 high = SHUFFLE(halves[2 * i], halves[2 * i + 1], 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
        quarters[i] = FARTHER(low, high);
    }
    UNROLL for (int i = 0; i < 2; ++i) {
        float16 low = SHUFFLE(quarters[2 * i], quarters[2 * i + 1], 0, 1, 4, 5, 8, 9, 12, 13, 16, 17, 20, 21, 24, 25, 28, 29);
        float16 high = SHUFFLE(quarters[2 * i], quarters[2 * i + 1], 2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23, 26, 27, 30, 31);
        eighths[i] = FARTHER(low, high);
    }
    float16 even = SHUFFLE(eighths[0], eighths[1], 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    float16 odd = SHUFFLE(eighths[0], eighths[1], 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
    return FARTHER(even, odd);
}

// Copy between the plane and a tile's blocks. `width`, `height`: the part of the tile inside the plane, in whole blocks.
INLINE void stage_depth(const Targets *targets, int x, int y, int width, int height, float16 *blocks, const bool back) {
    const ulong pitch = targets->depth.pitch;
    for (int row = 0; row < height; row += 4) {
        global float *line = (global float *)locate(&targets->depth, x, y + row, 0, 4);
        float16 *block = blocks + row / PART * (PARTS * PART_BLOCKS) + row % PART;  // a row of blocks is 4 texels high
        int column = 0;
        for (; column + 16 <= width; column += 16, line += 16, block += PART_BLOCKS) {
            float16 rows[4], four[4];
            if (back) {
                UNROLL for (int i = 0; i < 4; ++i) four[i] = block[i];
                exchange_quarters(four, rows);
                UNROLL for (int i = 0; i < 4; ++i) vstore16(rows[i], 0, (global float *)((global uchar *)line + i * pitch));
            } else {
                UNROLL for (int i = 0; i < 4; ++i) rows[i] = vload16(0, (global float *)((global uchar *)line + i * pitch));
                exchange_quarters(rows, four);
                UNROLL for (int i = 0; i < 4; ++i) block[i] = four[i];
            }
        }
        for (; column < width; column += 4, ++block) {
            if (back) store_depth(targets, x + column, y + row, 0, *block);
            else *block = load_depth(targets, x + column, y + row, 0);
        }
    }
}
#endif

#if STAGES_DEPTH
// Set all staged depths to one value.
INLINE void fill_blocks(float16 *blocks, int width, int height, float depth) {
    for (int row = 0; row < height; row += 4) {
        float16 *block = blocks + row / PART * (PARTS * PART_BLOCKS) + row % PART;
        for (int column = 0; column < width; column += 4) block[column / PART * PART_BLOCKS + column % PART / 4] = depth;
    }
}
#endif

// Add the samples that each lane has passed to the counter at `samples`, if there is one.
INLINE void count_samples(global const Batch *batch, ulong samples, int16 passed) {
    uint count = samples ? find_sum(passed) : 0;
    if (!count) return;
    volatile global uint *counter = AT(volatile uint, batch->counters + samples);
    if (atomic_add(counter, count) + count < count) atomic_inc(counter + 1);
}

SINGLE raster(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    const int tile = spread_work(get_global_id(0), batch->tiles);
    Records records;
    find_records(batch, tile, &records);
    int place = next_record(&records);
    const int tile_x = tile % batch->tiles_x * TILE, tile_y = tile / batch->tiles_x * TILE;
#if BOUNDS_DEPTH
    const int bounds_pitch = batch->tiles_x * PARTS;
    global float *left_bounds = AT(float, batch->bounds) + (tile_y >> PART_BITS) * bounds_pitch + (tile_x >> PART_BITS);
    if (place < 0 && !batch->bounded)
        for (int part = 0; part < PARTS * PARTS; ++part)
            left_bounds[part / PARTS * bounds_pitch + part % PARTS] = -NEARER;
#endif
    const uint cleared = batch->cleared;
    if (place < 0 && !cleared) return;
    global const Merger *merger = AT(const Merger, batch->places);
    global const ulong *target_places = (global const ulong *)(merger + 1);
    Targets opened;
    open_targets(merger, batch->surfaces, target_places, &opened);
    const Targets *targets = &opened;
    const int width = min(TILE, ((batch->width + 3) & ~3) - tile_x);  // of the part inside the target, in whole blocks
    const int height = min(TILE, ((batch->height + 3) & ~3) - tile_y);
    // Depth that is staged and written back is cleared in the staging area.
    const bool fills = STAGES_DEPTH && DEPTH_WRITES && place >= 0 && cleared >> COLOR_COUNT & 1;
    const uint in_memory = cleared ^ (uint)fills << COLOR_COUNT;
    if (in_memory) clear_targets(targets, target_places, in_memory, tile_x, tile_y, width, height);
    if (place < 0) return;
#if STAGES_DEPTH
    float16 blocks[PARTS * PARTS * PART_BLOCKS];
#if BOUNDS_DEPTH
    // Depths outside of the target must not affect bounds.
    if (width < TILE || height < TILE)
        for (int i = 0; i < PARTS * PARTS * PART_BLOCKS; ++i) blocks[i] = (float16)(NEARER);
#endif
    const float fresh_depth = as_float(*CLEAR_TEXEL(target_places, COLOR_COUNT));
    if (fills) fill_blocks(blocks, width, height, fresh_depth);
    else stage_depth(targets, tile_x, tile_y, width, height, blocks, false);
#if BOUNDS_DEPTH
    float16 block_bounds[PARTS * PARTS];
    float bounds[PARTS * PARTS] __attribute__((aligned(64)));
    uchar writes[PARTS * PARTS];  // number of blocks written since the bound was computed
#define FIND_BOUNDS(part) { \
        block_bounds[part] = find_block_bounds(blocks + part * PART_BLOCKS); \
        bounds[part] = find_farthest(block_bounds[part]); \
        writes[part] = 0; }
    for (int part = 0; part < PARTS * PARTS; ++part) {
        if (!fills && !batch->bounded) {
            FIND_BOUNDS(part)
            continue;
        }
        bounds[part] = fills ? fresh_depth : left_bounds[part / PARTS * bounds_pitch + part % PARTS];
        block_bounds[part] = bounds[part];
        writes[part] = 0;
    }
#endif
#endif
    global const int *record_memory = AT(const int, batch->records);
    global const Draw *draws = AT(const Draw, batch->draws);
    global const Draw *draw = 0;  // that of the current record, with its state
    global const View *view = 0;
    global const uint *state = 0;
    global const ulong *row = 0;
    int number = -1;
    ulong samples = 0;
    int16 passed = (int16)(0);  // samples of each lane for the current counter
    for (; place >= 0; place = next_record(&records)) {
        global const int *record = record_memory + (long)place * 16;
        if (records.list) {
            uint later = records.list[min(records.next + AHEAD, records.end - 1)];
            PREFETCH(record_memory + (long)later * 16);
        }
        const int flags = record[FLAGS], first = record[BOX_FIRST], last = record[BOX_LAST];
        const int kind = flags & 3, front = flags >> 2 & 1;
        const int box_x = first & 0xFFFF, box_y = first >> 16;  // the texel at which planes begin
        int first_x = box_x, first_y = box_y, last_x = last & 0xFFFF, last_y = last >> 16;
        if (flags & CUTS) {
            global const int *drawn = AT(const View, batch->views)[draws[flags >> 5].view].box;
            first_x = max(first_x, drawn[0]);
            first_y = max(first_y, drawn[1]);
            last_x = min(last_x, drawn[2]);
            last_y = min(last_y, drawn[3]);
        }
        const int x0 = max(first_x, tile_x) & ~3, y0 = max(first_y, tile_y) & ~3;
        const int x1 = min(last_x, tile_x + TILE - 1), y1 = min(last_y, tile_y + TILE - 1);
        uint parts = touch_squares(x0 - tile_x, y0 - tile_y, x1 - tile_x, y1 - tile_y, PART_BITS);
#if BOUNDS_DEPTH
        const float16 bound = *(const float16 *)bounds;
        const float closest = as_float(record[NEAR_IS_LESS ? LOWEST : HIGHEST]), step = batch->depth_step;
        parts &= ~bits_of(BEHIND(NEAR_IS_LESS ? closest - step : closest + step, bound));
        if (!parts) continue;
#endif
        if (flags >> 5 != number) {
            number = flags >> 5;
            draw = draws + number;
            view = AT(const View, batch->views) + draw->view;
            state = view->state;
            row = AT(const ulong, batch->rows) + (long)draw->row * batch->row_words;
            if (draw->samples != samples) {
                count_samples(batch, samples, passed);
                samples = draw->samples;
                passed = (int16)(0);
            }
        }
        global const float *depth_plane = (global const float *)(record + DEPTH_PLANE);
        const bool thin = flags & THIN;
        const float lowest = as_float(record[LOWEST]), highest = as_float(record[HIGHEST]);
        const float depth_x = thin ? 0.0f : depth_plane[0], depth_y = thin ? 0.0f : depth_plane[1];
        const float depth_start = !thin ? depth_plane[2] : batch->near_is_less ? lowest : highest;
        const float16 lane_depth = fma((float16)(depth_x), LANE_FX, depth_y * LANE_FY);
#if BOUNDS_DEPTH
        if (parts & (parts - 1)) {
            // The nearest depth of the plane in each part, with a margin for rounding.
            const int away_x = tile_x - box_x, away_y = tile_y - box_y;
            const float slope_x = fabs(depth_x), slope_y = fabs(depth_y), middle = (PART - 1) / 2.0f;
            float reach = (slope_x + slope_y) * middle + 1e-6f + batch->depth_step +
                          0x1p-20f * (slope_x * (abs(away_x) + TILE) + slope_y * (abs(away_y) + TILE));
            float start = depth_start + depth_x * (away_x + middle) + depth_y * (away_y + middle);
            float16 nearest = start + lane_depth * PART;
            nearest = clamp_to(NEAR_IS_LESS ? nearest - reach : nearest + reach, lowest - step, highest + step);
            parts &= ~bits_of(BEHIND(nearest, bound));
            if (!parts) continue;
        }
        // Difference between the depth of a block's first texel and that of its nearest corner.
        const float to_nearest = fma(depth_x, GETS_NEARER(depth_x) ? 3.0f : 0.0f, depth_y * (GETS_NEARER(depth_y) ? 3.0f : 0.0f));
#endif
#if FRAGMENT
        global const float *planes = AT(const float, batch->planes) + (long)place * 16;
#if VARYING_WORDS
        global const uint *varyings = AT(const uint, batch->varyings), *slots = (global const uint *)planes + SLOTS;
        global const uint *corner0 = varyings + (SHADES ? (long)slots[0] * VARYING_WORDS : 0);
        global const uint *corner1 = varyings + (SHADES ? (long)slots[1] * VARYING_WORDS : 0);
        global const uint *corner2 = varyings + (SHADES ? (long)slots[2] * VARYING_WORDS : 0);
#endif
#endif

        Rare rare;
        const bool is_rare = kind >= POLYGON || thin;
        if (SELDOM(is_rare) && !find_rare(targets, batch, view, record, x0, y0, &rare)) continue;
        Edges edges;
        if (kind == SMALL) {
            UNROLL for (int i = 0; i < 3; ++i) {
                edges.a[i] = i < 2 ? record[EDGE_A + i] : -record[EDGE_A] - record[EDGE_A + 1];
                edges.b[i] = i < 2 ? record[EDGE_B + i] : -record[EDGE_B] - record[EDGE_B + 1];
                UNROLL for (int sample = 0; sample < SAMPLES; ++sample) edges.c[sample][i] = record[EDGE_C + i];
            }
            edges.x = box_x;
            edges.y = box_y;
        } else if (kind == BIG) {
            int2 triangle[3];
            triangle[0] = (int2)(record[EDGE_C], record[EDGE_C + 1]);
            triangle[1] = triangle[0] + (int2)(record[EDGE_B], -record[EDGE_A]);
            triangle[2] = triangle[1] + (int2)(record[EDGE_B + 1], -record[EDGE_A + 1]);
            if (!find_edges(targets, triangle, x0, y0, &edges)) continue;
        } else edges = rare.edges;
        UNROLL for (int i = 0; i < 3; ++i) edges.lanes[i] = edges.a[i] * LANE_X + edges.b[i] * LANE_Y;
        int16 starts[3];
        uint crossed = parts;
        if (crossed & (crossed - 1)) crossed &= cross_squares(&edges, tile_x, tile_y, PART_BITS, starts);
        for (; crossed; crossed &= crossed - 1) {
            const int part = 31 - clz(crossed & -crossed);
            const int part_x = tile_x + part % PARTS * PART, part_y = tile_y + part / PARTS * PART;
            uint todo = touch_squares(max(x0 - part_x, 0), max(y0 - part_y, 0), min(x1 - part_x, PART - 1),
                                      min(y1 - part_y, PART - 1), 2);
            int start[3][16] __attribute__((aligned(64)));  // edges and depth at the first texel of each block
            float start_depth[16] __attribute__((aligned(64)));
            const float part_away_x = part_x - box_x, part_away_y = part_y - box_y;
            if (todo & (todo - 1)) {
                todo &= cross_squares(&edges, part_x, part_y, 2, starts);
                const float16 first_depths =
                    fma((float16)(depth_x), LANE_FX * 4.0f + part_away_x, depth_y * (LANE_FY * 4.0f + part_away_y)) + depth_start;
#if BOUNDS_DEPTH
                if (DEPTH_WRITES) {  // without writes, most blocks have the bound of their part, which was tested
                    const float16 nearest = round_depth(targets, clamp_to(first_depths + to_nearest, lowest, highest));
                    todo &= ~bits_of(BEHIND(nearest, block_bounds[part]));
                }
#endif
                if (!todo) continue;
                UNROLL for (int i = 0; i < 3; ++i) *(int16 *)start[i] = starts[i];
                *(float16 *)start_depth = first_depths;
            } else {  // a single block, as most small triangles touch, isn't worth a test
                const int block = 31 - clz(todo), column = block % 4, row_of_blocks = block / 4;
                const int x = part_x + column * 4 - edges.x, y = part_y + row_of_blocks * 4 - edges.y;
                UNROLL for (int i = 0; i < 3; ++i) start[i][block] = edges.c[0][i] + edges.a[i] * x + edges.b[i] * y;
                start_depth[block] =
                    fma(depth_x, column * 4.0f + part_away_x, depth_y * (row_of_blocks * 4.0f + part_away_y)) + depth_start;
            }
#if BOUNDS_DEPTH
            if (DEPTH_WRITES) writes[part] += popcount(todo);
#endif
            for (; todo; todo &= todo - 1) {
                const int place_in_part = 31 - clz(todo & -todo);
                const int x = part_x + place_in_part % 4 * 4, y = part_y + place_in_part / 4 * 4;
                const int16 edge0 = edges.lanes[0] + start[0][place_in_part];
                const int16 edge1 = edges.lanes[1] + start[1][place_in_part];
                const int16 edge2 = edges.lanes[2] + start[2][place_in_part];
                int16 box = (int16)(-1);
                if (SELDOM(flags & CUTS))
                    box = (x + LANE_X >= first_x) & (x + LANE_X <= last_x) & (y + LANE_Y >= first_y) & (y + LANE_Y <= last_y);
                int16 masks[MAX_SAMPLES], covered = (int16)(0);
                UNROLL for (int sample = 0; sample < SAMPLES; ++sample) {
                    masks[sample] = box & (((edge0 + (edges.c[sample][0] - edges.c[0][0])) |
                                            (edge1 + (edges.c[sample][1] - edges.c[0][1])) |
                                            (edge2 + (edges.c[sample][2] - edges.c[0][2]))) >= 0);
                    if (SELDOM(is_rare) && rare.has_range) masks[sample] &= find_within(&rare.range, x, y, sample);
                    covered |= masks[sample];
                }
                // The centres that are known to be covered: those of several samples may lie outside, as on other devices.
                const int16 inside = SAMPLES == 1 ? covered : (int16)(0);
                float16 z = lane_depth + start_depth[place_in_part];
                if (SELDOM(thin)) z = find_thin_depth(view, record, &rare, x, y, 0, 0, inside);
#if STAGES_DEPTH
                // The same as merge_depth_stencil for one sample without stencil, on the staged block.
                float16 *block = blocks + part * PART_BLOCKS + place_in_part;
                float16 stored = *block, fresh = round_depth(targets, clamp_to(z, lowest, highest));
#if TEST_ORDER != TEST_LATE || !SHADES
                covered &= compare_depth(targets, fresh, stored);
                masks[0] = covered;
#if DEPTH_WRITES && (TEST_ORDER == TEST_EARLY || !SHADES)
#if SHADES
                if (!bits_of(covered)) continue;
#endif
                *block = covered ? fresh : stored;
#endif
#if TEST_ORDER == TEST_EARLY || !SHADES
                passed -= covered;
#endif
#endif
#endif
#if FRAGMENT || !STAGES_DEPTH
                if (!bits_of(covered)) continue;
#endif
#define PLANE_DEPTH (z + (depth_x * (SAMPLE_X(sample) / 256.0f) + depth_y * (SAMPLE_Y(sample) / 256.0f)))
#define SAMPLE_DEPTH \
    clamp_to(SELDOM(thin && SAMPLES > 1) ? find_thin_depth(view, record, &rare, x, y, SAMPLE_X(sample), SAMPLE_Y(sample), \
                                                           masks[sample]) : PLANE_DEPTH, lowest, highest)
#if !STAGES_DEPTH
                if (TEST_ORDER != TEST_LATE || !SHADES) {
                    covered = (int16)(0);
                    UNROLL for (int sample = 0; sample < SAMPLES; ++sample) {
                        if (TEST_ORDER == TEST_EARLY || !SHADES) {
                            masks[sample] =
                                merge_depth_stencil(targets, state, x, y, sample, front, masks[sample], SAMPLE_DEPTH);
                            passed -= masks[sample];
                        } else
                            masks[sample] =
                                test_depth_stencil(targets, state, x, y, sample, front, masks[sample], SAMPLE_DEPTH);
                        covered |= masks[sample];
                    }
                    if (SHADES && !bits_of(covered)) continue;
                }
#endif
#if FRAGMENT
                if (!SHADES) continue;
                float16 away_x = (float)(x - box_x) + LANE_FX, away_y = (float)(y - box_y) + LANE_FY;
                Weights weights;
                if (SELDOM(thin)) find_thin_weights(&rare, x, y, inside, &weights);
                else find_weights(planes, away_x, away_y, &weights);
                const int shares = as_int(planes[SHARES]);
                clamp_weights(&weights.weight1, &weights.weight2, inside & -(shares & 1));
                clamp_weights(&weights.straight1, &weights.straight2, inside & -(shares >> 1));
                uint16 inputs[VARYING_WORDS + 1], outputs[OUTPUT_WORDS];
                uint flat[VARYING_WORDS + 1];
#if VARYING_WORDS
                VARYINGS(SMOOTH, FLAT, STRAIGHT)
#endif
                UNROLL for (int i = 0; i < OUTPUT_WORDS; ++i) outputs[i] = (uint16)(0u);
                z = inside ? clamp_to(z, lowest, highest) : z;
                float16 depth = z;
                int16 kept = rhi_fragment(
                    BINDINGS inputs, flat, (float)x + LANE_FX + 0.5f, (float)y + LANE_FY + 0.5f, z, weights.near_w,
                    front, as_int(planes[NUMBER]), weights.weight1, weights.weight2, covered, outputs, &depth);
                kept = test_alpha(targets, state, kept, outputs);
                UNROLL for (int sample = 0; sample < SAMPLES; ++sample) {
                    int16 mask = masks[sample] & kept;
                    if (MAX_SAMPLES > 1) mask = cover_by_alpha(targets, mask, outputs, sample);
#if STAGES_DEPTH
#if TEST_ORDER != TEST_EARLY
                    fresh = GIVES_DEPTH ? quantize_depth(targets, depth) : fresh;
                    mask &= compare_depth(targets, fresh, stored);
                    if (DEPTH_WRITES) *block = mask ? fresh : stored;
                    passed -= mask;
#endif
#else
                    if (TEST_ORDER != TEST_EARLY) {
                        mask = merge_depth_stencil(targets, state, x, y, sample, front, mask,
                                                   GIVES_DEPTH ? depth : SAMPLE_DEPTH);
                        passed -= mask;
                    }
#endif
                    if (COLOR_COUNT && (MAX_SAMPLES == 1 || bits_of(mask)))
                        merge_colors(targets, state, x, y, sample, mask, outputs);
                }
#endif
            }
#if BOUNDS_DEPTH
            if (DEPTH_WRITES && writes[part] >= WRITES_BEFORE_BOUND) FIND_BOUNDS(part)
#endif
        }
    }
    count_samples(batch, samples, passed);
#if STAGES_DEPTH
    if (DEPTH_WRITES) stage_depth(targets, tile_x, tile_y, width, height, blocks, true);
#endif
#if BOUNDS_DEPTH
    for (int part = 0; part < PARTS * PARTS; ++part) {
        if (writes[part]) FIND_BOUNDS(part)
        left_bounds[part / PARTS * bounds_pitch + part % PARTS] = bounds[part];
    }
#endif
}
