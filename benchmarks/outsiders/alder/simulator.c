/*
 * Test-bench simulator of flexure-guided piezo stages (one axis, displacement sensor) and of
 * tunnelling tips.  Everything is drawn from an integer seed; the noise from a second one.
 *
 * STAGE, signal path of one 50 us tick
 *   DAC (16 bits over +-10 V, held) -> dead time of one tick plus a fraction -> high-voltage amplifier
 *   (one pole, output limits, in some seeds a slew limit) -> hysteresis law -> creep -> one or two
 *   modes -> [platform] -> sensor (small nonlinearity, one pole) -> noise -> ADC (16 bits, +-10 V).
 * The linear parts are integrated exactly over four substeps of a tick (zero-order hold for the
 * amplifier, first-order hold behind it); the laws are independent of rate and are fed with the
 * amplifier's output at each substep, large jumps being cut into small pieces.
 *
 * LAWS (law = 7 * seed mod 10, so ten consecutive seeds bring all of them)
 *   0 Coleman-Hodgdon      B. D. Coleman, M. L. Hodgdon, Int. J. Engng Sci. 24 (1986) 897;
 *                          Arch. Rational Mech. Anal. 99 (1987) 375 (a Duhem model)
 *   1 Jiles-Atherton       D. C. Jiles, D. L. Atherton, J. Magn. Magn. Mater. 61 (1986) 48; as the
 *     / domain walls       domain-wall model R. C. Smith, C. L. Hom, J. Intell. Mater. Syst. Struct. 10
 *                          (1999) 195; three classes of pinning, strain with a quadratic term
 *                          (electrostriction)
 *   2 Krasnosel'skii-      M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989);
 *     Pokrovskii           W. S. Galinaitis, R. C. Rogers, Proc. SPIE 3323 (1998) 588
 *   3 Preisach, bimodal    F. Preisach, Z. Phys. 94 (1935) 277; Everett function and stack of extrema:
 *   4 Preisach, Lorentzian I. D. Mayergoyz, Mathematical Models of Hysteresis (1991); Lorentzian
 *                          density: G. Bertotti, Hysteresis in Magnetism (1998), chapter 13
 *   5 generalised Bouc-Wen J. Song, A. Der Kiureghian, J. Eng. Mech. 132 (2006) 610; asymmetric for
 *                          piezos: W. Zhu, D.-H. Wang, Sens. Actuators A 181 (2012) 51; the form
 *                          x = d u - h: T. S. Low, W. Guo, J. MEMS 4 (1995) 230
 *   6 Takacs T(x)          J. Takacs, COMPEL 20 (2001) 1002; branches transplanted between the
 *                          remembered reversal points by Madelung's rules (E. Madelung, Ann. Phys.
 *                          322 (1905) 861)
 *   7 Iwan, power law      W. D. Iwan, J. Appl. Mech. 33 (1966) 893; D. J. Segalman, J. Appl. Mech. 72
 *                          (2005) 752; bent curve in front, friction that grows along the stroke
 *   8 homogenised energy   R. C. Smith, S. Seelecke, Z. Ounaies, J. Smith, J. Intell. Mater. Syst.
 *                          Struct. 14 (2003) 719 (negligible relaxation: log-normal coercive and
 *                          normal interaction fields; strain with a quadratic term)
 *   9 Dahl walls           P. R. Dahl, AIAA J. 14 (1976) 1675, three walls of different exponents
 * Laws 0, 1, 5 and 9 forget along the path |dx|: small cycles drift without limit towards the anhysteretic
 * curve, which ceramics do not do (A. E. Charalampakis, V. K. Koumousis, Int. J. Solids Struct. 46 (2009) 1,
 * for Bouc-Wen).  The usual remedy is taken: a branch inside a remembered loop is stretched so that it
 * meets the reversal point it heads for (K. H. Carpenter, IEEE Trans. Magn. 27 (1991) 4404; D. C. Jiles,
 * IEEE Trans. Magn. 28 (1992) 2602).  The irreversible path is that of a play of radius 0.2 to 0.5 per cent of
 * the range, inside which motion is reversible (bending of pinned walls).
 *
 * Creep: sum of relaxations of evenly spaced logarithmic time constants, i.e. log(t)
 *   (H. Jung, D.-G. Gweon, Rev. Sci. Instrum. 71 (2000) 1896; D. Croft, G. Shed, S. Devasia, J. Dyn.
 *   Syst. Meas. Control 123 (2001) 35), weights slightly tilted in some seeds.
 *
 * TIP: I = I_set exp(-2 kappa (g - g_set)), kappa = sqrt(2 m phi) / hbar (J. G. Simmons, J. Appl. Phys. 34
 *   (1963) 1793; G. Binnig, H. Rohrer, Helv. Phys. Acta 55 (1982) 726).  Noise of the preamplifier:
 *   shot 2 e I and thermal 4 k T / R with an excess factor.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define TICK 5e-5
#define PI 3.14159265358979323846

/* ------------------------------------------------------------------ random numbers */

typedef struct { uint64_t s; int have; double kept; } rng_t;

static uint64_t mix64(uint64_t z)              /* splitmix64, G. Steele et al., OOPSLA 2014 */
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
}

static void rng_start(rng_t *r, uint32_t seed, uint32_t stream, uint32_t sub)
{
    uint64_t a = mix64(0x9e3779b97f4a7c15ULL * ((uint64_t)seed + 1));
    a = mix64(a ^ (0xd1b54a32d192ed03ULL * ((uint64_t)stream + 1)));
    a = mix64(a ^ (0x8cb92ba72f3d8dd7ULL * ((uint64_t)sub + 1)));
    r->s = a;
    r->have = 0;
    r->kept = 0.0;
}

static double uni(rng_t *r)                    /* (0, 1) */
{
    r->s += 0x9e3779b97f4a7c15ULL;
    return ((double)(mix64(r->s) >> 11) + 0.5) * (1.0 / 9007199254740992.0);
}

static double between(rng_t *r, double a, double b) { return a + (b - a) * uni(r); }
static double logbetween(rng_t *r, double a, double b) { return a * pow(b / a, uni(r)); }

static double gauss(rng_t *r)
{
    double u, v, q, f;
    if (r->have) {
        r->have = 0;
        return r->kept;
    }
    do {                                       /* Marsaglia's polar method */
        u = 2.0 * uni(r) - 1.0;
        v = 2.0 * uni(r) - 1.0;
        q = u * u + v * v;
    } while (q >= 1.0 || q == 0.0);
    f = sqrt(-2.0 * log(q) / q);
    r->kept = v * f;
    r->have = 1;
    return u * f;
}

static double clampd(double v, double lo, double hi) { return v < lo ? lo : (v > hi ? hi : v); }
static double sgn(double v) { return v > 0.0 ? 1.0 : (v < 0.0 ? -1.0 : 0.0); }

static double two_digits(double v)             /* as on a data sheet */
{
    double e = pow(10.0, floor(log10(v)) - 1.0);
    return floor(v / e + 0.5) * e;
}

/* ------------------------------------------------------------------ hysteresis laws */

enum { LAW_CH, LAW_JA, LAW_KP, LAW_PB, LAW_PL, LAW_BW, LAW_TAKACS, LAW_IWAN, LAW_HEM, LAW_DAHL, LAWS };

#define XS 1.6                                 /* negative and positive saturation, beyond all drives */
#define KPC 22
#define KPD 14
#define KPM (KPC * KPD)                        /* centres times half-widths, a multiple of 4 */
#define NS 97
#define ND 65
#define NC 1025
#define IW 24
#define DEPTH 240

typedef struct {
    double x[DEPTH], y[DEPTH];
    int n, dir;
} memory_t;

/* reversal points of the laws that are differential equations: up to three states; with each point the
 * unstretched state of the branch that ended there and what that state would be at the branch's goal */
typedef struct {
    double x[DEPTH], y[DEPTH][3], raw[DEPTH][3], goal[DEPTH][3];
    double raw_now[3], goal_now[3];
    int n, dir;
} path_t;

