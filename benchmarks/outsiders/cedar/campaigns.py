"""Recorded piezo stages with hidden effects; everything is drawn from an integer seed."""
import atexit, ctypes, math, shutil, subprocess, tempfile
from pathlib import Path
import numpy as np

HERE = Path(__file__).resolve().parent
LAWS = ("bouc_wen_generalised", "dahl", "lugre_wall", "duhem", "coleman_hodgdon", "jiles_atherton",
        "preisach_gauss", "preisach_cauchy", "preisach_lognormal", "takacs_tanh", "krasnoselskii_pokrovskii", "maxwell_bent")
CATALOGUE = ("creep", "thermal_drift", "rate_dependence", "resonance", "delay", "lag", "cross_coupling",
             "mains_interference", "sensor_periodic_error", "amplifier_saturation", "slew_limit", "gain_change",
             "quantisation", "timestamp_fault", "outliers", "initial_state")
OUTSIDE = {
    "pump_tone": "frequency", "stepper_beat": "frequency", "aircon": ("frequency", "time"),
    "range_hard": ("reading", "displacement"), "range_soft": ("reading", "displacement"),
    "dead_spot": ("reading", "displacement"), "sensor_kink": ("reading", "displacement"),
    "flexure_hair": ("displacement", "reading"), "adc_bit_error": ("reading", "displacement"),
    "adc_missing_codes": ("reading", "displacement"), "reading_noise": ("reading", "displacement", "multiplicative"),
    "turn_stick": "since_turn", "turn_leak": "since_turn",
    "speed_noise": ("speed", "multiplicative"), "direction_zero": "speed", "fast_even": ("speed", "drive"),
    "derivative_pickup": "speed", "speed_threshold": "speed",
    "zero_cross_step": "drive", "drive_dead_zone": "drive", "dac_nonlinearity": "drive", "dac_glitch": "drive",
    "drive_lead_pickup": ("drive", "speed"),
    "mux_glitch": "sample_index", "buffer_seam": "sample_index", "hold_droop": "sample_index",
    "interleaved_adc": ("sample_index", "frequency"),
    "loose_connector": ("time", "multiplicative"), "gain_walk": ("time", "multiplicative"),
    "popcorn": "time", "slow_walk": "time",
    "ripple_gain": ("line_phase", "multiplicative"), "thyristor_spike": "line_phase",
    "cryocooler_kick": ("line_phase", "frequency"),
    "distance_wear": "distance", "distance_slip": "distance",
    "y_speed_pickup": "other_axis", "y_gain": ("other_axis", "multiplicative"), "y_relay": "other_axis"}
TWO = {"cross_coupling", "y_speed_pickup", "y_gain", "y_relay"}
EDGE = 1.3


def kinds():
    out = {k: {"catalogue": k, "coordinate": None} for k in CATALOGUE}
    out.update({k: {"catalogue": None, "coordinate": c} for k, c in OUTSIDE.items()})
    return out


_lib = None
def lib():
    global _lib
    if _lib is None:
        d = tempfile.mkdtemp(); atexit.register(shutil.rmtree, d, True)
        subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", str(HERE / "physics.c"), "-o", d + "/p.so", "-lm"], check=True)
        _lib = ctypes.CDLL(d + "/p.so")
    return _lib

def ptr(a): return a.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
def arr(x): return np.ascontiguousarray(x, float)

def pole(x, ratio):
    x = arr(x); y = np.empty_like(x)
    lib().pole1(ptr(x), ptr(y), ctypes.c_long(len(x)), ctypes.c_double(ratio), ctypes.c_double(x[0])); return y

def pole0(x, ratio, y0):
    x = arr(x); y = np.empty_like(x)
    lib().pole1(ptr(x), ptr(y), ctypes.c_long(len(x)), ctypes.c_double(ratio), ctypes.c_double(y0)); return y

