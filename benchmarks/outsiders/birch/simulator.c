/* A university laboratory's piezo stages and tunnelling tips, drawn from a seed.
 *
 * STAGE: DAC (16 bit) -> delay of one tick and a fraction -> high-voltage amplifier (clipping,
 * slew limit, one pole) -> hysteresis law -> creep -> lightly damped mode(s) -> platform ->
 * sensor (one pole, noise) -> ADC (16 bit).
 *
 * TIP: DAC (20 bit) -> delay -> amplifier pole -> piezo tube (perhaps with a mode) -> gap ->
 * exponential tunnelling current -> preamplifier (one pole, noise, offset, clipping) -> ADC (16 bit).
 *
 * The hysteresis laws work on the dimensionless voltage u, which is -1..1 over the range that the
 * laboratory uses. Every law delivers a memory variable w; the displacement is an anhysteretic bent
 * curve g(u) combined with w. The share of w is found when a stage is opened, from its major loop,
 * so that the opening of the loop (largest vertical distance of the two branches over the stroke)
 * is the one drawn (7 to 15 %).
 *
 * Laws (number = stage_truth 0):
 *  0 Preisach, lognormal coercive and normal interaction field. F. Preisach, Z. Phys. 94, 277 (1935);
 *    I. Mayergoyz, Mathematical Models of Hysteresis (1991); E. Della Torre, Magnetic Hysteresis (1999).
 *  1 Preisach, product of two Lorentzians in the switching fields, unequal. B. Azzerboni et al.,
 *    IEEE Trans. Magn. 39, 3028 (2003); for piezoceramics P. Ge and M. Jouaneh, Precision Engineering
 *    17, 211 (1995) and G. Robert et al., J. Appl. Phys. 89, 5067 (2001).
 *  2 Bouc-Wen, generalised and asymmetric. Y.-K. Wen, J. Eng. Mech. 102, 249 (1976); T. Low and
 *    W. Guo, J. MEMS 4, 230 (1995), for piezos; J. Song and A. Der Kiureghian, J. Eng. Mech. 132, 610
 *    (2006), for the asymmetric shape function.
 *  3 Coleman-Hodgdon. B. Coleman and M. Hodgdon, Int. J. Eng. Sci. 24, 897 (1986); R. Banning et al.,
 *    Control Engineering Practice 9, 1317 (2001), for piezos.
 *  4 Duhem, semilinear and rate independent, unequal for rising and falling. J. Macki, P. Nistri,
 *    P. Zecca, SIAM Review 35, 94 (1993); J. Oh and D. Bernstein, IEEE Trans. Autom. Control 50, 631
 *    (2005).
 *  5 Dahl or LuGre walls. P. Dahl, Aerospace Corp. TOR-158 (1968); C. Canudas de Wit et al., IEEE
 *    Trans. Autom. Control 40, 419 (1995); Q. Xu and Y. Li, IEEE/ASME Trans. Mechatronics (2010-2012)
 *    for piezo stages.
 *  6 Maxwell slip, many elements with Weibull breaks and a bent curve in front. M. Goldfarb and
 *    N. Celanovic, IEEE Control Systems 17(3), 69 (1997).
 *  7 Jiles-Atherton adapted to ferroelectric polarisation and strain. D. Jiles and D. Atherton,
 *    J. Magn. Magn. Mater. 61, 48 (1986); R. Smith and Z. Ounaies, J. Intell. Mater. Syst. Struct. 11,
 *    62 (2000); no negative irreversible slope: J. Deane, IEEE Trans. Magn. 30, 2795 (1994).
 *  8 Krasnosel'skii-Pokrovskii. H. Banks, A. Kurdila, G. Webb, Math. Probl. Eng. 3, 287 (1997);
 *    W. Galinaitis and R. Rogers, Proc. SPIE 3323, 511 (1998).
 * The differential laws (2, 3, 4, 5, 7) have no return-point memory: small rapid motion makes them forget
 * (accommodation). A ceramic does so far less, as its walls move reversibly below a threshold field; these laws
 * are therefore fed through a play of +-0.3 to 1 % of the range, within which w follows elastically
 * (threshold of the Rayleigh range: D. Hall and P. Stevenson, Ferroelectrics 228, 139 (1999); D. Damjanovic, Rep. Prog. Phys. 61, 1267 (1998)).
 * Larger vibration, say a chirp of some per cent of the range, still relaxes them towards the middle of the loop.
 *
 * Creep: a spectrum of relaxations, one per decade (K. Kuhnen, P. Krejci and others, 1999-2001), which
 * is the logarithmic creep of S. Vieira, IBM J. Res. Dev. 30, 553 (1986).
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define TICK 50e-6

void *stage_open(uint32_t seed, uint32_t noise_seed);
void *stage_open_at(uint32_t seed, uint32_t noise_seed, double volts, int history);
void stage_step(void *stage, double volts, double *measured_m, double *position_m);
void stage_close(void *stage);
void stage_rest(void *stage, double *volts, double *displacement_m);
void stage_record(void *stage, const double *volts, long n, long every, double *measured_m);
double stage_truth(uint32_t seed, int which);
void *tip_open(uint32_t seed, uint32_t noise_seed, double gap_m);
void tip_step(void *tip, double volts, double *current_A, double *gap_m);
void tip_move_surface(void *tip, double height_m);
void tip_fault(void *tip, int kind);
void tip_close(void *tip);
double tip_truth(uint32_t seed, int which);
double tip_loop(void *tip, double drive, double ki, double kp, const double *dither, long n,
                double *drive_out, double *current_out);
void tip_sweep(void *tip, double drive, const double *zrel, long points, long dwell, long settle,
               double *forward, double *backward);

/* ---------------------------------------------------------------- random numbers */

typedef struct {
    uint64_t s;
    double spare;
    int has;
} Rng;

static uint64_t rng_next(Rng *r)
{
    uint64_t z = (r->s += 0x9E3779B97F4A7C15ull);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    return z ^ (z >> 31);
}

static void rng_seed(Rng *r, uint32_t a, uint32_t b, uint32_t purpose)
{
    int i;
    r->s = ((uint64_t)a << 32) ^ ((uint64_t)b * 0x9E3779B1u) ^ ((uint64_t)purpose << 20) ^ purpose;
    r->spare = 0.0;
    r->has = 0;
    for (i = 0; i < 3; i++)
        r->s ^= rng_next(r) << 1;
}

static double uni(Rng *r, double lo, double hi)
{
    return lo + (hi - lo) * ((double)(rng_next(r) >> 11) * (1.0 / 9007199254740992.0));
}

static double loguni(Rng *r, double lo, double hi)
{
    return lo * exp(uni(r, 0.0, 1.0) * log(hi / lo));
}

static double gauss(Rng *r) /* Marsaglia's polar method */
{
    double a, b, q;
    if (r->has) {
        r->has = 0;
        return r->spare;
    }
    do {
        a = uni(r, -1.0, 1.0);
        b = uni(r, -1.0, 1.0);
        q = a * a + b * b;
    } while (q >= 1.0 || q == 0.0);
    q = sqrt(-2.0 * log(q) / q);
    r->spare = b * q;
    r->has = 1;
    return a * q;
}