typedef struct {
    int kind;
    double m;                                  /* strength of the hysteretic part, calibrated */
    double b1, b2, b3;                         /* bent curve b(x) = b1 x + b2 x^2 + b3 x^3 */
    double asym;
    double r;                                  /* radius of the reversible play */
    double alpha;                              /* Coleman-Hodgdon */
    double ja_a, ja_k[3], ja_w[3], ja_l, ja_x0, ja_e;      /* Jiles-Atherton; ja_e also quadratic strain of law 8 */
    int ja_langevin;
    double kp_ramp, kp_s1[KPM], kp_s2[KPM], kp_w[KPM];
    double *f;                                 /* Everett / D^2, NS x ND */
    double pr_norm;
    double bw_n, bw_beta, bw_gamma, bw_up, bw_side, bw_norm;
    double tk_up, tk_down;
    double iw_break[IW], iw_k[IW];
    double da_l[3], da_n[3], da_w[3];
    double scale, offset;                      /* output = (raw - offset) * scale */
    double opening, minslope;                  /* found by calibration */
    /* state */
    double x, v, raw;
    double p;                                  /* Preisach, Takacs */
    double q[3];                               /* Coleman-Hodgdon P, Jiles-Atherton Pirr, Bouc-Wen h, Dahl */
    double z[KPM];                             /* Krasnosel'skii-Pokrovskii, Iwan */
    memory_t mem;                              /* Preisach, Takacs */
    path_t path;                               /* laws 0, 1, 5, 9 */
} law_t;

static double bend(const law_t *l, double x) { return x * (l->b1 + x * (l->b2 + x * l->b3)); }
static double bend_slope(const law_t *l, double x) { return l->b1 + x * (2.0 * l->b2 + 3.0 * x * l->b3); }

/* --- stack of extrema (wiping out, return-point memory) */

static void mem_reset(memory_t *m, double x, double y)
{
    m->n = 1;
    m->dir = 1;
    m->x[0] = x;
    m->y[0] = y;
}

/* remember a reversal at (x, y) if there was one, forget what the motion to xnew wipes out */
static void mem_move(memory_t *m, double x, double y, double xnew)
{
    int dir = xnew > x ? 1 : -1;
    if (dir != m->dir) {
        if (m->n >= DEPTH - 1)
            m->n -= 2;                         /* innermost pair: the smallest loop */
        m->x[m->n] = x;
        m->y[m->n] = y;
        m->n++;
        m->dir = dir;
    }
    if (dir > 0)
        while (m->n >= 3 && xnew >= m->x[m->n - 2])
            m->n -= 2;
    else
        while (m->n >= 4 && xnew <= m->x[m->n - 2])
            m->n -= 2;
}

/* --- Preisach: E(a, b), the integral of the density over b <= beta <= alpha <= a, kept as
 *     F(s, D) = E / D^2 with s = (a + b) / 2, D = (a - b) / 2: smooth down to the diagonal (Rayleigh) */

static double everett(const law_t *l, double a, double b)
{
    double s = 0.5 * (a + b), d = 0.5 * (a - b);
    double u = (s + XS) * ((NS - 1) / (2.0 * XS)), w = d * ((ND - 1) / XS);
    int i = (int)u, j = (int)w;
    const double *g;
    if (i < 0) i = 0;
    if (i > NS - 2) i = NS - 2;
    if (j < 0) j = 0;
    if (j > ND - 2) j = ND - 2;
    u -= i;
    w -= j;
    g = l->f + (size_t)i * ND + j;
    return d * d * ((1.0 - u) * ((1.0 - w) * g[0] + w * g[1]) + u * ((1.0 - w) * g[ND] + w * g[ND + 1]));
}

typedef struct { int shape; double amp, d0, dw, s0, sw; } bump_t;

static double bump_d(const bump_t *b, double d)
{
    double t;
    switch (b->shape) {
    case 0:                                    /* Gaussian */
        t = (d - b->d0) / b->dw;
        return b->amp * exp(-0.5 * t * t);
    case 1:                                    /* Lorentzian */
        t = (d - b->d0) / b->dw;
        return b->amp / (1.0 + t * t);
    default:                                   /* log-normal; finite and small at d = 0 */
        t = log((d + 1e-3) / b->d0) / b->dw;
        return b->amp * exp(-0.5 * t * t) * b->d0 / (d + 0.15 * b->d0);
    }
}

static double bump_s(const bump_t *b, double s)   /* integral of the density of s from -infinity */
{
    double t = (s - b->s0) / b->sw;
    if (b->shape == 1)
        return b->sw * (atan(t) + 0.5 * PI);
    return b->sw * sqrt(0.5 * PI) * (1.0 + erf(t / sqrt(2.0)));
}

static int preisach_table(law_t *l, const bump_t *bumps, int count)
{
    double *cum = malloc(sizeof(double) * NC);
    const double smax = 2.0 * XS + 0.1, ds = 2.0 * smax / (NC - 1);
    int c, i, j, k;
    l->f = calloc((size_t)NS * ND, sizeof(double));
    if (!cum || !l->f) {
        free(cum);
        return 0;
    }
    for (c = 0; c < count; c++) {
        double dens[3 * ND];
        for (i = 0; i < NC; i++)
            cum[i] = bump_s(&bumps[c], -smax + ds * i);
        for (j = 0; j < ND; j++) {
            double big = j ? XS * j / (ND - 1) : 1e-3;
            int pts = j < 4 ? 8 : 2 * j;       /* midpoint rule */
            if (pts > 3 * ND) pts = 3 * ND;
            double h = big / pts;
            for (k = 0; k < pts; k++)
                dens[k] = bump_d(&bumps[c], h * (k + 0.5));
            for (i = 0; i < NS; i++) {
                double s = -XS + 2.0 * XS * i / (NS - 1), sum = 0.0;
                for (k = 0; k < pts; k++) {
                    double half = big - h * (k + 0.5);
                    double u = (s + half + smax) / ds, w = (s - half + smax) / ds;
                    int iu = (int)u, iw = (int)w;
                    double hi = cum[iu] + (u - iu) * (cum[iu + 1] - cum[iu]);
                    double lo = cum[iw] + (w - iw) * (cum[iw + 1] - cum[iw]);
                    sum += dens[k] * (hi - lo);
                }
                l->f[(size_t)i * ND + j] += 2.0 * h * sum / (big * big);
            }
        }
    }
    free(cum);
    return 1;
}

/* --- Takacs: T(x) = tanh((x - xr) / L -+ a0) from the reversal point, scaled to meet the remembered one */

static double takacs_branch(const law_t *l, double x0, double y0, double x1, double y1, double x)
{
    double len = (x1 > x0 ? l->tk_up : l->tk_down) / l->m;      /* steepest at this many x behind the reversal */
    double t0 = tanh(-l->m), t1 = tanh(fabs(x1 - x0) / len - l->m), t = tanh(fabs(x - x0) / len - l->m);
    double den = t1 - t0;
    if (den < 1e-12)
        return y0 + (y1 - y0) * clampd(fabs(x - x0) / (fabs(x1 - x0) + 1e-15), 0.0, 1.0);
    return y0 + (y1 - y0) * (t - t0) / den;
}

/* --- Jiles-Atherton anhysteretic curve */

static double ja_an(const law_t *l, double x, double pirr)
{
    double e = (x + l->ja_x0 + l->ja_l * pirr) / l->ja_a;
    if (!l->ja_langevin)
        return l->ja_a * tanh(e);              /* Ising */
    e *= 3.0;                                  /* Langevin; same slope at zero */
    if (fabs(e) < 1e-2)
        return l->ja_a * e / 3.0 * (1.0 - e * e / 15.0);
    return l->ja_a * (1.0 / tanh(e) - 1.0 / e);
}

static double ja_rate(const law_t *l, double x, double pirr, double dir, double k)
{
    double gap = ja_an(l, x, pirr) - pirr, den;
    if (gap * dir <= 0.0)
        return 0.0;
    den = k - l->ja_l * gap * dir;
    if (den < 0.3 * k)
        den = 0.3 * k;
    return gap * dir / den;                    /* dPirr / dx, >= 0 */
}

static double ch_g(const law_t *l, double x) { return bend_slope(l, x) * (1.0 - l->m * (1.0 + l->asym * x)); }

static double bw_rate(const law_t *l, double x, double h, double dir)
{
    double shape = l->bw_gamma + l->bw_beta * sgn(dir * h) + l->bw_up * dir + l->bw_side * tanh(4.0 * x);
    return 1.0 - pow(fabs(h), l->bw_n) * shape;
}

