// Primitives that are rasterised as convex polygons: lines, and points of several samples.
//
// - They are few, so each is computed by itself in scalars, and twice: set-up needs its box, and each tile
//   that it touches needs its corners. So one record suffices for any polygon, and primitives keep their
//   order.
// - Clipping is against the view's depth range and a guard band far outside the target, never against the
//   target.

#define MAX_POINT_SIZE 1024.0f  // texels; rhi.backends.cl.cl_capabilities
#define MAX_CORNERS 4

// Return the signed distance of a clip position from a plane: near, far, then the four sides of the guard
// band.
SELDOM float inside_of(global const View *view, float4 p, int plane) {
    switch (plane) {
    case 0: return p.z;
    case 1: return p.w - p.z;
    case 2: return view->scale[0] * p.x + (view->shift[0] + CLIP_LIMIT) * p.w;
    case 3: return (CLIP_LIMIT - view->shift[0]) * p.w - view->scale[0] * p.x;
    case 4: return view->scale[1] * p.y + (view->shift[1] + CLIP_LIMIT) * p.w;
    default: return (CLIP_LIMIT - view->shift[1]) * p.w - view->scale[1] * p.y;
    }
}

SELDOM float4 cut(float4 inner, float4 outer, float inner_distance, float outer_distance) {
    return inner + (outer - inner) * (inner_distance / (inner_distance - outer_distance));
}

SELDOM int2 to_window(global const View *view, float4 p) {
    float inverse_w = 1.0f / p.w;
    float x = fma(p.x * inverse_w, view->scale[0], view->shift[0]);
    float y = fma(p.y * inverse_w, view->scale[1], view->shift[1]);
    return (int2)(convert_int_rte((x - 0.5f) * SUBTEXELS), convert_int_rte((y - 0.5f) * SUBTEXELS));
}

// Return the size of a point in texels; NaN becomes 1.
SELDOM float load_point_size(global const Batch *batch, uint slot) {
    if (batch->point_size < 0) return 1.0f;
    float size = AT(const float, batch->varyings)[(long)slot * batch->varying_words + batch->point_size];
    return size >= 1.0f ? fmin(size, MAX_POINT_SIZE) : 1.0f;
}

// Compute the corners of a line or a point in the window, in an order that makes its area positive. Return
// their number, or 0 if nothing is left of it. `size`: that of a point, or the width of a line.
SELDOM int make_polygon(
    global const View *view, const float4 *clips, int primitive, float size, int2 *points
) {
    float4 corners[2];
    for (int i = 0; i < primitive; ++i) corners[i] = clips[i];
    for (int plane = 0; plane < 6; ++plane) {
        float4 p = corners[0], q = corners[primitive - 1];
        float at_p = inside_of(view, p, plane), at_q = inside_of(view, q, plane);
        bool has_p = at_p >= 0.0f, has_q = at_q >= 0.0f;  // NaN is outside
        if (!has_p && !has_q) return 0;
        if (!has_p) corners[0] = cut(q, p, at_q, at_p);
        if (!has_q) corners[1] = cut(p, q, at_p, at_q);
    }
    if (!(corners[0].w > 0.0f)) return 0;
    int2 start = to_window(view, corners[0]);
    if (primitive == POINTS) {
        if (fabs(corners[0].x) > corners[0].w || fabs(corners[0].y) > corners[0].w) return 0;
        int side = convert_int_rte(size * SUBTEXELS), before = -side / 2, behind = before + side;
        points[0] = start + (int2)(before, before);
        points[1] = start + (int2)(behind, before);
        points[2] = start + (int2)(behind, behind);
        points[3] = start + (int2)(before, behind);
        return 4;
    }
    // A line is a parallelogram, `size` texels high or wide, that contains its start and not its end. The
    // fill rule includes points on the left or top edge, so a line in the opposite direction is shifted by
    // the smallest step.
    if (!(corners[1].w > 0.0f)) return 0;
    int2 end = to_window(view, corners[1]);
    int2 step = end - start;
    bool steep = abs(step.y) > abs(step.x);
    bool backwards = steep ? step.y < 0 : step.x < 0;
    if (!(steep ? step.y : step.x)) return 0;
    int2 shift = steep ? (int2)(0, backwards) : (int2)(backwards, 0);
    int half_size = (int)size * (SUBTEXELS / 2);
    int2 half_width = steep ? (int2)(half_size, 0) : (int2)(0, half_size);
    int2 first = (backwards ? end : start) + shift, last = (backwards ? start : end) + shift;
    points[0] = first - half_width;
    points[1] = steep ? first + half_width : last - half_width;
    points[2] = last + half_width;
    points[3] = steep ? last - half_width : first + half_width;
    return 4;
}
