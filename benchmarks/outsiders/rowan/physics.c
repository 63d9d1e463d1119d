/* Loops of the scanner simulator. Every function walks one long timeline (pasts and recordings in a row). */
#include <math.h>
#define SGN(v) ((v) > 0 ? 1.0 : ((v) < 0 ? -1.0 : 0.0))

/* First-order pole w [rad/s], exact for an input linear within a step; then slew limit (units/s) and clip. */
void pole(long n, const double *u, const double *dt, double w, double slew, double lo, double hi, double *y) {
    double s = u[0] < lo ? lo : (u[0] > hi ? hi : u[0]);
    y[0] = s;
    for (long i = 1; i < n; i++) {
        double a = w * dt[i], g = -expm1(-a), m = a < 1e-6 ? a / 2 : 1 - g / a;
        double d = (u[i - 1] - s) * g + (u[i] - u[i - 1]) * m, top = slew * dt[i];
        s += d > top ? top : (d < -top ? -top : d);
        y[i] = s = s < lo ? lo : (s > hi ? hi : s);
    }
}

/* Damped oscillator q'' + (w/Q) q' + w^2 q = w^2 x, exact for x linear within a step; gives q and q'/(Q w). */
void mode(long n, const double *x, const double *dt, double w, double Q, double *q, double *band) {
    double z = 1 / (2 * Q), wd = w * sqrt(1 - z * z), s = x[0], v = 0;
    q[0] = s; band[0] = 0;
    for (long i = 1; i < n; i++) {
        double b = (x[i] - x[i - 1]) / dt[i], lag = 2 * z * b / w;
        double A = s - x[i - 1] + lag, B = (v - b + z * w * A) / wd;      /* homogeneous part at the step's start */
        double e = exp(-z * w * dt[i]), c = cos(wd * dt[i]), t = sin(wd * dt[i]);
        s = x[i] - lag + e * (A * c + B * t);
        v = b + e * ((B * wd - z * w * A) * c - (A * wd + z * w * B) * t);
        q[i] = s; band[i] = v / (Q * w);
    }
}

/* Domains: fraction p of class i switches towards the field once it exceeds a coercive field, spread over c. */
static double domains(double x, double dx, int N, const double *a, const double *b, const double *c, double *p) {
    double s = SGN(dx), xm = x - dx / 2, sum = 0;
    for (int i = 0; i < N; i++) {
        double z = (s * (xm - b[i]) - a[i]) / c[i];
        if (z > -1) {
            double h = z > 1 ? z : 0.25 * (1 + z) * (1 + z), r = h * fabs(dx) / c[i];
            p[i] += (s - p[i]) * (r < 1 ? r / (1 + r / 2) : 1 - exp(-r));
        }
        sum += p[i];
    }
    return sum / N;
}

/* Landau grains: q^3 - q = e; each follows its well until the fold, then the other; finite mobility in field c. */
static double landau(double x, double dx, int N, const double *a, const double *b, const double *c, double *p) {
    double sum = 0, *q = p + N;                                     /* p: strain state, q: equilibrium in its well */
    for (int i = 0; i < N; i++) {
        double f = (x - b[i]) / a[i], e = 0.3849 * f, s = q[i] > 0 ? 1 : -1, m = fabs(dx) / c[i];
        if (s * f < -1) s = -s, q[i] = s * 1.2;
        double r = s * q[i];
        for (int k = 0; k < 40; k++) {
            double d = (r * r * r - r - s * e) / (3 * r * r - 1 + 1e-9);
            r -= d;
            if (r < 0.5774) r = 0.5774;
            if (fabs(d) < 1e-7) break;
        }
        q[i] = s * r;
        p[i] += (q[i] - p[i]) * (m < 1 ? m / (1 + m / 2) : 1 - exp(-m));
        sum += p[i];
    }
    return sum / N;
}

/* Walls in a pinned landscape (a: pin force, b: phase, c: wavelength), bowing against a hardening back stress;
   each slides to the next equilibrium, so only the path of the field counts. */
