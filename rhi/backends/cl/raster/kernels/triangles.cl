// Triangles in float64: the outline of those that the view cuts, and depth and weights of those too thin for
// planes in float32. Such triangles are few, so set-up stores their slots only, and each tile that they touch
// computes the rest.
//
// - Corners are homogeneous, {x w, y w, w} in subtexels, and an edge is the cross product of its corners. It
//   is a line in the window also if a corner lies behind the eye (Olano & Greer 1997). So are the near and
//   the far plane, since z / w is linear in the window. So nothing is ever cut, and a triangle is up to five
//   half-planes.
// - An edge depends on its two corners alone, bit for bit, and the two triangles at an edge see it with
//   opposite signs. So they meet without a gap, and no texel is drawn twice.
// - Corners that have a window position are rounded to it as those of any other triangle. Between two of
//   them, an edge is that of whole triangles. From a single one, it is parallel to the line between the
//   corners as they are: turned towards the other corner, or through a rounded end of what is visible, it
//   could be off by any distance elsewhere.
// - Weights come from the corners as they are, not rounded, unless these have no area. Where only the rounded
//   outline covers a sample, they go a little beyond 0…1, and shade.cl clamps them. If rounding has changed
//   the triangle's shape, they could be anything there: negative ones become 0, and the others add up to 1.

typedef struct {
    double3 corners[3];  // in an order of positive area
    double3 exact[3];    // the same corners, not rounded
    double z[3];
    int in_window;  // the corners that have a window position, as bits
} Outline;

// The weight of corner i divided by its w is dot(rows[i], {x, y, 1}) * scales[i].
typedef struct {
    double3 rows[3];
    double scales[3];
    bool blurred;  // whether rounding has changed the triangle's shape
} Barycentrics;

SELDOM float4 load_clip(global const Batch *batch, uint slot) {
    global const float *group = AT(const float, batch->clips) + (long)(slot / GROUP) * (4 * GROUP) +
        slot % GROUP;
    return (float4)(group[0], group[GROUP], group[2 * GROUP], group[3 * GROUP]);
}

// Return the line through two corners: a x + b y + c grows to the inside. It is computed in one order of the
// corners, since a contracted a b - c d isn't that of exchanged factors.
NOINLINE double3 join(double3 p, double3 q) {
    bool swaps = p.x < q.x || (p.x == q.x && (p.y < q.y || (p.y == q.y && p.z < q.z)));
    double3 from = swaps ? q : p, to = swaps ? p : q;
    double3 line = (double3)(from.y * to.z - to.y * from.z, to.x * from.z - from.x * to.z,
                             from.x * to.y - to.x * from.y);
    return swaps ? -line : line;
}

NOINLINE void load_outline(
    global const Batch *batch, global const View *view, const uint *slots, Outline *outline
) {
    outline->in_window = 0;
    for (int i = 0; i < 3; ++i) {
        const float4 p = load_clip(batch, slots[i]);
        const uint4 position = AT(const uint4, batch->positions)[slots[i]];
        const double w = p.w;
        // In this order a huge viewport loses nothing where the corner lies on its side.
        double3 exact = (double3)((p.x * (double)view->scale[0] + w * view->shift[0]) - 0.5 * w,
                                  (p.y * (double)view->scale[1] + w * view->shift[1]) - 0.5 * w, w);
        exact.xy *= SUBTEXELS;
        const bool in_window = as_float(position.w) >= 0.0f;
        outline->exact[i] = exact;
        outline->corners[i] = in_window ? (double3)(as_int(position.x), as_int(position.y), 1.0) : exact;
        outline->z[i] = p.z;
        outline->in_window |= in_window << i;
    }
}

SELDOM double signed_area(const double3 *corners) { return dot(corners[0], join(corners[1], corners[2])); }

NOINLINE void compute_barycentrics(const Outline *outline, Barycentrics *weights) {
    const double area = signed_area(outline->exact), rounded = signed_area(outline->corners);
    const bool flat = area == 0.0;
    double scale = 1.0;
    for (int i = 0; i < 3; ++i) scale *= outline->in_window >> i & 1 ? outline->exact[i].z : 1.0;
    weights->blurred = !(fabs(area - rounded * scale) < 0.5 * fabs(area));
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        weights->rows[i] = flat ? join(outline->corners[j], outline->corners[k])
                                : join(outline->exact[j], outline->exact[k]);
        weights->scales[i] = !flat        ? 1.0 / area
            : outline->in_window >> i & 1 ? 1.0 / (rounded * outline->exact[i].z)
                                          : 1.0 / rounded;
    }
}

