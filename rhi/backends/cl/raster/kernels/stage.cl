// The fragment stage as a kernel of its own, whose function general raster kernels call by its address
// (shade.cl). So a new program builds its stage, and not a rasteriser around it.
//
// The fragment stage's text, varyings.cl and the macros of kernel_structs.py precede this one.

NOINLINE void rhi_shade_fragments(Fragments *fragments) {
    uint16 inputs[VARYING_WORDS + 1];
    uint flat[VARYING_WORDS + 1];
    interpolate_varyings(
        fragments->corner0, fragments->corner1, fragments->corner2, &fragments->weights, inputs, flat
    );
    global const ulong *row = fragments->bindings;  // of BINDINGS
    fragments->covered = rhi_fragment(
        BINDINGS inputs, flat, fragments->x, fragments->y, fragments->depth, fragments->weights.inverse_w,
        fragments->front, fragments->primitive, fragments->weights.weight1, fragments->weights.weight2,
        fragments->covered, fragments->outputs, &fragments->depth
    );
}

ADDRESS_KERNEL(stage, rhi_shade_fragments, Fragments)