static double walls(double x, int N, const double *a, const double *b, const double *c, double *y, const double *par) {
    double sum = 0;
    for (int i = 0; i < N; i++) {
        double most = 8 * a[i] / c[i], d = 1;
        for (int n = 0; n < 200 && fabs(d) > 1e-6 * c[i]; n++) {
            double v = y[i] / c[i] + b[i], back = par[0] + 3 * par[1] * y[i] * y[i];
            v = 2 * (v - floor(v)) - 1;                              /* -1..1: one period of the pin potential */
            double pin = a[i] * 4 * v * (1 - fabs(v)), stiff = back + most * (1 - 2 * fabs(v));
            d = (x - (par[0] + par[1] * y[i] * y[i]) * y[i] - pin) / (stiff > 0.1 * most ? stiff : back + most);
            y[i] += d = fabs(d) > 0.1 * c[i] ? 0.1 * c[i] * SGN(d) : d;  /* never past the next well */
        }
        sum += y[i];
    }
    return sum / N;
}

/* Bristles: elastic below a share of their strength, sliding beyond; strength depends on the place. */
static double bristles(double x, double dx, int N, const double *a, double *z, const double *par) {
    double s = SGN(dx), g = 1 + par[0] * x * x + par[1] * x, sum = 0;
    for (int i = 0; i < N; i++) {
        double l = s * z[i] / (a[i] * g), k = l < par[2] ? 0 : (l - par[2]) / (1 - par[2]);
        z[i] += dx * (k < 1 ? 1 - k : 0) / (1 + fabs(dx) / (a[i] * g * (1 - par[2])) * (k > 0) / 2);
        if (k > 1) z[i] = s * a[i] * g;
        sum += z[i];
    }
    return x - sum / N;                                              /* what friction lets through */
}

static double langevin(double v) { return fabs(v) < 1e-3 ? v / 3 : 1 / tanh(v) - 1 / v; }

static double atherton(double x, double dx, double *s, const double *par) {  /* par: a, k, alpha, c */
    double sg = SGN(dx), m = s[0];
    for (int k = 0; k < 2; k++) {                                      /* midpoint rule */
        double d = langevin((x - dx / 2 + par[2] * m) / par[0]) - m;
        double rate = sg * d > 0 ? d / (sg * par[1] - par[2] * d) : 0;
        m = s[0] + rate * dx * (k ? 1 : 0.5);
    }
    s[0] = m;
    return par[3] * langevin((x + par[2] * m) / par[0]) + (1 - par[3]) * m;
}

/* Rayleigh in Preisach form: Everett function of a density that varies with the mean field and the width. */
static double everett(double from, double to, const double *par) {
    double D = to - from, M = (to + from) / 2;
    return SGN(D) * par[0] * D * D / 2 * (1 + par[1] * M + par[2] * (M * M + D * D / 24) - par[3] * fabs(D) / 3);
}
static double rayleigh(double x, double dx, double *s, const double *par) {  /* s: depth, direction, (x, p) stack */
    double sg = SGN(dx), *t = s + 2;
    if (s[0] == 0) { s[0] = s[1] = 1; t[0] = -2.6; t[1] = s[802] = -everett(-2.6, 2.6, par) / 2; }
    int d = (int)s[0];
    if (sg != 0 && sg != s[1]) {                                     /* a turn: remember it */
        if (d < 400) { t[2 * d] = x - dx; t[2 * d + 1] = s[802]; d++; }
        s[1] = sg;
    }
    while (d > 2 && sg * (x - t[2 * (d - 2)]) > 0) d -= 2;           /* a closed loop is forgotten */
    s[0] = d;
    return s[802] = t[2 * d - 1] + everett(t[2 * d - 2], x, par);
}

void law(long id, long n, const double *x, double *out, long N, const double *a, const double *b, const double *c,
         double *s, const double *par, double largest) {
    double now = 0, y = 0;                                           /* the virgin stage starts at zero field */
    for (long i = 0; i < n; i++) {
        double whole = x[i] - now;
        int parts = 1 + (int)(fabs(whole) / largest);
        double dx = whole / parts, from = now;
        for (int k = 1; k <= parts && (whole != 0 || i == 0); k++) {
            now = from + k * dx;
            if (id == 0) y = domains(now, dx, N, a, b, c, s);
            else if (id == 1) y = landau(now, dx, N, a, b, c, s);
            else if (id == 2) y = walls(now, N, a, b, c, s, par);
            else if (id == 3) y = bristles(now, dx, N, a, s, par);
            else if (id == 4) y = atherton(now, dx, s, par);
            else y = rayleigh(now, dx, s, par);
        }
        now = x[i]; out[i] = y;
    }
}