def mode(x, h, f, q):
    w = 2 * math.pi * f
    A = np.zeros((4, 4)); A[:2, :2] = [[0, 1], [-w * w, -w / q]]; A[:2, 2] = [0, w * w]; A[2, 3] = 1 / h
    S = np.diag([1, 1 / w, 1, 1]); Si = np.diag([1, w, 1, 1]); A = S @ A @ Si
    k = max(0, int(math.log2(max(1e-9, np.abs(A * h).sum()))) + 4); B = A * h / 2 ** k
    E = np.eye(4); T = np.eye(4)
    for i in range(1, 14): T = T @ B / i; E = E + T
    for _ in range(k): E = E @ E
    b1 = E[:2, 3]; b0 = E[:2, 2] - b1
    m = arr([*E[0, :2], *E[1, :2], *b0, *b1]); x = arr(x); y = np.empty_like(x)
    lib().ss2(ptr(x), ptr(y), ctypes.c_long(len(x)), ptr(m)); return y

def slew(x, step):
    x = arr(x); y = np.empty_like(x); lib().slew(ptr(x), ptr(y), ctypes.c_long(len(x)), ctypes.c_double(step)); return y

def turns(x, band):
    x = arr(x); a = np.empty_like(x); b = np.empty_like(x)
    lib().turns(ptr(x), ctypes.c_long(len(x)), ctypes.c_double(band), ptr(a), ptr(b)); return a, b