static double dahl_rate(double f, double dir, double len, double n)
{
    double t = 1.0 - f * dir;
    return t <= 0.0 ? 0.0 : pow(t, n) / len;
}

static int path_states(const law_t *l) { return l->kind == LAW_DAHL || l->kind == LAW_JA ? 3 : 1; }

static void path_ode(const law_t *l, double *p, double from, double to)   /* midpoint rule, small pieces */
{
    int pieces = (int)(fabs(to - from) * 50.0) + 1, i, k, states = path_states(l);
    double dv = (to - from) / pieces, dir = sgn(dv), half;
    if (dir == 0.0)
        return;
    for (i = 0; i < pieces; i++) {
        double x = from + dv * i, xm = x + 0.5 * dv;
        switch (l->kind) {
        case LAW_CH:
            half = p[0] + 0.5 * (l->alpha * fabs(dv) * (bend(l, x) - p[0]) + ch_g(l, x) * dv);
            p[0] += l->alpha * fabs(dv) * (bend(l, xm) - half) + ch_g(l, xm) * dv;
            break;
        case LAW_JA:
            for (k = 0; k < states; k++) {
                half = p[k] + 0.5 * dv * ja_rate(l, x, p[k], dir, l->ja_k[k]);
                p[k] += dv * ja_rate(l, xm, half, dir, l->ja_k[k]);
            }
            break;
        case LAW_BW:
            half = p[0] + 0.5 * dv * bw_rate(l, x, p[0], dir);
            p[0] += dv * bw_rate(l, xm, half, dir);
            break;
        default:
            for (k = 0; k < states; k++) {
                half = p[k] + 0.5 * dv * dahl_rate(p[k], dir, l->da_l[k], l->da_n[k]);
                p[k] = clampd(p[k] + dv * dahl_rate(half, dir, l->da_l[k], l->da_n[k]), -1.0, 1.0);
            }
        }
    }
}

static void path_move(law_t *l, double v1)
{
    path_t *m = &l->path;
    const size_t size = sizeof m->raw_now;
    int dir = v1 > l->v ? 1 : -1, k, states = path_states(l);
    if (v1 == l->v)
        return;
    if (dir != m->dir) {
        if (m->n >= DEPTH - 2) {               /* forget the innermost pair: the smallest loop */
            m->n -= 2;
            memcpy(m->raw_now, m->raw[m->n], size);
            memcpy(m->goal_now, m->goal[m->n], size);
        }
        m->x[m->n] = l->v;
        memcpy(m->y[m->n], l->q, size);
        memcpy(m->raw[m->n], m->raw_now, size);
        memcpy(m->goal[m->n], m->goal_now, size);
        m->n++;
        m->dir = dir;
        memcpy(m->raw_now, l->q, size);
        memcpy(m->goal_now, l->q, size);
        path_ode(l, m->goal_now, l->v, m->x[m->n - 2]);
    }
    while (m->n >= 3 && (v1 - m->x[m->n - 2]) * dir >= 0.0) {
        m->n -= 2;                             /* closed: on along the branch that ended at this point */
        l->v = m->x[m->n];
        memcpy(m->raw_now, m->raw[m->n], size);
        memcpy(m->goal_now, m->goal[m->n], size);
    }
    path_ode(l, m->raw_now, l->v, v1);
    l->v = v1;
    if (m->n < 2) {
        memcpy(l->q, m->raw_now, size);
        return;
    }
    for (k = 0; k < states; k++) {
        const double lin = 0.02;               /* a little of a straight line where the law stands still */
        double y0 = m->y[m->n - 1][k], y1 = m->y[m->n - 2][k], x0 = m->x[m->n - 1], x1 = m->x[m->n - 2];
        double whole = (m->goal_now[k] - y0) * dir + lin * fabs(x1 - x0);
        double done = (m->raw_now[k] - y0) * dir + lin * fabs(v1 - x0);
        l->q[k] = y0 + (y1 - y0) * (whole > 1e-12 ? done / whole : fabs((v1 - x0) / (x1 - x0)));
    }
}

static double law_raw(law_t *l, double xin)
{
    double x = clampd(xin, -XS + 0.02, XS - 0.02), y = 0.0, p;
    double a0 = 0.0, a1 = 0.0, a2 = 0.0, a3 = 0.0;
    int i;
    if (x == l->x)
        return l->raw;
    switch (l->kind) {
    case LAW_CH: case LAW_JA: case LAW_BW: case LAW_DAHL: {
        double e;
        path_move(l, clampd(l->v, x - l->r, x + l->r));
        e = x - l->v;                          /* reversible, inside the play */
        if (l->kind == LAW_CH)
            y = l->q[0] + ch_g(l, x) * e;
        else if (l->kind == LAW_JA) {
            p = l->ja_w[0] * l->q[0] + l->ja_w[1] * l->q[1] + l->ja_w[2] * l->q[2];
            p = (1.0 - l->m) * ja_an(l, x, p) + l->m * p;                      /* m = 1 - c */
            y = p + l->ja_e * p * p;
        } else if (l->kind == LAW_BW)
            y = bend(l, x) - l->m * l->bw_norm * (l->q[0] + e);
        else {
            y = bend(l, x);
            for (i = 0; i < 3; i++)
                y -= l->m * l->da_w[i] * (l->q[i] + e / l->da_l[i]);
        }
        break;
    }
    case LAW_KP: {
        const double slope = 2.0 / l->kp_ramp;
        double *z = l->z;
        const double *w = l->kp_w;
        if (x > l->x)
            for (i = 0; i < KPM; i++) {
                double t = (x - l->kp_s2[i]) * slope - 1.0;
                t = t > 1.0 ? 1.0 : t;
                z[i] = z[i] > t ? z[i] : t;
            }
        else
            for (i = 0; i < KPM; i++) {
                double t = (x - l->kp_s1[i]) * slope - 1.0;
                t = t < -1.0 ? -1.0 : t;
                z[i] = z[i] < t ? z[i] : t;
            }
        for (i = 0; i < KPM; i += 4) {
            a0 += w[i] * z[i];
            a1 += w[i + 1] * z[i + 1];
            a2 += w[i + 2] * z[i + 2];
            a3 += w[i + 3] * z[i + 3];
        }
        y = (1.0 - l->m) * bend(l, x) + l->m * (a0 + a1 + a2 + a3);
        break;
    }
    case LAW_PB: case LAW_PL: case LAW_HEM: {
        memory_t *m = &l->mem;
        double last;
        mem_move(m, l->x, l->p, x);
        last = m->x[m->n - 1];
        l->p = m->dir > 0 ? m->y[m->n - 1] + everett(l, x, last) : m->y[m->n - 1] - everett(l, last, x);
        p = (1.0 - l->m) * bend(l, x) + l->m * l->p * l->pr_norm;
        y = p + (l->kind == LAW_HEM ? l->ja_e * p * p : 0.0);
        break;
    }
    case LAW_TAKACS: {
        memory_t *m = &l->mem;
        mem_move(m, l->x, l->p, x);
        if (m->n == 1)
            l->p = takacs_branch(l, m->x[0], m->y[0], XS, XS, x);
        else
            l->p = takacs_branch(l, m->x[m->n - 1], m->y[m->n - 1], m->x[m->n - 2], m->y[m->n - 2], x);
        y = bend(l, l->p);
        break;
    }
    default: {                                 /* Iwan */
        double bx = bend(l, x), dx = bx - bend(l, l->x);
        for (i = 0; i < IW; i++) {
            double t = l->z[i] + dx, b = l->iw_break[i];
            t = t > b ? b : t;
            l->z[i] = t < -b ? -b : t;
        }
        for (i = 0; i < IW; i += 4) {
            a0 += l->iw_k[i] * l->z[i];
            a1 += l->iw_k[i + 1] * l->z[i + 1];
            a2 += l->iw_k[i + 2] * l->z[i + 2];
            a3 += l->iw_k[i + 3] * l->z[i + 3];
        }
        y = bx - l->m * (1.0 + l->asym * x) * (a0 + a1 + a2 + a3);
    }
    }
    l->x = x;
    l->raw = y;
    return y;
}

static double law_output(law_t *l, double x) { return (law_raw(l, x) - l->offset) * l->scale; }

