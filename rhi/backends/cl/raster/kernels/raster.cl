// Rasterisation: a work-item per tile, which it alone writes, processes the tile's records in order.
//
// - A tile is 4 × 4 parts, a part 4 × 4 blocks, a block 4 × 4 texels: 16 lanes each, lane = x + 4 y. Of the
//   parts and then the blocks that a record's box touches, those outside of an edge are discarded 16 at a
//   time. In the remaining blocks, coverage, depth and shading are vectors of 16.
// - records.cl reads records, edges.cl computes coverage, depth_tile.cl tests depth, and shade.cl shades. All
//   of their functions are inlined, except for what is rare, so their structs lie in registers.
// - Multi-sampled targets have a coverage for each sample and one shading.
// - merger.cl, the fragment stage, varyings.cl and the macros of kernel_structs.py precede these texts: FRAGMENT,
//   BINDINGS, VARYING_WORDS, VARYINGS, CACHES_DEPTH, BOUNDS_DEPTH. In a general kernel (merger.cl) depth isn't
//   staged.

// Select the blocks of the part at texel part_x, part_y that a record may cover, as bits, and compute edges
// and depth at their first texels.
INLINE uint select_blocks(
    const Targets *targets, const Record *record, const Edges *edges, const DepthBounds *bounds, int part,
    int part_x, int part_y, BlockStarts *starts
) {
    const float depth_x = record->depth_x, depth_y = record->depth_y, depth_start = record->depth_start;
    const float part_away_x = part_x - record->box_x, part_away_y = part_y - record->box_y;
    uint blocks = touch_squares(
        max(record->x0 - part_x, 0), max(record->y0 - part_y, 0), min(record->x1 - part_x, PART - 1),
        min(record->y1 - part_y, PART - 1), 2
    );
    if (!(blocks & (blocks - 1))) {  // a single block, as most small triangles touch, isn't worth a test
        const int block = 31 - clz(blocks), column = block % 4, row = block / 4;
        const int x = part_x + column * 4 - edges->x, y = part_y + row * 4 - edges->y;
        UNROLL_FOR (int i = 0; i < 3; ++i)
            starts->edges[i][block] = edges->c[0][i] + edges->a[i] * x + edges->b[i] * y;
        starts->depths[block] =
            fma(depth_x, column * 4.0f + part_away_x, depth_y * (row * 4.0f + part_away_y)) + depth_start;
        return blocks;
    }
    int16 edge_starts[3];
    blocks &= cross_squares(edges, part_x, part_y, 2, edge_starts);
    const float16 first_depths =
        fma((float16)(depth_x), LANE_FX * 4.0f + part_away_x, depth_y * (LANE_FY * 4.0f + part_away_y)) +
        depth_start;
    blocks = cull_blocks(targets, record, bounds, part, blocks, first_depths);
    if (!blocks) return 0;
    UNROLL_FOR (int i = 0; i < 3; ++i) *(int16 *)starts->edges[i] = edge_starts[i];
    *(float16 *)starts->depths = first_depths;
    return blocks;
}

// Draw a record's fragments in the block at texel x, y.
FUSED void draw_block(
    const Targets *targets, const Record *record, const Edges *edges, const Rare *rare,
    const BlockStarts *starts, int block, int x, int y, float16 *staged, CurrentDraw *draw
) {
    int16 masks[MAX_SAMPLES];
    int16 covered = cover_block(targets, record, edges, rare, starts, block, x, y, masks);
    // The centres that are known to be covered: those of several samples may lie outside, as on other
    // devices.
    const int16 inside = SAMPLES == 1 ? covered : (int16)(0);
    BlockDepth depth;
    depth.staged = staged;
    depth.z = record->lane_depth + starts->depths[block];
    if (UNLIKELY(record->thin)) depth.z = thin_depth(draw->view, record->words, rare, x, y, 0, 0, inside);
    covered = test_before_shading(targets, record, rare, x, y, &depth, draw, covered, masks);
#if FRAGMENT
    if (SHADES && bits_of(covered))
        shade_block(targets, record, rare, x, y, inside, covered, masks, &depth, draw);
#endif
}