class Law:
    def __init__(self, rng, name=None):
        self.name = name or LAWS[rng.integers(len(LAWS))]; U = rng.uniform; n = self.name; g = 0; t = np.zeros(1)
        if n == LAWS[0]:
            c, p = 0, [1, U(.5, .9), U(-.1, .1), U(-.1, .1), U(-.15, .15), U(-.06, .06), U(-.08, .08), U(1, 1.4)]
        elif n == LAWS[1]: c, p = 1, [U(.6, 1.4), U(1, 1.5)]
        elif n == LAWS[2]: c, p = 2, [U(.6, 1.5), U(-.3, .3), U(.8, 2), U(-.2, .2)]
        elif n == LAWS[3]: c, p = 3, [U(.8, 1.4), U(.05, .2), U(.8, 1.4), U(.05, .2), U(.8, 1.6), U(.1, .25), U(-.2, .2)]
        elif n == LAWS[4]: c, p = 4, [U(.7, 1.5), U(.4, .7), 1, U(.6, .85), U(.3, .5), U(-.2, .2), U(1, 3)]
        elif n == LAWS[5]: c, p = 5, [U(.45, .7), U(.3, .5), U(.05, .2), U(.1, .3), U(-.1, .3), U(-.15, .15)]
        elif n.startswith("preisach"):
            c, p, g = 6, [0], 401; x = np.linspace(-EDGE, EDGE, g); A, B = np.meshgrid(x, x, indexing="ij")
            m, d = (A + B) / 2, (A - B) / 2
            if "gauss" in n: r = np.exp(-((m - U(-.2, .2)) / U(.5, .9)) ** 2 / 2 - ((d - U(.1, .3)) / U(.2, .4)) ** 2 / 2)
            elif "cauchy" in n:
                a, s = U(.15, .4), U(.3, .6); r = 1 / (1 + ((A - a) / s) ** 2) / (1 + ((B + a + U(-.1, .1)) / s) ** 2)
            else: e = np.maximum(d, 1e-3); r = np.exp(-np.log(e / U(.2, .4)) ** 2 / 2 / U(.5, .8) ** 2) / e * np.exp(-(m - U(-.2, .2)) ** 2 / U(.8, 1.6))
            r = np.where(A > B, r, np.where(A == B, r / 2, 0))
            # Everett: integral over b0 <= beta, alpha <= a0, beta <= alpha
            r = r[:, ::-1]; E = np.cumsum(np.cumsum(r, 0), 1)[:, ::-1]; t = np.where(A >= B, E, 0); t = t - np.diag(np.diag(t)); t /= t.max()
        elif n == LAWS[9]: c, p = 7, [U(.35, .6), U(1.2, 2), U(.9, 1.1), U(.3, .7), U(.85, 1.15)]
        elif n == LAWS[10]:
            c, g = 8, 26; p = [U(.12, .3)]; x = np.linspace(-EDGE, EDGE, g); B, A = np.meshgrid(x, x, indexing="ij")
            m, d = (A + B) / 2, (A - B) / 2; t = np.where(A >= B, np.exp(-(m / U(.6, 1)) ** 2 - d / U(.25, .5)), 0)
        else:
            c, g = 9, 60; p = [U(-.08, .08), U(-.05, .05), U(-.2, .2)]; b = np.linspace(.02, 1.3, g)
            k = U(1.2, 2); t = np.concatenate([b, k * (b / .6) ** (k - 1) * np.exp(-(b / .6) ** k)]); t[g:] /= t[g:].sum()
        self.c, self.p, self.t, self.g = c, arr(p), arr(t), g; self.w = None
        self.r2, self.r3, goal = U(-.08, .08), U(-.06, .04), U(.075, .14)
        v = triangle([0, 1, -1, 1, -1, 1, -1, 1], 400); H = self.raw(v); H = (H - H[-801:].mean()) / (np.ptp(H[-801:])); self.hs = None
        R = self.rev(v)
        def opening(w):
            y = R * (1 - w) + w * H * 2 if c >= 3 and c != 9 else R + w * H
            dn, up = y[-801:-400], y[-401:]; return np.max(np.abs(dn[::-1] - up)) / np.ptp(y[-801:]), y
        ws = np.linspace(.005, 1 if c >= 3 and c != 9 else 1.2, 200); o = np.array([opening(w)[0] for w in ws])
        i = int(np.argmax(o >= goal)) if (o >= goal).any() else int(np.argmax(o)); self.w = ws[i]; self.opening, y = opening(self.w)
        h = self.raw(v)[-801:]; self.h0, self.hp = h.mean(), np.ptp(h); y = y[-801:]
        self.scale = 1 / np.ptp(y); self.zero = (y.max() + y.min()) / 2
        self.poly = np.polyfit(v[-801:], (y - self.zero) * self.scale, 3)
        self.lag = float(np.mean(y[:401][::-1] - y[400:])) > 0
        self.closes = c != 5
    def rev(self, v): return v + self.r2 * v * v + self.r3 * v ** 3
    def raw(self, v):
        v = arr(v); y = np.empty_like(v)
        lib().law_run(self.c, ptr(self.p), ptr(self.t), self.g, ptr(v), ptr(y), ctypes.c_long(len(v))); return y
    def __call__(self, v):
        H = (self.raw(v) - self.h0) / self.hp
        y = self.rev(v) * (1 - self.w) + 2 * self.w * H if self.c >= 3 and self.c != 9 else self.rev(v) + self.w * H
        return (y - self.zero) * self.scale


def triangle(points, n):
    return np.interp(np.arange((len(points) - 1) * n + 1) / n, np.arange(len(points)), points)


