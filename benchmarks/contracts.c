/* Contracts of the runtime's smallest parts, for every parameter that pz_check accepts. They stand
 * on declarations in front of the source, which stays as it ships. Comparisons are those of
 * floating-point numbers: reals beside them leave Z3 without an answer. */
#include "piezoid_runtime.h"

#ifdef PZ_REAL_FLOAT
#define LE(a, b) \le_float(a, b)
#define EQ(a, b) \eq_float(a, b)
#define GT(a, b) \gt_float(a, b)
#else
#define LE(a, b) \le_double(a, b)
#define EQ(a, b) \eq_double(a, b)
#define GT(a, b) \gt_double(a, b)
#endif

/*@ requires \is_finite(low) && \is_finite(high);
    assigns \nothing;
    ensures above: LE(low, high) ==> LE(low, \result);
    ensures below: LE(\result, high);
    ensures itself: LE(low, x) && LE(x, high) ==> EQ(\result, x);
    ensures finite: \is_finite(\result);
*/
static pz_real clamp(pz_real x, pz_real low, pz_real high);

/*@ requires \valid_read(p) && \is_finite(p->lsb_V) && !GT(p->lsb_V, (pz_real)0);
    assigns \nothing;
    ensures EQ(\result, volts) || !\is_finite(volts);
    ensures \is_finite(volts) ==> \is_finite(\result);
*/
static pz_real to_code(const pz_parameters *p, pz_real volts);

/*@ requires \valid(s) && \valid_read(p) && \separated(s, p);
    requires \is_finite(p->voltage_minimum_V) && \is_finite(p->voltage_maximum_V);
    requires LE(p->voltage_minimum_V, p->voltage_maximum_V);
    requires \is_finite(p->voltage_step_V) && LE((pz_real)0, p->voltage_step_V);
    requires LE(p->voltage_step_V, (pz_real)1e5);
    requires LE((pz_real)-1e4, p->voltage_minimum_V) && LE(p->voltage_maximum_V, (pz_real)1e4);
    requires LE(p->voltage_minimum_V, s->command_V) && LE(s->command_V, p->voltage_maximum_V);
    requires \is_finite(p->lsb_V) && !GT(p->lsb_V, (pz_real)0);
    assigns s->command_V, s->voltage_V, s->status;
    ensures LE(p->voltage_minimum_V, s->command_V) && LE(s->command_V, p->voltage_maximum_V);
    ensures LE(p->voltage_minimum_V, s->voltage_V) && LE(s->voltage_V, p->voltage_maximum_V);
*/
static void convert(pz_state *s, const pz_parameters *p, pz_real wanted);

#include "piezoid_runtime.c"

/*@ requires \is_finite(u) && \is_finite(r) && LE((pz_real)0, r) && LE(r, (pz_real)1e4);
    requires LE((pz_real)-1e10, u) && LE(u, (pz_real)1e10);
    assigns \nothing;
*/
static pz_real play(pz_real z, pz_real u, pz_real r) {
    const pz_real low = u - r;
    const pz_real high = u + r;
    const pz_real moved = clamp(z, low, high);
    /*@ assert near: (LE(low, high) ==> LE(low, moved)) && LE(moved, high); */
    /*@ assert stays: LE(low, z) && LE(z, high) ==> EQ(moved, z); */
    return moved;
}