// Draw a record's fragments in a set of parts of a tile.
FUSED void draw_parts(
    const Targets *targets, const Tile *tile, const Record *record, const Edges *edges, const Rare *rare,
    uint parts, float16 *blocks, DepthBounds *bounds, CurrentDraw *draw
) {
    for (; parts; parts &= parts - 1) {
        const int part = 31 - clz(parts & -parts);
        const int part_x = tile->x + part % PARTS * PART, part_y = tile->y + part / PARTS * PART;
        BlockStarts starts;
        uint remaining = select_blocks(targets, record, edges, bounds, part, part_x, part_y, &starts);
        if (!remaining) continue;
        note_writes(targets, part, remaining, bounds);
        for (; remaining; remaining &= remaining - 1) {
            const int block = 31 - clz(remaining & -remaining);
            const int x = part_x + block % 4 * 4, y = part_y + block / 4 * 4;
            draw_block(
                targets, record, edges, rare, &starts, block, x, y, blocks + part * PART_BLOCKS + block, draw
            );
        }
        update_bounds(targets, blocks, part, bounds);
    }
}

// Draw the fragments of a record, the one at `index`, in a tile.
FUSED void draw_record(
    const Targets *targets, const Tile *tile, long index, float16 *blocks, DepthBounds *bounds,
    CurrentDraw *draw
) {
    global const Batch *batch = tile->batch;
    global const Draw *draws = AT(const Draw, batch->draws);
    Record record;
    load_box(tile, draws, AT(const int, batch->records) + index * 16, &record);
    uint parts = touch_squares(
        record.x0 - tile->x, record.y0 - tile->y, record.x1 - tile->x, record.y1 - tile->y, PART_BITS
    );
    parts = cull_parts(tile, &record, bounds, parts);
    if (!parts) return;
    const int number = record.flags >> 5;
    if (number != draw->number) change_draw(batch, draws, number, draw);
    load_depth_plane(tile, &record);
    parts = cull_parts_by_plane(tile, &record, bounds, parts);
    if (!parts) return;
#if FRAGMENT
    load_shading(targets, batch, index, &record);
#endif
    Rare rare;
    if (UNLIKELY(record.is_rare) &&
        !compute_rare(targets, batch, draw->view, record.words, record.x0, record.y0, &rare))
        return;
    Edges edges;
    if (!load_edges(targets, &record, &rare, &edges)) return;
    int16 edge_starts[3];
    if (parts & (parts - 1)) parts &= cross_squares(&edges, tile->x, tile->y, PART_BITS, edge_starts);
    draw_parts(targets, tile, &record, &edges, &rare, parts, blocks, bounds, draw);
}

SINGLE raster(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    const int tile_index = spread_work(get_global_id(0), batch->tiles);
    Records records;
    begin_records(batch, tile_index, &records);
    int index = next_record(&records);
    Tile tile;
    tile.batch = batch;
    tile.x = tile_index % batch->tiles_x * TILE;
    tile.y = tile_index / batch->tiles_x * TILE;
    tile.width = min(TILE, ((batch->width + 3) & ~3) - tile.x);
    tile.height = min(TILE, ((batch->height + 3) & ~3) - tile.y);
    if (index < 0) reset_bounds(&tile);
    const uint cleared = batch->cleared;
    if (index < 0 && !cleared) return;
    global const Merger *merger = AT(const Merger, batch->merger);
    global const ulong *surface_layouts = (global const ulong *)(merger + 1);
    Targets opened;
    open_targets(merger, batch->surfaces, surface_layouts, &opened);
    const Targets *targets = &opened;
    // Depth that is staged and written back is cleared in the staging area.
    const bool clears_staged = CACHES_DEPTH && DEPTH_WRITES && index >= 0 && cleared >> COLOR_COUNT & 1;
    const uint in_memory = cleared ^ (uint)clears_staged << COLOR_COUNT;
    if (in_memory)
        clear_targets(targets, surface_layouts, in_memory, tile.x, tile.y, tile.width, tile.height);
    if (index < 0) return;
    float16 blocks[TILE_BLOCKS];
    DepthBounds bounds;
    const float clear_depth = CACHES_DEPTH ? as_float(*CLEAR_TEXEL(surface_layouts, COLOR_COUNT)) : 0.0f;
    begin_depth(targets, &tile, clears_staged, clear_depth, blocks, &bounds);
    CurrentDraw draw;
    draw.number = -1;
    draw.counter = 0;
    draw.stage = batch->stage;
    draw.passed = (int16)(0);
    for (; index >= 0; index = next_record(&records)) {
        prefetch_record(&records, AT(const int, batch->records));
        draw_record(targets, &tile, index, blocks, &bounds, &draw);
    }
    count_samples(batch, &draw);
    end_depth(targets, &tile, blocks, &bounds);
}