static double clampd(double x, double lo, double hi)
{
    return x < lo ? lo : (x > hi ? hi : x);
}

/* ---------------------------------------------------------------- a mode, exactly sampled */

/* x'' + (w/Q) x' + w^2 x = w^2 q, state (x, x'/w); q runs linearly from q0 to q1 within the step. */
typedef struct {
    double p[4], a[2], b[2];
} ModeStep;

static void mode_matrix(ModeStep *m, double w, double q, double h)
{
    double a[4][4] = {{0}}, e[4][4], t[4][4], s[4][4], scale;
    int i, j, k, n, squarings = 0;
    a[0][1] = w;
    a[1][0] = -w;
    a[1][1] = -w / q;
    a[1][2] = w;
    a[2][3] = 1.0 / h; /* the fourth state is q1 - q0 */
    scale = h;
    while (w * scale > 0.05 || scale / h > 0.05) {
        scale *= 0.5;
        squarings++;
    }
    for (i = 0; i < 4; i++)
        for (j = 0; j < 4; j++) {
            a[i][j] *= scale;
            e[i][j] = t[i][j] = (i == j);
        }
    for (n = 1; n < 12; n++) {
        for (i = 0; i < 4; i++)
            for (j = 0; j < 4; j++) {
                s[i][j] = 0.0;
                for (k = 0; k < 4; k++)
                    s[i][j] += t[i][k] * a[k][j] / n;
            }
        memcpy(t, s, sizeof t);
        for (i = 0; i < 4; i++)
            for (j = 0; j < 4; j++)
                e[i][j] += t[i][j];
    }
    while (squarings--) {
        for (i = 0; i < 4; i++)
            for (j = 0; j < 4; j++) {
                s[i][j] = 0.0;
                for (k = 0; k < 4; k++)
                    s[i][j] += e[i][k] * e[k][j];
            }
        memcpy(e, s, sizeof e);
    }
    m->p[0] = e[0][0];
    m->p[1] = e[0][1];
    m->p[2] = e[1][0];
    m->p[3] = e[1][1];
    m->a[0] = e[0][2];
    m->a[1] = e[1][2];
    m->b[0] = e[0][3];
    m->b[1] = e[1][3];
}

static void mode_advance(const ModeStep *m, double *z, double q0, double q1)
{
    double x = z[0], v = z[1], d = q1 - q0;
    z[0] = m->p[0] * x + m->p[1] * v + m->a[0] * q0 + m->b[0] * d;
    z[1] = m->p[2] * x + m->p[3] * v + m->a[1] * q0 + m->b[1] * d;
}

/* First-order low-pass whose input runs linearly from x0 to x1. */
typedef struct {
    double e, r;
} PoleStep;

static void pole_coefficients(PoleStep *p, double f, double h)
{
    double k = h * 2.0 * PI * f;
    p->e = exp(-k);
    p->r = 1.0 - (1.0 - p->e) / k;
}

static double pole_advance(const PoleStep *p, double s, double x0, double x1)
{
    return p->e * s + (1.0 - p->e) * x0 + p->r * (x1 - x0);
}

/* ---------------------------------------------------------------- hysteresis laws */

enum { PREISACH_LOGNORMAL, PREISACH_LORENTZ, BOUC_WEN, COLEMAN_HODGDON, DUHEM, DAHL_LUGRE,
       MAXWELL_SLIP, JILES_ATHERTON, KP, LAWS };

#define GRID 80
#define DEPTH 240
#define SLIPS 40
#define KPMAX 91
#define WALLS 4

typedef struct {
    int kind;
    double sign;            /* +1: w rises with u and lags; -1: w is a restoring force taken off */
    double lo, hi;          /* reachable u */
    double threshold, held; /* the small play in front of the differential laws */
    double elastic;         /* slope of w in the reversible range of that play */
    double w;
    /* Preisach: cumulated density, symmetric in (alpha, beta), and the turning points */
    double cum[GRID + 1][GRID + 1];
    double tu[DEPTH], tw[DEPTH], last;
    int depth, direction;
    /* differential laws */
    double par[12];
    double x[WALLS], up[WALLS], down[WALLS], weight[WALLS];
    /* Maxwell slip */
    double s[SLIPS], brk[SLIPS], stiff[SLIPS], bent;
    /* Krasnosel'skii-Pokrovskii */
    int kernels;
    double k[KPMAX], rise[KPMAX], fall[KPMAX], mass[KPMAX], inv_ridge;
} Law;

static double cum_at(const Law *L, double a, double b)
{
    double sc = GRID / (L->hi - L->lo), fa = (a - L->lo) * sc, fb = (b - L->lo) * sc;
    int i = (int)fa, j = (int)fb;
    i = i < 0 ? 0 : (i > GRID - 1 ? GRID - 1 : i);
    j = j < 0 ? 0 : (j > GRID - 1 ? GRID - 1 : j);
    fa -= i;
    fb -= j;
    return (L->cum[i][j] * (1 - fb) + L->cum[i][j + 1] * fb) * (1 - fa)
         + (L->cum[i + 1][j] * (1 - fb) + L->cum[i + 1][j + 1] * fb) * fa;
}

/* Everett function of a density constant in each cell: half the mass of the mirrored density over the
 * square [beta, alpha]^2, for which the bilinear cumulated function is exact. */
static double everett(const Law *L, double a, double b)
{
    return 0.5 * (cum_at(L, a, a) - 2.0 * cum_at(L, a, b) + cum_at(L, b, b));
}

static double preisach(Law *L, double u)
{
    double from;
    u = clampd(u, L->lo + 1e-9, L->hi - 1e-9);
    if (u == L->last)
        return L->w;
    if ((u > L->last) != (L->direction > 0)) {
        if (L->depth > DEPTH - 3)
            L->depth -= 2; /* the innermost loops, far below the resolution, are given up */
        L->tu[L->depth] = L->last;
        L->tw[L->depth] = L->w;
        L->depth++;
        L->direction = -L->direction;
    }
    while (L->depth >= 3 && (L->direction > 0 ? u >= L->tu[L->depth - 2] : u <= L->tu[L->depth - 2]))
        L->depth -= 2;
    from = L->tu[L->depth - 1];
    L->w = L->direction > 0 ? L->tw[L->depth - 1] + 2.0 * everett(L, u, from)
                            : L->tw[L->depth - 1] - 2.0 * everett(L, from, u);
    L->last = u;
    return L->w;
}

static double langevin(double x)
{
    if (fabs(x) < 0.05)
        return x / 3.0 - x * x * x / 45.0;
    return 1.0 / tanh(x) - 1.0 / x;
}

static double langevin_slope(double x)
{
    double s;
    if (fabs(x) < 0.05)
        return 1.0 / 3.0 - x * x / 15.0;
    s = sinh(x);
    return 1.0 / (x * x) - 1.0 / (s * s);
}

