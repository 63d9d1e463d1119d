"""Recordings of one axis of simulated piezo scanner stages, with hidden effects and their truth.

The stage is integrated along one timeline: for every recording a past (approach, cycles within the recording's own
range, rest), then the recording itself. Converter -> amplifier -> hysteresis law -> mechanics -> sensor -> converter.
"""
import ctypes
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

LAWS = ("domain_kinetics", "landau_wells", "homogenised_energy", "rayleigh_preisach", "jiles_atherton", "wall_pinning",
        "bristles", "electrostriction")
DECOYS = ("rest_around", "mid_motion_start", "hold_inside", "odd_last_file", "bent_reversible", "comment_line",
          "uneven_noise")

# kind: (catalogue, coordinate, name of the strength parameter, lowest, highest at full size; in units of below)
# units: "noise" (times the noise, in metres), "" (as it is). Strengths are tuned to 8..40 noise, within the limits.
_KINDS = {
    "creep": ("creep", None, "share_per_decade", 0.005, 0.03, ""),
    "thermal_drift": ("thermal_drift", None, "amplitude_m", 4, 300, "noise"),
    "rate_dependence": ("rate_dependence", None, "field_per_efold", 0.001, 0.04, ""),
    "resonance": ("resonance", None, "share", 0.3, 1.0, ""),
    "delay": ("delay", None, "delay_s", 1e-4, 3e-3, ""),
    "lag": ("lag", None, "time_constant_s", 1 / (2 * np.pi * 2000), 1 / (2 * np.pi * 20), ""),
    "cross_coupling": ("cross_coupling", None, "share", 0.0005, 0.1, ""),
    "mains_interference": ("mains_interference", None, "amplitude_m", 6, 60, "noise"),
    "sensor_periodic_error": ("sensor_periodic_error", None, "amplitude_m", 6, 60, "noise"),
    "amplifier_saturation": ("amplifier_saturation", None, "depth", 0.005, 0.35, ""),
    "slew_limit": ("slew_limit", None, "slowness", 1e-6, 1e3, ""),
    "gain_change": ("gain_change", None, "change", 0.01, 0.06, ""),
    "quantisation": ("quantisation", None, "step_m", 15, 150, "noise"),
    "timestamp_fault": ("timestamp_fault", None, "rows", 20, 400, ""),
    "outliers": ("outliers", None, "height_m", 40, 2000, "noise"),
    "initial_state": ("initial_state", None, "excursion_beyond", 0.5, 1.3, ""),
    "compressor_burst": (None, "time", "amplitude_m", 6, 100, "noise"),
    "notch_left_in": (None, "frequency", "depth", 0.3, 0.95, ""),
    "crossover_distortion": (None, "drive", "dead_zone", 0.001, 0.08, ""),
    "windage": (None, "speed", "amplitude_m", 6, 120, "noise"),
    "guide_bump": (None, "displacement", "height_m", 10, 200, "noise"),
    "missing_codes": (None, "reading", "width_m", 20, 400, "noise"),
    "interleaved_offset": (None, "sample_index", "offset_m", 10, 150, "noise"),
    "clamp_settling": (None, "since_turn", "amplitude_m", 8, 150, "noise"),
    "line_pickup": (None, "line_phase", "amplitude_m", 15, 200, "noise"),
    "slippage": (None, "distance", "total_m", 15, 300, "noise"),
    "tilt_gain": (None, "other_axis", "gain_per_range", 0.001, 0.08, ""),
}
FAIR = {
    "creep": {"rate_dependence"}, "rate_dependence": {"creep"}, "delay": {"lag"}, "lag": {"delay"},
    "notch_left_in": {"resonance", "lag"},
    "slippage": {"thermal_drift", "creep"}, "windage": {"rate_dependence"}, "tilt_gain": {"cross_coupling"},
    "missing_codes": {"quantisation"}, "interleaved_offset": {"outliers"}, "clamp_settling": {"creep"},
}
FAIR = {k: FAIR.get(k, set()) for k in _KINDS}
_TWO_AXES = {"cross_coupling", "tilt_gain"}
_ON_DRIVE = {"amplifier_saturation", "slew_limit"}


def kinds():
    return {k: {"catalogue": v[0], "coordinate": v[1]} for k, v in _KINDS.items()}


def _physics():
    source = Path(__file__).with_name("physics.c")
    lib = Path(tempfile.gettempdir()) / f"stage_physics_{hashlib.sha256(source.read_bytes()).hexdigest()[:16]}.so"
    if not lib.exists():
        fresh = lib.with_suffix(f".{os.getpid()}")
        subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", str(source), "-o", str(fresh), "-lm"], check=True)
        os.replace(fresh, lib)
    return ctypes.CDLL(str(lib))


_lib = None


def _c(name, *args):
    """Call a C function; arrays must be contiguous doubles, ints are passed as long, floats as double."""
    global _lib
    _lib = _lib or _physics()
    as_c = {float: ctypes.c_double, int: ctypes.c_long}
    getattr(_lib, name)(*(ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else as_c[type(a)](a)
                          for a in args))