static void law_reset(law_t *l)
{
    int i;
    l->x = l->v = 0.0;
    l->p = 0.0;
    l->raw = 0.0;
    for (i = 0; i < 3; i++)
        l->q[i] = 0.0;
    for (i = 0; i < KPM; i++)
        l->z[i] = 0.0;
    if (l->kind == LAW_CH || l->kind == LAW_JA || l->kind == LAW_BW || l->kind == LAW_DAHL) {
        path_t *m = &l->path;                  /* at negative saturation */
        double p[3] = {0.0, 0.0, 0.0};
        path_ode(l, p, 0.0, XS);
        path_ode(l, p, XS, -XS);
        path_ode(l, p, -XS, XS);
        path_ode(l, p, XS, -XS);
        m->n = 1;
        m->dir = 1;
        m->x[0] = -XS;
        memcpy(m->y[0], p, sizeof p);
        memcpy(m->raw[0], p, sizeof p);
        memcpy(m->goal[0], p, sizeof p);
        memcpy(m->raw_now, p, sizeof p);
        memcpy(m->goal_now, p, sizeof p);
        memcpy(l->q, p, sizeof p);
        l->x = l->v = -XS;
    }
    if (l->kind == LAW_KP)
        for (i = 0; i < KPM; i++)
            l->z[i] = clampd(-(l->kp_s1[i] + l->kp_s2[i]) / l->kp_ramp - 1.0, -1.0, 1.0);
    if (l->kind == LAW_PB || l->kind == LAW_PL || l->kind == LAW_HEM) {
        double e = everett(l, XS, -XS);
        l->pr_norm = 2.0 * XS / e;
        mem_reset(&l->mem, -XS, -0.5 * e);
        l->x = -XS;
        l->p = -0.5 * e;
    }
    if (l->kind == LAW_TAKACS) {
        mem_reset(&l->mem, -XS, -XS);
        l->x = -XS;
        l->p = -XS;
    }
}

static void law_go(law_t *l, double to, int steps)
{
    double from = l->x;
    int i;
    for (i = 1; i <= steps; i++)
        law_raw(l, from + (to - from) * i / steps);
}

#define CAL 160

/* settled loop between xm - a and xm + a: opening over its own span; smallest slope over the mean one */
static double law_loop(law_t *l, double xm, double a, double *span, double *mid, double *minslope)
{
    double up[CAL + 1], dn[CAL + 1], open = 0.0, least = 1e9, s;
    int i;
    law_reset(l);
    law_go(l, 1.0, 60);
    law_go(l, -1.0, 60);
    law_go(l, xm + a, 60);
    law_go(l, xm - a, 60);
    law_go(l, xm + a, 60);
    law_go(l, xm - a, 60);
    up[0] = l->raw;
    for (i = 1; i <= CAL; i++)
        up[i] = law_raw(l, xm - a + 2.0 * a * i / CAL);
    dn[CAL] = up[CAL];
    for (i = CAL - 1; i >= 0; i--)
        dn[i] = law_raw(l, xm - a + 2.0 * a * i / CAL);
    s = up[CAL] - up[0];
    for (i = 0; i <= CAL; i++) {
        if (dn[i] - up[i] > open)
            open = dn[i] - up[i];
        if (i) {
            least = fmin(least, (up[i] - up[i - 1]) * CAL / s);
            least = fmin(least, (dn[i] - dn[i - 1]) * CAL / s);
        }
    }
    if (span) *span = s;
    if (mid) *mid = 0.5 * (up[CAL] + up[0]);
    if (minslope) *minslope = least;
    return open / s;
}

static int law_attempt(law_t *l, uint32_t seed, uint32_t attempt)
{
    rng_t r;
    double target, lo_m = 0.0, hi_m = 1.0, span, mid, least = 1.0;
    int i, j, k, tries;
    rng_start(&r, seed, 2, attempt);
    memset(l, 0, sizeof *l);
    l->kind = (int)((seed % LAWS) * 7 % LAWS);
    l->scale = 1.0;
    target = between(&r, 0.078, 0.14);
    l->b1 = 1.0;
    l->b2 = between(&r, -0.06, 0.09);
    l->b3 = between(&r, -0.05, 0.03);
    l->asym = between(&r, -0.22, 0.22);
    l->r = between(&r, 0.004, 0.010);
    switch (l->kind) {
    case LAW_CH:
        l->alpha = between(&r, 1.3, 2.5);
        lo_m = 0.02;
        hi_m = 0.5;
        break;
    case LAW_JA:
        l->ja_a = between(&r, 1.5, 2.6);
        l->ja_k[0] = between(&r, 0.06, 0.14);                  /* weak, middling and strong pinning */
        l->ja_k[1] = between(&r, 0.25, 0.5);
        l->ja_k[2] = between(&r, 0.8, 1.4);
        for (i = 0; i < 3; i++)
            l->ja_w[i] = between(&r, 0.5, 1.5);
        for (i = 0, span = l->ja_w[0] + l->ja_w[1] + l->ja_w[2]; i < 3; i++)
            l->ja_w[i] /= span;
        l->ja_l = between(&r, 0.0, 0.12);
        l->ja_x0 = between(&r, -0.35, 0.25);
        l->ja_e = between(&r, -0.06, 0.10);
        l->ja_langevin = uni(&r) < 0.5;
        lo_m = 0.02;
        hi_m = 0.85;
        break;
    case LAW_KP: {
        double reach = between(&r, 0.25, 0.6), tilt = between(&r, -0.25, 0.25), bump = between(&r, 0.0, 1.2);
        double at = between(&r, 0.2, 0.45), lean = between(&r, -0.35, 0.35), total = 0.0, ratio = pow(1.3 / 0.02, 1.0 / (KPD - 1));
        const double step = 3.3 / (KPC - 1);
        l->kp_ramp = step * (2.0 + floor(between(&r, 0.0, 3.0)));  /* whole steps: the ramps add up smoothly */
        k = 0;
        for (i = 0; i < KPC; i++)
            for (j = 0; j < KPD; j++) {
                double d = 0.02 * pow(ratio, j), c = -1.65 + step * i, t = (d - at) / 0.12;
                l->kp_s1[k] = c - d - 0.5 * l->kp_ramp;
                l->kp_s2[k] = c + d - 0.5 * l->kp_ramp;
                l->kp_w[k] = d * (exp(-d / (reach * (1.0 + lean * c))) + bump * exp(-0.5 * t * t)) * (1.0 + tilt * c);
                total += l->kp_w[k++];
            }
        for (i = 0; i < k; i++)
            l->kp_w[i] *= 1.6 / total;
        break;
    }
    case LAW_PB: {
        bump_t b[3];
        b[0] = (bump_t){0, 1.0, between(&r, 0.10, 0.22), between(&r, 0.09, 0.14), between(&r, -0.6, -0.1), between(&r, 0.35, 0.7)};
        b[1] = (bump_t){0, between(&r, 0.4, 1.2), between(&r, 0.35, 0.65), between(&r, 0.10, 0.2), between(&r, 0.1, 0.6), between(&r, 0.3, 0.6)};
        b[2] = (bump_t){0, between(&r, 0.2, 0.5), 0.0, between(&r, 0.4, 0.7), between(&r, -0.2, 0.2), between(&r, 0.9, 1.6)};
        if (!preisach_table(l, b, 3)) return 0;
        break;
    }
    case LAW_PL: {
        bump_t b[2];
        b[0] = (bump_t){1, 1.0, between(&r, 0.08, 0.40), between(&r, 0.12, 0.35), between(&r, -0.3, 0.3), between(&r, 0.35, 1.0)};
        b[1] = (bump_t){1, between(&r, 0.05, 0.25), 0.0, between(&r, 0.5, 1.0), 0.0, between(&r, 0.8, 1.5)};
        if (!preisach_table(l, b, 2)) return 0;
        break;
    }
    case LAW_HEM: {
        bump_t b[1];
        b[0] = (bump_t){2, 1.0, between(&r, 0.10, 0.28), between(&r, 0.7, 1.1), between(&r, -0.25, 0.25), between(&r, 0.45, 0.9)};
        if (!preisach_table(l, b, 1)) return 0;
        l->ja_e = between(&r, -0.06, 0.09);
        break;
    }
    case LAW_BW: {
        double sat = between(&r, 0.30, 0.65), share = between(&r, 0.45, 0.75), b;
        l->bw_n = between(&r, 1.0, 1.8);
        b = pow(sat, -l->bw_n);
        l->bw_beta = share * b;
        l->bw_gamma = (1.0 - share) * b;
        l->bw_up = between(&r, -0.12, 0.12) * b;
        l->bw_side = between(&r, -0.15, 0.15) * b;
        l->bw_norm = 0.5;
        break;
    }
    case LAW_TAKACS:
        l->tk_up = between(&r, 1.5, 2.3);
        l->tk_down = l->tk_up * between(&r, 0.85, 1.18);
        lo_m = 0.05;
        hi_m = 2.2;
        break;
    case LAW_IWAN: {
        double chi = between(&r, -0.75, -0.1), top = between(&r, 0.5, 1.1), ratio = pow(top / 0.012, 1.0 / (IW - 1)), total = 0.0;
        for (i = 0; i < IW; i++) {
            l->iw_break[i] = 0.012 * pow(ratio, i);
            l->iw_k[i] = pow(l->iw_break[i], chi + 1.0);       /* density times width of a geometric class */
            total += l->iw_k[i];
        }
        for (i = 0; i < IW; i++)
            l->iw_k[i] /= total;
        break;
    }
    default: {                                 /* Dahl */
        double total = 0.0;
        for (i = 0; i < 3; i++) {
            static const double lengths[3] = {0.36, 0.75, 1.4};
            l->da_l[i] = lengths[i] * between(&r, 0.8, 1.25);
            l->da_n[i] = between(&r, 0.75, 1.6);
            l->da_w[i] = between(&r, 0.3, 1.0) * l->da_l[i];
            total += l->da_w[i] * pow(2.0, l->da_n[i]) / l->da_l[i];
        }
        for (i = 0; i < 3; i++)
            l->da_w[i] /= total;
    }
    }
    for (tries = 0; tries < 14; tries++) {     /* strength by bisection; keep the branches well rising */
        double lo = lo_m, hi = hi_m;
        for (i = 0; i < 22; i++) {
            l->m = 0.5 * (lo + hi);
            if (law_loop(l, 0.0, 1.0, NULL, NULL, NULL) < target)
                lo = l->m;
            else
                hi = l->m;
        }
        l->opening = law_loop(l, 0.0, 1.0, &span, &mid, &least);
        if (least > 0.2)
            break;
        target *= 0.96;
        if (target < 0.072)
            break;
    }
    l->minslope = least;
    l->scale = 2.0 / span;
    l->offset = mid;
    return 1;
}