/* One short piece |du| <= 0.004 of a differential law, from u to u + du. */
static void differential(Law *L, double u, double du, double rate)
{
    const double *p = L->par;
    double s = du > 0 ? 1.0 : -1.0, m = u + 0.5 * du, ad = fabs(du), z, dz;
    int i, pass;
    switch (L->kind) {
    case BOUC_WEN: /* p: scale, n, beta, gamma, b(sgn u du), b(sgn du), b(sgn u) */
        z = L->x[0];
        dz = 0.0;
        for (pass = 0; pass < 2; pass++) {
            double zm = z + 0.5 * dz, soft = tanh(4.0 * m);
            double shape = p[3] + p[2] * (s * zm > 0 ? 1.0 : (zm == 0 ? 0.0 : -1.0)) + p[4] * soft * s
                         + p[5] * s + p[6] * soft;
            dz = du * (1.0 - pow(fabs(zm) * p[0], p[1]) * shape);
        }
        L->x[0] = z + dz;
        L->w = L->x[0];
        break;
    case COLEMAN_HODGDON: { /* p: 1/length, its slope in u, f: linear, tanh, width, centre; g/f' low, high */
        double t = tanh((m - p[5]) / p[4]), f = p[2] * m + p[3] * t;
        double fs = p[2] + p[3] * (1.0 - t * t) / p[4];
        double ratio = p[6] + (p[7] - p[6]) * 0.5 * (1.0 + tanh(m)), k = ad * p[0] * (1.0 + p[1] * tanh(m));
        z = L->x[0];
        L->x[0] = z + (k * (f - z) + ratio * fs * du) / (1.0 + 0.5 * k);
        L->w = L->x[0];
        break;
    }
    case DUHEM: { /* p: bend of the drive seen by the states */
        double f = m + p[0] * (sqrt(1.0 + m * m) - 1.0);
        L->w = 0.0;
        for (i = 0; i < 3; i++) {
            double k = ad / (s > 0 ? L->up[i] : L->down[i]);
            L->x[i] += (f - L->x[i]) * k / (1.0 + 0.5 * k);
            L->w += L->weight[i] * L->x[i];
        }
        break;
    }
    case DAHL_LUGRE: { /* p: exponent, asymmetry, Stribeck excess, 1/Stribeck rate */
        double level = 1.0 + p[1] * tanh(m);
        if (p[2] > 0.0)
            level *= 1.0 + p[2] * exp(-rate * rate * p[3] * p[3]);
        L->w = 0.0;
        for (i = 0; i < WALLS; i++) {
            double r = 1.0 - s * L->x[i] / (L->up[i] * level);
            r = (p[0] == 1.0) ? r : (r > 0 ? pow(r, p[0]) : -pow(-r, p[0]));
            L->x[i] += du * r;
            L->w += L->weight[i] * L->x[i];
        }
        break;
    }
    default: { /* JILES_ATHERTON; p: shape a, coupling alpha, pinning k, reversible c, bias field, quadratic strain */
        double e0 = m + p[4], pan, irr = L->x[0], total = L->x[1], diff, slope, rev;
        double xe = (e0 + p[1] * total) / p[0];
        pan = langevin(xe);
        diff = pan - irr;
        slope = s * diff > 0 ? diff / (s * p[2] - p[1] * diff) : 0.0;
        irr += slope * du;
        rev = langevin_slope(xe) / p[0];
        rev = p[3] * rev / (1.0 - p[1] * p[3] * rev);
        L->x[0] = irr;
        L->x[1] = total + (1.0 - p[3]) * slope * du + rev * du;
        L->w = L->x[1] + p[5] * L->x[1] * L->x[1];
        break;
    }
    }
}

static double law_bend(double u, double q)
{
    return u + q * (sqrt(1.0 + u * u) - 1.0);
}

/* rate: speed of u in 1/s, which only LuGre looks at. */
static double law_step(Law *L, double u, double rate)
{
    int i;
    if (L->kind == PREISACH_LOGNORMAL || L->kind == PREISACH_LORENTZ)
        return preisach(L, u);
    if (L->kind == MAXWELL_SLIP) {
        double v = law_bend(u, L->par[0]), d = v - L->bent, w = 0.0;
        L->bent = v;
        for (i = 0; i < SLIPS; i++) {
            double s = L->s[i] + d;
            s = s > L->brk[i] ? L->brk[i] : s;
            s = s < -L->brk[i] ? -L->brk[i] : s;
            L->s[i] = s;
            w += L->stiff[i] * s;
        }
        return L->w = w;
    }
    if (L->kind == KP) {
        double w = 0.0, g = L->inv_ridge;
        for (i = 0; i < L->kernels; i++) {
            double a = (u - L->rise[i]) * g, b = (u - L->fall[i]) * g, k = L->k[i];
            a = a > 1.0 ? 1.0 : a;
            a = a < -1.0 ? -1.0 : a;
            b = b > 1.0 ? 1.0 : b;
            b = b < -1.0 ? -1.0 : b;
            k = k < a ? a : k;
            k = k > b ? b : k;
            L->k[i] = k;
            w += L->mass[i] * k;
        }
        return L->w = w;
    }
    {
        double to = L->held, d;
        long n, j;
        if (u > to + L->threshold)
            to = u - L->threshold;
        else if (u < to - L->threshold)
            to = u + L->threshold;
        d = to - L->held;
        if (d == 0.0)
            return L->w + L->elastic * (u - to);
        n = (long)ceil(fabs(d) / 0.004);
        d /= (double)n;
        for (j = 0; j < n; j++)
            differential(L, L->held + (double)j * d, d, rate);
        L->held = to;
        return L->w + L->elastic * (u - to);
    }
}

static void law_reset(Law *L)
{
    L->w = 0.0;
    L->held = 0.0;
    memset(L->x, 0, sizeof L->x);
    memset(L->s, 0, sizeof L->s);
    L->bent = law_bend(0.0, L->par[0]);
    L->depth = 1; /* negative saturation */
    L->direction = 1;
    L->tu[0] = L->last = L->lo + 1e-9;
    L->tw[0] = L->w;
    memset(L->k, 0, sizeof L->k);
}

