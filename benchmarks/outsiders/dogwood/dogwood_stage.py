"""Laws of hysteresis, linear parts and the laboratory with one stage; used by recordings.py.

Chain: DAC (16 bits, held) -> amplifier pole -> hysteresis law -> log creep -> (lightly damped mode)
-> sensor pole -> disturbance + white noise -> 16-bit ADC. Metres inside, um in the files.
"""
import math, zlib
import numpy as np

# ---------------------------------------------------------------- hysteresis laws (rate independent)
# Each factory draws its parameters and returns step(w) -> y with its own memory; w is the drive in -1..1.
# y needs no scale: Stage adds a reversible part so that the loop opens as drawn (see Stage.__init__).

def ode(slope, start, most=0.02):
    """Law dy/dw = slope(w, y, direction), midpoint rule with sub-steps of at most `most`."""
    at = [start[0], start[1]]
    def step(w):
        u, y = at
        n = max(1, math.ceil(abs(w - u) / most))
        h, s = (w - u) / n, (1.0 if w > u else -1.0)
        if h:
            for _ in range(n):
                k = slope(u, y, s)
                y += h * slope(u + h / 2, y + k * h / 2, s)
                u += h
        at[0], at[1] = w, y
        return y
    return step

def bouc_wen(r):                      # generalised: Song & Der Kiureghian 2006; in piezos: Low & Guo 1995
    n, b = r.uniform(1, 1.6), r.uniform(.5, .9)
    b1, b2, b3 = 0.65 * b, r.uniform(-.12, .12) * b, 0.2 * b
    def slope(w, y, s):
        z = -y
        return -(1 - min(abs(z), 3) ** n * (b1 * s * np.sign(z) + b2 * s + b3))
    return ode(slope, (0., 0.))

def dahl(r):                          # Dahl 1968; friction of walls opposing the strain
    sig, i = r.uniform(.3, .6), r.uniform(.8, 1.5)
    return ode(lambda w, y, s: -sig * max(0., 1 + y * s) ** i, (0., 0.))

def coleman_hodgdon(r):               # Coleman & Hodgdon 1986
    al, g, q = r.uniform(.4, .9), r.uniform(0, .3), r.uniform(-.12, .12)
    return ode(lambda w, y, s: al * s * (w + q * w * w - y) + g, (0., 0.))

def duhem(r):                         # Duhem, other rates up and down: Oh & Bernstein 2005 (semilinear + square)
    up, dn, k2, g = r.uniform(.4, .8), r.uniform(.4, .8), r.uniform(0, .5), r.uniform(0, .3)
    def slope(w, y, s):
        e = s * (w - y)
        return g + (up if s > 0 else dn) * e + k2 * e * abs(e)
    return ode(slope, (0., 0.))

def jiles_atherton(r):                # Jiles & Atherton 1986; ferroelectrics, strain: Smith & Ounaies 2000
    a, k, c, al, q = r.uniform(.4, .8), r.uniform(.5, 1.), r.uniform(.1, .3), r.uniform(.02, .06), r.uniform(-.15, .15)
    langevin = lambda x: x / 3 if abs(x) < 1e-3 else 1 / math.tanh(x) - 1 / x
    def slope(w, p, s):               # p is the irreversible polarisation
        e = langevin((w + al * p) / a) - p
        return e / (k * s - al * e) if e * s > 0 else 0.
    irr = ode(slope, (0., 0.))
    def step(w):
        p = irr(w)
        p += c * (langevin((w + al * p) / a) - p)
        return p + q * p * p
    return step

