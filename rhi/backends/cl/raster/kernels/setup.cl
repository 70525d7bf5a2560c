// Primitive set-up: turns primitives into records, 16 at a time, from the window positions of their vertices.
//
// - A work-item processes a chunk of groups in order. A primitive that survives culling gets a record of 64 bytes (coverage,
//   depth) and, if a fragment stage runs, a second one (1/w and the weights of the corners as planes in the window).
// - A texel is covered if A x + B y + C >= 0 for the three edges, in subtexels. At texel centres (multiples of 256) that
//   is equivalent with C / 256 rounded down, which keeps small triangles in 32 bits: SMALL. Larger ones are BIG: their
//   record has a corner instead of C, and each tile computes its own C in 64 bits. POLYGON: see polygon.cl.
// - A record's box is clamped to the target and not to the viewport and scissor. Its planes begin there, so a primitive
//   that is drawn twice has the same depth each time, wherever the scissor lies. A flag says whether the view cuts the box.
// - An edge that is neither top nor left doesn't own the points on it: its C is decreased by one before the division.
// - Areas are made positive by swapping two corners. The first one, which provides flat varyings, stays.

// Up to this extent, products of two distances and their sums fit in 31 bits.
#define SMALL_EXTENT 23000
// Slope of depth per texel beyond which the rounding of a corner would change depth by more than about 2^-18.
#define STEEP 0x1p-9f

FIND_DRAW(find_draw_of_primitives, primitive_group)

// Return the indices of a group's corners, three for each primitive: those of the draw, or a list written to `scratch`, in
// which lines and points repeat their last corner. Scalar loads from memory are faster than extracting lanes.
INLINE global const uint *find_corners(global const Draw *draw, int first, int last, global uint *scratch) {
    int corner_count = draw->primitive, bytes = draw->index_bytes;
    if (last >= GROUP - 1 && corner_count == TRIANGLES) {
        if (bytes == 4) return AT(const uint, draw->indices) + 3 * (long)first;
        UNROLL for (int i = 0; i < 3; ++i) {
            int16 index = 3 * first + GROUP * i + LANES + draw->lowest;
            if (bytes == 2) index = convert_int16(vload16(i, AT(const ushort, draw->indices) + 3 * (long)first));
            vstore16(as_uint16(index), i, scratch);
        }
        return scratch;
    }
    if (corner_count == TRIANGLES && bytes == 4) {  // few triangles, as those of a box: the last one is repeated
        global const uint *from = AT(const uint, draw->indices) + 3 * (long)first;
        for (int i = 0; i < GROUP; ++i) {
            int primitive = 3 * min(i, last);
            UNROLL for (int k = 0; k < 3; ++k) scratch[3 * i + k] = from[primitive + k];
        }
        return scratch;
    }
    for (int i = 0; i < 3 * GROUP; ++i) {
        int primitive = first + min(i / 3, last);
        long place = (long)primitive * corner_count + min(i % 3, corner_count - 1);
        int index = place + draw->lowest;
        if (bytes == 4) index = AT(const uint, draw->indices)[place];
        if (bytes == 2) index = AT(const ushort, draw->indices)[place];
        scratch[i] = index;
    }
    return scratch;
}

