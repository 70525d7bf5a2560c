// Primitive set-up: turns primitives into records, 16 at a time, from the window positions of their vertices.
//
// - A work-item processes a chunk of groups in order. A primitive that survives culling gets a record of 64
//   bytes (coverage, depth) and, if a fragment stage runs, a second one (1/w and the weights of the corners
//   as planes in the window).
// - A texel is covered if A x + B y + C >= 0 for the three edges, in subtexels. At texel centres (multiples
//   of 256) that is equivalent to C / 256 rounded down, which keeps small triangles in 32 bits: SMALL.
//   Larger ones are BIG: their record has a corner instead of C, and each tile computes its own C in 64 bits.
//   Triangles that the view cuts are CLIPPED: see triangles.cl; lines, and points of several samples, are
//   POLYGON: see polygon.cl. Points of one sample are SMALL, without edges.
// - A record's box is clamped to the target and not to the viewport and scissor. Its planes begin there, so a
//   primitive that is drawn twice has the same depth each time, wherever the scissor lies. A flag says
//   whether the view cuts the box.
// - An edge that is neither top nor left doesn't own the points on it: its C is decreased by one before the
//   division.
// - Areas are made positive by swapping two corners. The first one, which provides flat varyings, stays.

// Up to this extent, products of two distances and their sums fit in 31 bits.
#define SMALL_EXTENT 23000
// A THIN triangle is one whose weights change by more than this over the blocks that its box touches. Planes
// in float32 then lose 2^-23 times as much, and each block computes its weights in float64 (triangles.cl).
#define BLOCK_REACH 4  // texels that blocks and samples reach beyond the box
#define THIN_SWING 64.0f
// Slope of depth per texel beyond which the rounding of a corner would change depth by more than about 2^-18,
// and in the depth itself, or what it lacks to 1: of reversed depth, which is the inverse of the distance,
// 2^-18 of the distance, and of standard depth, which lacks that.
#define STEEP 0x1p-9f
#define RELATIVELY_STEEP 0x1p-9f

DEFINE_DRAW_SEARCH(search_primitive_draw, primitive_group)

// Return the indices of a group's corners, three for each primitive: those of the draw, or a list written to
// `scratch`, in which lines and points repeat their last corner. Scalar loads from memory are faster than
// extracting lanes.
INLINE global const uint *load_corners(global const Draw *draw, int first, int last, global uint *scratch) {
    int corner_count = draw->primitive, bytes = draw->index_bytes;
    if (last >= GROUP - 1 && corner_count == TRIANGLES) {
        if (bytes == 4) return AT(const uint, draw->indices) + 3 * (long)first;
        UNROLL_FOR (int i = 0; i < 3; ++i) {
            int16 index = 3 * first + GROUP * i + LANES + draw->lowest;
            if (bytes == 2)
                index = convert_int16(vload16(i, AT(const ushort, draw->indices) + 3 * (long)first));
            vstore16(as_uint16(index), i, scratch);
        }
        return scratch;
    }
    if (corner_count == TRIANGLES &&
        bytes == 4) {  // few triangles, as those of a box: the last one is repeated
        global const uint *from = AT(const uint, draw->indices) + 3 * (long)first;
        for (int i = 0; i < GROUP; ++i) {
            int primitive = 3 * min(i, last);
            UNROLL_FOR (int k = 0; k < 3; ++k) scratch[3 * i + k] = from[primitive + k];
        }
        return scratch;
    }
    for (int i = 0; i < 3 * GROUP; ++i) {
        int primitive = first + min(i / 3, last);
        long corner = (long)primitive * corner_count + min(i % 3, corner_count - 1);
        int index = corner + draw->lowest;
        if (bytes == 4) index = AT(const uint, draw->indices)[corner];
        if (bytes == 2) index = AT(const ushort, draw->indices)[corner];
        scratch[i] = index;
    }
    return scratch;
}

// Load the positions of corner `k` of 16 primitives.
#define LOAD_POSITIONS(k) \
    { \
        uint16 rows[4], columns[4]; \
        UNROLL_FOR (int i = 0; i < 4; ++i) \
            rows[i] = (uint16)(vertices[corners[3 * i + k]], vertices[corners[3 * i + 12 + k]], \
                               vertices[corners[3 * i + 24 + k]], vertices[corners[3 * i + 36 + k]]); \
        transpose4(rows, columns); \
        x[k] = as_int16(columns[0]); \
        y[k] = as_int16(columns[1]); \
        z[k] = as_float16(columns[2]); \
        inverse_w[k] = as_float16(columns[3]); \
    }

// Load the slots of 16 primitives' corners: every third of 48 words.
INLINE void load_slots(global const uint *corners, int to_slot, uint16 *slots) {
    uint16 a = vload16(0, corners), b = vload16(1, corners), c = vload16(2, corners), ab;
    ab = SHUFFLE(a, b, 0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 0, 0, 0, 0, 0);
    slots[0] = SHUFFLE(ab, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 17, 20, 23, 26, 29) + (uint)to_slot;
    ab = SHUFFLE(a, b, 1, 4, 7, 10, 13, 16, 19, 22, 25, 28, 31, 0, 0, 0, 0, 0);
    slots[1] = SHUFFLE(ab, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 18, 21, 24, 27, 30) + (uint)to_slot;
    ab = SHUFFLE(a, b, 2, 5, 8, 11, 14, 17, 20, 23, 26, 29, 0, 0, 0, 0, 0, 0);
    slots[2] = SHUFFLE(ab, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 19, 22, 25, 28, 31) + (uint)to_slot;
}