def _pole(u, dt, hz, slew=1e300, lo=-1e300, hi=1e300):
    y = np.empty_like(u)
    _c("pole", len(u), u, dt, float(2 * np.pi * hz), float(slew), float(lo), float(hi), y)
    return y


def _mode(x, dt, hz, Q):
    q, band = np.empty_like(x), np.empty_like(x)
    _c("mode", len(x), np.ascontiguousarray(x), dt, float(2 * np.pi * hz), float(Q), q, band)
    return q, band


def _log(rng, lo, hi):
    return float(np.exp(rng.uniform(np.log(lo), np.log(hi))))


class _Law:
    """A hysteresis law with its parameters: strain of a field in -1..1, mixed so that the full loop opens 7-15 %."""

    def __init__(self, name, rng):
        n, self.par, self.q, self.largest, states = 150, np.zeros(8), 0.0, 0.01, 1
        a, b, c = np.ones(n), np.zeros(n), np.ones(n)
        k = np.arange(n) + 0.5
        grid = k / n, (k * 0.6180339887) % 1, (k * 0.7548776662) % 1      # low-discrepancy: smooth sums
        normal = np.log(grid[1] / (1 - grid[1])) / 1.702                 # nearly standard normal
        if name in ("domain_kinetics", "electrostriction"):            # Weibull coercive fields down to zero
            self.id, a = 0, rng.uniform(0.3, 0.55) * (-np.log(1 - grid[0])) ** (1 / rng.uniform(1.3, 2.2))
            b, c = rng.uniform(0.1, 0.25) * normal + rng.uniform(-0.1, 0.1), rng.uniform(0.08, 0.2) + 0.1 * grid[2]
            self.q = rng.uniform(0.05, 0.2) * rng.choice([-1, 1]) if name == "electrostriction" else 0.0
        elif name == "homogenised_energy":                # lognormal coercive, normal interaction field, thermal width
            self.id, a = 0, rng.uniform(0.35, 0.5) * np.exp(0.8 * np.log(grid[0] / (1 - grid[0])) / 1.702)
            b, c = rng.uniform(0.3, 0.5) * normal, np.full(n, rng.uniform(0.05, 0.1))
        elif name == "landau_wells":
            self.id, self.largest, a = 1, 0.002, 0.05 + rng.uniform(0.8, 1.1) * grid[0] ** rng.uniform(0.7, 1.1)
            b, c, states = rng.uniform(0.2, 0.3) * normal, rng.uniform(0.03, 0.06) * np.ones(n), 2
        elif name == "wall_pinning":
            self.id, a = 2, rng.uniform(0.8, 1.1) * (0.03 + grid[0] ** rng.uniform(0.8, 1.3))
            b, c = grid[1], rng.uniform(0.05, 0.09) * (0.7 + 0.6 * grid[2])
            self.par[:2] = rng.uniform(0.7, 1.0), rng.uniform(0.1, 0.5)
        elif name == "bristles":
            self.id, a = 3, rng.uniform(0.8, 1.3) * grid[0] ** 1.3 + 0.02
            self.par[:3] = rng.uniform(-0.3, 0.6), rng.uniform(-0.25, 0.25), rng.uniform(0.05, 0.4)
        elif name == "jiles_atherton":
            self.id, self.largest = 4, 0.004
            self.par[:4] = rng.uniform(0.5, 0.8), rng.uniform(0.5, 0.8), rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.3)
        else:
            self.id, states = 5, 6                          # density varies with mean field and width
            self.par[:4] = 1, rng.uniform(-0.15, 0.15), rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.15)
        self.name, self.classes, self.cache = name, [np.ascontiguousarray(v, float) for v in (a, b, c)], {}
        self.start = np.zeros(states * n + 10)
        if self.id == 1:                                               # virgin grains: both wells alike
            self.start[:2 * n] = np.tile(np.where(np.arange(n) % 2, 1.0, -1.0), 2)
        self.mix, self.offset, self.scale, target = 0.0, 0.0, 1.0, rng.uniform(0.07, 0.15)
        x = np.concatenate([np.linspace(0, 1, 200), np.tile(np.r_[np.linspace(1, -1, 400), np.linspace(-1, 1, 400)], 4)])
        p = self.irreversible(x)
        self.offset, self.scale = (p[-800:].max() + p[-800:].min()) / 2, np.ptp(p[-800:]) / 2
        lo, hi = 0.02, 1.0
        for _ in range(30):
            self.mix = (lo + hi) / 2
            lo, hi = (self.mix, hi) if self.opening(x, p) < target else (lo, self.mix)
        self.loop_opening = self.opening(x, p)

    def opening(self, x, p):
        h = self.blend(x, (p - self.offset) / self.scale)[-800:]
        return np.abs(h[:400] - h[400:][::-1]).max() / np.ptp(h)

    def irreversible(self, x):
        key = hashlib.sha1(x.tobytes()).hexdigest()
        if key not in self.cache:
            out, state = np.empty_like(x), self.start.copy()
            _c("law", self.id, len(x), x, out, len(self.classes[0]), *self.classes, state, self.par, self.largest)
            self.cache[key] = out
        return self.cache[key]

    def blend(self, x, p):
        h = (1 - self.mix) * x + self.mix * p
        return h + self.q * h * h

    def strain(self, x, field):
        """Reversible part follows x, the irreversible one the effective field (the same unless rate dependent)."""
        return self.blend(x, (self.irreversible(np.ascontiguousarray(field)) - self.offset) / self.scale)


