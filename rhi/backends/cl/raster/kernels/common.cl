// Definitions that all kernels of the rasteriser share: the tables that they read, and operations on 16
// lanes.
//
// - A batch consists of many draws of one program into one pass. Its kernels take one argument, the address
//   of its `Batch`, and access everything else by addresses in memory: no argument is set per draw, whatever
//   a draw binds.
// - Work is divided into groups of 16 vertices or primitives. A group belongs to one instance of one draw, so
//   everything that differs from draw to draw is uniform over its 16 lanes. kernel_structs.py mirrors the
//   structs.
// - Functions take and return structs by address. For each program that is loaded, PoCL keeps the
//   attributes of functions that take or return structs by value, as long as the process lives.
// - Window positions are integers in subtexels (1/256 texel) from the centre of texel 0, 0; y counts from the
//   top.

#define INLINE static inline __attribute__((always_inline))
#define FUSED \
    static inline __attribute__((__always_inline__))  // in quick kernels too: chains of calls are dear
// Quick kernels (`QUICK` in cl_context.py) optimise functions that are INLINE, and none with these attributes: what
// is rare, which optimised kernels don't inline either, and what runs once for a draw or a cut triangle.
#define NOINLINE static __attribute__((__noinline__))
#define SEPARATE static __attribute__((noinline))  // quick kernels optimise it, none inlines it
#ifdef noinline
#define SELDOM NOINLINE
#else
#define SELDOM INLINE
#endif
#define UNLIKELY(condition) \
    __builtin_expect((condition) != 0, 0)  // keeps what is rare out of the way of registers
#define SINGLE kernel __attribute__((reqd_work_group_size(1, 1, 1))) void
#define AT(type, address) ((global type *)(address))
#define LANES (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
typedef uint4 word_uint4 __attribute__((aligned(4)));  // without alignment to 16 bytes
// PoCL unrolls only loops with a pragma. Arrays that are indexed by other loops would be stored in memory.
#define UNROLL_FOR _Pragma("unroll") for
#if defined(__x86_64__) || defined(__aarch64__)
#define PREFETCH(address) __builtin_prefetch((const void *)(ulong)(address), 0, 3)
#else  // a GPU hides latency by other work, and its compiler may not know the built-in function
#define PREFETCH(address)
#endif

#ifdef __x86_64__
// Call a function at an address, `void function(T *argument)`, by the calling convention of x86-64 under Linux. The
// stack has a red zone, which the call must not touch, and any alignment.
SEPARATE void call_function(ulong code, private void *argument) {
    __asm__ volatile("movq %%rsp, %%r12\n\tleaq -128(%%rsp), %%rsp\n\tandq $-64, %%rsp\n\t"
                     "callq *%1\n\tmovq %%r12, %%rsp"
                     : "+D"(argument), "+a"(code)
                     :
                     : "rcx", "rdx", "rsi", "r8", "r9", "r10", "r11", "r12", "memory", "cc", "xmm0", "xmm1",
                       "xmm2", "xmm3", "xmm4", "xmm5", "xmm6", "xmm7", "xmm8", "xmm9", "xmm10", "xmm11",
                       "xmm12", "xmm13", "xmm14", "xmm15");
}
// A kernel that writes the address of a function to the first word at `address`. The second word is 0: the call
// only keeps the function. OpenCL C has no addresses of functions, but the assembler has. A weak symbol that the
// compiler has renamed or removed has the address 0, and isn't an error.
#define ADDRESS_KERNEL(name, function, type) \
    SINGLE name(ulong address) { \
        ulong code; \
        __asm__ volatile(".weak " #function "\n\t.hidden " #function "\n\tmovq " #function \
                         "@GOTPCREL(%%rip), %0" \
                         : "=r"(code)); \
        global ulong *words = AT(ulong, address); \
        if (words[1]) function((private type *)words[1]); \
        words[0] = code; \
    }
#endif

#define SUBTEXELS 256
// Floats below 2^22 are rounded to integers by adding 1.5 * 2^23. So positions may lie 2^22 subtexels, 16384
// texels, from the target's corner, twice the size of the largest target. Primitives that reach further are
// clipped to a little less.
#define POSITION_LIMIT 4194000.0f
#define CLIP_LIMIT 16380.0f  // texels

#define TILE (1 << TILE_BITS)  // edge length in texels: 4096 depths are 16 KiB, half of a core's L1 cache

// There is a bound of depth for each PART × PART texels.
#define PART (1 << PART_BITS)
#define PARTS (TILE >> PART_BITS)  // in a row of a tile

enum { POINTS = 1, LINES = 2, TRIANGLES = 3, EDGES = 4 };  // EDGES: triangles drawn as lines