// The lines that bound what is visible of a triangle.
typedef struct {
    double3 lines[5];  // of the edges, then where the near and the far plane cut
    int2 meets[3];     // a window position on each edge, if there is one
    int fixed;  // as bits: edges between two window positions, those from one (<< 3), near and far if they
                // cut (<< 6)
} Contour;

NOINLINE void compute_contour(const Outline *outline, const Barycentrics *weights, Contour *contour) {
    contour->fixed = 0;
    contour->lines[3] = contour->lines[4] = (double3)(0.0);
    for (int i = 0; i < 3; ++i) {
        const int k = i < 2 ? i + 1 : 0, first = outline->in_window >> i & 1;
        const int second = outline->in_window >> k & 1;
        const double3 *corners = first & second ? outline->corners : outline->exact;
        contour->lines[i] = join(corners[i], corners[k]);
        contour->meets[i] = convert_int2(clamp(outline->corners[first ? i : k].xy, -0x1p30, 0x1p30));
        const double near = outline->z[i], far = outline->exact[i].z - outline->z[i];
        contour->lines[3] += weights->rows[i] * (weights->scales[i] * near);
        contour->lines[4] += weights->rows[i] * (weights->scales[i] * far);
        contour->fixed |= (first & second) << i | (first | second) << (i + 3) | (near < 0.0) << 6 |
            (far < 0.0) << 7;
    }
}

// Compute a line of the contour at texel x, y of a tile: integers A, B per texel of up to 23 bits, and its
// value there. It is exact at the tile's first texel, or at its window position if that lies in the tile,
// where other edges meet it.
NOINLINE long contour_edge(const Contour *contour, int i, int x, int y, int *a, int *b) {
    *a = *b = 0;
    const double3 line = contour->lines[i];
    const double most = fmax(fabs(line.x), fabs(line.y));
    if (i >= 3 && !(contour->fixed >> (i + 3) & 1)) return 1l << 40;
    if (!(most > 0.0)) return line.z < 0.0 ? -(1l << 40) : 1l << 40;
    int2 anchor = (int2)(x & -TILE, y & -TILE) * SUBTEXELS;
    double value = line.x * anchor.x + line.y * anchor.y + line.z;
    if (i < 3 && contour->fixed >> (i + 3) & 1) {
        const int2 away = contour->meets[i] - anchor;
        const bool meets = contour->fixed >> i & 1 ||
            (min(away.x, away.y) >= -SUBTEXELS && max(away.x, away.y) <= (TILE + 1) * SUBTEXELS);
        value = meets ? 0.0 : line.x * -away.x + line.y * -away.y;
        anchor = meets ? contour->meets[i] : anchor;
    }
    const double scale = as_double((ulong)(2 * 1023 + 22 - (as_ulong(most) >> 52)) << 52);
    *a = convert_int_rte(line.x * scale);
    *b = convert_int_rte(line.y * scale);
    const long start = convert_long_rte(clamp(value * scale, -0x1p58, 0x1p58));
    return start + (long)*a * (x * SUBTEXELS - anchor.x) + (long)*b * (y * SUBTEXELS - anchor.y);
}

SELDOM bool is_cut(const Contour *contour) { return contour->fixed >> 6; }

// Compute weights divided by w at 16 positions in subtexels. `inside`: the covered ones.
NOINLINE void compute_corner_parts(
    const Barycentrics *weights, int16 x, int16 y, int16 inside, double16 *parts
) {
    for (int i = 0; i < 3; ++i) {
        double3 row = weights->rows[i];
        double16 part = (row.x * convert_double16(x) + row.y * convert_double16(y) + row.z) *
            weights->scales[i];
        parts[i] = weights->blurred ? (part < 0.0) & convert_long16(inside) ? (double16)(0.0) : part : part;
    }
}

// Compute depth, not clamped, at 16 positions in subtexels.
NOINLINE float16 compute_depth(
    global const View *view, const Outline *outline, const Barycentrics *weights, int16 x, int16 y,
    int16 inside
) {
    double16 parts[3], depth = (double16)(0.0), whole = (double16)(0.0);
    compute_corner_parts(weights, x, y, inside, parts);
    for (int i = 0; i < 3; ++i) {
        depth += parts[i] * outline->z[i];
        whole += parts[i] * outline->exact[i].z;
    }
    return convert_float16(depth / whole * view->scale[2] + view->shift[2]);
}