def plan(rng, must):
    """normalised commands -1..1 on an internal grid"""
    extra = list(rng.permutation(["noise", "steps", "minor", "middle"]))
    names = ["slow", "fast", "noise" if rng.random() < .5 else "steps"]
    names += [m for m in must if m not in names]
    names += [e for e in extra if e not in names][: int(rng.integers(0, 3))]
    names = names[:5]; out = []
    for nm in rng.permutation(names):
        U = rng.uniform
        if nm in ("slow", "fast", "middle"):
            f, fs, T = {"slow": (U(.1, .8), 1000, U(10, 25)), "fast": (U(12, 45), rng.choice([10000, 20000]), U(.5, 1.2)), "middle": (U(2, 8), 4000, U(2, 5))}[nm]
        elif nm == "noise": f, fs, T = U(40, 400), rng.choice([10000, 20000]), U(.6, 1.4)
        elif nm == "steps": f, fs, T = 0, rng.choice([500, 1000]), U(10, 25)
        else: f, fs, T = U(1, 4), 2000, U(4, 10)
        fs = int(fs); N = int(fs * T); os = max(1, 20000 // fs); n = N * os; t = np.arange(n) / (fs * os)
        if nm in ("slow", "fast", "middle"):
            ph = f * t; a = np.ones(n)
            if nm != "fast" or rng.random() < .5: a[ph > max(2, int(f * T * .7))] = U(.4, .7)
            x = (1 - 4 * np.abs((ph + .25) % 1 - .5)) * -1 if rng.random() < .6 else np.sin(2 * np.pi * ph)
            u = a * x
        elif nm == "noise":
            z = rng.standard_normal(n + 8000)
            for _ in range(3): z = pole(z, 2 * np.pi * f / (fs * os))
            z = z[8000:]; u = z / np.abs(z).max() * U(.3, .95)
        elif nm == "steps":
            u = np.zeros(n); i = 0; k = 0
            while i < n:
                j = i + int(fs * os * U(.5, 3)); u[i:j] = U(-1, 1) if k % 3 else rng.choice([-1, 1]); i = j; k += 1
        else:
            pts = [0.0]; 
            while len(pts) < 200: pts += [float(U(.2, 1)), float(U(-.1, .3)), float(U(.3, .9)), float(U(-1, -.3)), float(U(-.2, .5)), float(U(-.8, -.2))]
            s = np.concatenate([[0], np.cumsum(np.abs(np.diff(pts)))]); u = np.interp(4 * f * .5 * t, s, pts)
        if rng.random() < .3: i = int(n * .88); u = u.copy(); u[i:] = u[i]
        out.append(dict(kind=str(nm), f=float(f), fs=fs, os=os, u=u, T=float(T)))
    return out


def unit(x):
    x = x - x.mean(); s = x.std(); return x / s if s > 0 else x


class Stage:
    def __init__(self, seed, kk, size):
        self.seed, self.kk, self.size = seed, kk, size; r = np.random.default_rng([seed, 1]); U = r.uniform
        self.law = Law(r); self.stroke = 10 ** U(math.log10(5e-6), -4); self.noise = self.stroke * 10 ** U(-4, -3)
        self.pol = -1 if r.random() < .3 else 1; self.gain = float(r.choice([10, 15, 20])); self.hi = U(5, 7); self.lo = -U(1, 4)
        self.amp, self.sen = U(1500, 8000), U(4000, 15000); self.amp_said, self.sen_said = round(self.amp * U(.96, 1.04), -2), round(self.sen * U(.96, 1.04), -2)
        self.f0, self.q0 = U(5500, 8000), U(.8, 1.5); self.zero_moves = r.random() < .5
        must = []
        if {"creep", "turn_stick", "turn_leak"} & set(kk): must.append("steps")
        if {"resonance"} & set(kk): must.append("noise")
        self.plan = plan(np.random.default_rng([seed, 2]), must); t = 0; q = np.random.default_rng([seed, 3])
        self.zero = []
        for p in self.plan: p["t0"] = t; t += p["T"] + q.uniform(30, 200); self.zero.append(q.normal() * .02 * self.stroke * self.zero_moves)
        self.total = t

    def par(self, k):
        i = list(kinds()).index(k); return np.random.default_rng([self.seed, 100 + i])

    def run(self, i, active):
        p = self.plan[i]; S = self.size; fs, os = p["fs"], p["os"]; h = 1 / (fs * os); n = len(p["u"]); st, nz = self.stroke, self.noise
        has = lambda k: k in active
        step = 20 / 65536; u = np.round(((self.hi + self.lo) / 2 + p["u"] * (self.hi - self.lo) / 2) / step) * step
        un = (u - (self.hi + self.lo) / 2) / ((self.hi - self.lo) / 2); t = p["t0"] + np.arange(n) * h; tr = t[::os]; ur = u[::os]; nr = len(ur)
        c = un.copy()                                        # drive path, normalised
        zv = -(self.hi + self.lo) / (self.hi - self.lo)       # where the drive is 0 V
        yv = None
        if TWO & set(self.kk):
            g = np.random.default_rng([self.seed, 4, i]); fy = max(2.2 / p["T"], p["f"] * .37 if p["f"] else .3); yv = 5 * np.sin(2 * np.pi * fy * np.arange(n) * h + g.uniform(0, 6)) 
            yv = np.round((yv + 1.5 * np.sin(2 * np.pi * fy * 2.71 * np.arange(n) * h)) / step) * step
        def A(k, lo=10, hi=30): return self.par(k).uniform(lo, hi) * nz * S
        def F(k): g = self.par(k); g.random(); return g
        def shift(x, d): return np.interp(np.arange(n) * h - d, np.arange(n) * h, x)
        if has("amplifier_saturation"): c = np.minimum(c, 1 - 2 * F("amplifier_saturation").uniform(.08, .14) * S)
        if has("drive_dead_zone"):
            w = F("drive_dead_zone").uniform(.03, .06) * S; d = c - zv; c = zv + np.sign(d) * np.maximum(np.abs(d) - w, 0)
        if has("dac_nonlinearity"):
            g = F("dac_nonlinearity"); c = c + 2 * A("dac_nonlinearity") * 1.4 / st * np.sin(2 * np.pi * c * g.uniform(1.5, 6) + g.uniform(0, 6))
        if has("slew_limit"):
            fm = max(q["f"] for q in self.plan if q["kind"] == "fast"); c = slew(c, 4 * fm * h * (1 - F("slew_limit").uniform(.2, .4) * S))
        if has("delay"): c = shift(c, F("delay").uniform(1.5e-4, 6e-4) * S)
        c = pole(c, 2 * np.pi * self.amp * h)
        if has("lag"): c = pole(c, h / (F("lag").uniform(2e-4, 1e-3) * S))
        g = np.random.default_rng([self.seed, 5, i]); pts = [0.]
        for _ in range(4): a = g.uniform(.6, 1); pts += [a, -a * g.uniform(.6, 1)]
        if has("initial_state"): pts += [1 + .28 * S, -1, 1 + .28 * S] if F("initial_state").random() < .5 else [-1 - .28 * S, 1, -1 - .28 * S]
        past = triangle(pts + [c[0]], 300); m = self.law(np.concatenate([past, c]))[len(past):]
        if has("rate_dependence"):
            k = F("rate_dependence").uniform(.15, .35) * S; rev = np.polyval(self.law.poly, c); sp = np.abs(np.gradient(c, h)); sp = pole(sp, h / max(.004, .1 / max(p["f"], .5)))
            m = rev + (m - rev) * (1 + k * np.log10(1 + sp / .5))
        m = m * st
        if has("creep"):
            k = F("creep").uniform(.005, .02) * S; x = m.copy()
            for e in np.arange(-2, 3.3, .5):
                tau = 10 ** e; m = m + k / 2 * pole0(x, h / tau, x[0] + (x.mean() - x[0]) * tau / (tau + 10))
        if has("resonance"): g = F("resonance"); d = mode(m, h, g.uniform(100, 900), g.uniform(8, 50)); m = m + S * (d - m)
        if has("gain_change"):
            g = F("gain_change"); j = int(g.integers(len(self.plan))); t1 = self.plan[j]["t0"] + g.uniform(.2, .8) * self.plan[j]["T"]
            m = m * (1 + S * g.choice([-1, 1]) * g.uniform(.02, .06) * (t > t1))
        if has("thermal_drift"):
            g = F("thermal_drift"); P = g.uniform(60, 300); f = lambda q: np.sin(2 * np.pi * q / P + 1) + q / P; L = max(self.plan, key=lambda q: q["T"])
            m = m + A("thermal_drift") * (f(t) - f(t[0])) / np.std(f(L["t0"] + np.linspace(0, L["T"], 500)))
        if has("cross_coupling"): m = m + A("cross_coupling") * yv / 3.6
        if has("y_gain"): m = m * (1 + S * F("y_gain").uniform(.003, .006) * yv)
        if has("y_relay"): m = m + A("y_relay") * np.tanh((yv - F("y_relay").uniform(-1, 1)) / .05)
        if has("y_speed_pickup"): m = m + A("y_speed_pickup") * np.gradient(yv) / np.gradient(yv).std()
        if has("flexure_hair"): g = F("flexure_hair"); m = m + 3 * A("flexure_hair") * np.exp(-((m / st - g.uniform(-.3, .3)) / g.uniform(.02, .06)) ** 2)
        if {"turn_stick", "turn_leak"} & set(active):
            s, d = turns(un, .02); s = s * h
            if has("turn_stick"): m = m - 2 * A("turn_stick") * d * np.exp(-s / F("turn_stick").uniform(.01, .06))
            if has("turn_leak"): m = m - 2 * A("turn_leak") * d * (1 - np.exp(-s / F("turn_leak").uniform(.05, .4)))
        sp = np.gradient(pole(un, 2 * np.pi * 500 * h), h); s0 = 4 * max(q["f"] for q in self.plan if q["kind"] == "fast")
        if has("direction_zero"): m = m + A("direction_zero") * np.tanh(sp / .1)
        if has("speed_threshold"): m = m + 1.5 * A("speed_threshold") * .5 * (1 + np.tanh((np.abs(sp) - .25 * s0) / (.03 * s0)))
        if has("fast_even"): m = m + 3 * A("fast_even") * np.minimum((sp / s0) ** 2, 4) * un ** 2
        if has("zero_cross_step"): m = m + A("zero_cross_step") * np.sign(un - zv)
        for k, L in (("distance_wear", 1), ("distance_slip", 0)):
            if has(k):
                d = np.cumsum(np.abs(np.diff(pole(m, 2 * np.pi * 300 * h), prepend=m[0]))) / st; q = F(k).uniform(4, 9)
                m = m + (A(k) * d / 20 if L else A(k) * np.floor(d / q))
        if has("loose_connector"):
            g = np.random.default_rng([self.seed, 60, i]); z = np.zeros(n)
            for _ in range(int(g.integers(2, 6))): a = int(g.uniform(0, n)); z[a:a + int(n * g.uniform(.005, .05))] = 1
            m = m * (1 - S * F("loose_connector").uniform(.03, .1) * z)
        if has("gain_walk"): P = F("gain_walk").uniform(3, 15); m = m * (1 + S * .03 * np.sin(2 * np.pi * t / P))
        lf = 50 if F("ripple_gain").random() < .7 else 60
        if has("ripple_gain"): m = m * (1 + S * F("ripple_gain").uniform(.02, .05) * np.sin(2 * np.pi * lf * t))
        if has("pump_tone"): g = F("pump_tone"); m = m + A("pump_tone", 5, 20) * 1.4 * np.sin(2 * np.pi * g.uniform(11, 44) * t)
        if has("stepper_beat"): g = F("stepper_beat"); f = g.uniform(63, 95); m = m + A("stepper_beat") * (np.sin(2 * np.pi * f * t) + np.sin(2 * np.pi * (f + g.uniform(.5, 3)) * t))
        if has("aircon"): m = m + A("aircon") * 1.4 * np.sin(2 * np.pi * t / F("aircon").uniform(3, 9))
        if has("cryocooler_kick"):
            ph = (t * F("cryocooler_kick").uniform(1.2, 2.5)) % 1; m = m + 8 * A("cryocooler_kick") * np.exp(-ph / .03) * np.sin(ph * 120)
        m = pole(mode(m, h, self.f0, self.q0), 2 * np.pi * self.sen * h)
        y = self.pol * m[::os] + self.zero[i]; g = np.random.default_rng([self.seed, 6, i]); w = g.standard_normal(nr); g = np.random.default_rng([self.seed, 7, i]); k = np.arange(nr)
        if has("sensor_periodic_error"):
            P = max(F("sensor_periodic_error").choice([.3164e-6, .775e-6, 2e-6, 4e-6]), st / 40); y = y + A("sensor_periodic_error", 5, 15) * 1.4 * np.sin(2 * np.pi * y / P)
        if has("range_hard"): y = np.minimum(y, st * (.5 - F("range_hard").uniform(.06, .12) * S))
        if has("range_soft"): b = .2 * st; d = np.maximum(y - b, 0); y = y - d + d / (1 + S * 1.2 * d / st)
        if has("dead_spot"):
            q = F("dead_spot"); b = q.uniform(-.25, .25) * st; ww = q.uniform(.02, .04) * st * S; d = y - b; y = np.where(np.abs(d) < ww, b, y)
        if has("sensor_kink"): q = F("sensor_kink"); y = y + S * q.choice([-1, 1]) * q.uniform(.02, .05) * np.maximum(y - q.uniform(-.2, .2) * st, 0)
        if has("adc_bit_error"): y = y + 2 * A("adc_bit_error") * (y > F("adc_bit_error").uniform(-.1, .2) * st)
        if has("adc_missing_codes"): q = 60 * nz * S; y = np.where(np.floor(y / q) % 4 == 1, np.floor(y / q) * q, y)
        fac = np.ones(nr)
        if has("reading_noise"): fac = fac + S * 20 * np.abs(y / st)
        if has("speed_noise"): fac = fac + S * 15 * np.minimum(np.abs(sp[::os]) / s0, 3)
        y = y + nz * w * fac
        if has("mains_interference"):
            q = F("mains_interference"); f = q.choice([50, 60])
            for j, a in ((1, 1.3), (2, .3), (3, .5), (5, .25)):
                if j * f < .45 * fs: y = y + A("mains_interference") * a * np.sin(2 * np.pi * j * f * tr + j)
        if has("thyristor_spike"): ph = (tr * lf * 2) % 1; y = y + 6 * A("thyristor_spike") * np.exp(-ph / .06) * (ph < .4)
        if has("derivative_pickup"): d = np.gradient(ur) * fs; y = y + 2 * A("derivative_pickup") * np.clip(d / (s0 * (self.hi - self.lo) / 2), -3, 3)
        if has("drive_lead_pickup"): y = y + 2 * A("drive_lead_pickup") * np.append(un[::os][1:], un[-1])
        if has("dac_glitch"): y = y + 4 * A("dac_glitch") * (np.diff(np.sign(ur), prepend=np.sign(ur[0])) != 0)
        if has("mux_glitch"): y = y + 3 * A("mux_glitch") * (k % 1024 == 700)
        if has("buffer_seam"): y = y + A("buffer_seam") * np.where((k // 512) % 2 == 0, 1, -1)
        if has("hold_droop"): y = y + A("hold_droop") * 3.4 * ((k % 256) / 256 - .5)
        if has("interleaved_adc"): y = y + A("interleaved_adc", 5, 15) * np.where(k % 2, 1, -1)
        if has("popcorn"): y = y + A("popcorn") * np.where(np.cumsum(g.random(nr) < 12 / nr) % 2, 1, -1)
        if has("slow_walk"): y = y + A("slow_walk") * unit(np.cumsum(np.random.default_rng([self.seed, 8, i]).standard_normal(nr)))
        if has("outliers"): q = np.random.default_rng([self.seed, 9, i]); y = y + (q.random(nr) < .003) * q.choice([-1, 1], nr) * nz * q.uniform(60, 200, nr) * S
        lsb = 1.6 * st / 65536; y = np.round(y / lsb) * lsb
        if has("quantisation"): q = A("quantisation", 12, 35); y = np.round(y / q) * q
        clock = k / fs; keep = np.ones(nr, bool)
        if has("timestamp_fault"):
            q = np.random.default_rng([self.seed, 10, i]); stall = F("timestamp_fault").random() < .4
            for _ in range(max(1, int(8 * S))):
                a = int(q.uniform(.05, .9) * nr); L = int(q.integers(5, 40))
                if stall: clock[a:a + L] = clock[a]; 
                else: keep[a:a + L] = False
        return clock, ur, None if yv is None else yv[::os], y, keep


def write(seed, kinds, size, folder, measure=True):
    kinds = tuple(kinds); folder = Path(folder); folder.mkdir(parents=True, exist_ok=True)
    known = globals()["kinds"]()
    for k in kinds:
        if k not in known: raise ValueError(k)
    s = Stage(seed, kinds, size); two = bool(TWO & set(kinds)); L = ["[rig]", f'name = "cedar {seed}"', ""]
    stages = {k: {} for k in kinds}; N = s.noise; recs = {}
    ax = "axis.x." if two else ""
    for a in (("axis.x.", "axis.y.") if two else ("",)):
        L += [f"[{a}amplifier]", f"gain_V_per_V = {s.gain:g}", f"bandwidth_Hz = {s.amp_said:g}", f"output_min_V = {-10 * s.gain:g}", f"output_max_V = {10 * s.gain:g}", ""]
    L += [f"[{ax}sensor]", f"bandwidth_Hz = {s.sen_said:g}", "", "[acquisition]", "sampling_rate_Hz = 20000", "dac_bits = 16", "adc_bits = 16", "input_range_V = [-10, 10]", ""]
    for i, p in enumerate(s.plan):
        clock, u, yv, y, keep = s.run(i, kinds); name = f"rec{i + 1}_{p['kind']}.csv"; recs[name] = dict(kind=p["kind"], rate_Hz=p["fs"], samples=int(keep.sum()), f_Hz=p["f"])
        cols = [clock, u] + ([yv] if two else []) + [y * 1e6]
        head = "time [s],voltage_x [V],voltage_y [V],displacement_x [um]" if two else "time [s],voltage [V],displacement [um]"
        fmt = ",".join(["%.6f", "%.5f"] + (["%.5f"] if two else []) + ["%.6f"])
        (folder / name).write_text(head + "\n" + "\n".join(fmt % tuple(r) for r in np.column_stack(cols)[keep].tolist()) + "\n")
        L += ["[[recording]]", f'file = "{name}"', 'axis = "x"'] + (['columns = { voltage = "voltage_x [V]", displacement = "displacement_x [um]" }'] if two else []) + [""]
        for k in kinds if measure else ():
            if k == "timestamp_fault": stages[k][name] = dict(rms_over_noise=None, peak_over_noise=None, lost=int((~keep).sum()), stalled=int((np.diff(clock) == 0).sum())); continue
            d = y - s.run(i, tuple(x for x in kinds if x != k))[3]; stages[k][name] = dict(rms_over_noise=float(np.sqrt(np.mean(d * d)) / N), peak_over_noise=float(np.abs(d).max() / N))
    (folder / "lab.toml").write_text("\n".join(L))
    eff = []
    for k in kinds:
        v = stages[k]; shown = [f for f, x in v.items() if x["rms_over_noise"] is None or x["rms_over_noise"] > 1 or x["peak_over_noise"] > 8]
        r = max([x["rms_over_noise"] or 0 for x in v.values()], default=0)
        eff.append(dict(kind=k, **known[k], size=r * N, unit="m (rms in the recording that shows it most)", shown_in=shown, by_recording=v))
    return dict(seed=seed, law=s.law.name, opening=float(s.law.opening), lags=bool(s.law.lag), closes=s.law.closes, polarity=s.pol,
                effects=eff, recordings=recs, noise_m=N, stroke_m=s.stroke, amplifier_Hz=s.amp, sensor_Hz=s.sen, mode_Hz=s.f0, mode_Q=s.q0)