// Records of primitives, 16 words each: three edges A x + B y + C, depth as a plane that begins at the box's
// first texel, the first and the last texel of the box, flags, and the range of depths. setup.cl documents
// the representation of edges. The slopes of three edges add up to 0, so those of the last one aren't stored.
enum { SMALL, BIG, POLYGON, CLIPPED };
enum {
    EDGE_A = 0,
    EDGE_B = 2,
    EDGE_C = 4,
    DEPTH_PLANE = 7,
    OFFSET = 10,
    BOX_FIRST = 11,
    BOX_LAST = 12,
    FLAGS = 13,
    LOWEST = 14,
    HIGHEST = 15
};
// Records for shading: 1/w, and the weights of corners 1 and 2 divided by w, as planes; the w of these two
// corners, for varyings without perspective; the slots of the three corners; the primitive's number in its
// draw; which weights are fractions of the corners, 0…1 inside, as bits: those with perspective, unless they
// are the position inside a point, and those without (<< 1), if all corners lie before the eye.
enum { WEIGHTS = 3, CORNER_W = 9, SLOTS = 11, NUMBER = 14, WEIGHT_FLAGS = 15 };
// Instead of edges, records of POLYGON and CLIPPED have the slots of their corners in an order of positive
// area. So have THIN ones instead of a plane.
enum { CLIPPED_SLOTS = 0, POLYGON_PRIMITIVE = 3, THIN_SLOTS = DEPTH_PLANE };
// Flags: the draw's number; whether planes in float32 don't suffice (triangles.cl); whether the view cuts the
// blocks that the box touches; whether it is front-facing; the kind.
#define PACK_FLAGS(draw, thin, cuts, front, kind) \
    ((draw) << 5 | (thin) << 4 | (cuts) << 3 | (front) << 2 | (kind))
enum { THIN = 16, CUTS = 8 };

// Whether an edge owns the points on it: it is a left or a top edge. True is -1 for vectors and 1 for
// scalars.
#define OWNS(a, b) (((a) > 0) | (((a) == 0) & ((b) > 0)))

// Subtexels from a texel's centre to its outermost sample, along an axis.
#define SAMPLE_REACH(samples) ((samples) == 1 ? 0 : (samples) == 8 ? 112 : 96)

// `Batch`, `Draw` and `View` are declared by kernel_structs.py, which describes their fields.

// The bounds of the vertices of one instance that one work-item transformed; the primitives made of them lie
// within. It is stored at the number of their first group.
typedef struct {
    int low_x, low_y, high_x, high_y;  // subtexels
    float low, high;                   // depth
    int fit;     // whether all of them have a window position; else the bounds are invalid
    int behind;  // the clip planes that all of them lie behind, as bits
} Extent;

#define SHUFFLE __builtin_shufflevector

// Transpose four vectors of four quarters: converts between 4 rows of 16 texels and 4 blocks of 4 × 4.
#define EXCHANGE_QUARTERS(type) \
    static inline __attribute__((always_inline, overloadable)) void exchange_quarters( \
        const type *from, type *to \
    ) { \
        type a = SHUFFLE(from[0], from[1], 0, 1, 2, 3, 16, 17, 18, 19, 4, 5, 6, 7, 20, 21, 22, 23); \
        type b = SHUFFLE(from[2], from[3], 0, 1, 2, 3, 16, 17, 18, 19, 4, 5, 6, 7, 20, 21, 22, 23); \
        type c = SHUFFLE(from[0], from[1], 8, 9, 10, 11, 24, 25, 26, 27, 12, 13, 14, 15, 28, 29, 30, 31); \
        type d = SHUFFLE(from[2], from[3], 8, 9, 10, 11, 24, 25, 26, 27, 12, 13, 14, 15, 28, 29, 30, 31); \
        to[0] = SHUFFLE(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23); \
        to[1] = SHUFFLE(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31); \
        to[2] = SHUFFLE(c, d, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23); \
        to[3] = SHUFFLE(c, d, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31); \
    }

EXCHANGE_QUARTERS(uint16)
EXCHANGE_QUARTERS(float16)

// Reduce 16 lanes to one number.
#define REDUCTION(name, type, combine) \
    static inline __attribute__((always_inline, overloadable)) type name(type##16 lanes) { \
        type##8 eight = combine(lanes.lo, lanes.hi); \
        type##4 four = combine(eight.lo, eight.hi); \
        type##2 two = combine(four.lo, four.hi); \
        return combine(two.x, two.y); \
    }
#define AND(a, b) ((a) & (b))
#define ADD(a, b) ((a) + (b))

REDUCTION(reduce_min, int, min)
REDUCTION(reduce_min, float, fmin)
REDUCTION(reduce_max, int, max)
REDUCTION(reduce_max, float, fmax)
REDUCTION(reduce_and, int, AND)
REDUCTION(reduce_add, int, ADD)