/* drawn again until loops of a fifth of the stroke are thinner in proportion, but open, and branches rise */
static int law_build(law_t *l, uint32_t seed)
{
    uint32_t attempt;
    for (attempt = 0;; attempt++) {
        double share;
        if (!law_attempt(l, seed, attempt))
            return 0;
        share = law_loop(l, 0.0, 0.2, NULL, NULL, NULL) / l->opening;
        if ((share > 0.2 && share < 0.75 && l->minslope > 0.3 && l->opening > 0.072) || attempt == 40)
            return 1;
        free(l->f);
        l->f = NULL;
    }
}

/* ------------------------------------------------------------------ linear parts */

typedef struct { double a[2][2], b[2], c[2]; } mode_t2;        /* state' = a state + b u_old + c u_new */

static void mode_make(mode_t2 *m, double f, double q, double h)
{
    double w = 2.0 * PI * f, a[4][4], e[4][4], t[4][4], n[4][4];
    int i, j, k, it;
    memset(a, 0, sizeof a);
    a[0][1] = w * h;                           /* states: q, dq/dt / w, u, du * (time / h) */
    a[1][0] = -w * h;
    a[1][1] = -w * h / q;
    a[1][2] = w * h;
    a[2][3] = 1.0;
    memset(e, 0, sizeof e);
    memset(t, 0, sizeof t);
    for (i = 0; i < 4; i++)
        e[i][i] = t[i][i] = 1.0;
    for (it = 1; it < 40; it++) {
        for (i = 0; i < 4; i++)
            for (j = 0; j < 4; j++) {
                n[i][j] = 0.0;
                for (k = 0; k < 4; k++)
                    n[i][j] += t[i][k] * a[k][j] / it;
            }
        memcpy(t, n, sizeof t);
        for (i = 0; i < 4; i++)
            for (j = 0; j < 4; j++)
                e[i][j] += t[i][j];
    }
    for (i = 0; i < 2; i++) {
        m->a[i][0] = e[i][0];
        m->a[i][1] = e[i][1];
        m->c[i] = e[i][3];
        m->b[i] = e[i][2] - e[i][3];
    }
}

static void mode_step(const mode_t2 *m, double *s, double u0, double u1)
{
    double q = m->a[0][0] * s[0] + m->a[0][1] * s[1] + m->b[0] * u0 + m->c[0] * u1;
    s[1] = m->a[1][0] * s[0] + m->a[1][1] * s[1] + m->b[1] * u0 + m->c[1] * u1;
    s[0] = q;
}

typedef struct { double a, b0, b1; } pole_t;   /* one pole with first-order hold */

static void pole_make(pole_t *p, double f, double h)
{
    double x = 2.0 * PI * f * h, g;
    p->a = exp(-x);
    g = (1.0 - p->a) / x;
    p->b1 = 1.0 - g;
    p->b0 = g - p->a;
}

/* amplifier: one pole, exact over dt, with a slew limit if slew > 0 */
static double amp_move(double v, double target, double dt, double tau, double slew, double fac)
{
    double e = target - v;
    if (slew > 0.0 && fabs(e) > slew * tau) {
        double t1 = (fabs(e) - slew * tau) / slew;
        if (t1 >= dt)
            return v + sgn(e) * slew * dt;
        return target - sgn(e) * slew * tau * exp(-(dt - t1) / tau);
    }
    return target - e * fac;                   /* fac = exp(-dt / tau) */
}

/* ------------------------------------------------------------------ stage */

#define SUB 4
#define CREEPS 10

typedef struct {
    uint32_t seed;
    /* truth */
    double stroke, polarity, mode_f, mode_q, mode2_f, mode2_q, mode2_share;
    double gain, amp_f, amp_f_said, out_min, out_max, slew, slew_said;
    double sensor_f, sensor_f_said, sensor_gain, frac;
    int gain_said;
    double creep, creep_tilt, noise, slow_noise, slow_tau, nl2, nl3;
    double dac_lo, dac_hi, rest, rest_shown, zero;
    law_t law;
    /* coefficients */
    double tau, h, fac_full, fac_pre, fac_post, pre, post;
    int split;
    double x_mid, x_half, half_m, creep_scale, slow_a;
    double cf[CREEPS], cw[CREEPS];
    mode_t2 m1, m2;
    pole_t sens;
    /* state */
    double queue[2], hv, u, s1[2], s2[2], y, ysens, sensed, cs[CREEPS], csum, slow;
    rng_t noise_rng;
} stage_t;

static double dac16(double v)
{
    const double lsb = 20.0 / 65536.0;
    if (!(v == v))
        v = 0.0;
    return clampd(floor(v / lsb + 0.5), -32768.0, 32767.0) * lsb;
}