static void law_draw(Law *L, int kind, Rng *r, double lo, double hi)
{
    int i, j, n;
    double sum;
    memset(L, 0, sizeof *L);
    L->kind = kind;
    L->lo = lo;
    L->hi = hi;
    L->sign = 1.0;
    switch (kind) {
    case PREISACH_LOGNORMAL:
    case PREISACH_LORENTZ: {
        double h = (hi - lo) / GRID;
        double med = uni(r, 0.32, 0.6), sig = uni(r, 0.5, 0.8), bias = uni(r, -0.35, 0.35), wide = uni(r, 0.7, 1.2);
        double a0 = uni(r, 0.1, 0.6), b0 = uni(r, 0.1, 0.6), s1 = uni(r, 0.45, 0.9), s2 = uni(r, 0.45, 0.9);
        for (i = 0; i < GRID; i++)
            for (j = 0; j < GRID; j++) {
                double a = lo + ((i > j ? i : j) + 0.5) * h, b = lo + ((i > j ? j : i) + 0.5) * h, d;
                if (kind == PREISACH_LOGNORMAL) {
                    double hc = 0.5 * (a - b) + 0.25 * h, hm = (0.5 * (a + b) - bias) / wide;
                    double l = log(hc / med) / sig;
                    d = exp(-0.5 * l * l) / hc * exp(-0.5 * hm * hm);
                } else {
                    double p = (a - a0) / s1, q = (b + b0) / s2;
                    d = 1.0 / ((1.0 + p * p) * (1.0 + q * q));
                }
                L->cum[i + 1][j + 1] = d * h * h + L->cum[i][j + 1] + L->cum[i + 1][j] - L->cum[i][j];
            }
        break;
    }
    case BOUC_WEN:
        L->sign = -1.0;
        L->par[0] = 1.0 / uni(r, 0.9, 1.6);
        L->par[1] = uni(r, 1.0, 1.4);
        L->par[2] = uni(r, 0.5, 0.75);       /* beta */
        L->par[3] = 1.0 - L->par[2];         /* gamma <= beta: bounded and dissipative */
        L->par[4] = uni(r, -0.12, 0.12);
        L->par[5] = uni(r, -0.15, 0.15);
        L->par[6] = uni(r, -0.12, 0.12);
        break;
    case COLEMAN_HODGDON:
        L->par[0] = 1.0 / uni(r, 0.7, 1.3);
        L->par[1] = uni(r, -0.3, 0.3);
        L->par[2] = uni(r, 0.6, 1.0);
        L->par[3] = uni(r, 0.2, 0.7);
        L->par[4] = uni(r, 0.8, 1.6);
        L->par[5] = uni(r, -0.4, 0.4);
        L->par[6] = uni(r, 0.3, 0.6);
        L->par[7] = uni(r, 0.3, 0.6);
        break;
    case DUHEM:
        L->par[0] = uni(r, -0.3, 0.3);
        for (i = 0; i < 3; i++) {
            static const double length[3] = {0.25, 0.8, 2.5};
            double base = length[i] * loguni(r, 0.75, 1.35), skew = loguni(r, 0.8, 1.25);
            L->up[i] = base * skew;
            L->down[i] = base / skew;
        }
        L->weight[0] = uni(r, 0.1, 0.3);
        L->weight[1] = uni(r, 0.7, 1.2);
        L->weight[2] = uni(r, 0.3, 0.8);
        break;
    case DAHL_LUGRE: {
        int lugre = uni(r, 0.0, 1.0) < 0.5;
        L->sign = -1.0;
        L->par[0] = lugre ? 1.0 : uni(r, 0.6, 1.6);
        L->par[1] = uni(r, -0.25, 0.25);
        L->par[2] = lugre ? uni(r, 0.04, 0.15) : 0.0;
        L->par[3] = 1.0 / loguni(r, 0.5, 20.0);
        for (i = 0; i < WALLS; i++) {
            static const double level[WALLS] = {0.12, 0.4, 1.0, 2.2};
            L->up[i] = level[i] * loguni(r, 0.75, 1.3);
            L->weight[i] = uni(r, 0.6, 1.4) * (i == 0 ? 0.4 : 1.0);
        }
        break;
    }
    case MAXWELL_SLIP: {
        double shape = uni(r, 1.0, 1.8), scale = uni(r, 0.5, 0.9);
        L->sign = -1.0;
        L->par[0] = uni(r, -0.45, 0.45);
        for (i = 0; i < SLIPS; i++) {
            L->brk[i] = scale * pow(-log(1.0 - (i + 0.5) / SLIPS), 1.0 / shape);
            L->stiff[i] = loguni(r, 0.6, 1.7) / SLIPS;
        }
        break;
    }
    case JILES_ATHERTON:
        L->par[0] = uni(r, 0.5, 0.9);
        L->par[1] = uni(r, 0.0, 0.15);
        L->par[2] = uni(r, 0.35, 0.7);
        L->par[3] = uni(r, 0.15, 0.4);
        L->par[4] = uni(r, -0.2, 0.5);
        L->par[5] = uni(r, 0.0, 0.25);
        break;
    default: { /* KP */
        double med = uni(r, 0.5, 0.85), bias = uni(r, -0.3, 0.3), wide = uni(r, 0.9, 1.5), tail = uni(r, 1.6, 2.4);
        double h;
        n = 12;
        h = (hi - lo) / n;
        L->inv_ridge = 2.0 / (h * uni(r, 1.6, 2.6));
        for (i = 0; i < n; i++)
            for (j = 0; j <= i; j++) {
                double a = lo + (i + 0.5) * h, b = lo + (j + 0.5) * h, hc, hm;
                a += (i == j ? 0.25 * h : 0.0);
                b -= (i == j ? 0.25 * h : 0.0);
                hc = 0.5 * (a - b) / med;
                hm = (0.5 * (a + b) - bias) / wide;
                L->rise[L->kernels] = a;
                L->fall[L->kernels] = b;
                L->mass[L->kernels] = (i == j ? 0.5 : 1.0) * pow(hc + 0.1, tail - 1.0) * exp(-pow(hc, tail))
                                    / (1.0 + hm * hm) * loguni(r, 0.8, 1.25);
                L->kernels++;
            }
        sum = 0.0;
        for (i = 0; i < L->kernels; i++)
            sum += L->mass[i];
        for (i = 0; i < L->kernels; i++)
            L->mass[i] /= sum;
        break;
    }
    }
    if (kind == BOUC_WEN || kind == COLEMAN_HODGDON || kind == DUHEM || kind == DAHL_LUGRE || kind == JILES_ATHERTON)
        L->threshold = uni(r, 0.006, 0.02);
    switch (kind) { /* the small-signal slope of each law */
    case BOUC_WEN:
        L->elastic = 1.0;
        break;
    case COLEMAN_HODGDON:
        L->elastic = 0.5 * (L->par[6] + L->par[7]) * (L->par[2] + L->par[3] / L->par[4]);
        break;
    case DAHL_LUGRE:
        for (i = 0; i < WALLS; i++)
            L->elastic += L->weight[i];
        break;
    case JILES_ATHERTON:
        L->elastic = L->par[3] / (3.0 * L->par[0]);
        break;
    default: /* no reversible part, or no play */
        break;
    }
    law_reset(L);
}

/* ---------------------------------------------------------------- the stage */

#define CREEPS 5

typedef struct {
    Law law;
    Rng noise;
    /* drawn */
    double f1, q1, f2, q2, share2;
    double delay, frac;                  /* ticks: in all, and beyond one */
    double gain, gain_nominal, amp, amp_nominal, hv_min, hv_max, slew;
    double sensor, sensor_nominal, volt_per_m, lsb;
    double creep, sigma, hum, hum_phase;
    double stroke, polarity, offset;
    double v_lo, v_hi, mid, half;        /* DAC range used, and its high voltage */
    double bend_q, bend_k, opening, least_slope;
    double share, w_scale, y_scale, y_mid;
    /* steps: [0] before the fraction of a tick, [1] after it */
    int sub[2];
    double h[2], amp_e[2];
    ModeStep m1[2], m2[2];
    PoleStep sp[2];
    double creep_k[CREEPS];
    /* state */
    double buf0, buf1;                   /* voltages of the last call and of the one before */
    double hv, q, z1[2], z2[2], c[CREEPS], creep_sum, pos, filtered, measured;
    double rest_v, rest_x;
    uint64_t ticks;
} Stage;

static double dac16(double v)
{
    const double lsb = 20.0 / 65536.0;
    return clampd(floor(v / lsb + 0.5) * lsb, -10.0, 10.0 - lsb);
}

static double anhysteretic(const Stage *s, double u)
{
    return u + s->bend_q * (sqrt(1.0 + u * u) - 1.0) + s->bend_k * tanh(1.2 * u);
}