def preisach(r, n=200):               # Preisach 1935, Mayergoyz 1986 (Everett function, wiping out)
    """Smooth density: log-normal in half width, normal in bias; Everett by double sums on a grid."""
    g = np.linspace(-1.02, 1.02, n + 1)
    up, dn = np.meshgrid((g[1:] + g[:-1]) / 2, (g[1:] + g[:-1]) / 2, indexing="ij")
    hw, bias = np.maximum((up - dn) / 2, 1e-6), (up + dn) / 2
    m, wd, sb, b0 = r.uniform(.2, .4), r.uniform(.8, 1.2), r.uniform(.3, .7), r.uniform(-.1, .1)
    rho = np.exp(-(np.log(hw / m) / wd) ** 2 / 2 - ((bias - b0) / sb) ** 2 / 2) * (up >= dn)
    ev = np.zeros((n + 1, n + 1))     # ev[i, j]: mass switched when going up to g[i] from g[j]
    ev[1:, :-1] = np.cumsum(np.cumsum(rho, 0)[:, ::-1], 1)[:, ::-1]
    ev = (ev / ev[-1, 0]).tolist()
    def everett(hi, lo):
        i, j = (hi + 1.02) / 2.04 * n, (lo + 1.02) / 2.04 * n
        a, b = min(int(i), n - 1), min(int(j), n - 1)
        i, j = i - a, j - b
        return (1 - i) * ((1 - j) * ev[a][b] + j * ev[a][b + 1]) + i * ((1 - j) * ev[a + 1][b] + j * ev[a + 1][b + 1])
    turn, at, rev = [(-1.02, -1.)], [-1.02, 0], r.uniform(0, .3)   # remembered turning points (w, output)
    def step(w):
        w = min(max(float(w), -1.019), 1.019)
        last, s = at
        d = (w > last) - (w < last)
        if d and s and d != s:        # a turn: remember where and at which output
            turn.append((last, out(last, s)))
        if d:
            while len(turn) > 2 and (w - turn[-2][0]) * d >= 0:    # passed the turn before last: wipe both
                del turn[-2:]
            at[0], at[1] = w, d
        return out(w, at[1]) + rev * w
    def out(w, s):
        u, y = turn[-1]
        return y + 2 * everett(w, u) if s >= 0 else y - 2 * everett(u, w)
    return step

def maxwell_slip(r, n=50):            # Goldfarb & Celanovic 1997, Weibull breaks, behind a bent curve
    br = r.uniform(.5, .9) * r.weibull(r.uniform(.9, 1.3), n)
    k, q, f, at = r.uniform(.5, 1.5, n) / n, r.uniform(-.12, .12), np.zeros(n), [None]
    def step(w):
        u = w + q * (w * w - 1)
        if at[0] is not None:
            np.clip(f + (u - at[0]), -br, br, out=f)
        at[0] = u
        return -float(k @ f)
    return step

LAWS = {f.__name__: f for f in (bouc_wen, dahl, coleman_hodgdon, duhem, jiles_atherton, preisach, maxwell_slip)}

# ---------------------------------------------------------------- linear parts

def pole(x, h, tau, held=False):
    """1/(1 + s tau), exact for input linear between samples (or held); tau may be complex (a mode)."""
    a = np.exp(-h / tau)
    b1 = 0 if held else 1 - (1 - a) * tau / h
    b0 = 1 - a - b1
    y, out, last, a = x[0], [x[0]], x[0], a.item()
    for v in (b0 * x[:-1] + b1 * x[1:]).tolist():
        y = a * y + v
        out.append(y)
    return np.array(out)

def mode(x, h, f0, q):
    w = 2 * np.pi * f0
    lam = complex(-w / 2 / q, w * math.sqrt(1 - 1 / 4 / q / q))
    res = w * w / (2j * lam.imag)
    return 2 * np.real(res * (-1 / lam) * pole(x.astype(complex), h, np.complex128(-1 / lam)))

def opening(v, x):
    """Signed greatest distance of the mean branches (positive: lags) over the extent of x, and its sign."""
    d = np.sign(np.diff(v, prepend=v[0]))
    idx = np.maximum.accumulate(np.where(d != 0, np.arange(d.size), 0))
    d = d[idx]
    lo, hi = v.min(), v.max()
    b = np.clip(((v - lo) / (hi - lo + 1e-30) * 40).astype(int), 0, 39)
    gap = []
    for i in range(2, 38):
        u, w = (b == i) & (d > 0), (b == i) & (d < 0)
        if u.any() and w.any():
            gap.append(x[w].mean() - x[u].mean())
    if not gap or np.ptp(x) == 0:
        return float("nan")
    g = max(gap, key=abs) * np.sign(np.sum((v - v.mean()) * (x - x.mean())))
    return float(g / np.ptp(x))