static void stage_draw(stage_t *s, uint32_t seed)
{
    rng_t r;
    double pick, v;
    rng_start(&r, seed, 1, 0);
    s->seed = seed;
    s->stroke = logbetween(&r, 5e-6, 100e-6);
    s->polarity = uni(&r) < 0.72 ? 1.0 : -1.0;
    s->mode_f = logbetween(&r, 300.0, 1500.0);
    s->mode_q = logbetween(&r, 5.0, 60.0);
    pick = uni(&r);
    s->mode2_f = s->mode_f * between(&r, 2.1, 3.8);
    s->mode2_q = logbetween(&r, 8.0, 40.0);
    s->mode2_share = between(&r, 0.015, 0.06) * (uni(&r) < 0.5 ? -1.0 : 1.0);
    if (pick > 0.4 || seed >= 5000)
        s->mode2_f = s->mode2_share = 0.0;
    if (seed >= 5000) {
        s->mode_f = between(&r, 3000.0, 6000.0);
        s->mode_q = between(&r, 1.0, 3.0);
    }
    pick = uni(&r);
    v = uni(&r);
    if (pick < 0.6) {                          /* unipolar */
        s->dac_lo = 0.0;
        s->dac_hi = 10.0;
        s->gain = v < 0.35 ? 10.0 : (v < 0.6 ? 15.0 : (v < 0.8 ? 12.0 : 7.5));
        s->out_min = s->gain == 10.0 ? -10.0 : (s->gain == 15.0 ? -30.0 : (s->gain == 12.0 ? -20.0 : 0.0));
        s->out_max = s->gain == 10.0 ? 110.0 : (s->gain == 15.0 ? 150.0 : (s->gain == 12.0 ? 120.0 : 75.0));
    } else if (pick < 0.82) {                  /* a little negative, as stacks allow */
        s->dac_lo = -2.0;
        s->dac_hi = 10.0;
        s->gain = v < 0.5 ? 10.0 : 15.0;
        s->out_min = -2.0 * s->gain;
        s->out_max = v < 0.5 ? 120.0 : 150.0;
    } else {                                   /* bipolar */
        s->dac_lo = v < 0.7 ? -10.0 : -7.5;
        s->dac_hi = -s->dac_lo;
        s->gain = v < 0.35 ? 15.0 : (v < 0.7 ? 20.0 : 13.0);
        s->out_max = v < 0.35 ? 150.0 : (v < 0.7 ? 200.0 : 130.0);
        s->out_min = -s->out_max;
    }
    s->amp_f_said = two_digits(logbetween(&r, 1000.0, 8000.0));
    s->amp_f = s->amp_f_said * between(&r, 0.94, 1.06);
    s->sensor_f_said = two_digits(logbetween(&r, 3000.0, 15000.0));
    s->sensor_f = s->sensor_f_said * between(&r, 0.94, 1.06);
    pick = uni(&r);
    s->slew_said = two_digits(logbetween(&r, 2.5e4, 3e5));
    s->slew = s->slew_said * between(&r, 0.97, 1.03);
    if (pick > 0.35)
        s->slew = s->slew_said = 0.0;
    s->frac = uni(&r) < 0.35 ? 0.0 : between(&r, 0.05, 0.9);
    s->creep = uni(&r) < 0.12 ? 0.0 : between(&r, 0.002, 0.02);
    s->creep_tilt = uni(&r) < 0.5 ? 0.0 : between(&r, -0.06, 0.06);
    s->noise = s->stroke * logbetween(&r, 1e-4, 9e-4);
    pick = uni(&r);
    s->slow_noise = s->noise * between(&r, 0.2, 0.7);
    s->slow_tau = logbetween(&r, 0.2, 4.0);
    if (pick > 0.3)
        s->slow_noise = 0.0;
    pick = uni(&r);
    s->nl2 = between(&r, -6e-4, 6e-4);
    s->nl3 = between(&r, -6e-4, 6e-4);
    if (pick > 0.4)
        s->nl2 = s->nl3 = 0.0;
    pick = uni(&r);                            /* where it waits */
    v = uni(&r);
    if (pick < 0.4)
        s->rest = 0.0;
    else if (pick < 0.75)
        s->rest = 0.5 * (s->dac_lo + s->dac_hi);
    else
        s->rest = s->dac_lo + (s->dac_hi - s->dac_lo) * (0.1 + 0.8 * v);
    s->rest = dac16(s->rest);
    pick = uni(&r);                            /* what the sensor calls zero, from the middle */
    s->zero = 0.0;
    if (pick < 0.3)
        s->zero = -0.5 * s->stroke * s->polarity;
    else if (pick < 0.6)
        s->zero = between(&r, -0.12, 0.12) * s->stroke;
    v = fabs(s->zero) + 0.5 * s->stroke;
    s->sensor_gain = two_digits(10.0 / (v * between(&r, 1.3, 1.5)));
    s->gain_said = uni(&r) < 0.65;
}

static double stage_x(const stage_t *s, double hv) { return (hv - s->x_mid) / s->x_half; }

static double stage_shown(const stage_t *s, double y)          /* static characteristic of the sensor */
{
    double z = y / (0.5 * s->stroke);
    z = clampd(z, -2.5, 2.5);
    return y - s->zero + s->stroke * (s->nl2 * (z * z - 1.0) + s->nl3 * (z * z * z - z));
}

static double stage_target(const stage_t *s, double volts)
{
    return clampd(volts * s->gain, s->out_min, s->out_max);
}

static stage_t *stage_build(uint32_t seed)
{
    stage_t *s = calloc(1, sizeof *s);
    double total = 0.0, w, x;
    rng_t r;
    int i;
    if (!s)
        return NULL;
    stage_draw(s, seed);
    if (!law_build(&s->law, seed)) {
        free(s->law.f);
        free(s);
        return NULL;
    }
    s->h = TICK / SUB;
    s->tau = 1.0 / (2.0 * PI * s->amp_f);
    s->split = (int)(s->frac * SUB);
    s->pre = s->frac * TICK - s->split * s->h;
    s->post = s->h - s->pre;
    s->fac_full = exp(-s->h / s->tau);
    s->fac_pre = exp(-s->pre / s->tau);
    s->fac_post = exp(-s->post / s->tau);
    s->x_mid = 0.5 * s->gain * (s->dac_lo + s->dac_hi);
    s->x_half = 0.5 * s->gain * (s->dac_hi - s->dac_lo);
    s->half_m = 0.5 * s->stroke * s->polarity;
    for (i = 0; i < CREEPS; i++) {             /* two relaxations a decade, 20 ms to 600 s */
        double tau = 0.02 * pow(10.0, 0.5 * i);
        s->cf[i] = 1.0 - exp(-TICK / tau);
        s->cw[i] = 0.5 * s->creep * pow(tau, s->creep_tilt);
        if (tau < 1.0)
            total += s->cw[i];
    }
    s->creep_scale = 1.0 / (1.0 + total);
    mode_make(&s->m1, s->mode_f, s->mode_q, s->h);
    if (s->mode2_f > 0.0)
        mode_make(&s->m2, s->mode2_f, s->mode2_q, s->h);
    pole_make(&s->sens, s->sensor_f, s->h);
    s->slow_a = exp(-TICK / s->slow_tau);
    /* history: full cycles, in some seeds followed by decreasing ones about the rest, then at rest for long */
    rng_start(&r, seed, 4, 0);
    x = stage_x(s, stage_target(s, s->rest));
    law_reset(&s->law);
    for (i = 0; i < 3; i++) {
        law_go(&s->law, 1.0, 200);
        law_go(&s->law, -1.0, 200);
    }
    if (uni(&r) < 0.35) {
        double a = 0.8;
        for (i = 0; i < 10; i++, a *= 0.7) {
            law_go(&s->law, clampd(x + a, -1.0, 1.0), 100);
            law_go(&s->law, clampd(x - a, -1.0, 1.0), 100);
        }
    } else if (uni(&r) < 0.4)
        law_go(&s->law, 1.0, 200);
    law_go(&s->law, x, 200);
    s->hv = stage_target(s, s->rest);
    s->queue[0] = s->queue[1] = s->rest;
    w = law_output(&s->law, x);
    s->csum = 0.0;
    for (i = 0; i < CREEPS; i++) {
        s->cs[i] = w;
        s->csum += s->cw[i] * w;
    }
    s->u = s->half_m * s->creep_scale * (w + s->csum);
    s->s1[0] = s->s2[0] = s->u;
    s->y = s->u;
    s->ysens = s->sensed = s->rest_shown = stage_shown(s, s->y);
    return s;
}

void *stage_open(uint32_t seed, uint32_t noise_seed);
void stage_step(void *stage, double volts, double *measured_m, double *position_m);
void stage_close(void *stage);
void stage_rest(void *stage, double *volts, double *displacement_m);
double stage_truth(uint32_t seed, int which);
void stage_run(void *stage, const double *volts, double *measured_m, double *position_m, long count);
void stage_law(uint32_t seed, const double *x, double *w, long count);

void *stage_open(uint32_t seed, uint32_t noise_seed)
{
    stage_t *s = stage_build(seed);
    if (s) {
        rng_start(&s->noise_rng, seed, 5, noise_seed);
        s->slow = s->slow_noise * gauss(&s->noise_rng);
    }
    return s;
}

void stage_close(void *stage)
{
    stage_t *s = stage;
    if (s) {
        free(s->law.f);
        free(s);
    }
}

void stage_rest(void *stage, double *volts, double *displacement_m)
{
    stage_t *s = stage;
    if (volts)
        *volts = s->rest;
    if (displacement_m)                        /* of the stage as opened, without noise */
        *displacement_m = s->rest_shown;
}