static double blend(const Stage *s, double g, double w)
{
    return (s->law.sign > 0 ? 1.0 - s->share : 1.0) * g + s->law.sign * s->share * s->w_scale * w;
}

static double quasi_static(Stage *s, double u, double rate)
{
    double w = law_step(&s->law, u, rate);
    return (blend(s, anhysteretic(s, u), w) - s->y_mid) * s->y_scale;
}

#define BRANCH 500

static void stage_calibrate(Stage *s, double target)
{
    double g[BRANCH + 1], rise[BRANCH + 1], fall[BRANCH + 1], wmin = 1e300, wmax = -1e300, gs, lo, hi, w = 0;
    int i, cycle, it;
    law_reset(&s->law);
    for (cycle = 0; cycle < 6; cycle++)
        for (i = 0; i <= 2 * BRANCH; i++) {
            double u = i <= BRANCH ? -1.0 + 2.0 * i / BRANCH : 3.0 - 2.0 * i / BRANCH;
            w = law_step(&s->law, u, 0.0);
            if (i <= BRANCH)
                rise[i] = w;
            if (i >= BRANCH)
                fall[2 * BRANCH - i] = w;
        }
    for (i = 0; i <= BRANCH; i++) {
        g[i] = anhysteretic(s, -1.0 + 2.0 * i / BRANCH);
        wmin = fmin(wmin, fmin(rise[i], fall[i]));
        wmax = fmax(wmax, fmax(rise[i], fall[i]));
    }
    gs = g[BRANCH] - g[0];
    s->w_scale = gs / (wmax - wmin);
    for (;;) {
        lo = 0.0;
        hi = 0.97;
        for (it = 0; it < 40; it++) {
            double open = 0.0, stroke, least = 1e300;
            s->share = 0.5 * (lo + hi);
            stroke = blend(s, g[BRANCH], rise[BRANCH]) - blend(s, g[0], fall[0]);
            for (i = 0; i <= BRANCH; i++) {
                double d = blend(s, g[i], fall[i]) - blend(s, g[i], rise[i]);
                open = fmax(open, d);
                if (i) {
                    least = fmin(least, blend(s, g[i], rise[i]) - blend(s, g[i - 1], rise[i - 1]));
                    least = fmin(least, blend(s, g[i], fall[i]) - blend(s, g[i - 1], fall[i - 1]));
                }
            }
            s->opening = open / stroke;
            s->least_slope = least * BRANCH / stroke;
            s->y_scale = 1.0 / stroke;
            s->y_mid = 0.5 * (blend(s, g[BRANCH], rise[BRANCH]) + blend(s, g[0], fall[0]));
            if (s->opening < target && stroke > 0)
                lo = s->share;
            else
                hi = s->share;
        }
        if (s->least_slope > 0.25 || target < 0.072)
            break;
        target *= 0.96;
    }
}

static void stage_draw(Stage *s, uint32_t seed)
{
    static const struct {
        double gain, lo, hi;
    } amps[5] = {{15, -30, 150}, {10, -20, 100}, {20, -200, 200}, {15, -150, 150}, {7.5, -10, 75}};
    Rng r;
    int pick, damped = seed >= 5000u, i;
    double lo, hi, span, target, cover;
    memset(s, 0, sizeof *s);
    rng_seed(&r, seed, 0u, 11u);
    pick = (int)uni(&r, 0.0, 5.0);
    s->gain_nominal = amps[pick].gain;
    s->hv_min = amps[pick].lo;
    s->hv_max = amps[pick].hi;
    s->gain = s->gain_nominal * (1.0 + uni(&r, -0.005, 0.005));
    span = s->hv_max - s->hv_min;
    lo = s->hv_min + uni(&r, 0.04, 0.16) * span;
    hi = s->hv_max - uni(&r, 0.04, 0.18) * span;
    s->v_lo = dac16(floor(lo / s->gain_nominal * 10.0) / 10.0);
    s->v_hi = dac16(fmin(floor(hi / s->gain_nominal * 10.0) / 10.0, 9.5));
    s->mid = 0.5 * (s->v_lo + s->v_hi) * s->gain;
    s->half = 0.5 * (s->v_hi - s->v_lo) * s->gain;
    s->amp_nominal = floor(loguni(&r, 1000.0, 8000.0) / 100.0) * 100.0;
    s->amp = s->amp_nominal * (1.0 + uni(&r, -0.04, 0.04));
    s->slew = uni(&r, 0.0, 1.0) < 0.5 ? loguni(&r, 1.0e5, 6.0e5) : 0.0;
    s->sensor_nominal = floor(loguni(&r, 3000.0, 15000.0) / 500.0) * 500.0;
    s->sensor = s->sensor_nominal * (1.0 + uni(&r, -0.04, 0.04));
    s->frac = uni(&r, 0.0, 1.0) < 0.35 ? 0.0 : uni(&r, 0.05, 0.7);
    s->delay = 1.0 + s->frac;
    s->f1 = damped ? loguni(&r, 3000.0, 6000.0) : loguni(&r, 300.0, 1500.0);
    s->q1 = damped ? uni(&r, 1.0, 3.0) : loguni(&r, 5.0, 60.0);
    if (!damped && uni(&r, 0.0, 1.0) < 0.45) {
        s->f2 = s->f1 * uni(&r, 2.1, 3.8);
        s->q2 = loguni(&r, 8.0, 40.0);
        s->share2 = loguni(&r, 0.01, 0.05) * (uni(&r, 0.0, 1.0) < 0.3 ? -1.0 : 1.0);
    }
    s->stroke = loguni(&r, 5e-6, 100e-6);
    s->polarity = uni(&r, 0.0, 1.0) < 0.3 ? -1.0 : 1.0;
    s->creep = uni(&r, 0.0, 1.0) < 0.1 ? 0.0 : uni(&r, 0.002, 0.02);
    s->sigma = s->stroke * loguni(&r, 1e-4, 1e-3);
    s->hum = uni(&r, 0.0, 1.0) < 0.3 ? s->sigma * uni(&r, 0.3, 1.0) : 0.0;
    s->hum_phase = uni(&r, 0.0, 2.0 * PI);
    s->offset = s->stroke * uni(&r, -0.12, 0.12);
    cover = uni(&r, 1.6, 2.1) * s->stroke; /* the ADC's 20 V, with room for overshoot and offset */
    s->volt_per_m = 20.0 / cover;
    s->lsb = 20.0 / 65536.0 / s->volt_per_m;
    s->bend_q = uni(&r, -0.22, 0.22);
    s->bend_k = uni(&r, -0.05, 0.3);
    target = uni(&r, 0.072, 0.148);
    {
        double ulo = (s->hv_min - s->mid) / s->half, uhi = (s->hv_max - s->mid) / s->half;
        law_draw(&s->law, (int)(seed % LAWS), &r, fmin(ulo, -1.0) - 0.03, fmax(uhi, 1.0) + 0.03);
    }
    stage_calibrate(s, target);
    /* integration steps */
    s->h[0] = s->frac * TICK;
    s->h[1] = (1.0 - s->frac) * TICK;
    for (i = 0; i < 2; i++) {
        s->sub[i] = (int)ceil(s->h[i] / 10.01e-6);
        if (!s->sub[i])
            continue;
        s->h[i] /= s->sub[i];
        s->amp_e[i] = exp(-s->h[i] * 2.0 * PI * s->amp);
        mode_matrix(&s->m1[i], 2.0 * PI * s->f1, s->q1, s->h[i]);
        if (s->f2 > 0.0)
            mode_matrix(&s->m2[i], 2.0 * PI * s->f2, s->q2, s->h[i]);
        pole_coefficients(&s->sp[i], s->sensor, s->h[i]);
    }
    for (i = 0; i < CREEPS; i++)
        s->creep_k[i] = -expm1(-TICK / (0.03 * pow(10.0, i)));
}

