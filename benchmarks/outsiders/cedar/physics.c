/* Hysteresis laws and linear filters for campaigns.py. C99, libm only. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EDGE 1.3 /* the laws are defined for -EDGE..EDGE of the normalised drive */

/* ---- filters: input is piecewise linear between samples (exact) ---- */
void pole1(const double *x, double *y, long n, double ratio, double y0) {
    /* ratio = step / time constant */
    double e = exp(-ratio), a = (1 - e) / ratio, s = y0;
    double b0 = a - e, b1 = 1 - a; /* exact response to a ramp */
    y[0] = s;
    for (long i = 1; i < n; i++) {
        s = e * s + b0 * x[i - 1] + b1 * x[i];
        y[i] = s;
    }
}

void ss2(const double *x, double *y, long n, const double *m) {
    /* m: Ad (4), B0 (2), B1 (2); output is state 0, starts at rest on x[0] */
    double p = x[0], q = 0;
    y[0] = p;
    for (long i = 1; i < n; i++) {
        double p1 = m[0] * p + m[1] * q + m[4] * x[i - 1] + m[6] * x[i];
        q = m[2] * p + m[3] * q + m[5] * x[i - 1] + m[7] * x[i];
        p = p1;
        y[i] = p;
    }
}

void slew(const double *x, double *y, long n, double step) {
    double s = x[0];
    for (long i = 0; i < n; i++) {
        double d = x[i] - s;
        s += d > step ? step : d < -step ? -step : d;
        y[i] = s;
    }
}

/* ---- reversal bookkeeping: time and place since the last reversal ---- */
void turns(const double *x, long n, double band, double *since, double *sign) {
    /* a reversal counts once the drive has come back by `band` from the extreme; then dated to the extreme */
    double ext = x[0];
    long at = 0, last = 0;
    int dir = 0;
    for (long i = 0; i < n; i++) {
        if (dir == 0) {
            if (x[i] > ext + band) { dir = 1; at = 0; ext = x[i]; }
            else if (x[i] < ext - band) { dir = -1; at = 0; ext = x[i]; }
        } else if (dir * (x[i] - ext) >= 0) { last = i; /* a hold at the extreme belongs to the way there */
            ext = x[i];
        } else if (dir * (ext - x[i]) > band) {
            dir = -dir; ext = x[i]; at = last; last = i; /* dated to the extreme */
        }
        since[i] = (double)(i - at);
        sign[i] = dir;
    }
}

/* ---- differential laws ---- */
static double f_rhs(int law, const double *p, double v, double h, double s) {
    /* dh/dv on a branch with sign s of dv */
    switch (law) {
    case 0: { /* generalised Bouc-Wen (Song & Der Kiureghian 2006): six-parameter shape function */
        double sh = h > 0 ? 1 : h < 0 ? -1 : 0, sv = s * h > 0 ? 1 : s * h < 0 ? -1 : 0;
        double sx = v > 0 ? 1 : v < 0 ? -1 : 0;
        double psi = p[1] * sv + p[2] * s * sx * 0.5 + p[3] * sx * sh * 0.5 + p[4] + p[5] * sh + p[6] * s;
        return p[0] - pow(fabs(h), p[7]) * psi;
    }
    case 1: { /* Dahl 1968 with exponent */
        double g = 1 - s * h;
        return p[0] * (g > 0 ? pow(g, p[1]) : -pow(-g, p[1]));
    }
    case 2: { /* LuGre wall, position-dependent Coulomb level, slow limit */
        double level = 1 + p[1] * tanh(p[2] * v) + p[3] * exp(-v * v * 4);
        return p[0] * (1 - s * h / level);
    }
    case 3: { /* Duhem with different ascending and descending boundaries */
        double f = s > 0 ? tanh(p[0] * (v - p[1])) : tanh(p[2] * (v + p[3]));
        return p[4] * s * (f - h) + p[5] * (1 + p[6] * v);
    }
    case 4: { /* Coleman & Hodgdon 1986: odd f(v), even g(v) */
        double f = fabs(v) < p[1] ? p[2] * v : (v > 0 ? 1 : -1) * (p[2] * p[1] + p[3] * (fabs(v) - p[1]));
        double g = p[4] * (1 + p[5] * exp(-p[6] * v * v));
        return p[0] * s * (f - h) + g;
    }
    }
    return 0;
}

static void differential(int law, const double *p, const double *v, double *y, long n) {
    double h = 0, old = v[0];
    for (long i = 0; i < n; i++) {
        double dv = v[i] - old;
        if (dv != 0) {
            double s = dv > 0 ? 1 : -1;
            int m = (int)(fabs(dv) / 0.004) + 1;
            double d = dv / m;
            for (int k = 0; k < m; k++) {
                double x = old + k * d;
                double k1 = f_rhs(law, p, x, h, s);
                double k2 = f_rhs(law, p, x + d / 2, h + k1 * d / 2, s);
                h += k2 * d;
            }
        }
        old = v[i];
        y[i] = law <= 2 ? -h : h;
    }
}

static double langevin(double x) {
    return fabs(x) < 1e-3 ? x / 3 : 1 / tanh(x) - 1 / x;
}

static void jiles(const double *p, const double *v, double *y, long n) {
    /* p: a, k, alpha, c, bias, electrostriction */
    double M = 0, irr = 0, old = v[0] + p[4];
    for (long i = 0; i < n; i++) {
        double E = v[i] + p[4], dv = E - old;
        if (dv != 0) {
            double s = dv > 0 ? 1 : -1;
            int m = (int)(fabs(dv) / 0.004) + 1;
            double d = dv / m;
            for (int k = 0; k < m; k++) {
                double x = old + (k + 0.5) * d;
                double an = langevin((x + p[2] * M) / p[0]);
                double gap = an - irr, den = p[1] * s - p[2] * gap;
                if (gap * s > 0) irr += gap / den * d;
                M = p[3] * an + (1 - p[3]) * irr;
            }
        }
        old = E;
        y[i] = M + p[5] * M * M;
    }
}

