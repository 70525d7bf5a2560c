// Varyings of a block, and the fragment stage as a function that other kernels call by its address.
//
// VARYING_WORDS and VARYINGS are macros of kernel_structs.py.

// Weights of the corners at 16 texels, which interpolate the varyings.
typedef struct {
    float16 inverse_w, weight1, weight2;  // with perspective
    float16 linear1, linear2;             // without perspective
} Weights;

// A block of fragments for a stage that is called by its address: its arguments and its results. `outputs` has
// room for the words of all outputs, which the caller has set to 0.
typedef struct {
    float16 x, y, depth;  // window coordinates of the centres; the stage may replace the depth
    Weights weights;
    int16 covered;  // in: the covered lanes; out: those that remain
    global const ulong *bindings;
    global const uint *corner0, *corner1, *corner2;
  private
    uint16 *outputs;
    int front, primitive;
} Fragments;

#ifdef VARYINGS
// Interpolate the words of a block's varyings, which VARYINGS lists by their kind.
INLINE void interpolate_varyings(
    global const uint *corner0, global const uint *corner1, global const uint *corner2,
    const Weights *weights, uint16 *inputs, uint *flat
) {
#define CORNER(k, word) as_float(corner##k[word])
#define INTERPOLATE(word, weight1, weight2) \
    inputs[word] = as_uint16( \
        CORNER(0, word) + (CORNER(1, word) - CORNER(0, word)) * weight1 + \
        (CORNER(2, word) - CORNER(0, word)) * weight2 \
    );
#define SMOOTH(word) INTERPOLATE(word, weights->weight1, weights->weight2)
#define LINEAR(word) INTERPOLATE(word, weights->linear1, weights->linear2)
#define FLAT(word) flat[word] = corner0[word];
    VARYINGS(SMOOTH, FLAT, LINEAR)
#undef CORNER
#undef INTERPOLATE
#undef SMOOTH
#undef LINEAR
#undef FLAT
}
#endif