// Transpose 16 vectors of 16 words.
INLINE void transpose16(const uint16 *fields, uint16 *records) {
    uint16 a[16];
    UNROLL_FOR (int i = 0; i < 4; ++i) transpose4(fields + 4 * i, a + 4 * i);
    // Quarter q of a[4 i + j] has the fields 4 i … 4 i + 3 of primitive 4 q + j.
    UNROLL_FOR (int j = 0; j < 4; ++j) {
        uint16 t = SHUFFLE(a[j], a[4 + j], 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
        uint16 u = SHUFFLE(a[j], a[4 + j], 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
        uint16 v = SHUFFLE(a[8 + j], a[12 + j], 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
        uint16 w = SHUFFLE(a[8 + j], a[12 + j], 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
        records[j] = SHUFFLE(t, v, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27);
        records[4 + j] = SHUFFLE(t, v, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
        records[8 + j] = SHUFFLE(u, w, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27);
        records[12 + j] = SHUFFLE(u, w, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
    }
}

// Return the depth bias of a polygon. For float depths the unit is the smallest step at its largest depth.
SELDOM float offset_depth(global const View *view, float slope_x, float slope_y, float largest) {
    float step = view->bias_step != 0.0f ? view->bias_step
                                         : as_float(max((as_int(largest) & 0x7F800000) - (23 << 23), 0));
    float offset = view->bias_units * step + view->bias_slope * fmax(fabs(slope_x), fabs(slope_y));
    float limit = view->bias_clamp;
    return limit > 0.0f ? fmin(offset, limit) : limit < 0.0f ? fmax(offset, limit) : offset;
}

typedef struct {
    double x[3], y[3],
        start[3];  // weight of each corner / w: slopes per texel, and values at the texel they begin at
} CornerPlanes;

// Compute planes of a triangle, clipped or not: they are linear in the window over the whole one.
SELDOM void compute_triangle_planes(const Barycentrics *weights, int left, int top, CornerPlanes *planes) {
    for (int i = 0; i < 3; ++i) {
        planes->x[i] = weights->rows[i].x * weights->scales[i] * SUBTEXELS;
        planes->y[i] = weights->rows[i].y * weights->scales[i] * SUBTEXELS;
        planes->start[i] = dot(weights->rows[i], (double3)(left * SUBTEXELS, top * SUBTEXELS, 1.0)) *
            weights->scales[i];
    }
}

// The same for a line between two corners, along its longer side, or a point. An end's weight / w is (s - s0)
// w0 / (s1 w0 - s0 w1), s being x or y times w.
SELDOM void compute_line_planes(
    const Outline *outline, bool is_line, int from, int to, int left, int top, CornerPlanes *planes
) {
    double3 a = outline->exact[from], b = outline->exact[to];
    bool steep = is_line && fabs(b.y * a.z - a.y * b.z) > fabs(b.x * a.z - a.x * b.z);
    double s0 = (steep ? a.y : a.x) / SUBTEXELS, s1 = (steep ? b.y : b.x) / SUBTEXELS;
    double at = steep ? top : left;
    double whole = is_line ? s1 * a.z - s0 * b.z : 1.0;
    double slope0 = is_line ? -b.z / whole : 0.0, slope1 = is_line ? a.z / whole : 0.0;
    for (int i = 0; i < 3; ++i) planes->x[i] = planes->y[i] = planes->start[i] = 0.0;
    planes->x[from] = steep ? 0.0 : slope0;
    planes->x[to] = steep ? 0.0 : slope1;
    planes->y[from] = steep ? slope0 : 0.0;
    planes->y[to] = steep ? slope1 : 0.0;
    planes->start[from] = is_line ? s1 / whole + slope0 * at : 1.0 / a.z;
    planes->start[to] = is_line ? slope1 * at - s0 / whole : 0.0;
}

// Find the range of the corners' depths: the whole range of the view if one of them is cut.
SELDOM void compute_depth_range(
    global const Batch *batch, global const View *view, const Outline *outline, const uint *slots,
    int primitive, int *record
) {
    float low = INFINITY, high = -low;
    for (int i = 0; i < min(primitive, 3); ++i) {
        float depth = as_float(AT(const uint4, batch->positions)[slots[i]].z);
        low = fmin(low, depth);
        high = fmax(high, depth);
        if (outline->exact[i].z > 0.0 && outline->z[i] >= 0.0 && outline->z[i] <= outline->exact[i].z)
            continue;
        low = fmin(view->shift[2], view->shift[2] + view->scale[2]);
        high = fmax(view->shift[2], view->shift[2] + view->scale[2]);
        break;
    }
    const float offset = as_float(record[OFFSET]);
    record[LOWEST] = as_int(clamp(low + offset, 0.0f, 1.0f));
    record[HIGHEST] = as_int(clamp(high + offset, 0.0f, 1.0f));
}

// Return the depth bias of a triangle that is drawn as lines. One without an area has no slope.
SELDOM float offset_edges(
    global const View *view, const Outline *outline, const Barycentrics *weights, float largest
) {
    CornerPlanes corner;
    compute_triangle_planes(weights, 0, 0, &corner);
    double slope_x = 0.0, slope_y = 0.0;
    for (int i = 0; i < 3; ++i) {
        slope_x += corner.x[i] * outline->z[i] * view->scale[2];
        slope_y += corner.y[i] * outline->z[i] * view->scale[2];
    }
    const bool has_slope = fabs(slope_x) + fabs(slope_y) < INFINITY;
    return offset_depth(view, has_slope ? slope_x : 0.0, has_slope ? slope_y : 0.0, largest);
}

// Complete the record of a primitive by planes in scalars: of those that are clipped, lines and points,
// triangles so wide or so steep that the rounding of a corner would be visible in their depth, and thin ones.
// `edge`: that of a triangle drawn as lines.
void set_planes(
    global const Batch *batch, global const View *view, const Outline *outline, const Barycentrics *weights,
    const uint *slots, int primitive, int edge, int number, bool thin, int *record, float *planes
) {
    const int left = record[BOX_FIRST] & 0xFFFF, top = record[BOX_FIRST] >> 16;
    const int width = (record[BOX_LAST] & 0xFFFF) - left + BLOCK_REACH;
    const int height = (record[BOX_LAST] >> 16) - top + BLOCK_REACH;
    CornerPlanes corner;
    if (primitive == TRIANGLES) compute_triangle_planes(weights, left, top, &corner);
    else compute_line_planes(outline, primitive != POINTS, edge, (edge + 1) % 3, left, top, &corner);
    double depth_x = 0.0, depth_y = 0.0, depth = view->shift[2], near_x = 0.0, near_y = 0.0, near = 0.0;
    double swing = 0.0;
    float largest = 0.0f;
    int in_front = 1;
    for (int i = 0; i < 3; ++i) {
        double clip_depth = outline->z[i] * view->scale[2], w = outline->exact[i].z;
        depth_x += corner.x[i] * clip_depth;
        depth_y += corner.y[i] * clip_depth;
        depth += corner.start[i] * clip_depth;
        near_x += corner.x[i];
        near_y += corner.y[i];
        near += corner.start[i];
        largest = fmax(largest, w > 0.0 ? (float)(clip_depth / w) + view->shift[2] : 1.0f);
        in_front &= w > 0.0;
        swing = fmax(swing, fabs(corner.x[i]) * width + fabs(corner.y[i]) * height);
    }
    const float offset = primitive == TRIANGLES ? offset_depth(view, depth_x, depth_y, fmin(largest, 1.0f))
        : primitive == EDGES                    ? offset_edges(view, outline, weights, fmin(largest, 1.0f))
                                                : 0.0f;
    record[DEPTH_PLANE] = as_int((float)depth_x);
    record[DEPTH_PLANE + 1] = as_int((float)depth_y);
    record[DEPTH_PLANE + 2] = as_int((float)(depth + offset));
    record[OFFSET] = as_int(offset);
    compute_depth_range(batch, view, outline, slots, primitive, record);
    if (primitive == TRIANGLES && (record[FLAGS] & 3) == CLIPPED) {
        double most = near + fmax(near_x * width, 0.0) + fmax(near_y * height, 0.0);
        thin = swing > THIN_SWING * most || fabs(depth_x) * width + fabs(depth_y) * height > THIN_SWING;
    }
    if (thin) {
        record[FLAGS] |= THIN;
        for (int i = 0; i < 3; ++i) record[THIN_SLOTS + i] = slots[i];
    }
    planes[0] = near_x;
    planes[1] = near_y;
    planes[2] = near;
    for (int i = 1; i < 3; ++i) {
        planes[WEIGHTS + 3 * (i - 1)] = corner.x[i];
        planes[WEIGHTS + 3 * (i - 1) + 1] = corner.y[i];
        planes[WEIGHTS + 3 * (i - 1) + 2] = corner.start[i];
        planes[CORNER_W + i - 1] = outline->exact[i].z;
    }
    for (int i = 0; i < 3; ++i) planes[SLOTS + i] = as_float(slots[i]);
    planes[NUMBER] = as_float(number);
    planes[WEIGHT_FLAGS] = as_float((primitive != POINTS) | in_front << 1);
}

// Set the weights of corners 1 and 2 to the position inside a point, 0 to 1 from its top left. Varyings don't
// depend on them, since a point's corners are one vertex.
SELDOM void set_point_weights(
    global const View *view, float4 clip, float size, int left, int top, float *planes
) {
    float inverse_w = 1.0f / clip.w, slope = inverse_w / size;
    double x = (double)clip.x / clip.w * view->scale[0] + view->shift[0] - 0.5;
    double y = (double)clip.y / clip.w * view->scale[1] + view->shift[1] - 0.5;
    planes[WEIGHTS] = slope;
    planes[WEIGHTS + 1] = 0.0f;
    planes[WEIGHTS + 2] = (float)(0.5 + (left - x) / size) * inverse_w;
    planes[WEIGHTS + 3] = 0.0f;
    planes[WEIGHTS + 4] = slope;
    planes[WEIGHTS + 5] = (float)(0.5 + (top - y) / size) * inverse_w;
}

// Return the signed distance of a point {x w, y w, w, clip z} from a plane: near, far, then the left, top,
// right and bottom side of a box in subtexels.
SELDOM double plane_distance(double4 p, int plane, int4 box) {
    switch (plane) {
    case 0: return p.w;
    case 1: return p.z - p.w;
    case 2: return p.x - box.x * p.z;
    case 3: return p.y - box.y * p.z;
    case 4: return box.z * p.z - p.x;
    default: return box.w * p.z - p.y;
    }
}

#define CUT_MARGIN 2  // texels, for the rounding of corners

// Find a box {left, top, right, bottom} of texels of the target that a triangle lies in, by cutting it.
// Return false if nothing is left of it.
bool bound_triangle(global const Batch *batch, const Outline *outline, int *box) {
    double4 corners[9], remaining[9];  // {x w, y w, w, z}
    double most = 0.0, most_w = 0.0;
    const int4 around =
        (int4)(-CUT_MARGIN, -CUT_MARGIN, batch->width + CUT_MARGIN, batch->height + CUT_MARGIN) * SUBTEXELS;
    int count = 3;
    for (int i = 0; i < 3; ++i) {
        corners[i] = (double4)(outline->exact[i], outline->z[i]);
        most = fmax(most, fmax(fabs(corners[i].x), fabs(corners[i].y)));
        most_w = fmax(most_w, fabs(corners[i].z));
    }
    for (int plane = 0; plane < 6; ++plane) {
        int left = 0;
        for (int i = 0; i < count; ++i) {
            double4 p = corners[i], q = corners[i + 1 < count ? i + 1 : 0];
            double at_p = plane_distance(p, plane, around), at_q = plane_distance(q, plane, around);
            if (at_p >= 0.0) remaining[left++] = p;
            if ((at_p >= 0.0) != (at_q >= 0.0)) remaining[left++] = p + (q - p) * (at_p / (at_p - at_q));
        }
        count = left;
        for (int i = 0; i < count; ++i) corners[i] = remaining[i];
    }
    double2 low = (double2)(0x1p30), high = -low;
    for (int i = 0; i < count; ++i) {
        double w = corners[i].z;
        // So near to the eye plane, rounding decides where a corner is.
        bool is_sure = w > 0x1p-36 * most_w && w > 0x1p-57 * most;
        low = is_sure ? fmin(low, corners[i].xy / w) : (double2)(-0x1p30);
        high = is_sure ? fmax(high, corners[i].xy / w) : (double2)(0x1p30);
        if (!is_sure) break;
    }
    low = clamp(low / SUBTEXELS - CUT_MARGIN, 0.0, 8192.0);
    high = clamp(high / SUBTEXELS + CUT_MARGIN, -1.0, 8191.0);
    box[0] = low.x;
    box[1] = low.y;
    box[2] = min((int)high.x, batch->width - 1);
    box[3] = min((int)high.y, batch->height - 1);
    return count >= 3;
}

// Find the box of a line or a point, as for `bound_triangle`.
bool bound_polygon(
    global const Batch *batch, global const View *view, const uint *slots, int primitive, int *box
) {
    float4 clips[2];
    int2 points[MAX_CORNERS];
    for (int i = 0; i < 2; ++i) clips[i] = load_clip(batch, slots[i]);
    const float size = primitive == POINTS ? load_point_size(batch, slots[0]) : view->line_width;
    int count = make_polygon(view, clips, primitive, size, points);
    if (!count) return false;
    int2 low = points[0], high = points[0];
    for (int i = 1; i < count; ++i) {
        low = min(low, points[i]);
        high = max(high, points[i]);
    }
    int reach = SAMPLE_REACH(batch->samples);
    box[0] = max((low.x - reach + 255) >> 8, 0);
    box[1] = max((low.y - reach + 255) >> 8, 0);
    box[2] = min((high.x + reach) >> 8, batch->width - 1);
    box[3] = min((high.y + reach) >> 8, batch->height - 1);
    return true;
}

SELDOM bool is_finite(const Outline *outline) {
    double sum = 0.0;
    for (int i = 0; i < 3; ++i)
        sum += fabs(outline->exact[i].x) + fabs(outline->exact[i].y) + fabs(outline->exact[i].z) +
            fabs(outline->z[i]);
    return sum < INFINITY;
}

// Set up a primitive that isn't a whole triangle: one that the view cuts, an edge of one that is drawn as
// lines (from corner `edge` to the next), a line or a point. Return false if it is culled.
bool set_up_clipped(
    global const Batch *batch, global const View *view, uint *slots, int primitive, int edge, int number,
    int draw_number, int *record, float *planes
) {
    Outline outline;
    Barycentrics weights;
    load_outline(batch, view, slots, &outline);
    const bool is_triangle = primitive == TRIANGLES, is_edge = primitive == EDGES;
    bool flipped = false;
    if (is_triangle || is_edge) {
        double area = signed_area(outline.exact);
        flipped = area < 0.0 ||
            (area == 0.0 && view->front);  // without an area, only edges are left: those of a back face
        if ((is_triangle && area == 0.0) || !is_finite(&outline) || (view->culled & (flipped ? 2 : 1)))
            return false;
        if (is_triangle && flipped) {
            uint slot = slots[1];
            slots[1] = slots[2];
            slots[2] = slot;
            load_outline(batch, view, slots, &outline);
        }
        compute_barycentrics(&outline, &weights);
    }
    int box[4];
    const uint ends[3] = {slots[edge], slots[(edge + 1) % 3], slots[(edge + 2) % 3]};
    const int shape = is_edge ? LINES : primitive;
    if (!(is_triangle ? bound_triangle(batch, &outline, box) : bound_polygon(batch, view, ends, shape, box)))
        return false;
    if (max(box[0], view->box[0]) > min(box[2], view->box[2]) ||
        max(box[1], view->box[1]) > min(box[3], view->box[3]))
        return false;
    for (int i = 0; i < 16; ++i) record[i] = 0;
    for (int i = 0; i < 3; ++i) record[CLIPPED_SLOTS + i] = ends[i];
    record[POLYGON_PRIMITIVE] = shape;
    record[BOX_FIRST] = box[0] | box[1] << 16;
    record[BOX_LAST] = box[2] | box[3] << 16;
    bool cuts = box[0] < view->box[0] || box[1] < view->box[1] || box[2] > view->box[2] ||
        box[3] > view->box[3] || ((batch->width | batch->height) & 3);
    record[FLAGS] = PACK_FLAGS(
        draw_number, 0, cuts, !(is_triangle || is_edge) || flipped != view->front,
        is_triangle ? CLIPPED : POLYGON
    );
    set_planes(batch, view, &outline, &weights, slots, primitive, edge, number, false, record, planes);
    if (primitive == POINTS) {
        set_point_weights(
            view, load_clip(batch, slots[0]), load_point_size(batch, slots[0]), box[0], box[1], planes
        );
    }
    return true;
}

// Return the layer of its target that a vertex chooses.
INLINE int load_layer(global const Batch *batch, uint slot) {
    return AT(const int, batch->varyings)[(long)slot * batch->varying_words + batch->target_layer];
}

// Return which of 16 primitives the batch's layer has: those whose first corner chooses it.
SELDOM int16 select_layer(global const Batch *batch, global const uint *corners, int to_slot) {
    int layers[GROUP];
    UNROLL_FOR (int i = 0; i < GROUP; ++i) layers[i] = load_layer(batch, corners[3 * i] + (uint)to_slot);
    return vload16(0, layers) == batch->layer;
}

// Add a record to the counts of the tiles that its box touches.
INLINE void count_tiles(global uint *counts, int tiles_x, uint box) {
    const int x0 = box & 255u, y0 = box >> 8 & 255u, x1 = box >> 16 & 255u, y1 = box >> 24;
    for (int row = y0; row <= y1; ++row)
        for (int column = x0; column <= x1; ++column) ++counts[row * tiles_x + column];
}

// Set up 16 points on a target of one sample, from the draw's point `first` on. Such a point covers the
// texels of its box, so its record is that of a triangle without edges whose box cuts it. Return the index
// behind the last record.
SEPARATE int set_up_points(
    global const Batch *batch, global const Draw *draw, int draw_number, int first, int to_slot,
    global uint *counts, int record_index
) {
    global const View *view = AT(const View, batch->views) + draw->view;
    const int last = draw->primitives - 1 - first;
    const int16 number = first + min(LANES, last);
    const int16 index = draw->index_bytes ? load_indices(draw->indices, draw->index_bytes, number)
                                          : number + draw->lowest;
    uint slots[GROUP];
    vstore16(as_uint16(index + to_slot), 0, slots);
    float clip_x[GROUP], clip_y[GROUP], clip_w[GROUP], sizes[GROUP];
    uint4 positions[GROUP];
    UNROLL_FOR (int i = 0; i < GROUP; ++i) {
        const float4 clip = load_clip(batch, slots[i]);
        clip_x[i] = clip.x;
        clip_y[i] = clip.y;
        clip_w[i] = clip.w;
        positions[i] = AT(const uint4, batch->positions)[slots[i]];
        sizes[i] = load_point_size(batch, slots[i]);
    }
    uint16 rows[4], columns[4];
    UNROLL_FOR (int i = 0; i < 4; ++i)
        rows[i] = (uint16)(positions[i], positions[i + 4], positions[i + 8], positions[i + 12]);
    transpose4(rows, columns);
    const int16 x = as_int16(columns[0]), y = as_int16(columns[1]);
    const float16 z = as_float16(columns[2]), inverse_w = as_float16(columns[3]), size = vload16(0, sizes);
    const float16 wide = vload16(0, clip_x), high = vload16(0, clip_y), w = vload16(0, clip_w);

    const int16 side = convert_int16_rte(size * SUBTEXELS), low_x = x - (side >> 1), low_y = y - (side >> 1);
    const int16 left = max((low_x + 255) >> 8, 0), right = min((low_x + side - 1) >> 8, batch->width - 1);
    const int16 top = max((low_y + 255) >> 8, 0), bottom = min((low_y + side - 1) >> 8, batch->height - 1);
    const int16 first_x = max(left, view->box[0]), last_x = min(right, view->box[2]);
    const int16 first_y = max(top, view->box[1]), last_y = min(bottom, view->box[3]);
    // Points whose centres lie outside of the view are dropped, as are all those without a window position.
    int16 present = LANES <= last;
    if (batch->layer >= 0) {
        int layers[GROUP];
        UNROLL_FOR (int i = 0; i < GROUP; ++i) layers[i] = load_layer(batch, slots[i]);
        present &= vload16(0, layers) == batch->layer;
    }
    uint survivors = bits_of(
        present & (inverse_w >= 0.0f) & (fabs(wide) <= w) & (fabs(high) <= w) & (first_x <= last_x) &
        (first_y <= last_y)
    );
    if (!survivors) return record_index;

    const float16 depth = fmin(fmax(z, 0.0f), 1.0f), none = (float16)(0.0f);
    uint16 fields[16] = {
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        (uint16)(0u),
        as_uint16(z),
        (uint16)(0u),
        as_uint16(left | top << 16),
        as_uint16(right | bottom << 16),
        (uint16)(PACK_FLAGS(draw_number, 0, 1, 1, SMALL)),
        as_uint16(depth),
        as_uint16(depth)
    };
    uint16 records[16], planes[16];
    transpose16(fields, records);
    if (batch->shades) {
        // The weights of corners 1 and 2 are the position inside the point, 0 to 1 from its top left.
        const double16 at_x = convert_double16(wide) / convert_double16(w) * view->scale[0] + view->shift[0] -
            0.5;
        const double16 at_y = convert_double16(high) / convert_double16(w) * view->scale[1] + view->shift[1] -
            0.5;
        const double16 sides = convert_double16(size);
        const float16 across = convert_float16(0.5 + (convert_double16(left) - at_x) / sides) * inverse_w;
        const float16 down = convert_float16(0.5 + (convert_double16(top) - at_y) / sides) * inverse_w;
        const float16 slope = inverse_w / size;
        const uint16 slot = vload16(0, slots);
        uint16 words[16] = {
            as_uint16(none),
            as_uint16(none),
            as_uint16(inverse_w),
            as_uint16(slope),
            as_uint16(none),
            as_uint16(across),
            as_uint16(none),
            as_uint16(slope),
            as_uint16(down),
            as_uint16(w),
            as_uint16(w),
            slot,
            slot,
            slot,
            as_uint16(first + LANES),
            (uint16)(2u)
        };
        transpose16(words, planes);
    }
    uint tile_boxes[GROUP];
    vstore16(
        as_uint16(
            first_x >> TILE_BITS | (first_y >> TILE_BITS) << 8 | (last_x >> TILE_BITS) << 16 |
            (last_y >> TILE_BITS) << 24
        ),
        0, tile_boxes
    );
    for (; survivors; survivors &= survivors - 1, ++record_index) {
        const int lane = 31 - clz(survivors & -survivors);
        AT(uint16, batch->records)[record_index] = records[lane];
        if (batch->shades) AT(uint16, batch->planes)[record_index] = planes[lane];
        AT(uint, batch->boxes)[record_index] = tile_boxes[lane];
        if (batch->listed) count_tiles(counts, batch->tiles_x, tile_boxes[lane]);
    }
    return record_index;
}

// Find the extent of an instance's vertices, which begin at `group`.
SELDOM void merge_extents(global const Batch *batch, global const Draw *draw, int group, Extent *whole) {
    global const Extent *extents = AT(const Extent, batch->extents);
    int end = group + draw->vertex_groups;
    *whole = extents[group];
    while ((group = (group / batch->vertex_chunk + 1) * batch->vertex_chunk) < end) {
        whole->low_x = min(whole->low_x, extents[group].low_x);
        whole->low_y = min(whole->low_y, extents[group].low_y);
        whole->high_x = max(whole->high_x, extents[group].high_x);
        whole->high_y = max(whole->high_y, extents[group].high_y);
        whole->low = fmin(whole->low, extents[group].low);
        whole->high = fmax(whole->high, extents[group].high);
        whole->fit &= extents[group].fit;
        whole->behind &= extents[group].behind;
    }
}

SINGLE set_up(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    global const Draw *draws = AT(const Draw, batch->draws);
    global const uint4 *positions = AT(const uint4, batch->positions);
    global uint *boxes = AT(uint, batch->boxes);
    const int chunk = spread_work(get_global_id(0), batch->chunks), tiles_x = batch->tiles_x;
    global const float *bounds = AT(const float, batch->bounds);
    const bool bounded = batch->bounded;
    const bool listed = batch->listed, shades = batch->shades, near_is_less = batch->near_is_less;
    const bool all_big = batch->samples > 1;
    const int reach = SAMPLE_REACH(batch->samples);
    global uint *scratch = AT(uint, batch->scratch) + chunk * 3 * GROUP;
    global uint *counts = AT(uint, batch->counts) + (long)chunk * batch->tiles;
    if (listed)
        for (int tile = 0; tile < batch->tiles; ++tile) counts[tile] = 0;
    int group = batch->first_group + chunk * batch->chunk_groups;
    int end = min(group + batch->chunk_groups, batch->end_group);
    const int first_record = chunk * batch->chunk_records;
    int record_index = first_record;
    int draw_number = search_primitive_draw(draws, batch->draw_count, group);
    while (group < end) {
        while (group >= draws[draw_number + 1].primitive_group) ++draw_number;
        global const Draw *draw = draws + draw_number;
        if (is_dropped(draw)) {
            group = draws[draw_number + 1].primitive_group;
            continue;
        }
        global const View *view = AT(const View, batch->views) + draw->view;
        const int left_limit = view->box[0], top_limit = view->box[1], right_limit = view->box[2];
        const int bottom_limit = view->box[3], culled = view->culled, front = view->front;
        const bool biased = view->bias_units != 0.0f || view->bias_slope != 0.0f;
        const int primitive = batch->edges && draw->primitive == TRIANGLES ? EDGES : draw->primitive;
        int instance = (group - draw->primitive_group) / draw->primitive_groups;
        int part = (group - draw->primitive_group) - instance * draw->primitive_groups;
        int parts = min(draw->primitive_groups, part + end - group);
        const int vertex_group = draw->vertex_group + instance * draw->vertex_groups;
        Extent whole;
        merge_extents(batch, draw, vertex_group, &whole);
        if (is_invisible(batch, draw, view, &whole)) {
            group += parts - part;
            continue;
        }
        int to_slot = vertex_group * GROUP - draw->lowest;
        global const uint4 *vertices = positions + to_slot;
        if (primitive == POINTS && !all_big) {
            for (; part < parts; ++part, ++group)
                record_index =
                    set_up_points(batch, draw, draw_number, part * GROUP, to_slot, counts, record_index);
            continue;
        }
        for (; part < parts; ++part, ++group) {
            int last = draw->primitives - 1 - part * GROUP;
            global const uint *corners = load_corners(draw, part * GROUP, last, scratch);
            if (last >= 2 * GROUP - 1 && draw->index_bytes == 4 && corners != scratch)
                // one corner of each primitive in the next group: the others are near it
                UNROLL_FOR (int i = 0; i < GROUP; ++i) PREFETCH(vertices + corners[3 * (GROUP + i)]);
            int16 x[3], y[3];
            float16 z[3], inverse_w[3];
            LOAD_POSITIONS(0)
            LOAD_POSITIONS(1)
            LOAD_POSITIONS(2)

            int16 present = LANES <= last;
            if (batch->layer >= 0) present &= select_layer(batch, corners, to_slot);
            int16 unfit = (inverse_w[0] < 0.0f) | (inverse_w[1] < 0.0f) | (inverse_w[2] < 0.0f);
            int16 hidden = (inverse_w[0] < 0.0f) & (inverse_w[1] < 0.0f) & (inverse_w[2] < 0.0f) &
                ((x[0] & x[1] & x[2]) != 0);
            int16 whole = primitive == TRIANGLES ? present & ~unfit : (int16)(0);
            uint polygons = bits_of(present & ~whole & ~hidden);

            int16 low_x = min(min(x[0], x[1]), x[2]), high_x = max(max(x[0], x[1]), x[2]);
            int16 low_y = min(min(y[0], y[1]), y[2]), high_y = max(max(y[0], y[1]), y[2]);
            int16 left = max((low_x - reach + 255) >> 8, 0);
            int16 right = min((high_x + reach) >> 8, batch->width - 1);
            int16 top = max((low_y - reach + 255) >> 8, 0);
            int16 bottom = min((high_y + reach) >> 8, batch->height - 1);
            // The same within the viewport and scissor.
            int16 first_x = max(left, left_limit);
            int16 last_x = min(right, right_limit);
            int16 first_y = max(top, top_limit), last_y = min(bottom, bottom_limit);
            int16 surviving = whole & (first_x <= last_x) & (first_y <= last_y);
            uint survivors = bits_of(surviving);
            if (!(survivors | polygons)) continue;

            int16 extent = max(high_x - low_x, high_y - low_y), wide = extent > SMALL_EXTENT;
            int16 big = all_big ? (int16)(-1) : wide;
            float16 area;
            int16 ax = x[1] - x[0], ay = y[1] - y[0], bx = x[2] - x[0], by = y[2] - y[0];
            if (bits_of(wide & surviving))
                area = convert_float16(
                    convert_long16(ax) * convert_long16(by) - convert_long16(bx) * convert_long16(ay)
                );
            else area = convert_float16(ax * by - bx * ay);
            int16 flipped = area < 0.0f;
            surviving &= area != 0.0f;
            if (culled & 1) surviving &= flipped;
            if (culled & 2) surviving &= ~flipped;
            survivors = bits_of(surviving);
            if (!(survivors | polygons)) continue;
            flipped &= surviving;
            if (bits_of(flipped)) {
                int16 other_x = x[1], other_y = y[1];
                float16 other_z = z[1], other_w = inverse_w[1];
                x[1] = flipped ? x[2] : x[1];
                y[1] = flipped ? y[2] : y[1];
                z[1] = flipped ? z[2] : z[1];
                inverse_w[1] = flipped ? inverse_w[2] : inverse_w[1];
                x[2] = flipped ? other_x : x[2];
                y[2] = flipped ? other_y : y[2];
                z[2] = flipped ? other_z : z[2];
                inverse_w[2] = flipped ? other_w : inverse_w[2];
            }
            area = fabs(area);
            // Edges 0 1, 1 2, 2 0: A x + B y grows towards the inside.
            int16 a0 = y[0] - y[1], a1 = y[1] - y[2], a2 = y[2] - y[0];
            int16 b0 = x[1] - x[0], b1 = x[2] - x[1], b2 = x[0] - x[2];
            int16 origin_x = left << 8, origin_y = top << 8;
            int16 start0 = a0 * (origin_x - x[0]) + b0 * (origin_y - y[0]);
            int16 start1 = a1 * (origin_x - x[1]) + b1 * (origin_y - y[1]);
            int16 start2 = a2 * (origin_x - x[2]) + b2 * (origin_y - y[2]);
            int16 c0 = (start0 - 1 - OWNS(a0, b0)) >> 8, c1 = (start1 - 1 - OWNS(a1, b1)) >> 8;
            int16 c2 = (start2 - 1 - OWNS(a2, b2)) >> 8;
            if (!all_big) {
                // Cull boxes of 1 or 2 texels a side without a covered texel.
                int16 two_x = right > left, two_y = bottom > top, covers = (c0 | c1 | c2) >= 0;
                covers |= two_x & (((c0 + a0) | (c1 + a1) | (c2 + a2)) >= 0);
                covers |= two_y & (((c0 + b0) | (c1 + b1) | (c2 + b2)) >= 0);
                covers |= two_x & two_y & (((c0 + a0 + b0) | (c1 + a1 + b1) | (c2 + a2 + b2)) >= 0);
                surviving &= covers | big | (((right - left) | (bottom - top)) > 1);
                survivors = bits_of(surviving);
                if (!(survivors | polygons)) continue;
            }
            c0 = big ? x[0] : c0;
            c1 = big ? y[0] : c1;

            // Weights of corners 1 and 2: their slopes, and their values at the box's first texel.
            float16 scale = 1.0f / area;
            float16 weight1 = convert_float16(start2) * scale, weight2 = convert_float16(start0) * scale;
            float16 weight1_x = convert_float16(a2) * scale * SUBTEXELS;
            float16 weight1_y = convert_float16(b2) * scale * SUBTEXELS;
            float16 weight2_x = convert_float16(a0) * scale * SUBTEXELS;
            float16 weight2_y = convert_float16(b0) * scale * SUBTEXELS;
            float16 rise1 = z[1] - z[0], rise2 = z[2] - z[0];
            float16 depth_x = rise1 * weight1_x + rise2 * weight2_x;
            float16 depth_y = rise1 * weight1_y + rise2 * weight2_y;
            float16 depth = z[0] + rise1 * weight1 + rise2 * weight2;
            // Where the rounding of corners would be visible, planes come from the corners as they are.
            // Beside triangles thinner than a subtexel, planes are far off.
            float16 least = fmin(fmin(fabs(z[0]), fabs(z[1])), fabs(z[2]));
            least = fmin(least, fmin(fmin(fabs(1.0f - z[0]), fabs(1.0f - z[1])), fabs(1.0f - z[2])));
            int16 tilts = wide | (fabs(depth_x) + fabs(depth_y) > fmin(STEEP, RELATIVELY_STEEP * least));
            int16 blurred = area <= convert_float16(extent);
            float16 width = convert_float16(right - left + BLOCK_REACH);
            float16 height = convert_float16(bottom - top + BLOCK_REACH);
            float16 swing1 = fabs(weight1_x) * width + fabs(weight1_y) * height;
            float16 swing2 = fabs(weight2_x) * width + fabs(weight2_y) * height;
            int16 thins = (fmax(swing1, swing2) > THIN_SWING) | (tilts & blurred);
            const uint thin = bits_of(thins & surviving);
            const uint tilted = bits_of(tilts & surviving) | thin;
            float16 offset = (float16)(0.0f);
            if (biased) {
                float slope_x[GROUP], slope_y[GROUP], largest[GROUP], offsets[GROUP];
                vstore16(depth_x, 0, slope_x);
                vstore16(depth_y, 0, slope_y);
                vstore16(fmax(fmax(z[0], z[1]), z[2]), 0, largest);
                for (int i = 0; i < GROUP; ++i)
                    offsets[i] = offset_depth(view, slope_x[i], slope_y[i], largest[i]);
                offset = vload16(0, offsets);
                depth += offset;
            }
            // No covered sample has a depth beyond these.
            float16 lowest = fmin(fmin(z[0], z[1]), z[2]) + offset;
            float16 highest = fmax(fmax(z[0], z[1]), z[2]) + offset;
            lowest = fmin(fmax(lowest, 0.0f), 1.0f);
            highest = fmin(fmax(highest, 0.0f), 1.0f);
            int16 cuts = (left < left_limit) | (top < top_limit) | (right > right_limit) |
                (bottom > bottom_limit);
            cuts |= (right < (high_x + reach) >> 8) & (batch->width & 3 ? -1 : 0);
            cuts |= (bottom < (high_y + reach) >> 8) & (batch->height & 3 ? -1 : 0);
            int16 is_front = (flipped & 1) ^ front;
            uint16 fields[16] = {
                as_uint16(a0),
                as_uint16(a1),
                as_uint16(b0),
                as_uint16(b1),
                as_uint16(c0),
                as_uint16(c1),
                as_uint16(c2),
                as_uint16(depth_x),
                as_uint16(depth_y),
                as_uint16(depth),
                as_uint16(offset),
                as_uint16(left | top << 16),
                as_uint16(right | bottom << 16),
                as_uint16(PACK_FLAGS((int16)(draw_number), 0, cuts & 1, is_front, big & 1)),
                as_uint16(lowest),
                as_uint16(highest)
            };
            uint16 records[16], planes[16];
            transpose16(fields, records);
            if (shades) {
                uint16 slots[3];
                load_slots(corners, to_slot, slots);
                float16 far1 = inverse_w[1] - inverse_w[0], far2 = inverse_w[2] - inverse_w[0];
                float16 w1 = batch->linear ? 1.0f / inverse_w[1] : inverse_w[1];
                float16 w2 = batch->linear ? 1.0f / inverse_w[2] : inverse_w[2];
                uint16 words[16] = {
                    as_uint16(far1 * weight1_x + far2 * weight2_x),
                    as_uint16(far1 * weight1_y + far2 * weight2_y),
                    as_uint16(inverse_w[0] + far1 * weight1 + far2 * weight2),
                    as_uint16(weight1_x * inverse_w[1]),
                    as_uint16(weight1_y * inverse_w[1]),
                    as_uint16(weight1 * inverse_w[1]),
                    as_uint16(weight2_x * inverse_w[2]),
                    as_uint16(weight2_y * inverse_w[2]),
                    as_uint16(weight2 * inverse_w[2]),
                    as_uint16(w1),
                    as_uint16(w2),
                    slots[0],
                    flipped ? slots[2] : slots[1],
                    flipped ? slots[1] : slots[2],
                    as_uint16(part * GROUP + LANES),
                    (uint16)(3u)
                };
                transpose16(words, planes);
            }
            // A box in tiles, one byte per side. Values that are read back lane by lane are stored
            // separately: reading a part of a vector that was just stored stalls.
            uint tile_boxes[GROUP];
            vstore16(
                as_uint16(
                    first_x >> TILE_BITS | (first_y >> TILE_BITS) << 8 | (last_x >> TILE_BITS) << 16 |
                    (last_y >> TILE_BITS) << 24
                ),
                0, tile_boxes
            );
            uint firsts[GROUP], lasts[GROUP];
            float nearests[GROUP];
            if (bounded) {
                vstore16(as_uint16(first_x | first_y << 16), 0, firsts);
                vstore16(as_uint16(last_x | last_y << 16), 0, lasts);
                vstore16(
                    near_is_less ? lowest - batch->depth_step : highest + batch->depth_step, 0, nearests
                );
            }
            uint todo = survivors | polygons;
            for (int edge = 0, next = 0; todo; edge = next) {
                int lane = 31 - clz(todo & -todo);
                next = primitive == EDGES && edge < 2 ? edge + 1 : 0;
                if (!next) todo &= todo - 1;
                global uint16 *record = AT(uint16, batch->records) + record_index;
                if (UNLIKELY(polygons >> lane & 1)) {
                    int words[16];
                    float plane[16];
                    uint slots[3];
                    for (int k = 0; k < 3; ++k) slots[k] = corners[3 * lane + k] + to_slot;
                    if (!set_up_clipped(
                            batch, view, slots, primitive, edge, part * GROUP + lane, draw_number, words,
                            plane
                        ))
                        continue;
                    int first = words[BOX_FIRST], final = words[BOX_LAST];
                    tile_boxes[lane] = max(first & 0xFFFF, left_limit) / TILE |
                        max(first >> 16, top_limit) / TILE << 8 |
                        min(final & 0xFFFF, right_limit) / TILE << 16 |
                        min(final >> 16, bottom_limit) / TILE << 24;
                    *record = as_uint16(vload16(0, words));
                    if (shades) AT(float16, batch->planes)[record_index] = vload16(0, plane);
                } else {
                    const bool recomputed = tilted >> lane & 1;
                    if (bounded && !(recomputed && biased) &&
                        is_hidden(
                            bounds, tiles_x, near_is_less, firsts[lane] & 0xFFFFu, firsts[lane] >> 16,
                            lasts[lane] & 0xFFFFu, lasts[lane] >> 16, nearests[lane]
                        ))
                        continue;
                    *record = records[lane];
                    if (shades) AT(uint16, batch->planes)[record_index] = planes[lane];
                    if (UNLIKELY(recomputed)) {
                        int words[16];
                        float plane[16];
                        uint slots[3];
                        bool turned = bits_of(flipped) >> lane & 1;
                        for (int k = 0; k < 3; ++k)
                            slots[k] = corners[3 * lane + (turned ? (3 - k) % 3 : k)] + to_slot;
                        Outline outline;
                        Barycentrics weights;
                        load_outline(batch, view, slots, &outline);
                        compute_barycentrics(&outline, &weights);
                        vstore16(as_int16(records[lane]), 0, words);
                        set_planes(
                            batch, view, &outline, &weights, slots, TRIANGLES, 0, part * GROUP + lane,
                            thin >> lane & 1, words, plane
                        );
                        *record = as_uint16(vload16(0, words));
                        if (shades) AT(float16, batch->planes)[record_index] = vload16(0, plane);
                    }
                }
                uint box = tile_boxes[lane];
                boxes[record_index++] = box;
                if (listed) count_tiles(counts, tiles_x, box);
            }
        }
    }
    AT(uint, batch->survivors)[chunk] = record_index - first_record;
}