// Return the lanes of a mask as bits.
INLINE uint bits_of(int16 mask) {
#if defined(__AVX512DQ__)
    return (uint)(ushort)__builtin_ia32_cvtd2mask512(mask);
#elif defined(__AVX__)
    return (uint)__builtin_ia32_movmskps256(as_float8(mask.lo)) |
        (uint)__builtin_ia32_movmskps256(as_float8(mask.hi)) << 8;
#else
    int16 bits = mask & (int16)(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768);
    int8 half_sum = bits.lo | bits.hi;
    int4 quarter = half_sum.lo | half_sum.hi;
    int2 pair = quarter.lo | quarter.hi;
    return (uint)(pair.x | pair.y);
#endif
}

// Transpose each 4 × 4 words of four vectors: converts 16 rows of 4 words (row 4 i + j in quarter i of vector
// j) to the 4 columns, and back.
INLINE void transpose4(const uint16 *rows, uint16 *columns) {
    uint16 a = SHUFFLE(rows[0], rows[1], 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    uint16 b = SHUFFLE(rows[0], rows[1], 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    uint16 c = SHUFFLE(rows[2], rows[3], 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    uint16 d = SHUFFLE(rows[2], rows[3], 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    columns[0] = SHUFFLE(a, c, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
    columns[1] = SHUFFLE(a, c, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
    columns[2] = SHUFFLE(b, d, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
    columns[3] = SHUFFLE(b, d, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
}

// Find the draw that a group belongs to: the last one whose `field`, the number of its first group, isn't
// greater.
#define DEFINE_DRAW_SEARCH(name, field) \
    INLINE int name(global const Draw *draws, int count, int group) { \
        int low = 0, high = count - 1; \
        while (low < high) { \
            int middle = (low + high + 1) / 2; \
            if (draws[middle].field <= group) low = middle; \
            else high = middle - 1; \
        } \
        return low; \
    }

// Return the indices at 16 positions of a list.
INLINE int16 load_indices(ulong list, int bytes, int16 positions) {
    int loaded[GROUP];
    vstore16(positions, 0, loaded);
    for (int i = 0; i < GROUP; ++i)
        loaded[i] = bytes == 2 ? AT(const ushort, list)[loaded[i]] : AT(const uint, list)[loaded[i]];
    return vload16(0, loaded);
}

// Return the i-th of `count` pieces of work in an order of every other one first: drivers assign runs of
// work-items to threads, and costly pieces are often neighbours.
INLINE int spread_work(int i, int count) {
    int half_way = (count + 1) / 2;
    return i < half_way ? 2 * i : 2 * (i - half_way) + 1;
}

// Return whether all depths stored in a box of texels are nearer than `nearest`. `bounds`: those of the
// target's parts.
INLINE bool is_hidden(
    global const float *bounds, int tiles_x, bool near_is_less, int left, int top, int right, int bottom,
    float nearest
) {
    for (int y = top >> PART_BITS; y <= bottom >> PART_BITS; ++y)
        for (int x = left >> PART_BITS; x <= right >> PART_BITS; ++x) {
            float bound = bounds[y * (tiles_x * PARTS) + x];
            if (!(near_is_less ? nearest > bound : nearest < bound)) return false;
        }
    return true;
}

// Return whether an instance whose vertices lie within `whole` is invisible: outside of the view, or behind
// all stored depths.
INLINE bool is_invisible(
    global const Batch *batch, global const Draw *draw, global const View *view, const Extent *whole
) {
    if (whole->behind) return true;
    if (!whole->fit || draw->primitive != TRIANGLES || batch->edges) return false;
    int reach = SAMPLE_REACH(batch->samples);
    int left = max((whole->low_x - reach + 255) >> 8, view->box[0]);
    int right = min((whole->high_x + reach) >> 8, view->box[2]);
    int top = max((whole->low_y - reach + 255) >> 8, view->box[1]);
    int bottom = min((whole->high_y + reach) >> 8, view->box[3]);
    if (left > right || top > bottom) return true;
    if (!batch->bounded || view->bias_units != 0.0f || view->bias_slope != 0.0f) return false;
    const float slack = batch->depth_step;
    return is_hidden(
        AT(const float, batch->bounds), batch->tiles_x, batch->near_is_less, left, top, right, bottom,
        batch->near_is_less ? whole->low - slack : whole->high + slack
    );
}

// Return whether a draw is skipped by its condition, the counter of a query (two words).
INLINE bool is_dropped(global const Draw *draw) {
    if (!draw->condition) return false;
    global const uint *counter = AT(const uint, draw->condition);
    bool seen = counter[0] | counter[1];
    return seen == draw->inverted;
}