# ---------------------------------------------------------------- a laboratory with one stage

class Lab:
    def __init__(self, kind, seed, folder):
        r = self.r = np.random.default_rng([zlib.crc32(kind.encode()), seed])
        self.folder, self.files, self.put, self.F, self.toml, self.alias = folder, {}, {}, {}, {}, {}
        self.law = list(LAWS)[r.integers(len(LAWS))]
        self.open, self.stroke = r.uniform(.06, .145), 1e-6 * 10 ** r.uniform(.7, 2)
        self.noise = self.stroke * 10 ** r.uniform(-4, -2.7)
        self.sign = 1 if r.random() < .75 else -1
        self.hi = r.uniform(6, 9.9)
        self.lo = (0., -.2 * self.hi, -self.hi)[r.integers(3)]
        self.amp, self.sen = r.uniform(1000, 8000), r.uniform(3000, 15000)
        self.creep = r.uniform(.003, .02) if r.random() < .5 else 0.
        self.zero = r.uniform(-.3, .3)                    # where the sensor's zero lies, of the stroke
        self.f0 = self.Q = None
        self.bend, self.margin = r.uniform(-.12, .12), 1.35 + 2 * abs(self.zero) + r.uniform(0, 1)   # ADC range / stroke

    def set(self, **k):
        self.__dict__.update(k)

    def make(self):
        """Draw the law until the loop opened as wanted is monotone; fix the reversible part."""
        up = np.linspace(-1, 1, 161)
        for _ in range(50):
            seed = self.r.integers(2 ** 31)
            step = LAWS[self.law](np.random.default_rng(seed))
            y = np.array([step(w) for w in np.r_[up, -up, up, -up, up, -up]])[-322:]
            y = np.array([y[:161], y[161:][::-1]])        # last rising and falling branch
            self._y, self._seed = y, seed
            if self.fit(self.open) > .12:
                return
        raise RuntimeError(self.law)

    def fit(self, wanted):
        """Reversible part so that the full loop opens by `wanted`; returns least slope over mean slope."""
        y, up = self._y, np.linspace(-1, 1, 161)
        gap, rng = np.max(y[1] - y[0]), y[0, -1] - y[0, 0]
        c = (gap / wanted - rng) / 2
        x = y + c * (up + self.bend * (up * up - 1))
        self._c, self._scale, self._mid = c, 1 / (rng + 2 * c), x.mean()
        slopes = np.diff(x, axis=1)
        return slopes.min() / slopes.mean() if c > 0 else -1.

    def stepper(self, w0):
        """The static stage: step(w) -> displacement / stroke, cycled twice before and brought to w0."""
        if not hasattr(self, "_c"):
            self.make()
        step = LAWS[self.law](np.random.default_rng(self._seed))
        up = np.linspace(-1, 1, 161)
        for w in np.r_[up, -up, up, -up, np.linspace(-1, w0, 161)]:
            step(float(w))
        return lambda w: (step(w) + self._c * (w + self.bend * (w * w - 1)) - self._mid) * self._scale

    def volts(self, s):
        return np.round((self.lo + (self.hi - self.lo) * (np.asarray(s) + 1) / 2) * 3276.8) / 3276.8

    def static(self, v, fs, clip=None):
        """From the DAC volts to the displacement of the ceramic with creep (metres, before mode and sensor)."""
        h = 1 / fs
        w = (pole(v, h, 1 / (2 * np.pi * self.amp), held=True) - self.lo) / (self.hi - self.lo) * 2 - 1
        w = w if clip is None else np.minimum(w, clip)
        step = self.stepper(w[0])
        x = np.array([step(u) for u in w.tolist()])
        if self.creep:
            x = x + sum(self.creep / 2 * pole(x, h, t) for t in 10 ** np.arange(-1.5, 2.1, .5))
        return self.sign * x * self.stroke

    def respond(self, v, fs, **k):
        x = self.static(v, fs, **k)
        if self.f0:
            x = mode(x, 1 / fs, self.f0, self.Q)
        return pole(x, 1 / fs, 1 / (2 * np.pi * self.sen)) + self.zero * self.stroke

    def quantise(self, x):
        lsb = self.stroke * self.margin / 65536
        return np.round(x / lsb) * lsb

    def record(self, name, v, fs, det, dist=0., spoil=None, note=""):
        """Add disturbance, noise, ADC; spoil(d) -> (d, good rows)."""
        full = det + dist
        d = self.quantise(full + self.noise * self.r.standard_normal(det.size))
        good = np.ones(d.size, bool)
        if spoil:
            d, good = spoil(d)
        floor = d - full
        rms = lambda e: float(np.sqrt(np.mean(e ** 2))) if e.size else None
        self.files[name] = dict(rate_Hz=fs, samples=d.size, bad_rows=int((~good).sum()), note=note,
            stroke_seen_m=float(np.ptp(full)), opening_seen=opening(v, full),
            perfect_rms_m=rms(floor[good]),               # all causes known: noise and rounding
            drive_only_rms_m=rms((d - det)[good]),        # the sound stage known exactly, the disturbance not
            drive_only_rms_all_rows_m=rms(d - det))
        self.F.setdefault("one", 100 * opening(v, det))       # of the loop without the disturbance
        self.save(name, np.arange(d.size) / fs, v, d)
        return d

    def save(self, name, t, v, d):
        self.alias[name] = (t, v, d)
        np.savetxt(self.folder / name, np.c_[t, v, d * 1e6], fmt=["%.6f", "%.4f", "%.6f"], delimiter=",",
                   header="time [s],voltage [V],displacement [um]", comments="")

    def rate(self, duration, least=500):
        ok = [f for f in (500, 1000, 2000, 5000, 10000, 20000) if f >= least and 3000 <= f * duration <= 30000]
        if not ok and least > 500:
            return self.rate(duration, least // 2)
        return int(self.r.choice(ok)) if ok else int(min(20000, max(500, 3000 / duration)))

    def cycles(self, f=None, n=None, shape=None, least=500):
        """Equal full cycles from the bottom: (v, fs); remembers frequency, count and shape."""
        n = n or int(self.r.integers(3, 9))
        f = f or 10 ** self.r.uniform(-.3, .7)
        fs = self.rate(n / f, least)
        shape = shape or ("triangle", "sine")[self.r.integers(2)]
        N = min(int(n / f * fs), 30000)
        p = np.arange(N) / fs * f
        s = wave(p, shape)
        self.put |= {"drive_Hz": f, "cycles": N / fs * f, "shape": shape}
        self.F |= {"f": f, "n": int(N / fs * f), "shape": shape}
        return self.volts(s), fs

    def lab_toml(self):
        a, s = self.toml.get("amp", self.amp), self.toml.get("sen", self.sen)
        t = [f'[rig]\nname = "stage"\n\n[amplifier]\ngain_V_per_V = 15']
        t += [f"bandwidth_Hz = {a:.0f}"] if a else []
        t += [f"output_min_V = -150\noutput_max_V = 150\n\n[sensor]"]
        t += [f"bandwidth_Hz = {s:.0f}"] if s else []
        t += [f"gain_V_per_m = {20 / (self.stroke * self.margin):.4g}\n\n[acquisition]\nsampling_rate_Hz = 20000",
              "dac_bits = 16\nadc_bits = 16\ninput_range_V = [-10, 10]\n"]
        t += [f'[[recording]]\nfile = "{n}"\naxis = "x"\n' for n in self.alias]
        (self.folder / "lab.toml").write_text("\n".join(t))

def wave(p, shape="triangle"):
    """Period 1 in p, -1..1, starting at the bottom."""
    return -np.cos(2 * np.pi * p) if shape == "sine" else 1 - 4 * np.abs(p % 1 - .5)
