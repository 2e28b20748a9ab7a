/* The limit: what 64 lanes of sonar, 60-8-1, cost in C.

   The same work as a tile of 64 lanes does in hebbviz, with the same random numbers: the rule with
   held input for the 480 synapses from the inputs (hebbviz/rule.py has the equations), step by step
   for the 8 from hidden to output neuron, Philox4x32-7 with hebbviz's counters, reward 1 where the
   output is right, a new pattern every HOLD steps. Every epoch has the order of the first one, which
   is given from outside: shuffling, 186 draws in 187 000 steps, is left out.

   The lane is the last, contiguous axis, and arithmetic is in the compiler's vector types, 16, 32 or
   64 bytes of REAL, float or double. A vector multiply of 32-bit words gives 64-bit products; so the
   four words of Philox live in the low halves of 64-bit elements, and nobody looks at the high ones.
*/

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __SSE2__
#include <immintrin.h>
#endif

enum { INPUTS = 60, HIDDEN = 8, NEURONS = HIDDEN + 1, LANES = 64, HOLD = 1000 };

#if defined(__AVX512F__)
#define BYTES 64
#define OF_VECTOR(name) _mm512_##name
#elif defined(__AVX2__)
#define BYTES 32
#define OF_VECTOR(name) _mm256_##name
#else
#define BYTES 16
#define OF_VECTOR(name) _mm_##name
#endif
#define VECTOR __attribute__((vector_size(BYTES)))
#define INLINE static inline __attribute__((always_inline))

#if REAL_BYTES == 4
typedef float REAL;
typedef int32_t Integer;
#define OF_REALS(name) OF_VECTOR(name##_ps)
#else
typedef double REAL;
typedef int64_t Integer;
#define OF_REALS(name) OF_VECTOR(name##_pd)
#endif

typedef REAL Real VECTOR;
typedef Integer Integers VECTOR; /* of the size of a REAL; comparisons give 0 or -1 */
typedef uint64_t Words VECTOR;
typedef long long Whole VECTOR; /* as the intrinsics want it */
enum {
    WIDTH = BYTES / sizeof(REAL),  /* lanes in a vector */
    GROUPS = LANES / WIDTH,        /* vectors in a tile */
    PARTS = 8 / sizeof(REAL),      /* vectors of words for a vector of lanes: lane PARTS e + part */
    BLOCKS = (NEURONS + 3) / 4
};
static const uint64_t LOW_HALF = 0xFFFFFFFF;
static const Words PLACES = { /* of the lanes in a vector */
    0,
    PARTS,
#if BYTES > 16
    2 * PARTS,
    3 * PARTS,
#endif
#if BYTES > 32
    4 * PARTS,
    5 * PARTS,
    6 * PARTS,
    7 * PARTS,
#endif
};

/* What 64 lanes are. Named as in hebbviz/layout.py; w and z of the held synapses are w0 and z0. */
typedef struct {
    Real held_weight[HIDDEN][INPUTS][GROUPS], held_trace[HIDDEN][INPUTS][GROUPS];
    Real input[INPUTS][GROUPS], label[GROUPS], activity[NEURONS][GROUPS];
    Real w_drive[HIDDEN][GROUPS], z_drive[HIDDEN][GROUPS], x_squared[GROUPS];
    Real decay[GROUPS], gain[GROUPS], z_input[HIDDEN][GROUPS], w_input[HIDDEN][GROUPS];
    Real weight[HIDDEN][GROUPS], trace[HIDDEN][GROUPS];
} Tile;

/* ---- Random numbers, hebbviz/chance.py ---- */

INLINE Words product(Words a, uint64_t m)
{
#ifdef __SSE2__
    return (Words)OF_VECTOR(mul_epu32)((Whole)a, (Whole)((Words){} + m));
#else
    return (a & LOW_HALF) * m;
#endif
}

INLINE void philox(Words c[4], uint32_t seed, Words lane)
{
#pragma GCC unroll 7
    for (uint32_t round = 0; round < 7; round++) {
        const uint32_t k0 = seed + round * 0x9E3779B9u;
        const Words k1 = lane + round * (uint64_t)0xBB67AE85u;
        const Words p0 = product(c[0], 0xD2511F53u), p1 = product(c[2], 0xCD9E8D57u);
        c[0] = (p1 >> 32) ^ c[1] ^ k0;
        c[2] = (p0 >> 32) ^ c[3] ^ k1;
        c[1] = p1;
        c[3] = p0;
    }
}

