/* Hysteresis laws and the slow loops of the stage simulator (C99). */
#include <math.h>
#include <stdlib.h>
#define MAXLEV 64
enum { EVERETT, BOUC_WEN, DAHL, DUHEM, COLEMAN, JILES, MAXWELL, KRASNOSELSKII, KINETIC, GEN_PLAY };

static double clip(double x, double a, double b) { return x < a ? a : x > b ? b : x; }
static double at(const double *T, int m, double L, double a, double b) { /* Everett table, bilinear */
    double s = (m - 1) / (2 * L), p = clip((a + L) * s, 0, m - 1.001), q = clip((b + L) * s, 0, m - 1.001);
    int i = (int)p, j = (int)q; p -= i; q -= j;
    const double *r = T + (long)i * m + j;
    return (1 - p) * ((1 - q) * r[0] + q * r[1]) + p * ((1 - q) * r[m] + q * r[m + 1]);
}
static void everett(const double *p, const double *T, const double *u, long n, double *y) {
    int m = (int)p[0]; double L = p[1];
    double *su = malloc((n + 4) * sizeof *su), *sy = malloc((n + 4) * sizeof *sy);
    long top = 0; int dir = 1; double last = -L, now = 0;   /* su: turning points, starting from negative saturation */
    su[0] = -L; sy[0] = 0;
    for (long k = 0; k < n; k++) {
        double x = clip(u[k], -L * 0.999, L * 0.999);
        if (x != last) {
            int d = x > last ? 1 : -1;
            if (d != dir) { top++; su[top] = last; sy[top] = now; dir = d; }
            while (top >= 2 && (dir > 0 ? x >= su[top - 1] : x <= su[top - 1])) top -= 2;
            if (top == 1 && dir > 0) top = 0;
            now = dir > 0 ? sy[top] + at(T, m, L, su[top], x) : sy[top] - at(T, m, L, x, su[top]);
            last = x;
        }
        y[k] = now;
    }
    free(su); free(sy);
}
/* slope dy/du of the laws written as differential equations; s = direction of the drive */
static double slope(int id, const double *p, double u, double z, double s) {
    double f, g;
    switch (id) {
    case BOUC_WEN: return p[0] - pow(fabs(z), p[3]) * (p[1] * (s * z > 0 ? 1 : -1) + p[2] + p[4] * s);
    case DAHL: g = clip(1 - s * z / (p[0] * (1 + p[2] * u)), 0, 3); return pow(g, p[1]);
    case DUHEM: f = p[0] * tanh(p[1] * u); return p[2] * exp(clip(s * (s > 0 ? p[3] : p[4]) * (f - z), -8, 2));
    default: f = p[0] * tanh(p[1] * (u + p[4])); g = 1 - f * f / (p[0] * p[0]);
        return s * p[2] * (f - z) + p[0] * p[1] * g * (1 - p[3]);
    }
}
static double langevin(double x) { return fabs(x) < 1e-3 ? x / 3 : 1 / tanh(x) - 1 / x; }
static void differential(int id, const double *p, const double *u, long n, double *y) {
    double z = 0, z2 = 0, w = 0;
    for (long k = 0; k < n; k++) {
        double d = k ? u[k] - u[k - 1] : u[0], x = u[k] - d, s = d > 0 ? 1 : -1;
        int m = (int)(fabs(d) / 0.004) + 1; d /= m;
        for (int i = 0; i < m && d != 0; i++, x += d) {
            if (id == JILES) {          /* p: a, k, alpha, c, strain share */
                double an = langevin((x + d / 2 + p[2] * z) / p[0]), e = an - z;
                if (e * s > 0) z += d * e / (p[1] * s * (1 + p[4] * x) - p[2] * e);
                w = p[3] * langevin((x + d + p[2] * z) / p[0]) + (1 - p[3]) * z;
            } else {
                double h = slope(id, p, x, z, s);
                z += d * slope(id, p, x + d / 2, z + h * d / 2, s); w = z;
                if (id == DAHL) { z2 += d * slope(id, p + 3, x + d / 2, z2, s); w = z + p[6] * z2; }
            }
        }
        y[k] = w;
    }
}
static void elements(int id, const double *p, const double *w, const double *u, long n, double *y) {
    int m = (int)p[0], c = 0; double L = p[1], lev[MAXLEV], st[MAXLEV * MAXLEV];
    for (int i = 0; i < m; i++) lev[i] = -L + 2 * L * (i + 0.5) / m;
    for (int i = 0; i < MAXLEV * MAXLEV; i++) st[i] = id == KRASNOSELSKII ? -1 : 0;
    for (long k = 0; k < n; k++) {
        double d = k ? u[k] - u[k - 1] : u[0], x = u[k], out = 0;
        if (id == MAXWELL) {             /* bent curve in front: p[2], p[3]; m springs with yield (i+1)/m*L */
            double f = x + p[2] * x * x + p[3] * x * x * x, o = x - d, g = f - (o + p[2] * o * o + p[3] * o * o * o);
            for (int i = 0; i < m; i++) { double r = L * (i + 1) / m; st[i] = clip(st[i] + g, -r, r); out += w[i] * st[i]; }
        } else if (id == GEN_PLAY) {     /* envelopes differ on the two sides and saturate */
            double up = tanh(p[2] * x + p[4]), dn = tanh(p[3] * x + p[5]) ;
            for (int i = 0; i < m; i++) {
                double r = L * i / m + 0.02;
                if (d > 0) { if (up - r > st[i]) st[i] = up - r; } else if (d < 0) { if (dn + r < st[i]) st[i] = dn + r; }
                out += w[i] * st[i];
            }
        } else if (id == KRASNOSELSKII) {/* ridge of width p[2] */
            c = 0;
            for (int i = 0; i < m; i++) for (int j = 0; j <= i; j++, c++) {
                double a = clip(2 * (x - lev[i]) / p[2] - 1, -1, 1), b = clip(2 * (x - lev[j]) / p[2] + 1, -1, 1);
                if (d > 0 && a > st[c]) st[c] = a; else if (d < 0 && b < st[c]) st[c] = b;
                out += w[c] * st[c];
            }
        } else {                         /* kinetic relays: switching probability per unit of drive travelled */
            double ru[MAXLEV], rd[MAXLEV]; int q = (int)(fabs(d) / 0.01) + 1; d /= q;
            for (int z = q - 1; z >= 0; z--) {
                if (d == 0) continue;
                for (int i = 0; i < m; i++) {
                    double e = x - d * (z + 0.5) - lev[i], r = e / sqrt(e * e + p[2] * p[2]);
                    ru[i] = pow(0.5 * (1 + r), 3); rd[i] = pow(0.5 * (1 - r), 3);
                }
                c = 0;
                for (int i = 0; i < m; i++) for (int j = 0; j <= i; j++, c++) {
                    double R = ru[i] + rd[j]; st[c] += (ru[i] / R - st[c]) * -expm1(-p[3] * fabs(d) * R);
                }
            }
            for (int i = 0; i < m * (m + 1) / 2; i++) out += w[i] * st[i];
        }
        y[k] = out;
    }
}
void law(int id, const double *p, const double *w, const double *u, long n, double *y) {
    if (id == EVERETT) everett(p, w, u, n, y);
    else if (id < MAXWELL) differential(id, p, u, n, y);
    else elements(id, p, w, u, n, y);
}
/* sum of K relaxations towards h with times tau, variable step */
void creep(const double *h, const double *dt, long n, const double *tau, int K, double *y) {
    double x[32], a[32], last = -1;
    for (int i = 0; i < K; i++) x[i] = h[0];
    for (long k = 0; k < n; k++) {
        if (dt[k] != last) { last = dt[k]; for (int i = 0; i < K; i++) a[i] = -expm1(-last / tau[i]); }
        y[k] = 0;
        for (int i = 0; i < K; i++) { x[i] += a[i] * (h[k] - x[i]); y[k] += x[i]; }
    }
}
void slew(const double *v, long n, double step, double *y) {
    y[0] = v[0];
    for (long k = 1; k < n; k++) y[k] = y[k - 1] + clip(v[k] - y[k - 1], -step, step);
}
/* sample of the last turn of u (an excursion back by more than thr) and the direction since */
void turns(const double *u, long n, double thr, double *since, double *dir) {
    double ext = u[0]; long at_ext = 0, turn = 0; int d = 0;
    for (long k = 0; k < n; k++) {
        if (d >= 0 ? u[k] > ext : u[k] < ext) { ext = u[k]; at_ext = k; if (!d) d = 1; }
        else if (fabs(u[k] - ext) > thr) { d = u[k] > ext ? 1 : -1; turn = at_ext; ext = u[k]; at_ext = k; }
        since[k] = (double)(k - turn); dir[k] = d;
    }
}