// Load the positions of corner `k` of 16 primitives.
#define LOAD_POSITIONS(k) { \
    uint16 rows[4], columns[4]; \
    UNROLL for (int i = 0; i < 4; ++i) \
        rows[i] = (uint16)(vertices[corners[3 * i + k]], vertices[corners[3 * i + 12 + k]], \
                           vertices[corners[3 * i + 24 + k]], vertices[corners[3 * i + 36 + k]]); \
    transpose4(rows, columns); \
    x[k] = as_int16(columns[0]); y[k] = as_int16(columns[1]); \
    z[k] = as_float16(columns[2]); near_w[k] = as_float16(columns[3]); }

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
    UNROLL for (int i = 0; i < 4; ++i) transpose4(fields + 4 * i, a + 4 * i);
    // Quarter q of a[4 i + j] has the fields 4 i … 4 i + 3 of primitive 4 q + j.
    UNROLL for (int j = 0; j < 4; ++j) {
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
INLINE float offset_depth(global const View *view, float slope_x, float slope_y, float largest) {
    float step = view->bias_step != 0.0f ? view->bias_step
                 : as_float(max((as_int(largest) & 0x7F800000) - (23 << 23), 0));
    float offset = view->bias_units * step + view->bias_slope * fmax(fabs(slope_x), fabs(slope_y));
    float limit = view->bias_clamp;
    return limit > 0.0f ? fmin(offset, limit) : limit < 0.0f ? fmax(offset, limit) : offset;
}

// Compute planes in scalars from clip positions, which aren't rounded: for polygons, and for triangles so wide or so steep
// that the rounding of a corner would be visible in their depth. All planes are linear in the window over the whole
// primitive, clipped or not: with P its corners {x, y, w} before the division, the weight of corner i / w is
// (Pj × Pk) · {x, y, 1} / det P (Olano & Greer 1997). `left` and `top`: the texel that planes begin at.
void find_planes(
    global const View *view, const float4 *clips, const uint *slots, int primitive, int number, int left, int top,
    int *record, float *planes
) {
    double3 p[3];
    for (int i = 0; i < 3; ++i)
        p[i] = (double3)((double)clips[i].x * view->scale[0] + ((double)view->shift[0] - 0.5) * clips[i].w,
                         (double)clips[i].y * view->scale[1] + ((double)view->shift[1] - 0.5) * clips[i].w, clips[i].w);
    double plane_x[3], plane_y[3], plane_c[3];  // planes of corner i's weight / w
    double3 origin = (double3)(left, top, 1.0);
    if (primitive == TRIANGLES) {
        double area = dot(p[0], cross(p[1], p[2]));
        for (int i = 0; i < 3; ++i) {
            double3 row = cross(p[(i + 1) % 3], p[(i + 2) % 3]) / area;
            plane_x[i] = row.x;
            plane_y[i] = row.y;
            plane_c[i] = dot(row, origin);
        }
    } else {
        // Along a line's longer side, its end's weight / w is (s - s0) w0 / (s1 w0 - s0 w1), s being x or y times w.
        double3 a = p[0], b = p[1];
        bool is_line = primitive == LINES;
        bool steep = is_line && fabs(b.y * a.z - a.y * b.z) > fabs(b.x * a.z - a.x * b.z);
        double s0 = steep ? a.y : a.x, s1 = steep ? b.y : b.x, at = steep ? top : left;
        double whole = is_line ? s1 * a.z - s0 * b.z : 1.0;
        double slope0 = is_line ? -b.z / whole : 0.0, slope1 = is_line ? a.z / whole : 0.0;
        for (int i = 0; i < 3; ++i) plane_x[i] = plane_y[i] = plane_c[i] = 0.0;
        plane_x[0] = steep ? 0.0 : slope0;
        plane_x[1] = steep ? 0.0 : slope1;
        plane_y[0] = steep ? slope0 : 0.0;
        plane_y[1] = steep ? slope1 : 0.0;
        plane_c[0] = is_line ? s1 / whole + slope0 * at : 1.0 / a.z;
        plane_c[1] = is_line ? slope1 * at - s0 / whole : 0.0;
    }
    double depth_x = 0.0, depth_y = 0.0, depth = view->shift[2];
    float largest = 0.0f;
    for (int i = 0; i < 3; ++i) {
        double height = (double)clips[i].z * view->scale[2];
        depth_x += plane_x[i] * height;
        depth_y += plane_y[i] * height;
        depth += plane_c[i] * height;
        largest = fmax(largest, clips[i].w > 0.0f ? (float)(height / clips[i].w) + view->shift[2] : 1.0f);
    }
    if (primitive == TRIANGLES) depth += offset_depth(view, depth_x, depth_y, fmin(largest, 1.0f));
    record[DEPTH_PLANE] = as_int((float)depth_x);
    record[DEPTH_PLANE + 1] = as_int((float)depth_y);
    record[DEPTH_PLANE + 2] = as_int((float)depth);
    planes[0] = plane_x[0] + plane_x[1] + plane_x[2];
    planes[1] = plane_y[0] + plane_y[1] + plane_y[2];
    planes[2] = plane_c[0] + plane_c[1] + plane_c[2];
    for (int i = 1; i < 3; ++i) {
        planes[WEIGHTS + 3 * (i - 1)] = plane_x[i];
        planes[WEIGHTS + 3 * (i - 1) + 1] = plane_y[i];
        planes[WEIGHTS + 3 * (i - 1) + 2] = plane_c[i];
        planes[CORNER_W + i - 1] = clips[i].w;
    }
    for (int i = 0; i < 3; ++i) planes[SLOTS + i] = as_float(slots[i]);
    planes[NUMBER] = as_float(number);
    planes[15] = 0.0f;
}

// Let the weights of corners 1 and 2 be the place inside a point, 0 to 1 from its top left: varyings don't depend on them,
// since a point's corners are one vertex.
INLINE void place_in_point(global const View *view, float4 clip, float size, int left, int top, float *planes) {
    float near_w = 1.0f / clip.w, slope = near_w / size;
    double x = (double)clip.x / clip.w * view->scale[0] + view->shift[0] - 0.5;
    double y = (double)clip.y / clip.w * view->scale[1] + view->shift[1] - 0.5;
    planes[WEIGHTS] = slope;
    planes[WEIGHTS + 1] = 0.0f;
    planes[WEIGHTS + 2] = (float)(0.5 + (left - x) / size) * near_w;
    planes[WEIGHTS + 3] = 0.0f;
    planes[WEIGHTS + 4] = slope;
    planes[WEIGHTS + 5] = (float)(0.5 + (top - y) / size) * near_w;
}

// Set up a primitive that is a polygon. Return false if it is culled.
bool set_up_polygon(
    global const Batch *batch, global const View *view, const uint *slots, int primitive, int number, int draw_number,
    int *record, float *planes
) {
    float4 clips[3];
    for (int i = 0; i < 3; ++i) clips[i] = load_clip(batch, slots[i]);
    bool flipped = false;
    if (primitive == TRIANGLES) {
        // The area has the sign of the whole triangle's determinant, inverted since the scale of y is negative.
        double3 a = (double3)(clips[0].x, clips[0].y, clips[0].w), b = (double3)(clips[1].x, clips[1].y, clips[1].w);
        double area = -dot(a, cross(b, (double3)(clips[2].x, clips[2].y, clips[2].w)));
        flipped = area < 0.0;
        if (!(area != 0.0) || (view->culled & (flipped ? 2 : 1))) return false;
    }
    int2 points[MAX_CORNERS + 1];
    float size = primitive == POINTS ? load_point_size(batch, slots[0]) : 0.0f;
    int count = make_polygon(view, clips, primitive, flipped, size, points);
    if (!count) return false;
    int2 low = points[0], high = points[0];
    for (int i = 1; i < count; ++i) {
        low = min(low, points[i]);
        high = max(high, points[i]);
    }
    int reach = batch->samples > 1 ? SAMPLE_REACH : 0;
    int left = max((low.x - reach + 255) >> 8, 0), right = min((high.x + reach) >> 8, batch->width - 1);
    int top = max((low.y - reach + 255) >> 8, 0), bottom = min((high.y + reach) >> 8, batch->height - 1);
    if (max(left, view->box[0]) > min(right, view->box[2]) || max(top, view->box[1]) > min(bottom, view->box[3])) return false;
    find_planes(view, clips, slots, primitive, number, left, top, record, planes);
    if (primitive == POINTS) place_in_point(view, clips[0], size, left, top, planes);
    for (int i = 0; i < DEPTH_PLANE; ++i) record[i] = 0;
    for (int i = 0; i < 3; ++i) record[POLYGON_SLOTS + i] = slots[i];
    record[POLYGON_PRIMITIVE] = primitive;
    record[POLYGON_FLIPPED] = flipped;
    record[BOX_FIRST] = left | top << 16;
    record[BOX_LAST] = right | bottom << 16;
    bool cuts = left < view->box[0] || top < view->box[1] || right > view->box[2] || bottom > view->box[3] ||
                ((batch->width | batch->height) & 3);
    record[FLAGS] = PACK_FLAGS(draw_number, cuts, primitive != TRIANGLES || flipped != view->front, POLYGON);
    record[NEAREST] = as_int(batch->near_is_less ? -INFINITY : INFINITY);
    return true;
}

// Return the extent of an instance's vertices, which begin at `group`.
INLINE Extent find_extent(global const Batch *batch, global const Draw *draw, int group) {
    global const Extent *extents = AT(const Extent, batch->extents);
    int end = group + draw->vertex_groups;
    Extent whole = extents[group];
    while ((group = (group / batch->vertex_chunk + 1) * batch->vertex_chunk) < end) {
        whole.low_x = min(whole.low_x, extents[group].low_x);
        whole.low_y = min(whole.low_y, extents[group].low_y);
        whole.high_x = max(whole.high_x, extents[group].high_x);
        whole.high_y = max(whole.high_y, extents[group].high_y);
        whole.low = fmin(whole.low, extents[group].low);
        whole.high = fmax(whole.high, extents[group].high);
        whole.fit &= extents[group].fit;
        whole.behind &= extents[group].behind;
    }
    return whole;
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
    const int reach = all_big ? SAMPLE_REACH : 0;
    global uint *scratch = AT(uint, batch->scratch) + chunk * 3 * GROUP;
    global uint *counts = AT(uint, batch->counts) + (long)chunk * batch->tiles;
    if (listed) for (int tile = 0; tile < batch->tiles; ++tile) counts[tile] = 0;
    int group = batch->first_group + chunk * batch->chunk_groups;
    int end = min(group + batch->chunk_groups, batch->end_group);
    const int first_record = (group - batch->first_group) * GROUP;
    int place = first_record;
    int found = find_draw_of_primitives(draws, batch->draw_count, group);
    while (group < end) {
        while (group >= draws[found + 1].primitive_group) ++found;
        global const Draw *draw = draws + found;
        if (is_dropped(draw)) {
            group = draws[found + 1].primitive_group;
            continue;
        }
        global const View *view = AT(const View, batch->views) + draw->view;
        const int left_limit = view->box[0], top_limit = view->box[1], right_limit = view->box[2];
        const int bottom_limit = view->box[3], culled = view->culled, front = view->front;
        const bool biased = view->bias_units != 0.0f || view->bias_slope != 0.0f;
        int instance = (group - draw->primitive_group) / draw->primitive_groups;
        int part = (group - draw->primitive_group) - instance * draw->primitive_groups;
        int parts = min(draw->primitive_groups, part + end - group);
        const int vertex_group = draw->vertex_group + instance * draw->vertex_groups;
        if (is_unseen(batch, draw, view, find_extent(batch, draw, vertex_group))) {
            group += parts - part;
            continue;
        }
        int to_slot = vertex_group * GROUP - draw->lowest;
        global const uint4 *vertices = positions + to_slot;
        for (; part < parts; ++part, ++group) {
            int last = draw->primitives - 1 - part * GROUP;
            global const uint *corners = find_corners(draw, part * GROUP, last, scratch);
            if (last >= 2 * GROUP - 1 && draw->index_bytes == 4)
                UNROLL for (int i = 0; i < GROUP; ++i)  // one corner of each primitive in the next group: the others are near it
                    __builtin_prefetch((const void *)(ulong)(vertices + corners[3 * (GROUP + i)]), 0, 3);
            int16 x[3], y[3];
            float16 z[3], near_w[3];
            LOAD_POSITIONS(0) LOAD_POSITIONS(1) LOAD_POSITIONS(2)

            int16 wanted = LANES <= last;
            int16 unfit = (near_w[0] < 0.0f) | (near_w[1] < 0.0f) | (near_w[2] < 0.0f);
            int16 hidden = (near_w[0] < 0.0f) & (near_w[1] < 0.0f) & (near_w[2] < 0.0f) & ((x[0] & x[1] & x[2]) != 0);
            int16 whole = draw->primitive == TRIANGLES ? wanted & ~unfit : (int16)(0);
            uint polygons = bits_of(wanted & ~whole & ~hidden);

            int16 low_x = min(min(x[0], x[1]), x[2]), high_x = max(max(x[0], x[1]), x[2]);
            int16 low_y = min(min(y[0], y[1]), y[2]), high_y = max(max(y[0], y[1]), y[2]);
            int16 left = max((low_x - reach + 255) >> 8, 0), right = min((high_x + reach) >> 8, batch->width - 1);
            int16 top = max((low_y - reach + 255) >> 8, 0), bottom = min((high_y + reach) >> 8, batch->height - 1);
            int16 first_x = max(left, left_limit), last_x = min(right, right_limit);  // within the viewport and scissor
            int16 first_y = max(top, top_limit), last_y = min(bottom, bottom_limit);
            int16 kept = whole & (first_x <= last_x) & (first_y <= last_y);
            uint survivors = bits_of(kept);
            if (!(survivors | polygons)) continue;

            int16 extent = max(high_x - low_x, high_y - low_y), wide = extent > SMALL_EXTENT;
            int16 big = all_big ? (int16)(-1) : wide;
            float16 area;
            int16 ax = x[1] - x[0], ay = y[1] - y[0], bx = x[2] - x[0], by = y[2] - y[0];
            if (bits_of(wide & kept))
                area = convert_float16(convert_long16(ax) * convert_long16(by) - convert_long16(bx) * convert_long16(ay));
            else area = convert_float16(ax * by - bx * ay);
            int16 flipped = area < 0.0f;
            kept &= area != 0.0f;
            if (culled & 1) kept &= flipped;
            if (culled & 2) kept &= ~flipped;
            survivors = bits_of(kept);
            if (!(survivors | polygons)) continue;
            flipped &= kept;
            if (bits_of(flipped)) {
                int16 other_x = x[1], other_y = y[1];
                float16 other_z = z[1], other_w = near_w[1];
                x[1] = flipped ? x[2] : x[1];
                y[1] = flipped ? y[2] : y[1];
                z[1] = flipped ? z[2] : z[1];
                near_w[1] = flipped ? near_w[2] : near_w[1];
                x[2] = flipped ? other_x : x[2];
                y[2] = flipped ? other_y : y[2];
                z[2] = flipped ? other_z : z[2];
                near_w[2] = flipped ? other_w : near_w[2];
            }
            area = fabs(area);
            // Edges 0 1, 1 2, 2 0: A x + B y grows towards the inside.
            int16 a0 = y[0] - y[1], a1 = y[1] - y[2], a2 = y[2] - y[0];
            int16 b0 = x[1] - x[0], b1 = x[2] - x[1], b2 = x[0] - x[2];
            int16 origin_x = left << 8, origin_y = top << 8;
            int16 c0 = (a0 * (origin_x - x[0]) + b0 * (origin_y - y[0]) - 1 - OWNS(a0, b0)) >> 8;
            int16 c1 = (a1 * (origin_x - x[1]) + b1 * (origin_y - y[1]) - 1 - OWNS(a1, b1)) >> 8;
            int16 c2 = (a2 * (origin_x - x[2]) + b2 * (origin_y - y[2]) - 1 - OWNS(a2, b2)) >> 8;
            if (!all_big) {
                // Cull boxes of 1 or 2 texels a side without a covered texel.
                int16 two_x = right > left, two_y = bottom > top, covers = (c0 | c1 | c2) >= 0;
                covers |= two_x & (((c0 + a0) | (c1 + a1) | (c2 + a2)) >= 0);
                covers |= two_y & (((c0 + b0) | (c1 + b1) | (c2 + b2)) >= 0);
                covers |= two_x & two_y & (((c0 + a0 + b0) | (c1 + a1 + b1) | (c2 + a2 + b2)) >= 0);
                kept &= covers | big | (((right - left) | (bottom - top)) > 1);
                survivors = bits_of(kept);
                if (!(survivors | polygons)) continue;
            }
            c0 = big ? x[0] : c0;
            c1 = big ? y[0] : c1;

            // Weights of corners 1 and 2: their slopes, and their values at the box's first texel.
            float16 scale = 1.0f / area;
            float16 weight1_x = convert_float16(a2) * scale, weight1_y = convert_float16(b2) * scale;
            float16 weight2_x = convert_float16(a0) * scale, weight2_y = convert_float16(b0) * scale;
            float16 away_x = convert_float16(origin_x - x[0]), away_y = convert_float16(origin_y - y[0]);
            float16 weight1 = weight1_x * away_x + weight1_y * away_y, weight2 = weight2_x * away_x + weight2_y * away_y;
            weight1_x *= SUBTEXELS;
            weight1_y *= SUBTEXELS;
            weight2_x *= SUBTEXELS;
            weight2_y *= SUBTEXELS;
            float16 rise1 = z[1] - z[0], rise2 = z[2] - z[0];
            float16 depth_x = rise1 * weight1_x + rise2 * weight2_x, depth_y = rise1 * weight1_y + rise2 * weight2_y;
            float16 depth = z[0] + rise1 * weight1 + rise2 * weight2;
            // Not triangles thinner than a subtexel: covered texels lie beside them, where their planes are far off.
            int16 tilts = (wide | (fabs(depth_x) + fabs(depth_y) > STEEP)) & (area > convert_float16(extent));
            const uint tilted = bits_of(tilts);
            float16 offset = (float16)(0.0f);
            if (biased) {
                float slope_x[GROUP], slope_y[GROUP], largest[GROUP], offsets[GROUP];
                vstore16(depth_x, 0, slope_x);
                vstore16(depth_y, 0, slope_y);
                vstore16(fmax(fmax(z[0], z[1]), z[2]), 0, largest);
                for (int i = 0; i < GROUP; ++i) offsets[i] = offset_depth(view, slope_x[i], slope_y[i], largest[i]);
                offset = vload16(0, offsets);
                depth += offset;
            }
            // The nearest depth of the primitive, with a margin for the rounding of its plane.
            float16 slack = 1e-6f + 0x1p-21f * (fabs(depth_x) * convert_float16((high_x - low_x) >> 8) +
                                                fabs(depth_y) * convert_float16((high_y - low_y) >> 8));
            slack += tilts ? (fabs(depth_x) + fabs(depth_y)) * (1.0f / 128.0f) : 0.0f;  // for the rounding of corners
            slack += batch->depth_step;
            float16 nearest = near_is_less ? fmin(fmin(z[0], z[1]), z[2]) + offset - slack
                                           : fmax(fmax(z[0], z[1]), z[2]) + offset + slack;
            // Depth is clamped after the bias, and equal depths may pass the test.
            if (biased) nearest = near_is_less ? fmin(nearest, (float16)(1.0f)) : fmax(nearest, (float16)(0.0f));
            int16 cuts = (left < left_limit) | (top < top_limit) | (right > right_limit) | (bottom > bottom_limit);
            cuts |= (right < (high_x + reach) >> 8) & (batch->width & 3 ? -1 : 0);
            cuts |= (bottom < (high_y + reach) >> 8) & (batch->height & 3 ? -1 : 0);
            int16 is_front = (flipped & 1) ^ front;
            uint16 fields[16] = {
                as_uint16(a0), as_uint16(a1), as_uint16(a2), as_uint16(b0), as_uint16(b1), as_uint16(b2),
                as_uint16(c0), as_uint16(c1), as_uint16(c2), as_uint16(depth_x), as_uint16(depth_y), as_uint16(depth),
                as_uint16(left | top << 16), as_uint16(right | bottom << 16),
                as_uint16(PACK_FLAGS((int16)(found), cuts & 1, is_front, big & 1)), as_uint16(nearest),
            };
            uint16 records[16], planes[16];
            transpose16(fields, records);
            if (shades) {
                uint16 slots[3];
                load_slots(corners, to_slot, slots);
                float16 far1 = near_w[1] - near_w[0], far2 = near_w[2] - near_w[0];
                float16 w1 = batch->linear ? 1.0f / near_w[1] : near_w[1], w2 = batch->linear ? 1.0f / near_w[2] : near_w[2];
                uint16 words[16] = {
                    as_uint16(far1 * weight1_x + far2 * weight2_x), as_uint16(far1 * weight1_y + far2 * weight2_y),
                    as_uint16(near_w[0] + far1 * weight1 + far2 * weight2),
                    as_uint16(weight1_x * near_w[1]), as_uint16(weight1_y * near_w[1]), as_uint16(weight1 * near_w[1]),
                    as_uint16(weight2_x * near_w[2]), as_uint16(weight2_y * near_w[2]), as_uint16(weight2 * near_w[2]),
                    as_uint16(w1), as_uint16(w2),
                    slots[0], flipped ? slots[2] : slots[1], flipped ? slots[1] : slots[2],
                    as_uint16(part * GROUP + LANES), (uint16)(0u),
                };
                transpose16(words, planes);
            }
            // A box in tiles, one byte per side. Values that are read back lane by lane are stored separately: reading a
            // part of a vector that was just stored stalls.
            uint tile_boxes[GROUP];
            vstore16(as_uint16(first_x >> TILE_BITS | (first_y >> TILE_BITS) << 8 | (last_x >> TILE_BITS) << 16 |
                                (last_y >> TILE_BITS) << 24), 0, tile_boxes);
            uint firsts[GROUP], lasts[GROUP];
            float nearests[GROUP];
            if (bounded) {
                vstore16(as_uint16(first_x | first_y << 16), 0, firsts);
                vstore16(as_uint16(last_x | last_y << 16), 0, lasts);
                vstore16(nearest, 0, nearests);
            }
            uint todo = survivors | polygons;
            while (todo) {
                int lane = 31 - clz(todo & -todo);
                todo &= todo - 1;
                global uint16 *record = AT(uint16, batch->records) + place;
                if (polygons >> lane & 1) {
                    int made[16];
                    float plane[16];
                    uint slots[3];
                    for (int k = 0; k < 3; ++k) slots[k] = corners[3 * lane + k] + to_slot;
                    if (!set_up_polygon(batch, view, slots, draw->primitive, part * GROUP + lane, found, made, plane))
                        continue;
                    int first = made[BOX_FIRST], final = made[BOX_LAST];
                    tile_boxes[lane] = max(first & 0xFFFF, left_limit) / TILE | max(first >> 16, top_limit) / TILE << 8 |
                                       min(final & 0xFFFF, right_limit) / TILE << 16 | min(final >> 16, bottom_limit) / TILE << 24;
                    *record = as_uint16(vload16(0, made));
                    if (shades) AT(float16, batch->planes)[place] = vload16(0, plane);
                } else {
                    if (bounded && is_hidden(bounds, tiles_x, near_is_less, firsts[lane] & 0xFFFFu, firsts[lane] >> 16,
                                             lasts[lane] & 0xFFFFu, lasts[lane] >> 16, nearests[lane]))
                        continue;
                    *record = records[lane];
                    if (shades) AT(uint16, batch->planes)[place] = planes[lane];
                    if (tilted >> lane & 1) {
                        int made[16];
                        float plane[16];
                        float4 clips[3];
                        uint slots[3];
                        bool turned = bits_of(flipped) >> lane & 1;
                        for (int k = 0; k < 3; ++k) {
                            slots[k] = corners[3 * lane + (turned ? (3 - k) % 3 : k)] + to_slot;
                            clips[k] = load_clip(batch, slots[k]);
                        }
                        int first = ((global const int *)record)[BOX_FIRST];
                        find_planes(view, clips, slots, TRIANGLES, part * GROUP + lane, first & 0xFFFF, first >> 16, made, plane);
                        vstore3((int3)(made[DEPTH_PLANE], made[DEPTH_PLANE + 1], made[DEPTH_PLANE + 2]), 0,
                                (global int *)record + DEPTH_PLANE);
                        if (shades) AT(float16, batch->planes)[place] = vload16(0, plane);
                    }
                }
                uint box = tile_boxes[lane];
                boxes[place++] = box;
                if (!listed) continue;
                int x0 = box & 255u, y0 = box >> 8 & 255u, x1 = box >> 16 & 255u, y1 = box >> 24;
                if (x0 == x1 && y0 == y1) {
                    ++counts[y0 * tiles_x + x0];
                    continue;
                }
                for (int row = y0; row <= y1; ++row)
                    for (int column = x0; column <= x1; ++column) ++counts[row * tiles_x + column];
            }
        }
    }
    AT(uint, batch->survivors)[chunk] = place - first_record;
}