static double go(Stage *s, double from, double to) /* slow quasi-static travel */
{
    int i, n = 1 + (int)(fabs(to - from) * 250.0);
    double y = 0.0;
    for (i = 1; i <= n; i++)
        y = quasi_static(s, from + (to - from) * i / n, 0.0);
    return y;
}

static void stage_sense(Stage *s)
{
    double x = s->filtered + s->sigma * gauss(&s->noise), code;
    if (s->hum > 0.0)
        x += s->hum * sin(2.0 * PI * 50.0 * TICK * (double)(s->ticks % 400u) + s->hum_phase);
    code = floor(x / s->lsb + 0.5);
    s->measured = clampd(code, -32768.0, 32767.0) * s->lsb;
}

/* history: 0 full cycles, then to rest from below; 1 from above; 2 cycles of decreasing amplitude
 * around the rest; 3 full cycles and some wandering. */
static void stage_settle(Stage *s, double volts, int history, Rng *r)
{
    double u, at = 0.0, y, amp;
    int i;
    s->rest_v = dac16(volts);
    s->hv = clampd(s->rest_v * s->gain, s->hv_min, s->hv_max);
    u = (s->hv - s->mid) / s->half;
    law_reset(&s->law);
    go(s, 0.0, -1.0);
    for (i = 0; i < 4; i++) {
        go(s, -1.0, 1.0);
        go(s, 1.0, -1.0);
    }
    at = -1.0;
    if (history == 1) {
        go(s, at, 1.0);
        at = 1.0;
    } else if (history == 2) {
        for (amp = 0.9; amp > 0.02; amp *= 0.85) {
            double top = fmin(u + amp, 1.0), bottom = fmax(u - amp, -1.0);
            go(s, at, top);
            go(s, top, bottom);
            at = bottom;
        }
    } else if (history == 3) {
        for (i = 0; i < 5; i++) {
            double next = uni(r, -1.0, 1.0);
            go(s, at, next);
            at = next;
        }
    }
    y = go(s, at, u);
    s->buf0 = s->buf1 = s->rest_v;
    s->creep_sum = 0.0;
    for (i = 0; i < CREEPS; i++) {
        s->c[i] = s->creep * y;
        s->creep_sum += s->c[i];
    }
    s->q = y + s->creep_sum;
    s->z1[0] = s->z2[0] = s->q;
    s->z1[1] = s->z2[1] = 0.0;
    s->rest_x = s->pos = s->filtered = s->polarity * s->stroke * s->q + s->offset;
    stage_sense(s);
}

void *stage_open_at(uint32_t seed, uint32_t noise_seed, double volts, int history)
{
    Stage *s = malloc(sizeof *s);
    Rng r;
    if (!s)
        return NULL;
    stage_draw(s, seed);
    rng_seed(&s->noise, seed, noise_seed, 12u);
    rng_seed(&r, seed, noise_seed, 13u);
    stage_settle(s, volts, history, &r);
    return s;
}

void *stage_open(uint32_t seed, uint32_t noise_seed)
{
    Stage *s = malloc(sizeof *s);
    Rng r;
    double kind, v;
    if (!s)
        return NULL;
    stage_draw(s, seed);
    rng_seed(&s->noise, seed, noise_seed, 12u);
    rng_seed(&r, seed, noise_seed, 14u);
    kind = uni(&r, 0.0, 1.0);
    v = s->v_lo + (s->v_hi - s->v_lo) * uni(&r, 0.25, 0.75);
    if (kind < 0.4)
        v = 0.5 * (s->v_lo + s->v_hi);
    else if (kind < 0.6 && fabs(s->mid) < 0.6 * s->half)
        v = 0.0; /* switched on and left alone, where that is well inside the range */
    stage_settle(s, v, (int)uni(&r, 0.0, 4.0), &r);
    return s;
}

void stage_close(void *stage)
{
    free(stage);
}

void stage_rest(void *stage, double *volts, double *displacement_m)
{
    const Stage *s = stage;
    *volts = s->rest_v;
    *displacement_m = s->rest_x;
}

/* One tick. The amplifier sees the voltage of the call before last for `frac` of the tick and then that
 * of the last call; the voltage of this call comes one tick (and the fraction) later. */
void stage_step(void *stage, double volts, double *measured_m, double *position_m)
{
    Stage *s = stage;
    double y = 0.0;
    int part, i;
    for (part = 0; part < 2; part++) {
        double target = clampd((part ? s->buf0 : s->buf1) * s->gain, s->hv_min, s->hv_max);
        for (i = 0; i < s->sub[part]; i++) {
            double h = s->h[part], step = (target - s->hv) * (1.0 - s->amp_e[part]), q, x, before = s->pos;
            if (s->slew > 0.0)
                step = clampd(step, -s->slew * h, s->slew * h);
            s->hv += step;
            y = quasi_static(s, (s->hv - s->mid) / s->half, step / s->half / h);
            q = y + s->creep_sum;
            mode_advance(&s->m1[part], s->z1, s->q, q);
            x = s->z1[0];
            if (s->f2 > 0.0) {
                mode_advance(&s->m2[part], s->z2, s->q, q);
                x += s->share2 * (s->z2[0] - s->z1[0]);
            }
            s->q = q;
            s->pos = s->polarity * s->stroke * x + s->offset;
            s->filtered = pole_advance(&s->sp[part], s->filtered, before, s->pos);
        }
    }
    s->creep_sum = 0.0;
    for (i = 0; i < CREEPS; i++) {
        s->c[i] += s->creep_k[i] * (s->creep * y - s->c[i]);
        s->creep_sum += s->c[i];
    }
    s->buf1 = s->buf0;
    if (isfinite(volts))
        s->buf0 = dac16(volts);
    s->ticks++;
    stage_sense(s);
    if (measured_m)
        *measured_m = s->measured;
    if (position_m)
        *position_m = s->pos;
}

/* A recording by the controller's own converters: in tick k it reads the ADC (what the call before
 * returned) and writes volts[k]. Every `every`-th reading is kept. */
void stage_record(void *stage, const double *volts, long n, long every, double *measured_m)
{
    Stage *s = stage;
    long k;
    for (k = 0; k < n; k++) {
        if (k % every == 0)
            measured_m[k / every] = s->measured;
        stage_step(stage, volts[k], NULL, NULL);
    }
}