void stage_step(void *stage, double volts, double *measured_m, double *position_m)
{
    stage_t *s = stage;
    double before = stage_target(s, s->queue[0]), after = stage_target(s, s->queue[1]);
    double share1 = 1.0 - s->mode2_share, w = 0.0, volt;
    const double lsb = 20.0 / 65536.0;
    int i;
    for (i = 0; i < SUB; i++) {
        double u, y, shown;
        if (i < s->split)
            s->hv = amp_move(s->hv, before, s->h, s->tau, s->slew, s->fac_full);
        else if (i == s->split && s->pre > 0.0) {
            s->hv = amp_move(s->hv, before, s->pre, s->tau, s->slew, s->fac_pre);
            s->hv = amp_move(s->hv, after, s->post, s->tau, s->slew, s->fac_post);
        } else
            s->hv = amp_move(s->hv, after, s->h, s->tau, s->slew, s->fac_full);
        w = law_output(&s->law, stage_x(s, s->hv));
        u = s->half_m * s->creep_scale * (w + s->csum);
        mode_step(&s->m1, s->s1, s->u, u);
        y = s->s1[0];
        if (s->mode2_f > 0.0) {
            mode_step(&s->m2, s->s2, s->u, u);
            y = share1 * s->s1[0] + s->mode2_share * s->s2[0];
        }
        shown = stage_shown(s, y);
        s->sensed = s->sens.a * s->sensed + s->sens.b0 * s->ysens + s->sens.b1 * shown;
        s->ysens = shown;
        s->u = u;
        s->y = y;
    }
    s->csum = 0.0;
    for (i = 0; i < CREEPS; i++) {
        s->cs[i] += s->cf[i] * (w - s->cs[i]);
        s->csum += s->cw[i] * s->cs[i];
    }
    s->queue[0] = s->queue[1];                 /* the voltage of this call acts from the next tick on */
    s->queue[1] = dac16(volts);
    if (s->slow_noise > 0.0)
        s->slow = s->slow_a * s->slow + s->slow_noise * sqrt(1.0 - s->slow_a * s->slow_a) * gauss(&s->noise_rng);
    volt = (s->sensed + s->slow + s->noise * gauss(&s->noise_rng)) * s->sensor_gain;
    volt = clampd(floor(volt / lsb + 0.5), -32768.0, 32767.0) * lsb;
    if (measured_m)
        *measured_m = volt / s->sensor_gain;
    if (position_m)
        *position_m = s->y - s->zero;
}

/* many ticks at once, the same as so many calls of stage_step */
void stage_run(void *stage, const double *volts, double *measured_m, double *position_m, long count)
{
    long i;
    for (i = 0; i < count; i++)
        stage_step(stage, volts[i], measured_m ? measured_m + i : NULL, position_m ? position_m + i : NULL);
}

/* the law alone, x and w from -1 to 1 over the nominal range, after full cycles (for plots) */
void stage_law(uint32_t seed, const double *x, double *w, long count)
{
    stage_t *s = stage_build(seed);
    long i;
    if (!s)
        return;
    law_reset(&s->law);
    for (i = 0; i < 2; i++) {
        law_go(&s->law, 1.0, 200);
        law_go(&s->law, -1.0, 200);
    }
    for (i = 0; i < count; i++)
        w[i] = law_output(&s->law, x[i]);
    stage_close(s);
}

double stage_truth(uint32_t seed, int which)
{
    stage_t *s = stage_build(seed);
    double v = NAN;
    if (!s)
        return v;
    switch (which) {
    case 0: v = s->law.kind; break;
    case 1: v = s->law.opening; break;
    case 2: v = s->stroke; break;
    case 3: v = s->polarity; break;
    case 4: v = s->mode_f; break;
    case 5: v = s->mode_q; break;
    case 6: v = s->mode2_f; break;
    case 7: v = s->mode2_share; break;
    case 8: v = s->mode2_f > 0.0 ? s->mode2_q : 0.0; break;
    case 9: v = s->gain; break;
    case 10: v = s->amp_f; break;
    case 11: v = s->amp_f_said; break;
    case 12: v = s->out_min; break;
    case 13: v = s->out_max; break;
    case 14: v = s->slew; break;
    case 15: v = s->slew_said; break;
    case 16: v = s->sensor_f; break;
    case 17: v = s->sensor_f_said; break;
    case 18: v = s->sensor_gain; break;
    case 19: v = s->gain_said; break;
    case 20: v = 1.0 + s->frac; break;
    case 21: v = s->creep; break;
    case 22: v = s->creep_tilt; break;
    case 23: v = s->noise; break;
    case 24: v = s->slow_noise; break;
    case 25: v = s->nl2; break;
    case 26: v = s->nl3; break;
    case 27: v = s->dac_lo; break;
    case 28: v = s->dac_hi; break;
    case 29: v = s->rest; break;
    case 30: v = s->rest_shown; break;
    case 31: v = s->law.minslope; break;
    case 32: v = law_loop(&s->law, 0.0, 0.2, NULL, NULL, NULL); break;
    default: break;
    }
    stage_close(s);
    return v;
}

/* ------------------------------------------------------------------ tip */

#define TSUB 5
#define TQ 4

typedef struct {
    uint32_t seed;
    double barrier, kappa, ext, gain, amp_f, amp_f_said, pre_f, pre_f_said, delay;
    double mode_f, mode_q, set, floor_a, ceiling, rf, offset, s0, drift, hum_i, hum_z, g0, bias, full;
    int pre_said;
    /* coefficients */
    double h, tau, fac_full, fac_pre, fac_post, pre, post, drive_m;
    int lag, split;
    mode_t2 mode;
    pole_t pole;
    /* state */
    double queue[TQ + 1], hv, z, s[2], zmode, current, iraw, surface, extra, t, reading, hum_phase;
    int fault, have_reading;
    rng_t rng;
} tip_t;

void *tip_open(uint32_t seed, uint32_t noise_seed, double gap_m);
void tip_step(void *tip, double volts, double *current_A, double *gap_m);
void tip_move_surface(void *tip, double height_m);
void tip_fault(void *tip, int kind);
void tip_close(void *tip);
double tip_truth(uint32_t seed, int which);
void tip_loop(void *tip, double ki, double kp, const double *dither, double *drive_V, double *current_A, long count,
              double *state);
void tip_drive(void *tip, const double *volts, double *current_A, double *gap_m, long count);

static void tip_draw(tip_t *t, uint32_t seed)
{
    rng_t r;
    double v, limit;
    rng_start(&r, seed, 3, 0);
    t->seed = seed;
    t->barrier = between(&r, 1.0, 5.0);
    t->kappa = sqrt(2.0 * 9.1093837e-31 * t->barrier * 1.602176634e-19) / 1.054571817e-34;
    v = uni(&r);
    t->gain = v < 0.4 ? 15.0 : (v < 0.7 ? 10.0 : (v < 0.85 ? 13.5 : 20.0));
    t->ext = two_digits(logbetween(&r, 1e-9, 30e-9) / t->gain) * t->gain;  /* metres per volt of the DAC */
    t->amp_f_said = two_digits(logbetween(&r, 1000.0, 8000.0));
    t->amp_f = t->amp_f_said * between(&r, 0.95, 1.05);
    t->pre_f_said = two_digits(logbetween(&r, 2000.0, 20000.0));
    t->pre_f = t->pre_f_said * between(&r, 0.95, 1.05);
    t->pre_said = uni(&r) < 0.7;
    t->delay = TICK + between(&r, 10e-6, 60e-6);
    v = uni(&r);
    t->mode_f = logbetween(&r, 6000.0, 20000.0);
    t->mode_q = between(&r, 3.0, 14.0);
    if (v > 0.5)
        t->mode_f = t->mode_q = 0.0;
    t->set = two_digits(logbetween(&r, 5e-11, 2e-9));
    t->rf = t->set > 1.2e-9 ? (uni(&r) < 0.5 ? 1e9 : 3e8) : (uni(&r) < 0.75 ? 1e9 : 3e8);
    t->full = 10.0 / t->rf;
    t->ceiling = two_digits(t->full * between(&r, 0.7, 0.92));
    t->floor_a = t->set * 1e-3 > 1e-12 ? two_digits(t->set * 1e-3) : 1e-12;
    limit = t->set * 0.01 < 4e-12 ? t->set * 0.01 : 4e-12;
    t->offset = between(&r, -1.0, 1.0) * (limit < 1e-12 ? 1e-12 : limit);
    t->s0 = 4.0 * 1.380649e-23 * 295.0 / t->rf * logbetween(&r, 1.5, 12.0);
    v = uni(&r);
    t->drift = logbetween(&r, 1e-12, 1e-10) * (uni(&r) < 0.5 ? -1.0 : 1.0);
    if (fabs(t->drift) > 0.02 * t->ext)
        t->drift = sgn(t->drift) * 0.02 * t->ext;
    if (v < 0.12)
        t->drift = 0.0;
    v = uni(&r);
    t->hum_i = t->set * logbetween(&r, 1e-3, 8e-3);
    t->hum_z = logbetween(&r, 0.3e-12, 3e-12);
    if (v > 0.4)
        t->hum_i = t->hum_z = 0.0;
    t->g0 = between(&r, 0.5e-9, 1.0e-9);
    t->bias = two_digits(logbetween(&r, 0.01, 1.5));
}