/* A number in (0, 1) from 32 bits of each lane: (word + 1/2) / 2^32; rounded in float. */
INLINE Real uniform(const Words part[PARTS])
{
#if REAL_BYTES == 4
    const Words both = (part[0] & LOW_HALF) | (part[1] << 32);
    const Integers centred = (Integers)both ^ INT32_MIN;
    return __builtin_convertvector(centred, Real) * 0x1p-32f + 0.5f;
#else
    const Words bits = (part[0] & LOW_HALF) | 0x4330000000000000u; /* 2^52 + word */
    return ((Real)bits - (0x1p52 - 0.5)) * 0x1p-32;
#endif
}

/* ---- The rule, hebbviz/rule.py ---- */

INLINE Real all(REAL a) { return (Real){} + a; }

INLINE Real either(Integers is, Real a, Real b)
{
    return (Real)((is & (Integers)a) | (~is & (Integers)b));
}

INLINE Real between(REAL least, Real a, REAL most)
{
#ifdef __SSE2__
    return OF_REALS(max)(OF_REALS(min)(a, all(most)), all(least));
#else
    a = either(a < most, a, all(most));
    return either(a > least, a, all(least));
#endif
}

/* 1/(1 + e^-v): in float by a rational function of v/2 for tanh, in double by the series of e. */
INLINE Real sigmoid(Real v)
{
#if REAL_BYTES == 4
    const Real x = between(-7.9f, v * 0.5f, 7.9f), q = x * x;
    const Real top =
        4.89352455891786e-03f + q * (6.37261928875436e-04f + q * (1.48572235717979e-05f
        + q * (5.12229709037114e-08f + q * (-8.60467152213735e-11f + q * (2.00018790482477e-13f
        + q * -2.76076847742355e-16f)))));
    const Real bottom = 4.89352518554385e-03f + q * (2.26843463243900e-03f
        + q * (1.18534705686654e-04f + q * 1.19825839466702e-06f));
    return 0.5f + 0.5f * x * top / bottom;
#else
    const Real a = between(-700.0, -v, 700.0);
    const Real shifted = a * 1.4426950408889634 + 6755399441055744.0;
    const Real n = shifted - 6755399441055744.0;
    const Real x = (a - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    const Real x2 = x * x, x4 = x2 * x2;
    const Real low = (1.0 + x) + x2 * (1. / 2 + x * (1. / 6));
    const Real mid = (1. / 24 + x * (1. / 120)) + x2 * (1. / 720 + x * (1. / 5040));
    const Real high =
        (1. / 40320 + x * (1. / 362880)) + x2 * (1. / 3628800 + x * (1. / 39916800));
    const Real series = low + x4 * (mid + x4 * (high + x4 * (1. / 479001600)));
    const Real e = (Real)((Integers)series + ((Integers)shifted << 52)); /* times 2^n */
    return 1.0 / (1.0 + e);
#endif
}

/* Put the sums back into w0 and z0, then begin anew with the patterns of `order`. */
static void hold(Tile *tile, const REAL (*data)[INPUTS + 1], const int32_t order[LANES])
{
    static _Thread_local REAL seen[INPUTS + 1][LANES] __attribute__((aligned(BYTES)));
    for (int lane = 0; lane < LANES; lane++)
        for (int j = 0; j <= INPUTS; j++)
            seen[j][lane] = data[order[lane]][j];
    const Real (*next)[GROUPS] = (const Real (*)[GROUPS])seen;
    for (int g = 0; g < GROUPS; g++) {
        for (int i = 0; i < HIDDEN; i++) {
            Real w_drive = {}, z_drive = {};
            for (int j = 0; j < INPUTS; j++) {
                Real *w = &tile->held_weight[i][j][g], *z = &tile->held_trace[i][j][g];
                const Real x = tile->input[j][g];
                *w += tile->gain[g] * *z + tile->w_input[i][g] * x;
                *z = tile->decay[g] * *z + tile->z_input[i][g] * x;
                w_drive += *w * next[j][g];
                z_drive += *z * next[j][g];
            }
            tile->w_drive[i][g] = w_drive;
            tile->z_drive[i][g] = z_drive;
            tile->z_input[i][g] = tile->w_input[i][g] = (Real){};
        }
        Real square = {};
        for (int j = 0; j < INPUTS; j++)
            square += next[j][g] * next[j][g];
        tile->x_squared[g] = square;
        tile->decay[g] = all(1);
        tile->gain[g] = (Real){};
        tile->label[g] = next[INPUTS][g];
    }
    memcpy(tile->input, seen, sizeof tile->input);
}

/* One step of one vector of lanes. */
INLINE void step(Tile *tile, int g, uint64_t now, uint32_t seed, uint32_t lane, REAL beta, REAL gamma)
{
    Words draw[BLOCKS][4][PARTS];
#pragma GCC unroll 3
    for (int block = 0; block < BLOCKS; block++)
#pragma GCC unroll 2
        for (int part = 0; part < PARTS; part++) {
            Words c[4] = {
                (Words){} + block, (Words){} + (now & LOW_HALF), (Words){} + (now >> 32), {}
            };
            philox(c, seed, PLACES + (lane + part));
#pragma GCC unroll 4
            for (int k = 0; k < 4; k++)
                draw[block][k][part] = c[k];
        }
    Real fired[NEURONS], surprise[NEURONS], v = {};
#pragma GCC unroll 8
    for (int i = 0; i < HIDDEN; i++)
        v += tile->weight[i][g] * tile->activity[i][g];
#pragma GCC unroll 9
    for (int i = 0; i < NEURONS; i++) {
        const Real potential = i == HIDDEN ? v : tile->w_drive[i][g]
            + tile->gain[g] * tile->z_drive[i][g] + tile->w_input[i][g] * tile->x_squared[g];
        const Real expected = sigmoid(potential);
        fired[i] = either(uniform(draw[i / 4][i % 4]) < expected, all(1), all(0));
        surprise[i] = fired[i] - expected;
    }
    const Real output = (REAL)2 * fired[HIDDEN] - (REAL)1;
    const Real move = either(output == tile->label[g], all(gamma), all(0)); /* gamma r */
    const Real decay = beta * tile->decay[g];
    tile->decay[g] = decay;
    tile->gain[g] += move * decay;
#pragma GCC unroll 8
    for (int i = 0; i < HIDDEN; i++) {
        const Real held = beta * tile->z_input[i][g] + surprise[i];
        tile->z_input[i][g] = held;
        tile->w_input[i][g] += move * held;
        const Real trace = beta * tile->trace[i][g] + surprise[HIDDEN] * tile->activity[i][g];
        tile->trace[i][g] = trace;
        tile->weight[i][g] += move * trace;
        tile->activity[i][g] = (REAL)2 * fired[i] - (REAL)1;
    }
    tile->activity[HIDDEN][g] = output;
}

/* ---- What is called from outside ---- */

/* A tile at rest that sees the patterns of `order`; weights (8 60 + 8, LANES). */
Tile *tile_new(const REAL *weights, const REAL (*data)[INPUTS + 1], const int32_t order[LANES])
{
    Tile *tile = aligned_alloc(64, (sizeof(Tile) + 63) / 64 * 64);
    if (!tile)
        return NULL;
    memset(tile, 0, sizeof *tile);
    memcpy(tile->held_weight, weights, sizeof tile->held_weight);
    memcpy(tile->weight, weights + HIDDEN * INPUTS * LANES, sizeof tile->weight);
    for (int i = 0; i < NEURONS; i++)
        for (int g = 0; g < GROUPS; g++)
            tile->activity[i][g] = all(-1);
    hold(tile, data, order);
    return tile;
}

void tile_free(Tile *tile) { free(tile); }

/* `steps` steps, the first of them number `start`. Row k of `order` (epoch, LANES) is seen from step
   HOLD k on. */
void tile_run(Tile *tile, int64_t steps, int64_t start, uint32_t seed, uint32_t first_lane,
    REAL beta, REAL gamma, const REAL (*data)[INPUTS + 1], const int32_t (*order)[LANES],
    int64_t epoch)
{
    for (int64_t now = start; now < start + steps; now++) {
        for (int g = 0; g < GROUPS; g++)
            step(tile, g, now, seed, first_lane + g * WIDTH, beta, gamma);
        if ((now + 1) % HOLD == 0)
            hold(tile, data, order[(now + 1) / HOLD % epoch]);
    }
}

/* What is known now: weights (8 60 + 8, LANES), activities (NEURONS, LANES). */
void tile_read(const Tile *tile, REAL *weights, REAL *activity)
{
    Real *w = (Real *)weights;
    for (int i = 0; i < HIDDEN; i++)
        for (int j = 0; j < INPUTS; j++)
            for (int g = 0; g < GROUPS; g++, w++) {
                const Real now = tile->held_weight[i][j][g] + tile->gain[g] * tile->held_trace[i][j][g]
                    + tile->w_input[i][g] * tile->input[j][g];
                memcpy(w, &now, sizeof now);
            }
    memcpy(w, tile->weight, sizeof tile->weight);
    memcpy(activity, tile->activity, sizeof tile->activity);
}
