// Coverage: which parts of a tile, blocks of a part, and samples of a block a record covers.
//
// - The edges of large primitives are computed at the tile in 64 bits. An edge with all of the tile on its
//   inside is dropped; one with all of the tile on its outside ends the record. The others fit in 32 bits.
//   Lines and points have a fourth edge, and clipped triangles have two more, those of the near and far
//   planes: a mask.
// - What only these and thin triangles need is `Rare`. It stays in memory, and functions that aren't inlined
//   compute it, so that it takes no registers from the loop over blocks.

typedef struct {
    int a[3], b[3];         // per texel
    int x, y;               // the texel at which `c` is valid
    int c[MAX_SAMPLES][3];  // rounded down to whole texels
    int16 lanes[3];         // increments for the texels of a block
} Edges;

// From the texel's centre, in subtexels, for 1, 2, 4 and 8 samples. Two lie off both diagonals, whose edges
// cover both or none; four and eight are the standard patterns of Direct3D 11 and Vulkan.
constant int sample_x[15] = {0, -32, 32, -32, 96, -96, 32, 16, -16, 80, -48, -80, -112, 48, 112};
constant int sample_y[15] = {0, -96, 96, -96, -32, 32, 96, -48, 48, 16, -80, 80, -16, 112, -112};
#define SAMPLE_X(sample) sample_x[SAMPLES - 1 + (sample)]
#define SAMPLE_Y(sample) sample_y[SAMPLES - 1 + (sample)]

// Store an edge A x + B y per texel, valid at texel edges->x, edges->y, where its value is `start`. Return
// false if it has nothing of the tile from there on inside.
INLINE bool set_edge(const Targets *targets, Edges *edges, const int i, int a, int b, long start) {
    start += OWNS(a, b) - 1;
    // With a margin, since samples lie off the centres.
    long across = (long)TILE * (max(a, 0) + max(b, 0)) + abs(a) + abs(b);
    long back = (long)TILE * (min(a, 0) + min(b, 0));
    if ((start >> 8) + across < 0) return false;
    bool holds = (start >> 8) + back - abs(a) - abs(b) >= 0;
    edges->a[i] = holds ? 0 : a;
    edges->b[i] = holds ? 0 : b;
    UNROLL_FOR (int sample = 0; sample < SAMPLES; ++sample)
        edges->c[sample][i] =
            holds ? 0 : (int)((start + (long)a * SAMPLE_X(sample) + (long)b * SAMPLE_Y(sample)) >> 8);
    return true;
}

// Store the edge from one corner to the next, as `set_edge` does.
INLINE bool join_corners(const Targets *targets, Edges *edges, const int i, int2 from, int2 to) {
    int a = from.y - to.y, b = to.x - from.x;
    long start = (long)a * (edges->x * SUBTEXELS - from.x) + (long)b * (edges->y * SUBTEXELS - from.y);
    return set_edge(targets, edges, i, a, b, start);
}

// Compute the edges of a triangle of any size at texel x, y. Return false if it covers nothing of the tile
// from there on.
INLINE bool set_triangle_edges(const Targets *targets, const int2 *points, int x, int y, Edges *edges) {
    edges->x = x;
    edges->y = y;
    UNROLL_FOR (int i = 0; i < 3; ++i)
        if (!join_corners(targets, edges, i, points[i], points[i < 2 ? i + 1 : 0])) return false;
    return true;
}

// Compute the edges of a line or a point, a parallelogram: two triangles would shade a texel twice whose
// samples both cover. `range`: the fourth edge.
INLINE bool set_parallelogram_edges(
    const Targets *targets, const int2 *points, int x, int y, Edges *edges, Edges *range
) {
    edges->x = range->x = x;
    edges->y = range->y = y;
    UNROLL_FOR (int i = 0; i < 3; ++i)
        if (!join_corners(targets, edges, i, points[i], points[i + 1])) return false;
    return join_corners(targets, range, 0, points[3], points[0]) &&
        set_edge(targets, range, 1, 0, 0, 1l << 40);
}

// Compute the edges of a triangle that the view cuts. `range`: what the near and far planes cut, in two
// edges.
NOINLINE bool set_clipped_edges(
    const Targets *targets, const Contour *contour, int x, int y, Edges *edges, Edges *range
) {
    edges->x = range->x = x;
    edges->y = range->y = y;
    for (int i = 0; i < 5; ++i) {
        int a, b;
        long start = contour_edge(contour, i, x, y, &a, &b);
        if (!set_edge(targets, i < 3 ? edges : range, i % 3, a, b, start)) return false;
    }
    return true;
}

// Return the lanes of the block at texel x, y that the first two edges contain.
NOINLINE int16 lanes_within(const Edges *range, int x, int y, const int sample) {
    int16 innermost = (int16)(0);
    UNROLL_FOR (int i = 0; i < 2; ++i)
        innermost |= range->a[i] * (x - range->x + LANE_X) +
            (range->b[i] * (y - range->y + LANE_Y) + range->c[sample][i]);
    return innermost >= 0;
}

// Sets of 4 × 4 squares as bits: the parts of a tile, or the blocks of a part. A square has 2^`bits` texels a
// side.

// Return the squares that a box touches, whose first and last texel are relative to the first square.
INLINE uint touch_squares(int x0, int y0, int x1, int y1, const int bits) {
    const uint columns = (2u << (x1 >> bits)) - (1u << (x0 >> bits));
    return columns * (((16u << (y1 >> bits) * 4) - (1u << (y0 >> bits) * 4)) & 0x1111u);
}