static void tip_build(tip_t *t, uint32_t seed)
{
    double d, f;
    memset(t, 0, sizeof *t);
    tip_draw(t, seed);
    t->h = TICK / TSUB;
    t->tau = 1.0 / (2.0 * PI * t->amp_f);
    d = t->delay - TICK;                       /* beyond the tick of the interface */
    t->lag = (int)(d / TICK);
    f = d - t->lag * TICK;
    t->split = (int)(f / t->h);
    t->pre = f - t->split * t->h;
    t->post = t->h - t->pre;
    t->fac_full = exp(-t->h / t->tau);
    t->fac_pre = exp(-t->pre / t->tau);
    t->fac_post = exp(-t->post / t->tau);
    t->drive_m = t->ext / t->gain;
    if (t->mode_f > 0.0)
        mode_make(&t->mode, t->mode_f, t->mode_q, t->h);
    pole_make(&t->pole, t->pre_f, t->h);
}

static double tip_tunnel(const tip_t *t, double gap)
{
    double e = -2.0 * t->kappa * (gap - t->g0);
    return t->set * exp(e > 25.0 ? 25.0 : e);  /* contact limits it far beyond the preamplifier's range */
}

static double tip_gap(const tip_t *t)
{
    double gap = t->g0 + t->extra - t->zmode - t->surface + t->drift * t->t;
    if (t->hum_z > 0.0)
        gap += t->hum_z * sin(2.0 * PI * 50.0 * t->t + t->hum_phase);
    return gap;
}

void *tip_open(uint32_t seed, uint32_t noise_seed, double gap_m)
{
    tip_t *t = malloc(sizeof *t);
    if (!t)
        return NULL;
    tip_build(t, seed);
    rng_start(&t->rng, seed, 6, noise_seed);
    t->hum_phase = 2.0 * PI * uni(&t->rng);
    t->extra = gap_m;
    t->iraw = t->current = tip_tunnel(t, tip_gap(t));
    t->reading = clampd(t->current + t->offset, -t->full, t->full);
    return t;
}

void tip_close(void *tip) { free(tip); }
void tip_move_surface(void *tip, double height_m) { ((tip_t *)tip)->surface += height_m; }
void tip_fault(void *tip, int kind) { ((tip_t *)tip)->fault = kind; }

void tip_step(void *tip, double volts, double *current_A, double *gap_m)
{
    tip_t *t = tip;
    const double lsb = 20.0 / 1048576.0, adc = 20.0 / 65536.0;
    double before, after, shot, out, sound;
    int i;
    /* queue[0] is the voltage of the previous call */
    after = t->queue[t->lag] * t->gain;
    before = t->queue[t->lag + 1] * t->gain;
    for (i = 0; i < TSUB; i++) {
        double z, in;
        if (i < t->split)
            t->hv = before + (t->hv - before) * t->fac_full;
        else if (i == t->split) {
            t->hv = before + (t->hv - before) * t->fac_pre;
            t->hv = after + (t->hv - after) * t->fac_post;
        } else
            t->hv = after + (t->hv - after) * t->fac_full;
        z = t->hv * t->drive_m;
        if (t->mode_f > 0.0) {
            mode_step(&t->mode, t->s, t->z, z);
            t->zmode = t->s[0];
        } else
            t->zmode = z;
        t->z = z;
        t->t += t->h;
        in = tip_tunnel(t, tip_gap(t));
        /* the input stage limits at 1.5 times the range of the converter */
        in = in > 1.5 * t->full ? 1.5 * t->full : in;
        shot = (2.0 * 1.602176634e-19 * in + t->s0) / (2.0 * t->h);       /* one-sided density to variance */
        in += sqrt(shot) * gauss(&t->rng);
        t->current = t->pole.a * t->current + t->pole.b0 * t->iraw + t->pole.b1 * in;
        t->iraw = in;
    }
    for (i = TQ; i > 0; i--)
        t->queue[i] = t->queue[i - 1];
    if (!(volts == volts))
        volts = 0.0;
    t->queue[0] = clampd(floor(volts / lsb + 0.5), -524288.0, 524287.0) * lsb;
    sound = t->current + t->offset;
    if (t->hum_i > 0.0)
        sound += t->hum_i * sin(2.0 * PI * 50.0 * t->t + 1.0);
    switch (t->fault) {
    case 3: sound = t->offset + sqrt(t->s0 * 0.5 * PI * t->pre_f) * gauss(&t->rng); break;
    case 4: sound = -t->current + t->offset; break;
    case 5: sound = t->full; break;
    default: break;
    }
    out = clampd(floor(sound * t->rf / adc + 0.5), -32768.0, 32767.0) * adc / t->rf;
    if (t->fault == 2)
        out = t->reading;
    else
        t->reading = out;
    if (t->fault == 1)
        out = NAN;
    if (current_A)
        *current_A = out;
    if (gap_m)
        *gap_m = tip_gap(t);
}

/* the laboratory's own controller: PI on the logarithm of the current; state = {integral, last reading} */
void tip_loop(void *tip, double ki, double kp, const double *dither, double *drive_V, double *current_A, long count,
              double *state)
{
    tip_t *t = tip;
    const double lsb = 20.0 / 1048576.0;
    long k;
    for (k = 0; k < count; k++) {
        double i = state[1] > t->floor_a ? state[1] : t->floor_a, v;
        double e = log(t->set / i) + (dither ? dither[k] : 0.0);
        state[0] = clampd(state[0] + ki * e, -9.9, 9.9);
        v = clampd(state[0] + kp * e, -9.99, 9.99);
        v = floor(v / lsb + 0.5) * lsb;
        if (drive_V)
            drive_V[k] = v;                    /* a row: what was read at this tick, what is written at it */
        if (current_A)
            current_A[k] = state[1];
        tip_step(tip, v, &state[1], NULL);
    }
}

/* many ticks at given voltages, the same as so many calls of tip_step */
void tip_drive(void *tip, const double *volts, double *current_A, double *gap_m, long count)
{
    long k;
    for (k = 0; k < count; k++)
        tip_step(tip, volts[k], current_A ? current_A + k : NULL, gap_m ? gap_m + k : NULL);
}

double tip_truth(uint32_t seed, int which)
{
    tip_t t;
    tip_build(&t, seed);
    switch (which) {
    case 0: return t.barrier;
    case 1: return t.kappa;
    case 2: return t.ext;
    case 3: return t.gain;
    case 4: return t.amp_f;
    case 5: return t.amp_f_said;
    case 6: return t.pre_f;
    case 7: return t.pre_f_said;
    case 8: return t.delay;
    case 9: return t.mode_f;
    case 10: return t.mode_q;
    case 11: return t.set;
    case 12: return t.floor_a;
    case 13: return t.ceiling;
    case 14: return t.rf;
    case 15: return t.offset;
    case 16: return sqrt((2.0 * 1.602176634e-19 * t.set + t.s0) * 0.5 * PI * t.pre_f);
    case 17: return t.drift;
    case 18: return t.hum_i;
    case 19: return t.hum_z;
    case 20: return t.g0;
    case 21: return t.bias;
    case 22: return t.full;
    case 23: return t.pre_said;
    default: return NAN;
    }
}