double stage_truth(uint32_t seed, int which)
{
    Stage *s = malloc(sizeof *s);
    double t[29], out;
    if (!s)
        return NAN;
    stage_draw(s, seed);
    t[0] = s->law.kind;
    t[1] = s->f1;
    t[2] = s->q1;
    t[3] = s->f2;
    t[4] = s->q2;
    t[5] = s->share2;
    t[6] = s->delay;
    t[7] = s->amp;
    t[8] = s->sensor;
    t[9] = s->creep;
    t[10] = s->sigma;
    t[11] = s->stroke;
    t[12] = s->opening;
    t[13] = s->polarity;
    t[14] = s->v_lo;
    t[15] = s->v_hi;
    t[16] = s->gain;
    t[17] = s->gain_nominal;
    t[18] = s->amp_nominal;
    t[19] = s->hv_min;
    t[20] = s->hv_max;
    t[21] = s->slew;
    t[22] = s->sensor_nominal;
    t[23] = s->volt_per_m;
    t[24] = s->lsb;
    t[25] = s->offset;
    t[26] = s->hum;
    t[27] = s->least_slope;
    t[28] = s->law.threshold;
    out = which >= 0 && which < 29 ? t[which] : NAN;
    free(s);
    return out;
}

/* ---------------------------------------------------------------- the tunnelling tip */

/* Current: I = I_set exp(-2 kappa (d - d_set)), 2 kappa = 2 sqrt(2 m phi)/hbar = 10.246/nm sqrt(phi/eV)
 * (G. Binnig, H. Rohrer et al., Appl. Phys. Lett. 40, 178 (1982); J. Simmons, J. Appl. Phys. 34, 1793
 * (1963), at small bias), joined to the conductance of a contact of a few atoms, G0 V each, when the gap closes
 * (J. Gimzewski and R. Moller, Phys. Rev. B 36, 1284 (1987)).
 * Preamplifier noise: Johnson noise of the feedback resistor, shot noise, the amplifier's voltage noise on the
 * input capacitance (C. J. Chen, Introduction to Scanning Tunneling Microscopy, chapter 11). */
typedef struct {
    Rng noise;
    double barrier, kappa2, ext, hv_gain, actuator;
    double extra, amp, amp_nominal, pre, pre_nominal;
    double set, ohm, offset, floor_a, ceiling, sat, contact, bias;
    double gap_set, drift, hum, hum_phase;
    double mode_f, mode_q, mode_share;
    double vib_f, vib_rms;
    double white, lsb, hiss, hiss_e;
    int lag;                  /* whole ticks of delay */
    double frac;
    int sub[2];
    double h[2], amp_e[2];
    ModeStep m[2];
    PoleStep pp[2];
    double buf[4], dac, z[2], retracted, vib[2], vib_a, vib_b, vib_s, last_i, state, reading, shown, gap;
    int fault;
    uint64_t ticks;
} Tip;

static double dac20(double v)
{
    const double lsb = 20.0 / 1048576.0;
    return clampd(floor(v / lsb + 0.5) * lsb, -10.0, 10.0 - lsb);
}

static double extension(const Tip *t)
{
    return t->ext * (t->dac + t->mode_share * (t->z[0] - t->dac));
}

static double current_at(const Tip *t, double gap)
{
    double e = t->kappa2 * (t->gap_set - gap), i;
    i = t->set * exp(clampd(e, -60.0, 60.0));
    return i / (1.0 + i / t->contact);
}

static void tip_draw(Tip *t, uint32_t seed)
{
    static const double gains[4] = {7.5, 10.0, 15.0, 20.0};
    Rng r;
    int i, big;
    double total, johnson, rising;
    memset(t, 0, sizeof *t);
    rng_seed(&r, seed, 0u, 21u);
    t->barrier = uni(&r, 1.0, 5.0);
    t->kappa2 = 10.246e9 * sqrt(t->barrier);
    t->ext = loguni(&r, 1e-9, 30e-9);
    t->hv_gain = gains[(int)uni(&r, 0.0, 4.0)];
    /* the owner's number has four digits and is the true one */
    {
        double a = t->ext / t->hv_gain, p = pow(10.0, floor(log10(a)) - 3.0);
        t->actuator = floor(a / p + 0.5) * p;
        t->ext = t->actuator * t->hv_gain;
    }
    t->amp_nominal = floor(loguni(&r, 2000.0, 8000.0) / 100.0) * 100.0;
    t->amp = t->amp_nominal * (1.0 + uni(&r, -0.04, 0.04));
    t->extra = uni(&r, 10e-6, 60e-6);
    t->set = loguni(&r, 0.05e-9, 2e-9);
    big = t->set < 0.6e-9 || (t->set < 1.2e-9 && uni(&r, 0.0, 1.0) < 0.5);
    t->ohm = big ? 1e9 : 3e8;
    if (!big && uni(&r, 0.0, 1.0) < 0.3)
        t->ohm = 1e8;
    t->pre_nominal = floor((big ? loguni(&r, 2000.0, 10000.0) : loguni(&r, 4000.0, 20000.0)) / 100.0) * 100.0;
    t->pre = t->pre_nominal * (1.0 + uni(&r, -0.04, 0.04));
    t->sat = 10.0 / t->ohm;
    t->ceiling = 0.9 * t->sat;
    t->floor_a = big ? 1e-12 : (t->ohm < 2e8 ? 1e-11 : 3e-12);
    t->offset = uni(&r, -1.0, 1.0) * fmin(0.02 * t->set, 5e-12);
    t->bias = loguni(&r, 0.02, 1.0);
    t->contact = t->bias * 7.748e-5 * uni(&r, 1.0, 4.0);
    t->gap_set = uni(&r, 0.5e-9, 1.0e-9);
    t->drift = uni(&r, 0.0, 1.0) < 0.1 ? 0.0 : loguni(&r, 1e-12, 100e-12) * (uni(&r, 0.0, 1.0) < 0.5 ? -1.0 : 1.0);
    t->hum = uni(&r, 0.0, 1.0) < 0.4 ? t->set * loguni(&r, 0.002, 0.02) : 0.0;
    t->hum_phase = uni(&r, 0.0, 2.0 * PI);
    if (uni(&r, 0.0, 1.0) < 0.5) {
        t->mode_f = loguni(&r, 4000.0, 9000.0);
        t->mode_q = loguni(&r, 5.0, 25.0);
        t->mode_share = loguni(&r, 0.03, 0.25);
    } else {
        t->mode_f = 10000.0;
        t->mode_q = 1.0;
    }
    t->vib_f = loguni(&r, 15.0, 300.0);
    t->vib_rms = loguni(&r, 0.2e-12, 2.5e-12);
    /* noise at the output of the preamplifier: bandwidth of one pole is pi/2 f */
    {
        double b = 0.5 * PI * t->pre, en = uni(&r, 4e-9, 9e-9), cin = uni(&r, 10e-12, 60e-12);
        johnson = 4.0 * 1.380649e-23 * 295.0 / t->ohm * b;
        total = 2.0 * PI * en * cin;
        rising = total * total * t->pre * t->pre * fmin(t->pre, 10000.0) / 3.0;
        t->white = sqrt(johnson + rising);
    }
    t->hiss_e = exp(-2.0 * PI * t->pre * TICK);
    t->lsb = 20.0 / 65536.0 / t->ohm;
    total = 1.0 + t->extra / TICK;
    t->lag = (int)floor(total);
    t->frac = total - t->lag;
    t->h[0] = t->frac * TICK;
    t->h[1] = (1.0 - t->frac) * TICK;
    for (i = 0; i < 2; i++) {
        t->sub[i] = (int)ceil(t->h[i] / 10.01e-6);
        if (!t->sub[i])
            continue;
        t->h[i] /= t->sub[i];
        t->amp_e[i] = exp(-t->h[i] * 2.0 * PI * t->amp);
        mode_matrix(&t->m[i], 2.0 * PI * t->mode_f, t->mode_q, t->h[i]);
        pole_coefficients(&t->pp[i], t->pre, t->h[i]);
    }
    /* building vibration that passes the suspension: a narrow band, Q about 5 */
    {
        double w = 2.0 * PI * t->vib_f * TICK, d = exp(-w / 10.0);
        t->vib_a = 2.0 * d * cos(w);
        t->vib_b = -d * d;
        t->vib_s = t->vib_rms * sqrt((1.0 - t->vib_b) == 0.0 ? 0.0 : (1.0 + t->vib_b)
                 * ((1.0 - t->vib_b) * (1.0 - t->vib_b) - t->vib_a * t->vib_a) / (1.0 - t->vib_b));
    }
}