def _triangle(phase):
    return 1 - np.abs((phase + 0.25) % 1 * 4 - 2)


def _drive(kind, n, rate, amp, rng):
    """Normalised drive of n samples, and the phase of its line (periods) or None."""
    t, periods = np.arange(n) / rate, int(rng.integers(3, 9))
    phase = np.arange(n) * periods / n
    if kind in ("triangle", "sine"):
        if rng.random() < 0.4:                                         # two speeds in one file
            f = np.where(np.arange(n) < n // 2, 1.0, rng.uniform(1.7, 3.5))
            phase = np.r_[0, np.cumsum(f)[:-1]] * (periods + 2) / f.sum()
        levels = np.ones(40) if rng.random() < 0.4 else rng.permutation(np.r_[1, rng.uniform(0.25, 1, 39)])
        k = np.minimum(phase.astype(int), 39)
        levels[int(rng.integers(0, 2))] = 1
        return amp * levels[k] * (_triangle(phase) if kind == "triangle" else np.sin(2 * np.pi * phase)), phase
    if kind == "raster":
        phase = np.arange(n) * int(rng.integers(12, 40)) / n
        fly, part = rng.uniform(0.1, 0.3), phase % 1
        line = np.where(part < 1 - fly, part / (1 - fly), (1 - part) / fly) * 2 - 1
        return amp * (0.7 * line + 0.3 * np.linspace(-1, 1, n)), phase
    if kind == "spiral":
        phase = np.arange(n) * (periods + 8) / n
        return amp * np.linspace(0, 1, n) * np.sin(2 * np.pi * phase), phase
    if kind == "minor":
        turns = [0, 1, -1, 1]
        for _ in range(int(rng.integers(3, 7))):
            a, b = np.sort(rng.uniform(-0.9, 0.9, 2))
            turns += [a, b] * 2 + [a, rng.choice([-1, 1])]
        way = np.r_[0, np.cumsum(np.abs(np.diff(turns)))]
        return amp * np.interp(np.linspace(0, way[-1], n), way, turns), None
    if kind == "two_tone":
        return amp * (0.65 * np.sin(2 * np.pi * phase) + 0.35 * np.sin(2 * np.pi * phase * rng.uniform(3, 9))), None
    if kind == "noise":
        s = sosfiltfilt(butter(3, rng.uniform(0.004, 0.02), output="sos"), rng.standard_normal(n + 4000))[2000:-2000]
        return amp * s / np.abs(s).max(), None
    if kind == "staircase":
        m = int(rng.integers(8, 20))
        levels = np.r_[0, 1, -1, rng.uniform(-1, 1, m)] if rng.random() < 0.5 else _triangle(np.arange(m + 1) / m)
        edge = np.arange(1, len(levels)) / len(levels)
        knots = np.sort(np.r_[0, edge, edge + rng.uniform(0.05, 0.4) / len(levels), 1.2])
        return amp * np.interp(np.arange(n) / n, knots, np.repeat(levels, 2)), None
    top, low = rate * rng.uniform(0.1, 0.18), rng.uniform(4, 20)
    if kind == "chirp":
        c = np.log(top / low)
        return amp * np.sin(2 * np.pi * low * (n / rate) / c * np.expm1(c * t * rate / n)), None
    if kind == "stepped_sine":
        m = int(rng.integers(12, 22))
        part = np.minimum(np.arange(n) * m // n, m - 1)
        return amp * np.sin(2 * np.pi * np.cumsum(np.geomspace(low * 2, top, m)[part]) / rate), None
    bits = rng.choice([-1.0, 1.0], n)                                # pseudo-random sequence
    return amp * np.repeat(bits, int(rng.integers(4, 12)))[:n], None


class _Stage:
    """Everything that depends on the seed alone."""

    def __init__(self, seed):
        rng = np.random.default_rng([seed, 7001])
        self.seed, self.law = seed, _Law(LAWS[int(rng.integers(len(LAWS)))], rng)
        self.stroke, self.polarity = _log(rng, 2e-6, 1e-4), int(rng.choice([1, 1, -1]))
        self.noise, self.origin = self.stroke * _log(rng, 1e-4, 1e-3), self.stroke * rng.uniform(-0.2, 0.2)
        self.gain, self.out = [(15, (-150, 150)), (10, (-100, 100)), (20, (-200, 200)), (15, (-30, 150))][rng.integers(4)]
        lo, hi = np.array(self.out) / self.gain * rng.uniform(0.75, 0.97)
        self.centre, self.half = (lo + hi) / 2, (hi - lo) / 2              # of the converter's voltage
        self.amp_sheet, self.sensor_sheet = round(_log(rng, 800, 6000), -2), round(_log(rng, 2000, 12000), -2)
        self.amp_hz, self.sensor_hz = (v * rng.uniform(0.97, 1.03) for v in (self.amp_sheet, self.sensor_sheet))
        self.adc = self.stroke * 1.6 / 65536
        self.decoys = [d for d in DECOYS if rng.random() < 0.4] if rng.random() < 0.5 else []
        self.bent = rng.uniform(0.01, 0.04) * rng.choice([-1, 1]) if "bent_reversible" in self.decoys else 0.0
        self.plan(rng)
        self.timeline(rng)

    def plan(self, rng):
        count = int(rng.integers(2, 6))
        plain = ["triangle", "sine", "raster", "spiral", "minor", "two_tone", "noise", "staircase"]
        names = [str(rng.choice(["triangle", "sine"])), *rng.choice(plain, count - 1)]
        names[1] = "raster" if rng.random() < 0.3 else names[1]
        if rng.random() < 0.8:
            names[-1] = str(rng.choice(["chirp", "stepped_sine", "prbs"]))
        else:
            names[1] = "raster"                                        # its flyback excites the dynamics a little
        if "odd_last_file" in self.decoys:
            names = names[:4] + [str(rng.choice(["staircase", "noise"]))]
        elif rng.random() < 0.4:
            names = list(rng.permutation(names))
        self.files, first = [], True
        for i, kind in enumerate(map(str, names)):
            dynamic = kind in ("chirp", "stepped_sine", "prbs")
            n = int(rng.integers(3000, 14000 if dynamic else 12000))
            rate = int(rng.choice([10000, 20000] if dynamic else [200, 500, 1000, 2000, 5000]))
            if kind == "raster" or (i == 1 and rng.random() < 0.5 and not dynamic):
                rate = int(rng.choice([10000, 20000]))                     # one faster recording
            small = np.clip(2 * self.noise / self.stroke * rng.uniform(40, 150), 0.006, 0.06)
            amp = small if dynamic else 1.0 if first else rng.uniform(0.3, 1)
            first = first and dynamic
            lead = int(n * rng.uniform(0.05, 0.15)) if "mid_motion_start" in self.decoys and i % 2 == 0 else 0
            s, phase = _drive(kind, n + lead, rate, amp, rng)
            s = s + (rng.uniform(-0.3, 0.3) if dynamic else 0)
            phase = np.full(n + lead, np.nan) if phase is None else phase
            holds = [(0, n // 12), (n + lead - 1, n // 10)] if "rest_around" in self.decoys and not lead else []
            holds += [((n + lead) * 2 // 5, n // 11)] if "hold_inside" in self.decoys and not dynamic else []
            for at, m in sorted(holds, reverse=True):
                s, phase = (np.insert(v, at, np.full(m, v[at])) for v in (s, phase))
            style, cycles = int(rng.integers(3)), rng.uniform(0.5, 2.5)
            y = [lambda q: np.sin(2 * np.pi * cycles * q + 1), lambda q: 2 * q - 1,
                 lambda q: np.round(4 * np.sin(2 * np.pi * cycles * q)) / 4][style](np.arange(len(s)) / len(s))
            name = f"{i + 1:02d}_{kind}.csv" if self.seed % 2 else f"{kind}_{rate}_{i}.csv"
            self.files.append({"file": name, "kind": kind, "rate": rate, "volts": s * self.half + self.centre,
                               "phase": phase, "lead": lead, "y": 10 * 0.8 * y, "n": len(s) - lead,
                               "noise": rng.uniform(0.85, 1.2) if "uneven_noise" in self.decoys else 1.0})

    def timeline(self, rng):
        """Concatenate the pasts and the recordings on a fine grid; 'slot' is where an unexpected history would be."""
        parts, last, last_y, at = {"u": [], "dt": [], "phase": [], "y": []}, 0.0, 0.0, 0
        for f in self.files:
            v = f["volts"] = np.round(f["volts"] / (20 / 65536)) * (20 / 65536)
            yv = f["y"] = np.round(f["y"] / (20 / 65536)) * (20 / 65536)
            rests, sign = rng.random() < 0.4, rng.choice([0, 1])
            ends = (v.max(), v.min()) if sign else (v.min(), v.max())
            knots = [last, v[0], *(ends + (v[0],)) * int(rng.integers(3, 5))]
            past = np.concatenate([np.linspace(a, b, 250, endpoint=False) for a, b in zip(knots, knots[1:])])
            past = [(past, rng.uniform(1, 3) / 750), (np.full(60, v[0]), (_log(rng, 5, 300) if rests else 0.3) / 60),
                    (np.full(400, v[0]), 2 / 400)]
            os_ = f["os"] = 4 if f["rate"] >= 5000 else 2
            fine = np.arange((len(v) - 1) * os_ + 1) / os_
            for u, dt in past:
                parts["u"].append(u), parts["dt"].append(np.full(len(u), dt))
            m = sum(len(u) for u, _ in past)
            f["slot"], f["start"] = slice(at + m - 400, at + m), at + m + f["lead"] * os_
            parts["u"].append(np.interp(fine, np.arange(len(v)), v))
            parts["dt"].append(np.full(len(fine), 1 / f["rate"] / os_))
            parts["phase"] += [np.full(m, np.nan), np.interp(fine, np.arange(len(v)), f["phase"])]
            parts["y"] += [np.r_[np.linspace(last_y, yv[0], 200), np.full(m - 200, yv[0])],
                           np.interp(fine, np.arange(len(v)), yv)]
            at, last, last_y = at + m + len(fine), v[-1], yv[-1]
            f["at"] = f["start"] + np.arange(f["n"]) * os_
        for k, v in parts.items():
            setattr(self, k, np.ascontiguousarray(np.concatenate(v)))
        self.t = np.cumsum(self.dt)
        self.fine = np.concatenate([np.arange(f["start"], f["at"][-1] + 1) for f in self.files])
        rate = np.abs(np.diff(self.u, prepend=self.u[0]) / self.dt)
        self.fastest = rate[self.fine].max() * self.gain                       # V/s at the amplifier's output

    def volts(self, P):
        u = self.u
        if "initial_state" in P:
            p = P["initial_state"]
            u, f = u.copy(), self.files[p["index"]]
            v, way = f["volts"], np.bartlett(402)[1:-1]
            far = (v.max() if p["side"] > 0 else v.min()) + p["side"] * p["excursion_beyond"] * self.half
            far = self.centre + np.clip(far - self.centre, -2.4 * self.half, 2.4 * self.half)
            u[f["slot"]] = u[f["slot"]] + (far - v[0]) * way
        if "crossover_distortion" in P:
            d = P["crossover_distortion"]["dead_zone"] * self.half
            u = u - d * np.tanh(u / d)
        slew, lo, hi = 1e300, -1e300, 1e300
        if "slew_limit" in P:
            slew = self.fastest / P["slew_limit"]["slowness"]
        if "amplifier_saturation" in P:
            p = P["amplifier_saturation"]
            reach = self.half * (1 - 2 * p["depth"])
            lo, hi = ((self.centre + s * reach) * self.gain if s in p["sides"] else s * 1e300 for s in (-1, 1))
        return _pole(u * self.gain, self.dt, self.amp_hz, slew, lo, hi)

    def readings(self, P):
        """Displacement readings [m] of all files, concatenated per file, with the hidden effects P."""
        t, dt, pos = self.t, self.dt, self.stroke / 2
        x = (self.volts(P) / self.gain - self.centre) / self.half
        field = x
        if "rate_dependence" in P:
            p = P["rate_dependence"]
            field = x - p["field_per_efold"] * np.arcsinh(np.gradient(x, t) / p["speed"])
        h = self.law.strain(x, field)
        h = pos * self.polarity * (h + self.bent * h * h)
        if "creep" in P:
            h = h + sum(0.5 * P["creep"]["share_per_decade"] * _pole(h, dt, 1 / (2 * np.pi * tau))
                        for tau in np.geomspace(0.02, 2000, 11))
        if _TWO_AXES & P.keys():
            y = _pole(self.y * self.gain, dt, self.amp_hz) / self.gain / 8
            if "tilt_gain" in P:
                h = h * (1 + P["tilt_gain"]["gain_per_range"] * y)
            if "cross_coupling" in P:
                h = h + pos * P["cross_coupling"]["share"] * P["cross_coupling"]["sign"] * self.law.strain(y, y)
        if "gain_change" in P:
            p, f = P["gain_change"], self.files[P["gain_change"]["index"]]
            h, k = h.copy(), f["at"][int(p["where"] * f["n"])]
            h[k:None if p["persists"] else f["at"][-1] + 1] *= 1 + p["sign"] * p["change"]
        add = 0.0
        if "windage" in P:
            v = np.gradient(x, t) ** 2
            add = add + P["windage"]["amplitude_m"] * v / (v + P["windage"]["speed"] ** 2)
        if "guide_bump" in P:
            p = P["guide_bump"]
            add = add + p["height_m"] * np.exp(-0.5 * ((h - p["place_m"]) / p["width_m"]) ** 2)
        if "slippage" in P:
            way = np.cumsum(np.abs(np.diff(h, prepend=h[0])))
            add = add + P["slippage"]["total_m"] * P["slippage"]["sign"] * way / way[-1]
        if "clamp_settling" in P:
            add = add + P["clamp_settling"]["amplitude_m"] * self.since_turn(P["clamp_settling"]["time_constant_s"])
        h = h + add
        if "resonance" in P:
            p = P["resonance"]
            h = (1 - p["share"]) * h + p["share"] * _mode(h, dt, p["frequency_Hz"], p["Q"])[0]
        if "notch_left_in" in P:
            p = P["notch_left_in"]
            h = h - p["depth"] * _mode(h, dt, p["frequency_Hz"], p["Q"])[1]
        if "thermal_drift" in P:
            p = P["thermal_drift"]
            h = h + p["amplitude_m"] * sum(a * np.sin(2 * np.pi * t / T + q) for a, T, q in
                                           zip(p["weights"], p["periods_s"], p["phases"]))
        if "compressor_burst" in P:
            p = P["compressor_burst"]
            h = h + p["amplitude_m"] * np.sin(2 * np.pi * p["frequency_Hz"] * t) * \
                ((t / p["every_s"] + p["offset"]) % 1 < 0.35)
        if "delay" in P:
            h = np.interp(t - P["delay"]["delay_s"], t, h)
        if "lag" in P:
            h = _pole(h, dt, 1 / (2 * np.pi * P["lag"]["time_constant_s"]))
        if "sensor_periodic_error" in P:
            p = P["sensor_periodic_error"]
            arg = 2 * np.pi * h / p["wavelength_m"]
            h = h + p["amplitude_m"] * (np.sin(arg + p["phase"]) + p["second"] * np.sin(2 * arg))
        if "line_pickup" in P:
            p = P["line_pickup"]
            d = (np.nan_to_num(self.phase, nan=0.5 + p["line_phase"]) - p["line_phase"] + 0.5) % 1 - 0.5
            h = h + p["amplitude_m"] * np.exp(-0.5 * (d / p["width"]) ** 2)
        h = _pole(h + self.origin, dt, self.sensor_hz)
        return [self.acquire(i, h[f["at"]], t[f["at"]], P) for i, f in enumerate(self.files)]

    def since_turn(self, tau):
        """After every turn of the drive a sag that grows and fades, in proportion to the leg before the turn."""
        move = np.sign(np.diff(self.u, prepend=self.u[0]))
        moving = np.flatnonzero(move)
        turn = moving[1:][move[moving[1:]] != move[moving[:-1]]]
        k = np.searchsorted(turn, np.arange(len(self.u)), side="right") - 1
        leg = np.diff(self.u[turn], prepend=self.u[0]) / (2 * self.half)
        z = np.where(k >= 0, (self.t - self.t[turn][k]) / tau, 0.0)
        return np.where(k >= 0, leg[k], 0.0) * z * np.exp(1 - z)

    def acquire(self, i, r, t, P):
        f, n = self.files[i], len(r)
        r = r + self.noise * f["noise"] * np.random.default_rng([self.seed, 7002, i]).standard_normal(n)
        if "mains_interference" in P:
            p = P["mains_interference"]
            r = r + p["amplitude_m"] * sum(a * np.sin(2 * np.pi * p["frequency_Hz"] * m * t + q)
                                           for m, (a, q) in enumerate(zip(p["weights"], p["phases"]), 1))
        if "outliers" in P and i in P["outliers"]["files"]:
            g = np.random.default_rng([self.seed, 7003, i])
            at = g.choice(n, max(4, int(P["outliers"]["share"] * n)), replace=False)
            r[at] += P["outliers"]["height_m"] * g.choice([-1, 1], len(at)) * g.uniform(0.5, 1.3, len(at))
        if "interleaved_offset" in P:
            r = r + P["interleaved_offset"]["offset_m"] * (np.arange(n) % P["interleaved_offset"]["period"] == 0)
        if "missing_codes" in P:
            for c in P["missing_codes"]["codes_m"]:
                r = np.where((r > c) & (r < c + P["missing_codes"]["width_m"]), c, r)
        step = P["quantisation"]["step_m"] if "quantisation" in P else self.adc
        return np.round(r / step) * step


def _draw(stage, kind, rng):
    """Parameters of an effect besides its strength."""
    files, S = stage.files, stage.stroke
    wide = [i for i, f in enumerate(files) if np.ptp(f["volts"]) > 0.4 * stage.half]
    longest = max(f["n"] / f["rate"] for f in files)
    speeds = [np.std(np.diff(f["volts"])) * f["rate"] / stage.half for f in files]
    quick = max(f["rate"] for f in files)
    dynamic = any(f["kind"] in ("chirp", "stepped_sine", "prbs") for f in files)
    signs = float(rng.choice([-1, 1]))
    frequency = _log(rng, 200, 1300 if dynamic else min(500, quick / 8) if quick > 2000 else 220)
    return {
        "thermal_drift": lambda: {"weights": [0.6, 1.0, 0.3], "phases": list(rng.uniform(0, 6.28, 3)),
                                  "periods_s": [longest * rng.uniform(a, 2 * a) for a in (6, 2, 0.8)]},
        "rate_dependence": lambda: {"speed": min(speeds[i] for i in wide) * 0.3},
        "resonance": lambda: {"frequency_Hz": frequency, "Q": _log(rng, 5, 60)},
        "notch_left_in": lambda: {"frequency_Hz": frequency, "Q": _log(rng, 1, 4)},
        "cross_coupling": lambda: {"sign": signs},
        "mains_interference": lambda: {"frequency_Hz": float(rng.choice([50, 60])) * rng.uniform(0.9995, 1.0005), "weights": [
            1.0, rng.uniform(0, 0.3), rng.uniform(0.1, 0.6)], "phases": list(rng.uniform(0, 6.28, 3))},
        "sensor_periodic_error": lambda: {"wavelength_m": _log(rng, max(1e-7, S / 40), max(1.2e-7, min(5e-6, S / 4))),
                                          "phase": rng.uniform(0, 6.28), "second": rng.uniform(0, 0.4)},
        "amplifier_saturation": lambda: {"sides": [(-1, 1), (1,), (-1,)][rng.integers(3)]},
        "gain_change": lambda: {"index": int(rng.choice(wide)), "where": rng.uniform(0.3, 0.7), "sign": signs,
                                "persists": bool(rng.random() < 0.5)},
        "timestamp_fault": lambda: {"mode": str(rng.choice(["gap", "renumbered", "stall"])), "index": int(rng.choice(wide)),
                                    "where": rng.uniform(0.2, 0.7)},
        "outliers": lambda: {"files": sorted({int(rng.integers(len(files))) for _ in range(3)}),
                             "share": _log(rng, 0.001, 0.006)},
        "initial_state": lambda: {"index": min(wide, key=lambda i: np.ptp(files[i]["volts"])), "side": signs},
        "compressor_burst": lambda: {"frequency_Hz": rng.uniform(17, 38), "every_s": longest * rng.uniform(0.3, 0.9),
                                     "offset": rng.uniform(0, 1)},
        "windage": lambda: {"speed": max(speeds[i] for i in wide) * rng.uniform(0.5, 1)},
        "guide_bump": lambda: {"place_m": S * rng.uniform(-0.25, 0.25), "width_m": S * rng.uniform(0.01, 0.04)},
        "missing_codes": lambda: {"codes_m": list(stage.origin + S * rng.uniform(-0.3, 0.3, 3))},
        "interleaved_offset": lambda: {"period": int(rng.choice([2, 4, 8, 16]))},
        "clamp_settling": lambda: {"time_constant_s": rng.uniform(0.04, 0.1) * files[wide[0]]["n"] / files[wide[0]]["rate"] / 5},
        "line_pickup": lambda: {"line_phase": rng.uniform(0.1, 0.9), "width": rng.uniform(0.01, 0.03)},
        "slippage": lambda: {"sign": signs},
    }.get(kind, dict)()


def _effect(stage, kind, size, healthy):
    """True parameters of an effect: its strength is tuned to 8..40 noise in the recording that shows it most."""
    rng = np.random.default_rng([stage.seed, *kind.encode()])
    p, (_, _, name, lo, hi, unit) = _draw(stage, kind, rng), _KINDS[kind]
    lo, hi = (v * (stage.noise if unit == "noise" else 1) for v in (lo, hi))
    target, still = _log(rng, 8, 40), stage.volts({}) if kind in _ON_DRIVE else None

    def seen(k):
        q = {kind: {**p, name: k}}
        if kind in _ON_DRIVE:                                          # judged on the voltage: cheap
            d = (stage.volts(q) - still) / stage.gain / stage.half * stage.stroke / 2
            diffs = [d[f["at"]] for f in stage.files]
        else:
            diffs = [a - b for a, b in zip(stage.readings(q), healthy)]
        return max(np.std(d) for d in diffs) / stage.noise

    if kind == "timestamp_fault":
        k = _log(rng, 60, hi) * size
    elif kind in _ON_DRIVE:                                            # bisection on a logarithmic scale
        for _ in range(25):
            k = np.sqrt(lo * hi)
            lo, hi = (k, hi) if seen(k) < target * size else (lo, k)
    else:
        if kind == "initial_state":                                    # come from the side that matters more
            p["side"] = max((1.0, -1.0), key=lambda s: (p.update(side=s), seen(hi))[1])
        k = np.sqrt(lo * hi)
        for _ in range(3):
            k = float(np.clip(k * target / max(seen(k), 1e-9), lo, hi))
        while kind == "resonance" and p["frequency_Hz"] < 1400 and seen(k) > 60:
            p.update({"Q": max(5.0, p["Q"] * 0.6)} if p["Q"] > 5 else {"frequency_Hz": min(1400, p["frequency_Hz"] * 1.3)})
        k *= size
    p[name] = int(round(k)) if kind == "timestamp_fault" else float(k)
    return p


def _report(stage, kind, p):
    """The true numbers, also in the units a user would expect, as plain Python values."""
    p = {k: np.asarray(v).tolist() for k, v in p.items()}
    if "index" in p:
        p["file"] = stage.files[p["index"]]["file"]
    if kind == "gain_change":
        p["time_s"] = int(p["where"] * stage.files[p["index"]]["n"]) / stage.files[p["index"]]["rate"]
    elif kind == "lag":
        p["pole_Hz"] = 1 / (2 * np.pi * p["time_constant_s"])
    elif kind == "slew_limit":
        p["slew_V_per_s"] = float(stage.fastest / p["slowness"])
    elif kind == "amplifier_saturation":
        p["limits_V"] = [float((stage.centre + s * stage.half * (1 - 2 * p["depth"])) * stage.gain) for s in p["sides"]]
    return p


def _lab(stage, two):
    amplifier = (f"gain_V_per_V = {stage.gain}\nbandwidth_Hz = {stage.amp_sheet:.0f}\n"
                 f"output_min_V = {stage.out[0]}\noutput_max_V = {stage.out[1]}\n")
    heads = ("[axis.x.amplifier]\n", "[axis.y.amplifier]\n") if two else ("[amplifier]\n",)
    columns = 'columns = { voltage = "voltage_x [V]", displacement = "displacement_x [um]" }\n' if two else ""
    return (f'[rig]\nname = "scanner stage {stage.seed}"\n' + "".join(h + amplifier for h in heads)
            + f"[{'axis.x.' if two else ''}sensor]\nbandwidth_Hz = {stage.sensor_sheet:.0f}\n[acquisition]\n"
            f"sampling_rate_Hz = {max(f['rate'] for f in stage.files)}\ndac_bits = 16\nadc_bits = 16\n"
            "input_range_V = [-10, 10]\n"
            + "".join(f'[[recording]]\nfile = "{f["file"]}"\naxis = "x"\n{columns}' for f in stage.files))


def write(seed, kinds, size, folder, measure=True):
    stage, folder = _Stage(seed), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    healthy = stage.readings({})
    P = {k: _effect(stage, k, size, healthy) for k in kinds}
    readings, two = stage.readings(P), bool(_TWO_AXES & P.keys())
    for i, f in enumerate(stage.files):
        v, y, t = f["volts"][f["lead"]:], f["y"][f["lead"]:], np.arange(f["n"]) / f["rate"]
        keep = np.ones(f["n"], bool)
        fault = P.get("timestamp_fault", {"index": -1})
        if fault["index"] == i:
            a, m = int(fault["where"] * f["n"]), fault["rows"]
            if fault["mode"] == "stall":
                t = np.r_[t[:a], np.full(m, t[a]), t[a:f["n"] - m]]      # the clock stood, then went on
            else:
                keep[a:a + m] = False
                t = t if fault["mode"] == "gap" else np.r_[t[:a + m], t[a:f["n"] - m]]
        table = np.column_stack([t, v, y, readings[i] * 1e6] if two else [t, v, readings[i] * 1e6])[keep]
        head = "time [s],voltage_x [V],voltage_y [V],displacement_x [um]" if two else "time [s],voltage [V],displacement [um]"
        comment = "# exported by the scanner's logger\n" if "comment_line" in stage.decoys and i == 0 else ""
        row = ",".join(["%.6f"] + ["%.5f"] * (1 + two) + ["%.6f"]) + "\n"
        (folder / f["file"]).write_text(comment + head + "\n" + "".join(row % tuple(r) for r in table.tolist()))
        f["rows"] = len(table)
    (folder / "lab.toml").write_text(_lab(stage, two))
    mode, effects = P.get("resonance", {}), []
    for k in kinds:
        entry = {"kind": k, "catalogue": _KINDS[k][0], "parameters": _report(stage, k, P[k])}
        if measure:
            less = stage.readings({q: v for q, v in P.items() if q != k})
            entry["by_recording"] = {}
            for f, a, b in zip(stage.files, readings, less):         # rms as asked for; std: without a constant offset
                rms, std = float(np.sqrt(np.mean((a - b) ** 2))) / stage.noise, float(np.std(a - b)) / stage.noise
                entry["by_recording"][f["file"]] = {"rms_over_noise": None, "std_over_noise": None} \
                    if k == "timestamp_fault" else {"rms_over_noise": rms, "std_over_noise": std}
        effects.append(entry)
    return {"seed": seed, "law": stage.law.name, "noise_m": stage.noise, "stroke_m": stage.stroke, "polarity": stage.polarity,
            "mode_Hz": mode.get("frequency_Hz"), "mode_Q": mode.get("Q"), "amplifier_Hz": stage.amp_hz,
            "sensor_Hz": stage.sensor_hz, "decoys": list(stage.decoys), "effects": effects, "recordings": {
                f["file"]: {"kind": f["kind"], "rate_Hz": f["rate"], "samples": f["rows"]} for f in stage.files}}