// Return the squares that don't lie outside of any edge; the first square begins at texel x, y. `starts`: the
// edges at each square's first texel.
INLINE uint cross_squares(const Edges *edges, int x, int y, const int bits, int16 *starts) {
    x -= edges->x;
    y -= edges->y;
    int16 innermost = (int16)(0);
    UNROLL_FOR (int i = 0; i < 3; ++i) {
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
    Outline outline;  // of a clipped or thin triangle
    Barycentrics precise;
    Edges edges, range;  // of a clipped triangle, a line or a point: three edges, and further ones
    bool has_range;
} Rare;

// Compute what a rare record needs at texel x, y. Return false if it covers nothing of the tile from there
// on.
NOINLINE bool compute_rare(
    const Targets *targets, global const Batch *batch, global const View *view, global const int *record,
    int x, int y, Rare *rare
) {
    const int kind = record[FLAGS] & 3;
    rare->has_range = false;
    if (kind == POLYGON) {
        float4 clips[2];
        int2 points[MAX_CORNERS];
        UNROLL_FOR (int i = 0; i < 2; ++i) clips[i] = load_clip(batch, record[CLIPPED_SLOTS + i]);
        const int primitive = record[POLYGON_PRIMITIVE];
        rare->has_range = true;
        const float size = primitive == POINTS ? load_point_size(batch, record[CLIPPED_SLOTS])
                                               : view->line_width;
        return make_polygon(view, clips, primitive, size, points) &&
            set_parallelogram_edges(targets, points, x, y, &rare->edges, &rare->range);
    }
    uint corners[3];
    for (int i = 0; i < 3; ++i) corners[i] = record[(kind == CLIPPED ? CLIPPED_SLOTS : THIN_SLOTS) + i];
    load_outline(batch, view, corners, &rare->outline);
    compute_barycentrics(&rare->outline, &rare->precise);
    if (kind != CLIPPED) return true;
    Contour contour;
    compute_contour(&rare->outline, &rare->precise, &contour);
    rare->has_range = is_cut(&contour);
    return set_clipped_edges(targets, &contour, x, y, &rare->edges, &rare->range);
}

// Return the depth of a thin triangle in the block at texel x, y, at samples whose coverage is `inside`.
NOINLINE float16 thin_depth(
    global const View *view, global const int *record, const Rare *rare, int x, int y, int aside, int below,
    int16 inside
) {
    return compute_depth(
               view, &rare->outline, &rare->precise, (x + LANE_X) * SUBTEXELS + aside,
               (y + LANE_Y) * SUBTEXELS + below, inside
           ) +
        as_float(record[OFFSET]);
}

// Compute a record's edges at the first block of the tile that its box touches. Return false if it covers
// nothing of the tile from there on. `rare`: what `compute_rare` computes of a rare one.
INLINE bool load_edges(const Targets *targets, const Record *record, const Rare *rare, Edges *edges) {
    global const int *words = record->words;
    if (record->kind == SMALL) {
        UNROLL_FOR (int i = 0; i < 3; ++i) {
            edges->a[i] = i < 2 ? words[EDGE_A + i] : -words[EDGE_A] - words[EDGE_A + 1];
            edges->b[i] = i < 2 ? words[EDGE_B + i] : -words[EDGE_B] - words[EDGE_B + 1];
            UNROLL_FOR (int sample = 0; sample < SAMPLES; ++sample) edges->c[sample][i] = words[EDGE_C + i];
        }
        edges->x = record->box_x;
        edges->y = record->box_y;
    } else if (record->kind == BIG) {
        int2 triangle[3];
        triangle[0] = (int2)(words[EDGE_C], words[EDGE_C + 1]);
        triangle[1] = triangle[0] + (int2)(words[EDGE_B], -words[EDGE_A]);
        triangle[2] = triangle[1] + (int2)(words[EDGE_B + 1], -words[EDGE_A + 1]);
        if (!set_triangle_edges(targets, triangle, record->x0, record->y0, edges)) return false;
    } else *edges = rare->edges;
    UNROLL_FOR (int i = 0; i < 3; ++i) edges->lanes[i] = edges->a[i] * LANE_X + edges->b[i] * LANE_Y;
    return true;
}

// Edges and depth at the first texel of each block of a part.
typedef struct {
    int edges[3][16] __attribute__((aligned(64)));
    float depths[16] __attribute__((aligned(64)));
} BlockStarts;

// Compute which lanes of the block at texel x, y each sample covers. Return the lanes that have a covered
// sample.
INLINE int16 cover_block(
    const Targets *targets, const Record *record, const Edges *edges, const Rare *rare,
    const BlockStarts *starts, int block, int x, int y, int16 *masks
) {
    const int16 edge0 = edges->lanes[0] + starts->edges[0][block];
    const int16 edge1 = edges->lanes[1] + starts->edges[1][block];
    const int16 edge2 = edges->lanes[2] + starts->edges[2][block];
    int16 box = (int16)(-1), covered = (int16)(0);
    if (UNLIKELY(record->flags & CUTS))
        box = (x + LANE_X >= record->first_x) & (x + LANE_X <= record->last_x) &
            (y + LANE_Y >= record->first_y) & (y + LANE_Y <= record->last_y);
    UNROLL_FOR (int sample = 0; sample < SAMPLES; ++sample) {
        masks[sample] = box &
            (((edge0 + (edges->c[sample][0] - edges->c[0][0])) |
              (edge1 + (edges->c[sample][1] - edges->c[0][1])) |
              (edge2 + (edges->c[sample][2] - edges->c[0][2]))) >= 0);
        if (UNLIKELY(record->is_rare) && rare->has_range)
            masks[sample] &= lanes_within(&rare->range, x, y, sample);
        covered |= masks[sample];
    }
    return covered;
}