static void tip_sense(Tip *t)
{
    double b = 0.5 * PI * t->pre, i = clampd(t->state, -t->sat, t->sat);
    double n = sqrt(t->white * t->white + 2.0 * 1.602177e-19 * fabs(i) * b), stray;
    t->hiss = t->hiss_e * t->hiss + sqrt(1.0 - t->hiss_e * t->hiss_e) * gauss(&t->noise);
    stray = t->offset + n * t->hiss; /* noise as coloured by the pole */
    if (t->hum > 0.0)
        stray += t->hum * sin(2.0 * PI * 50.0 * TICK * (double)(t->ticks % 400u) + t->hum_phase);
    if (t->fault == 3)
        i = 0.0;
    else if (t->fault == 4)
        i = -i;
    else if (t->fault == 5)
        i = 2.0 * t->sat;
    t->reading = clampd(floor((i + stray) / t->lsb + 0.5), -32768.0, 32767.0) * t->lsb;
    if (t->fault != 2)
        t->shown = t->fault == 1 ? NAN : t->reading;
}

void *tip_open(uint32_t seed, uint32_t noise_seed, double gap_m)
{
    Tip *t = malloc(sizeof *t);
    if (!t)
        return NULL;
    tip_draw(t, seed);
    rng_seed(&t->noise, seed, noise_seed, 22u);
    t->retracted = gap_m;
    t->gap = t->gap_set + gap_m;
    t->last_i = t->state = current_at(t, t->gap);
    tip_sense(t);
    return t;
}

void tip_close(void *tip)
{
    free(tip);
}

void tip_move_surface(void *tip, double height_m)
{
    Tip *t = tip;
    t->retracted -= height_m;
    t->gap -= height_m;
}

void tip_fault(void *tip, int kind)
{
    Tip *t = tip;
    t->fault = kind;
    if (kind == 2 && !isfinite(t->shown))
        t->shown = t->reading; /* the last reading is a number, even behind a fault that showed none */
}

void tip_step(void *tip, double volts, double *current_A, double *gap_m)
{
    Tip *t = tip;
    double shake;
    int part, i;
    shake = t->vib_a * t->vib[0] + t->vib_b * t->vib[1] + t->vib_s * gauss(&t->noise);
    t->vib[1] = t->vib[0];
    t->vib[0] = shake;
    t->retracted += t->drift * TICK;
    for (part = 0; part < 2; part++) {
        double target = t->buf[t->lag - part]; /* buf[0]: the last call */
        for (i = 0; i < t->sub[part]; i++) {
            double before = t->dac, now;
            t->dac += (target - t->dac) * (1.0 - t->amp_e[part]);
            mode_advance(&t->m[part], t->z, before, t->dac);
            t->gap = t->gap_set + t->retracted - extension(t) + shake;
            now = current_at(t, t->gap);
            t->state = pole_advance(&t->pp[part], t->state, t->last_i, now);
            t->last_i = now;
        }
    }
    /* the operational amplifier sits at its rail and does not integrate further */
    t->state = clampd(t->state, -1.05 * t->sat, 1.05 * t->sat);
    t->buf[3] = t->buf[2];
    t->buf[2] = t->buf[1];
    t->buf[1] = t->buf[0];
    if (isfinite(volts))
        t->buf[0] = dac20(volts);
    t->ticks++;
    tip_sense(t);
    if (current_A)
        *current_A = t->shown;
    if (gap_m)
        *gap_m = t->gap;
}

/* The laboratory's controller: PI on the logarithm of the current. In tick k it reads the current,
 * adds dither[k] to the logarithm of the set point and writes drive_out[k]. Returns the integrator. */
double tip_loop(void *tip, double drive, double ki, double kp, const double *dither, long n,
                double *drive_out, double *current_out)
{
    Tip *t = tip;
    long k;
    for (k = 0; k < n; k++) {
        double i = t->shown, e = log(t->set / fmax(i, t->floor_a)) + (dither ? dither[k] : 0.0), out;
        e = clampd(e, -2.0, 2.0);
        drive = clampd(drive + ki * e, -10.0, 9.99);
        out = dac20(drive + kp * e);
        if (current_out)
            current_out[k] = i;
        if (drive_out)
            drive_out[k] = out;
        tip_step(tip, out, NULL, NULL);
    }
    return drive;
}

/* Feedback off: withdraw by zrel point by point and come back, average after settling. */
void tip_sweep(void *tip, double drive, const double *zrel, long points, long dwell, long settle,
               double *forward, double *backward)
{
    Tip *t = tip;
    long j, k;
    for (j = 0; j < 2 * points; j++) {
        long at = j < points ? j : 2 * points - 1 - j;
        double sum = 0.0, i;
        for (k = 0; k < dwell; k++) {
            tip_step(tip, drive - zrel[at] / t->ext, &i, NULL);
            if (k >= settle)
                sum += i;
        }
        (j < points ? forward : backward)[at] = sum / (double)(dwell - settle);
    }
}

double tip_truth(uint32_t seed, int which)
{
    Tip t;
    double v[24];
    tip_draw(&t, seed);
    v[0] = t.barrier;
    v[1] = t.kappa2;
    v[2] = t.ext;
    v[3] = TICK + t.extra;
    v[4] = t.drift;
    v[5] = t.amp;
    v[6] = t.pre;
    v[7] = t.set;
    v[8] = t.ohm;
    v[9] = t.offset;
    v[10] = sqrt(t.white * t.white + 2.0 * 1.602177e-19 * t.set * 0.5 * PI * t.pre);
    v[11] = t.gap_set;
    v[12] = t.mode_share > 0.0 ? t.mode_f : 0.0;
    v[13] = t.mode_share > 0.0 ? t.mode_q : 0.0;
    v[14] = t.mode_share;
    v[15] = t.hum;
    v[16] = t.vib_rms;
    v[17] = t.bias;
    v[18] = t.hv_gain;
    v[19] = t.actuator;
    v[20] = t.floor_a;
    v[21] = t.ceiling;
    v[22] = t.amp_nominal;
    v[23] = t.pre_nominal;
    return which >= 0 && which < 24 ? v[which] : NAN;
}
