// The functions of textures.cl as calls of one function at an address, which stands in a texture's words. So a
// kernel that samples contains a call instead of all that sampling takes.
//
// `call_function` (common.cl of the rasteriser) precedes this text, in which RHI_CALLS_TEXTURES is defined; and
// so is RHI_TEXTURE_FUNCTION in the text of the function itself, which textures.cl precedes. A function that only
// samples plain textures (RHI_COMPARES is 0) is a smaller one, at an address of its own.

enum { RHI_DO_SAMPLE, RHI_DO_COVER, RHI_DO_SQUARE, RHI_DO_LOAD, RHI_DO_LOAD_EACH, RHI_DO_SIZE, RHI_DO_STORE };

// What is called, with the bits of its operands in the order of its parameters. `number`: the parameter that isn't a
// vector.
typedef struct {
    rhi_texture texture;
    rhi_description words;
  private
    UINT *results;
    int function, number, compared;
    UINT operands[11];
} RhiTextureCall;

#ifdef RHI_TEXTURE_FUNCTION
#define FLOAT_AT(i) as_FLOAT(call->operands[i])
#define INT_AT(i) as_INT(call->operands[i])
static __attribute__((noinline)) void RHI_TEXTURE_FUNCTION(RhiTextureCall *call) {
    rhi_texture t = call->texture;
    rhi_description w = call->words;
    UINT *r = call->results;
    const int compared = call->compared, number = call->number;
    const FLOAT a = FLOAT_AT(0), b = FLOAT_AT(1), c = FLOAT_AT(2), d = FLOAT_AT(3), e = FLOAT_AT(4);
    const INT i = INT_AT(0), j = INT_AT(1), k = INT_AT(2), l = INT_AT(3);
    switch (call->function) {
    case RHI_DO_SAMPLE: rhi_sampled(t, w, compared, a, b, c, d, e, r); break;
    case RHI_DO_COVER:
        rhi_covered(
            t, w, compared, a, b, c, d, e, FLOAT_AT(5), FLOAT_AT(6), FLOAT_AT(7), FLOAT_AT(8), FLOAT_AT(9),
            FLOAT_AT(10), r
        );
        break;
#if RHI_COMPARES
    case RHI_DO_SQUARE: rhi_square(t, w, number, compared, a, b, c, d, r); break;
    case RHI_DO_LOAD: rhi_load_any(t, w, i, j, k, number, r); break;
    case RHI_DO_LOAD_EACH: rhi_load_each(t, w, i, j, k, l, r); break;
    case RHI_DO_SIZE: r[0] = as_UINT(rhi_size_each(w, i, number)); break;
    default:
        rhi_store(
            (rhi_image)t, i, w, j, k, l, call->operands[4], call->operands[5], call->operands[6],
            call->operands[7]
        );
#endif
    }
}
#else
static RHI_CALLED void rhi_call_texture(RhiTextureCall *call) {
    global const ulong *functions = *(global const ulong *const global *)(call->words + RHI_FUNCTIONS);
    call_function(functions[RHI_FAST + 2 * RHI_PLAIN_SAMPLES], call);
}

static RHI_CALLED void rhi_call_sample(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT lod,
    UINT *r
) {
    RhiTextureCall call = {t, w, r, RHI_DO_SAMPLE, 0, compared};
    call.operands[0] = as_UINT(u), call.operands[1] = as_UINT(v), call.operands[2] = as_UINT(z);
    call.operands[3] = as_UINT(reference), call.operands[4] = as_UINT(lod);
    rhi_call_texture(&call);
}

static RHI_FUSED void rhi_sample(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT lod, UINT *r
) {
    rhi_call_sample(t, w, 0, u, v, z, u, lod, r);
}

static RHI_FUSED void rhi_sample_compare(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT lod, UINT *r
) {
    rhi_call_sample(t, w, 1, u, v, z, reference, lod, r);
}