/* ---- laws with a memory of turning points ---- */
#define DEEP 20000
static double everett(const double *T, int g, double hi, double lo) {
    double a = (hi + EDGE) / (2 * EDGE) * (g - 1), b = (lo + EDGE) / (2 * EDGE) * (g - 1);
    int i = (int)a, j = (int)b;
    if (i > g - 2) i = g - 2;
    if (j > g - 2) j = g - 2;
    if (i < 0) i = 0;
    if (j < 0) j = 0;
    a -= i; b -= j;
    const double *r = T + (long)i * g + j;
    return (1 - a) * ((1 - b) * r[0] + b * r[1]) + a * ((1 - b) * r[g] + b * r[g + 1]);
}

static double takacs(const double *p, double q, double span) {
    double m = p[0] * pow(span / 2, p[3]), c = p[1], z = p[2];
    double s = (tanh(c * (q - z)) + tanh(c * z)) / (tanh(c * (1 - z)) + tanh(c * z));
    return q + m * (s - q);
}

static void memory(int law, const double *p, const double *T, int g, const double *v, double *y, long n) {
    double *sv = malloc(sizeof(double) * DEEP), *sy = malloc(sizeof(double) * DEEP);
    int top = 1;
    int dir = 1; /* rising from the lower end */
    double top_y = law ? 1 : everett(T, g, EDGE, -EDGE);
    sv[0] = EDGE; sy[0] = law ? 1 : top_y;
    sv[1] = -EDGE; sy[1] = law ? -1 : 0;
    double old = -EDGE, oy = sy[1];
    for (long i = 0; i < n; i++) {
        double x = v[i];
        if (x > EDGE - 1e-9) x = EDGE - 1e-9;
        if (x < -EDGE + 1e-9) x = -EDGE + 1e-9;
        if (x != old) {
            int d = x > old ? 1 : -1;
            if (d != dir) {
                if (top < DEEP - 2) { top++; sv[top] = old; sy[top] = oy; dir = d; }
                else { top--; dir = d; }
            }
            while (top >= 3 && dir * (x - sv[top - 1]) >= 0) top -= 2;
            double span = fabs(sv[top - 1] - sv[top]);
            if (law) {
                double q = span > 1e-12 ? (x - sv[top]) / (sv[top - 1] - sv[top]) : 0;
                /* the upper branch and the lower one may be of different strength */
                double pp[4] = {p[0] * (dir > 0 ? 1 : p[4]), p[1], p[2], p[3]};
                oy = sy[top] + (sy[top - 1] - sy[top]) * takacs(pp, q, span);
            } else if (dir > 0) oy = sy[top] + everett(T, g, x, sv[top]);
            else oy = sy[top] - everett(T, g, sv[top], x);
            old = x;
        }
        y[i] = oy;
    }
    free(sv); free(sy);
}

/* ---- sums of elements ---- */
static void kp(const double *p, const double *w, int g, const double *v, double *y, long n) {
    /* Krasnosel'skii-Pokrovskii kernels on a triangle of g x g thresholds, ridge of width p[0] */
    double *st = malloc(sizeof(double) * g * g), up[256], total = 0;
    for (int k = 0; k < g * g; k++) { st[k] = -1; total += w[k]; }
    double old = 1e30, oy = 0;
    for (long i = 0; i < n; i++) {
        if (v[i] != old) {
            for (int k = 0; k < g; k++) {
                double r = (v[i] - (-EDGE + 2 * EDGE * k / (g - 1))) / p[0];
                up[k] = r < -1 ? -1 : r > 1 ? 1 : r;
            }
            double sum = 0;
            for (int a = 0; a < g; a++)        /* lower threshold a <= upper threshold b */
                for (int b = a; b < g; b++) {
                    int k = a * g + b;
                    double s = st[k];
                    s = s < up[b] ? up[b] : s > up[a] ? up[a] : s;
                    st[k] = s;
                    sum += w[k] * s;
                }
            oy = sum / total;
            old = v[i];
        }
        y[i] = oy;
    }
    free(st);
}

static void maxwell(const double *p, const double *w, int g, const double *v, double *y, long n) {
    /* p: bend 2, bend 3, growth of the breaks with position; w: g breaks then g stiffnesses */
    double *f = calloc((size_t)g, sizeof(double)), old = 0, oy = 0;
    int first = 1;
    for (long i = 0; i < n; i++) {
        double x = v[i] + p[0] * v[i] * v[i] + p[1] * v[i] * v[i] * v[i];
        if (first || x != old) {
            double d = first ? 0 : x - old, sum = 0, grow = 1 + p[2] * x;
            for (int k = 0; k < g; k++) {
                double b = w[k] * grow, s = f[k] + d;
                s = s > b ? b : s < -b ? -b : s;
                f[k] = s;
                sum += w[g + k] * s;
            }
            oy = -sum;
            old = x; first = 0;
        }
        y[i] = oy;
    }
    free(f);
}

void law_run(int law, const double *p, const double *table, int g, const double *v, double *y, long n) {
    if (law <= 4) differential(law, p, v, y, n);
    else if (law == 5) jiles(p, v, y, n);
    else if (law == 6) memory(0, p, table, g, v, y, n);
    else if (law == 7) memory(1, p, table, g, v, y, n);
    else if (law == 8) kp(p, table, g, v, y, n);
    else if (law == 9) maxwell(p, table, g, v, y, n);
}