static RHI_CALLED void rhi_call_cover(
    rhi_texture t, rhi_description w, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT ux,
    FLOAT vx, FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    RhiTextureCall call = {t, w, r, RHI_DO_COVER, 0, compared};
    call.operands[0] = as_UINT(u), call.operands[1] = as_UINT(v), call.operands[2] = as_UINT(z);
    call.operands[3] = as_UINT(reference);
    call.operands[4] = as_UINT(ux), call.operands[5] = as_UINT(vx), call.operands[6] = as_UINT(zx);
    call.operands[7] = as_UINT(uy), call.operands[8] = as_UINT(vy), call.operands[9] = as_UINT(zy);
    call.operands[10] = as_UINT(bias);
    rhi_call_texture(&call);
}

static RHI_FUSED void rhi_sample_grad(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT ux, FLOAT vx, FLOAT zx, FLOAT uy,
    FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    rhi_call_cover(t, w, 0, u, v, z, u, ux, vx, zx, uy, vy, zy, bias, r);
}

static RHI_FUSED void rhi_sample_compare_grad(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, FLOAT ux, FLOAT vx,
    FLOAT zx, FLOAT uy, FLOAT vy, FLOAT zy, FLOAT bias, UINT *r
) {
    rhi_call_cover(t, w, 1, u, v, z, reference, ux, vx, zx, uy, vy, zy, bias, r);
}

static RHI_CALLED void rhi_call_square(
    rhi_texture t, rhi_description w, int component, int compared, FLOAT u, FLOAT v, FLOAT z, FLOAT reference,
    UINT *r
) {
    RhiTextureCall call = {t, w, r, RHI_DO_SQUARE, component, compared};
    call.operands[0] = as_UINT(u), call.operands[1] = as_UINT(v), call.operands[2] = as_UINT(z);
    call.operands[3] = as_UINT(reference);
    rhi_call_texture(&call);
}

static RHI_FUSED void rhi_gather(
    rhi_texture t, rhi_description w, int component, FLOAT u, FLOAT v, FLOAT z, UINT *r
) {
    rhi_call_square(t, w, component, 0, u, v, z, u, r);
}

static RHI_FUSED void rhi_gather_compare(
    rhi_texture t, rhi_description w, FLOAT u, FLOAT v, FLOAT z, FLOAT reference, UINT *r
) {
    rhi_call_square(t, w, 0, 1, u, v, z, reference, r);
}

static RHI_CALLED void rhi_load(rhi_texture t, rhi_description w, INT x, INT y, INT z, int number, UINT *r) {
    RhiTextureCall call = {t, w, r, RHI_DO_LOAD, number, 0};
    call.operands[0] = as_UINT(x), call.operands[1] = as_UINT(y), call.operands[2] = as_UINT(z);
    rhi_call_texture(&call);
}

static RHI_CALLED void rhi_load_each(
    rhi_texture t, rhi_description w, INT x, INT y, INT z, INT number, UINT *r
) {
    RhiTextureCall call = {t, w, r, RHI_DO_LOAD_EACH, 0, 0};
    call.operands[0] = as_UINT(x), call.operands[1] = as_UINT(y), call.operands[2] = as_UINT(z);
    call.operands[3] = as_UINT(number);
    rhi_call_texture(&call);
}

static RHI_CALLED INT rhi_size_each(rhi_description w, INT number, int axis) {
    UINT r[1];
    RhiTextureCall call = {0, w, r, RHI_DO_SIZE, axis, 0};
    call.operands[0] = as_UINT(number);
    rhi_call_texture(&call);
    return as_INT(r[0]);
}

static RHI_CALLED void rhi_store(
    rhi_image t, INT mask, rhi_description w, INT x, INT y, INT z, UINT r0, UINT r1, UINT r2, UINT r3
) {
    RhiTextureCall call = {t, w, 0, RHI_DO_STORE, 0, 0};
    call.operands[0] = as_UINT(mask);
    call.operands[1] = as_UINT(x), call.operands[2] = as_UINT(y), call.operands[3] = as_UINT(z);
    call.operands[4] = r0, call.operands[5] = r1, call.operands[6] = r2, call.operands[7] = r3;
    rhi_call_texture(&call);
}
#endif
