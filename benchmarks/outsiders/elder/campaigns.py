"""Campaigns of simulated piezo stages with known hidden effects (an outsider's simulator)."""
import ctypes, hashlib, subprocess, tempfile
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace as NS
import numpy as np
from scipy import signal

LAWS = ("preisach_gaussian", "preisach_lorentzian", "preisach_power", "bouc_wen_asymmetric", "dahl_walls", "duhem",
        "coleman_hodgdon", "jiles_atherton", "maxwell_bent", "krasnoselskii_pokrovskii", "kinetic_relays", "generalised_play")
C_IDS = (0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9)
MENU = ("triangle", "sine", "minor_loops", "two_tone", "noise", "steps")
GRID = np.linspace(-1, 1, 401)

# kind: (catalogue name, coordinate); the order is also the order of the reading errors
_KINDS = {
    "creep": ("creep", "time"), "thermal_drift": ("thermal_drift", "time"), "rate_dependence": ("rate_dependence", "speed"),
    "resonance": ("resonance", "frequency"), "delay": ("delay", "frequency"), "lag": ("lag", "frequency"),
    "cross_coupling": ("cross_coupling", "other_axis"), "mains_interference": ("mains_interference", "line_phase"),
    "sensor_periodic_error": ("sensor_periodic_error", "displacement"), "amplifier_saturation": ("amplifier_saturation", "drive"),
    "slew_limit": ("slew_limit", "speed"), "gain_change": ("gain_change", "time"), "quantisation": ("quantisation", "reading"),
    "timestamp_fault": ("timestamp_fault", "sample_index"), "outliers": ("outliers", "sample_index"),
    "initial_state": ("initial_state", None),
    "loose_connector": (None, "time"), "laser_mode_hop": (None, "time"), "temperature_controller": (None, "time"),
    "pump_beat": (None, "frequency"), "dac_bit_error": (None, "drive"), "encoder_scratch": (None, "displacement"),
    "adc_seam": (None, "reading"), "buffer_glitch": (None, "sample_index"), "eddy_speed_error": (None, "speed"),
    "speed_noise": (None, "speed"), "lamp_dimmer": (None, "line_phase"), "turn_sticking": (None, "distance"),
    "turn_rattle": (None, "since_turn"), "guide_settling": (None, "distance"), "neighbour_shadow": (None, "other_axis"),
}
# other names a careful reader could give, judged before any tool was run
FAIR = {
    "creep": {"thermal_drift", "rate_dependence"}, "thermal_drift": {"creep"}, "rate_dependence": {"creep", "lag"},
    "resonance": {"lag", "delay"}, "delay": {"lag"}, "lag": {"delay", "rate_dependence", "resonance"},
    "cross_coupling": set(), "mains_interference": set(), "sensor_periodic_error": set(), "quantisation": set(),
    "amplifier_saturation": set(), "slew_limit": {"lag", "amplifier_saturation"}, "gain_change": {"thermal_drift"},
    "timestamp_fault": {"delay"}, "outliers": set(), "initial_state": {"thermal_drift", "creep"},
    "loose_connector": {"outliers"}, "laser_mode_hop": {"gain_change", "thermal_drift"}, "temperature_controller": {"thermal_drift"},
    "pump_beat": {"mains_interference"}, "dac_bit_error": set(), "encoder_scratch": {"sensor_periodic_error"},
    "adc_seam": {"quantisation"}, "buffer_glitch": {"outliers"}, "eddy_speed_error": {"rate_dependence"}, "speed_noise": {"outliers"},
    "lamp_dimmer": {"mains_interference"}, "turn_sticking": {"rate_dependence"}, "turn_rattle": {"resonance"},
    "guide_settling": {"creep", "thermal_drift"}, "neighbour_shadow": {"cross_coupling"},
}
# strength at full size: lower and upper bound where physics sets the range
BOUNDS = {"creep": (.005, .03), "rate_dependence": (.01, .5), "resonance": (.3, 1), "delay": (1e-4, 3e-3), "lag": (8e-5, 8e-3),
          "amplifier_saturation": (.005, .4), "slew_limit": (.02, None), "gain_change": (.01, .06), "initial_state": (.15, 1)}
NEEDS_Y = {"cross_coupling", "neighbour_shadow"}


def kinds():
    return {k: {"catalogue": c, "coordinate": x} for k, (c, x) in _KINDS.items()}


def _rng(*key):
    return np.random.default_rng(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()[:8], "big"))


def _log(r, a, b):
    return float(np.exp(r.uniform(np.log(a), np.log(b))))


@lru_cache(None)
def _lib():
    out = Path(tempfile.mkdtemp(prefix="stage_")) / "physics.so"
    subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", str(Path(__file__).with_name("physics.c")), "-o", str(out), "-lm"], check=True)
    return ctypes.CDLL(str(out))


def _c(name, *args):
    """Call a C loop: arrays go as double*, the last argument is filled and returned."""
    conv = [np.ascontiguousarray(a, float) if isinstance(a, np.ndarray) else a for a in args]
    ct = [ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else ctypes.c_double(a) if isinstance(a, float) else ctypes.c_long(a) for a in conv]
    getattr(_lib(), name)(*ct)
    return conv[-1]


# ---------------------------------------------------------------- the stage
def _law_parameters(name, r):
    u, w, n = r.uniform, np.zeros(1), 24
    if name.startswith("preisach"):
        m, L = 361, 2.0
        a, b = np.meshgrid(np.linspace(-L, L, m), np.linspace(-L, L, m), indexing="ij")
        c, h = (a + b) / 2 - u(-.15, .15), np.maximum((a - b) / 2, 0)
        if name.endswith("gaussian"): dens = np.exp(-(h - u(.1, .3))**2 / 2 / u(.15, .3)**2 - c**2 / 2 / u(.4, .7)**2)
        elif name.endswith("lorentzian"): dens = 1 / (1 + ((h - u(.35, .6)) / u(.2, .35))**2) / (1 + (c / u(.5, .9))**2)
        else: dens = (h + .05)**-u(.05, .3) * np.exp(-(h / u(.8, 1.2))**2) * (1 - .35 * np.tanh(c)) / (1 + c**4)
        cum = np.pad(np.cumsum(np.cumsum(np.where(a > b, dens, np.where(a == b, .5 * dens, 0)), 0), 1), ((1, 0), (1, 0)))[1:, 1:]
        d = np.diag(cum)
        w = np.triu(d[None, :] - cum - cum.T + d[:, None])          # Everett: mass of lo < beta < alpha < hi
        return [m, L], w
    if name == "bouc_wen_asymmetric": p = [1, u(.6, 1.4), u(.3, .9), u(1, 1.8), u(-.25, .25)]
    elif name == "dahl_walls": p = [u(.35, .6), u(1, 1.6), u(-.25, .25), u(.9, 1.6), u(1, 2), u(-.25, .25), u(.5, 1.5)]
    elif name == "duhem": p = [u(1.1, 1.6), u(.7, 1), u(.45, .6), u(1.5, 2.5), u(1.5, 2.5)]
    elif name == "coleman_hodgdon": p = [u(1.1, 1.6), u(.6, .9), u(.8, 1.6), u(.3, .6), u(-.1, .1)]
    elif name == "jiles_atherton": p = [u(.5, .8), u(.3, .5), u(.05, .2), u(.1, .3), u(-.2, .2)]
    elif name == "maxwell_bent":
        m = 9; p, w = [m, u(.8, 1.2), u(-.22, .22), u(-.12, .05)], u(.4, 1.6, m)
    elif name == "generalised_play":
        m, a = 10, u(.7, 1.1); p = [m, u(.8, 1.1), a, a * u(.85, 1.15), u(-.06, .06), u(-.06, .06)]; w = np.exp(-np.arange(m) / u(8, 20)) * u(.6, 1.4, m)
    else:
        L = 1.5; lev = -L + 2 * L * (np.arange(n) + .5) / n
        i, j = np.tril_indices(n)
        h, c = (lev[i] - lev[j]) / 2, (lev[i] + lev[j]) / 2 - u(-.15, .15)
        w = np.exp(-(h - u(.35, .5))**2 / 2 / u(.25, .4)**2) / (1 + (c / u(.5, .9))**2)
        p = [n, L, u(.15, .25)] if name.startswith("kras") else [n, L, u(.08, .15), u(25, 60)]
    return p, w


def _hysteresis(st, u):
    """Normalised motion (-1..1 for a full cycle of the drive -1..1)."""
    key = hashlib.sha1(u.tobytes()).digest()
    if key not in st.cache:
        if len(st.cache) > 60: st.cache.clear()
        q = _c("law", C_IDS[LAWS.index(st.law)], np.array(st.law_p, float), st.law_w, u, len(u), np.empty(len(u)))
        if st.lead: q = st.lead * u - q                               # friction laws: what the friction leaves of the drive
        st.cache[key] = (1 - st.mix) * (u + st.bend[0] * (u * u - 1) + st.bend[1] * (u**3 - u)) + st.mix * ((q - st.q0) * st.q1)
    return st.cache[key]


@lru_cache(4)
def _stage(seed):
    r = _rng(seed, "stage")
    st = NS(seed=seed, law=LAWS[seed % len(LAWS)], cache={}, mix=1., lead=0., q0=0., q1=1., bend=(0, 0), decoys=[])
    st.law_p, st.law_w = _law_parameters(st.law, _rng(seed, "law"))
    loop = np.concatenate([np.linspace(0, 1, 400)] + [GRID[::-1], GRID] * 3)
    q = _hysteresis(st, loop)[-802:]
    if st.law in ("bouc_wen_asymmetric", "dahl_walls", "maxwell_bent"):
        st.lead = 1.05 * np.max(np.diff(q[401:])) / (GRID[1] - GRID[0])
        st.cache.clear(); q = _hysteresis(st, loop)[-802:]
    q = np.stack([q[:401][::-1], q[401:]])                            # down and up branch on GRID
    lo, hi = q[1, 0], q[1, -1]
    opening = np.max(q[0] - q[1]) / (hi - lo)
    st.q0, st.q1 = (lo + hi) / 2, 2 / (hi - lo)
    st.plain = r.random() < .5                                        # half of the stages carry no decoys
    st.mix = min(r.uniform(.075, .145) / opening, 1.3)
    st.opening = st.mix * opening
    if not st.plain and r.random() < .6: st.bend = (r.uniform(-.05, .05), r.uniform(-.04, .04)); st.decoys.append("bent reversible curve")
    st.cache.clear()
    st.mid_curve = np.mean([_hysteresis(st, loop)[-802:-401][::-1], _hysteresis(st, loop)[-401:]], axis=0)
    st.stroke, st.polarity = _log(r, 5, 100) * 1e-6, int(r.choice([1, 1, 1, -1]))
    st.noise = st.stroke * _log(r, 1e-4, 8e-4)
    st.offset = st.stroke * r.uniform(-.1, .1)
    st.mid, st.half = (0., r.uniform(5, 8)) if r.random() < .6 else (4., r.uniform(3, 3.8))
    st.gain = float(r.choice([10, 15, 15, 20]))
    st.amp_sheet, st.sen_sheet = float(round(_log(r, 2000, 6000), -2)), float(round(_log(r, 3000, 12000), -2))
    st.amp, st.sen = st.amp_sheet * r.uniform(.98, 1.02), st.sen_sheet * r.uniform(.98, 1.02)
    st.mode, st.Q = _log(r, 300, 1500), _log(r, 5, 60)
    st.adc = 1.5 * st.stroke / 65536
    if not st.plain and r.random() < .4: st.adc = st.noise * r.uniform(.5, .9); st.decoys.append("coarse ADC step below the noise")
    st.noise_spread = not st.plain and r.random() < .6
    if st.noise_spread: st.decoys.append("noise differs between files")
    _campaign(st)
    return st


# ---------------------------------------------------------------- the programme
def _programme(kind, r, n, fs, amp, mode):
    t, T, c = np.arange(n) / fs, n / fs, r.uniform(-1, 1) * (1 - amp) * (r.random() < .6)
    if kind in ("triangle", "sine"):
        wave = (lambda p: 2 / np.pi * np.arcsin(np.sin(2 * np.pi * p))) if kind == "triangle" else (lambda p: np.sin(2 * np.pi * p))
        b = int(r.integers(1, 5)); amps = amp * np.array([1.] if b == 1 else r.permutation(np.linspace(r.uniform(.15, .4), 1, b)))
        cyc = r.integers(2, 5, b); rel = np.ones(b) if r.random() < .5 else np.exp(r.uniform(-1, 1, b))
        f = rel * np.sum(cyc / rel) / T                              # blocks of whole cycles fill the file
        edges = np.concatenate([[0], np.cumsum(cyc / f)])
        k = np.clip(np.searchsorted(edges, t, "right") - 1, 0, b - 1)
        return c + amps[k] * wave((t - edges[k]) * f[k])
    if kind == "minor_loops":
        turns = [0.] + [s * amp * x for x in np.linspace(1, .15, int(r.integers(4, 8))) for s in ((1, -1) if r.random() < .7 else (1, -.3))]
        turns = np.array(turns if r.random() < .6 else turns[::-1])
        d = np.concatenate([[0], np.cumsum(np.abs(np.diff(turns)))])
        return c + np.interp(t / T * d[-1], d, turns)
    if kind == "two_tone":
        f, k = r.uniform(2, 6) / T, r.uniform(3.2, 9.5)
        a = r.uniform(.5, .8); return c + amp * (a * np.sin(2 * np.pi * f * t) + (1 - a) * np.sin(2 * np.pi * f * k * t))
    if kind == "noise":
        x = signal.sosfiltfilt(signal.butter(2, _log(r, 8, 60) / T / fs * 2, output="sos"), r.standard_normal(n))
        x = (x - x[0]) * np.minimum(1, t / T * 15); return c + amp * x / np.max(np.abs(x))
    if kind == "steps":
        m = int(r.integers(5, 11)); lev = r.uniform(-1, 1, m) * amp; lev[0] = amp; lev[1] = -amp
        at = np.linspace(.04, 1, m + 1)[:m] * T; ramp = _log(r, 3e-4, 3e-3)
        x = np.zeros(n)
        for a, d in zip(at, np.diff(lev, prepend=0.)): x += d * np.clip((t - a) / ramp, 0, 1)
        return c + x
    if kind == "idle": return np.full(n, c)
    f0, f1 = r.uniform(3, 20), r.uniform(1.3, 2) * mode             # chirp
    ph = 2 * np.pi * (f0 * t + (f1 - f0) * t * t / 2 / T) if r.random() < .5 else 2 * np.pi * f0 * T / np.log(f1 / f0) * ((f1 / f0)**(t / T) - 1)
    return c + amp * np.sin(ph) * np.minimum(1, t / T * 40)


def _campaign(st):
    r = _rng(st.seed, "campaign")
    n_files, chirp = int(r.choice([2, 3, 3, 4, 4, 5, 5])), st.seed % 5 != 3
    plan = [str(r.choice(["triangle", "sine", "triangle", "minor_loops"]))] + [str(r.choice(MENU)) for _ in range(n_files - 2)]
    plan.append("chirp" if chirp else "steps")
    full = int(np.argmax([k in ("triangle", "sine", "minor_loops") for k in plan]))
    small = next((i for i, k in enumerate(plan) if i != full and k != "chirp"), None)
    order = r.permutation(n_files) if r.random() < .5 else range(n_files)
    if not st.plain and n_files < 5 and r.random() < .5: plan.append("idle"); order = [*order, n_files]; st.decoys.append("odd last file: stage at rest")
    st.recs, clock = [], 0.
    for i in order:
        kind, q = plan[i], _rng(st.seed, "file", int(i))
        fast = kind == "chirp" or (kind == "steps" and (not chirp or q.random() < .4))
        fs = int(q.choice([10000, 20000] if fast else [500, 1000, 1000, 2000, 2500, 5000, 8000]))
        n = int(_log(q, 8000, 22000)) if fast else int(_log(q, 3000, 14000))
        amp = 1. if i == full else float(np.clip(st.noise / st.stroke * 2 * q.uniform(25, 60), .01, .06)) if kind == "chirp" \
            else q.uniform(.25, .6) if i == small else q.uniform(.3, .95)
        pre = max(int(.05 * fs), 400)
        motion = _programme(kind, q, n + pre, fs, amp, st.mode)
        decoys, name = [], f"{kind}_{len(st.recs) + 1}.csv"
        if kind not in ("chirp", "steps", "idle") and not st.plain and q.random() < .3: decoys.append("starts in mid-motion")
        else: motion = np.concatenate([np.full(pre, motion[0]), motion[:n]])
        if not st.plain and q.random() < .3: decoys.append("rest before"); motion = np.concatenate([np.full(int(q.uniform(.03, .12) * n), motion[0]), motion])
        if not st.plain and q.random() < .3: decoys.append("rest after"); motion = np.concatenate([motion, np.full(int(q.uniform(.05, .15) * n), motion[-1])])
        if kind in ("triangle", "sine", "minor_loops") and not st.plain and q.random() < .4:
            k = pre + int(q.uniform(.3, .7) * n); decoys.append("hold in the middle"); motion = np.insert(motion, k, np.full(int(.08 * n), motion[k]))
        motion = np.clip(motion, -1, 1)
        lo, hi, m0 = motion.min(), motion.max(), motion[0]
        if q.random() < .6: past = [0, 1, -1] + [hi, lo] * int(q.integers(2, 5)) + [m0]
        else: past = [0, 1] + [m0 + (s - m0) * .85**k for k in range(20) for s in (-1, 1)] + [m0]   # demagnetised
        volts = np.round((st.mid + st.half * motion + 10) / 20 * 65535) / 65535 * 20 - 10
        st.recs.append(NS(index=len(st.recs), file=name, kind=kind, fs=fs, pre=pre, volts=volts, n=len(motion) - pre, past=past, lo=lo, hi=hi,
                          rest=_log(q, 5, 300), clock=clock, noise=st.noise * (q.uniform(.85, 1.15) if st.noise_spread else 1.)))
        clock += n / fs * q.uniform(1.05, 1.6)
        st.decoys += [f"{name}: {d}" for d in decoys]
    for k, rec in enumerate(st.recs):
        q = _rng(st.seed, "other axis", k)
        wave = _programme(str(q.choice(["triangle", "sine", "two_tone", "steps"])), q, rec.n + rec.pre, rec.fs, q.uniform(.5, .9), st.mode)
        idle = k > 0 and q.random() < .25
        rec.vy = np.round((st.mid + st.half * (0 * wave if idle else wave)) / 20 * 65535) / 65535 * 20
    st.longest = max(c.n / c.fs for c in st.recs)
    st.vmax = max(np.max(np.abs(np.diff(c.volts))) * c.fs for c in st.recs)
    st.vplain = max(np.max(np.abs(c.volts[10:] - c.volts[:-10])) * c.fs / 10 for c in st.recs if c.kind not in ("chirp", "idle"))
    st.smooth = [c.index for c in st.recs if c.kind not in ("chirp", "idle")]


# ---------------------------------------------------------------- the effects
def _draw(kind, st):
    """Parameters of an effect besides its strength."""
    r, x = _rng(st.seed, "effect", kind), _log
    n_rec, u = len(st.recs), r.uniform
    f = int(r.choice(st.smooth)); at = u(.25, .75)
    p = {"thermal_drift": lambda: dict(period_s=x(r, .9, 4) * st.longest, phase=u(0, 6.28), slope=u(-1, 1)),
         "rate_dependence": lambda: dict(reference_V_per_s=x(r, .02, .3) * np.median([np.mean(np.abs(np.diff(c.volts))) * c.fs for c in st.recs]), memory_s=x(r, .002, .02)),
         "cross_coupling": lambda: dict(pole_Hz=x(r, 100, 1000), square=u(-.1, .1), sign=float(r.choice([-1, 1]))),
         "mains_interference": lambda: dict(line_Hz=float(r.choice([50, 60])) * (1 + u(-3e-4, 3e-4)), second=u(0, .4), third=u(.1, .5), phase=u(0, 6.28)),
         "sensor_periodic_error": lambda: dict(wavelength_m=float(np.clip(st.stroke / x(r, 8, 50), 1e-7, 5e-6)), phase=u(0, 6.28), second=u(0, .3)),
         "amplifier_saturation": lambda: dict(side=int(r.choice([-1, 0, 1]))),
         "gain_change": lambda: dict(record=max(st.smooth, key=lambda i: st.recs[i].hi - st.recs[i].lo), at=at, sign=float(r.choice([-1, 1])), stays=bool(r.random() < .5)),
         "quantisation": lambda: dict(phase=u(0, 1)), "outliers": lambda: dict(share=x(r, .0008, .005)),
         "timestamp_fault": lambda: dict(record=f, at=at, form=str(r.choice(["lost_hidden", "lost_gap", "clock_stalled"]))),
         "initial_state": lambda: dict(record=f, side=int(r.choice([-1, 1]))),
         "loose_connector": lambda: dict(bursts=int(r.integers(3, 9)), length_share=x(r, .002, .02)),
         "laser_mode_hop": lambda: dict(record=f, hops=int(r.integers(1, 4))),
         "temperature_controller": lambda: dict(period_s=x(r, .06, .3) * st.longest, duty=u(.2, .8)),
         "pump_beat": lambda: dict(tone_Hz=u(11, 44), ratio=1 + u(.02, .09), second=u(.5, 1)),
         "dac_bit_error": lambda: dict(bit=int(r.integers(9, 13))),
         "encoder_scratch": lambda: dict(centre=u(-.15, .15), width=x(r, .008, .04)), "adc_seam": lambda: dict(centre=u(-.12, .12)),
         "buffer_glitch": lambda: dict(buffer=int(r.choice([128, 256, 512])), decay=u(2, 6)),
         "eddy_speed_error": lambda: dict(power=u(.6, 1.5), sign=float(r.choice([-1, 1]))),
         "lamp_dimmer": lambda: dict(line_Hz=float(r.choice([50, 60])), phase=u(0, 1), width=u(.04, .1)),
         "turn_sticking": lambda: dict(length=x(r, .01, .05)), "turn_rattle": lambda: dict(tone_Hz=u(22, 90), decay_s=x(r, .03, .15)),
         "guide_settling": lambda: dict(length=x(r, .5, 3)), "neighbour_shadow": lambda: dict(centre=u(-.3, .3), width=u(.08, .2))}.get(kind, dict)()
    return dict(p, target=x(r, 7, 45), n_rec=n_rec)


def _reading_error(kind, p, c, st, r):
    """Shape of an effect that adds to the reading, about 1 at its largest."""
    sin, pi2, t, n = np.sin, 2 * np.pi, c.t, len(c.t)
    if kind == "thermal_drift": T = t + c.rec.clock; return sin(pi2 * T / p["period_s"] + p["phase"]) - sin(p["phase"]) + p["slope"] * T / st.longest
    if kind == "cross_coupling": return p["sign"] * (c.y + p["square"] * c.y**2)
    if kind == "mains_interference":
        ph = pi2 * p["line_Hz"] * (t + c.rec.clock) + p["phase"]; return sin(ph) + p["second"] * sin(2 * ph + 1) + p["third"] * sin(3 * ph + 2)
    if kind == "sensor_periodic_error": ph = pi2 * c.x / p["wavelength_m"] + p["phase"]; return sin(ph) + p["second"] * sin(2 * ph)
    if kind == "outliers": return (r.random(n) < p["share"]) * r.choice([-1, 1], n) * r.uniform(.5, 1.5, n)
    if kind == "loose_connector":
        e, L = np.zeros(n), int(p["length_share"] * n) + 3
        for a in r.integers(0, n - L, p["bursts"]): m = int(r.integers(L // 2, L)); e[a:a + m] = (1 if r.random() < .8 else -1) * r.uniform(.5, 1.2) * (r.random(m) < .8)
        return e
    if kind == "laser_mode_hop": return c.hit * (np.searchsorted(np.sort(r.uniform(.1, .9, p["hops"])), np.arange(n) / n) % 2)
    if kind == "temperature_controller": return signal.sawtooth(pi2 * (t + c.rec.clock) / p["period_s"], p["duty"])
    if kind == "pump_beat": return sin(pi2 * p["tone_Hz"] * t) + p["second"] * sin(pi2 * p["tone_Hz"] * p["ratio"] * t + 1)
    if kind == "encoder_scratch": z = (c.x / st.stroke - p["centre"]) / p["width"]; return np.exp(-z * z) * (1 + z)
    if kind == "adc_seam": return (c.x > p["centre"] * st.stroke) * 1.
    if kind == "buffer_glitch": return np.exp(-(np.arange(n) % p["buffer"]) / p["decay"])
    if kind == "eddy_speed_error": return p["sign"] * (np.abs(c.speed) / np.max(np.abs(c.speed)))**p["power"] * c.rel_speed
    if kind == "speed_noise": return r.standard_normal(n) * np.abs(c.speed) / np.max(np.abs(c.speed)) * c.rel_speed
    if kind == "lamp_dimmer": z = (2 * p["line_Hz"] * t + p["phase"]) % 1; return np.exp(-z / p["width"])
    if kind == "turn_sticking": z = c.way / p["length"]; return -c.dir * z * np.exp(1 - z) * st.polarity
    if kind == "turn_rattle": return (c.since > 0) * c.dir * np.exp(-c.since / p["decay_s"]) * sin(pi2 * p["tone_Hz"] * c.since)
    if kind == "guide_settling": return 1 - np.exp(-np.cumsum(np.abs(np.diff(c.u, prepend=c.u[0]))) / p["length"])
    if kind == "neighbour_shadow": return np.exp(-((c.y - p["centre"]) / p["width"])**2)
    return None


def _pole(x, tau, dt):
    a = np.exp(-dt / tau); g = (1 - a) * tau / dt                    # exact for straight lines between samples
    return signal.lfilter([1 - g, g - a], [1, -a], x, zi=[g * x[0]])[0]


def _record(st, rec, fx):
    """One recording: (volts, volts of the other axis, reading in metres)."""
    P = lambda k: fx[k][0]
    S = lambda k: fx[k][1]
    os = 2 if rec.fs >= 5000 else 1
    dt, N = 1 / rec.fs / os, len(rec.volts)
    v = rec.volts.copy()
    if "dac_bit_error" in fx: v += S("dac_bit_error") * st.noise * 2 / st.stroke * st.half * ((np.round((v + 10) / 20 * 65535).astype(int) >> P("dac_bit_error")["bit"]) & 1)
    tf = np.arange((N - 1) * os + 1) * dt
    v = np.interp(tf, tf[::os], v)
    if "slew_limit" in fx: v = _c("slew", v, len(v), float(st.vmax / (1 + S("slew_limit")) * dt), np.empty(len(v)))
    u = (v - st.mid) / st.half
    lim, past = [-9., 9.], np.array(rec.past, float)
    if "amplifier_saturation" in fx:
        side = P("amplifier_saturation")["side"]
        lim = [-9. if side > 0 else S("amplifier_saturation") - 1, 9. if side < 0 else 1 - S("amplifier_saturation")]
    u = _pole(np.clip(u, *lim), 1 / (2 * np.pi * st.amp), dt)
    if "delay" in fx: u = np.interp(tf - S("delay"), tf, u)
    if "initial_state" in fx and P("initial_state")["record"] == rec.index:
        side = P("initial_state")["side"]; edge = rec.hi if side > 0 else rec.lo
        past = np.concatenate([past, [edge + side * S("initial_state") * (1.35 - side * edge), past[-1]]])
    past = np.interp(np.arange((len(past) - 1) * 150 + 1) / 150, np.arange(len(past)), np.clip(past, *lim))
    past = np.concatenate([past, np.full(20, past[-1]), [u[0]]])
    times = np.concatenate([np.full(len(past) - 21, 2 / 150), np.full(21, rec.rest / 21), np.full(len(u), dt)])
    both = np.concatenate([past, u])
    h = _hysteresis(st, both)
    if "rate_dependence" in fx:
        p, uf, k = P("rate_dependence"), u, len(past)
        speed = _pole(np.abs(np.gradient(uf, dt)) * st.half, p["memory_s"], dt)
        mid = np.interp(uf, GRID, st.mid_curve)
        h = np.concatenate([h[:k], h[k:] + (h[k:] - mid) * S("rate_dependence") * np.log10(1 + speed / p["reference_V_per_s"])])
    if "creep" in fx:
        tau = 10.**np.arange(-2, 3.1, .5)
        h = h + S("creep") / 2 * (_c("creep", h, times, len(h), tau, len(tau), np.empty(len(h))) - len(tau) * h)
    h = h[len(past):]
    if "resonance" in fx:
        w0 = 2 * np.pi * st.mode
        A, B, C, D, _ = signal.cont2discrete(signal.tf2ss([w0 * w0], [1, w0 / st.Q, w0 * w0]), dt, "foh")
        num, den = signal.ss2tf(A, B, C, D)
        m = signal.lfilter(num[0], den, h, zi=signal.lfilter_zi(num[0], den) * h[0])[0]
        h = h + S("resonance") * (m - h)
    x = st.offset + st.polarity * st.stroke / 2 * h
    if "lag" in fx: x = _pole(x, S("lag"), dt)
    x = _pole(x, 1 / (2 * np.pi * st.sen), dt)[::os][rec.pre:]
    u = u[::os][rec.pre:]
    if any(k in fx for k in _KINDS if k not in BOUNDS):
        n, since = len(u), np.empty(len(u)); dirn = np.empty(n)
        _c("turns", u, n, .004, since, dirn); turn = (np.arange(n) - since).astype(int)
        tau = P("cross_coupling")["pole_Hz"] if "cross_coupling" in fx else 1e3
        speed = _pole(np.gradient(u) * rec.fs * st.half, 2 / rec.fs, 1 / rec.fs)
        c = NS(rec=rec, t=np.arange(n) / rec.fs, u=u, x=x, since=since / rec.fs, dir=dirn, way=np.abs(u - u[turn]) * (turn > 0), speed=speed + 1e-12,
               rel_speed=min(1, np.std(u) * 2), y=_pole((rec.vy - st.mid) / st.half, 1 / (2 * np.pi * tau), 1 / rec.fs)[rec.pre:], hit=0.)
        for k in _KINDS:
            if k in fx:
                c.hit = float(P(k).get("record", rec.index) == rec.index)
                e = _reading_error(k, P(k), c, st, _rng(st.seed, k, rec.file))
                if e is not None: x = x + S(k) * st.noise * e
    if "gain_change" in fx:
        p = P("gain_change"); k = int(p["at"] * rec.n)
        after = np.arange(rec.n) >= k if rec.index == p["record"] else np.full(rec.n, p["stays"] and rec.index > p["record"])
        x = x * (1 + p["sign"] * S("gain_change") * after)
    x = x + rec.noise * _rng(st.seed, "noise", rec.file).standard_normal(rec.n)
    x = np.round(x / st.adc) * st.adc
    if "quantisation" in fx: q = S("quantisation") * st.noise; x = (np.round(x / q - P("quantisation")["phase"]) + P("quantisation")["phase"]) * q
    return rec.volts[rec.pre:], rec.vy[rec.pre:], x


def _visible(with_it, without):
    """(rms of the difference, rms of what no offset and no gain explains)."""
    d = with_it - without
    A = np.stack([np.ones(len(d)), without], 1) / np.sqrt(len(d))
    A[:, 1] -= A[:, 1].mean(); A[:, 1] /= max(np.linalg.norm(A[:, 1]), 1e-30)
    rest = d - d.mean() - A[:, 1] * (A[:, 1] @ d)
    return float(np.sqrt(np.mean(d * d))), float(np.sqrt(np.mean(rest * rest)))


@lru_cache(256)
def _strength(seed, kind, size):
    """(parameters, strength), found on the stage with this effect alone so that it shows `size` times its drawn target."""
    st, p = _stage(seed), _draw(kind, _stage(seed))
    if kind == "quantisation": return p, size * _log(_rng(seed, "step"), 18, 70)
    if kind == "timestamp_fault": return p, size * _log(_rng(seed, "lost"), .004, .02)
    base = [_record(st, c, {})[2] for c in st.recs]
    which = 0 if kind in ("initial_state", "slew_limit", "amplifier_saturation") else 1
    f = lambda s: max(_visible(_record(st, c, {kind: (p, s)})[2], b)[which] / st.noise for c, b in zip(st.recs, base))
    if kind == "initial_state":
        trial = {(i, side): _visible(_record(st, st.recs[i], {kind: (dict(p, record=i, side=side), 1.)})[2], base[i])[0]
                 for i in st.smooth for side in (-1, 1)}
        p["record"], p["side"] = max(trial, key=trial.get)
    if kind not in BOUNDS:
        s = 20.
        for _ in range(2): s *= p["target"] / max(f(s), 1e-3)
        return p, float(s * size)
    a, b = np.log([BOUNDS[kind][0] * size, 2 * st.vmax / st.vplain if kind == "slew_limit" else BOUNDS[kind][1] * size])
    for _ in range(9):
        m = (a + b) / 2
        a, b = (a, m) if f(np.exp(m)) > p["target"] * size else (m, b)
    return p, float(np.exp((a + b) / 2))


# ---------------------------------------------------------------- the files
def _parameters(kind, p, s, st):
    """The true numbers of an effect, in physical units."""
    out = {k: v for k, v in p.items() if k not in ("target", "n_rec", "record")}
    if "record" in p: out["file"] = st.recs[p["record"]].file
    named = {"creep": dict(per_decade=s), "rate_dependence": dict(per_decade_of_speed=s), "delay": dict(delay_s=s),
             "resonance": dict(frequency_Hz=st.mode, Q=st.Q, weight=s), "lag": dict(pole_Hz=1 / (2 * np.pi * s)),
             "amplifier_saturation": dict(clip_low_V=st.mid - st.half * (1 - s) if p.get("side", 0) <= 0 else None,
                                          clip_high_V=st.mid + st.half * (1 - s) if p.get("side", 0) >= 0 else None),
             "slew_limit": dict(limit_V_per_s=st.vmax / (1 + s)), "gain_change": dict(relative=p.get("sign", 1) * s),
             "quantisation": dict(step_m=s * st.noise), "timestamp_fault": dict(share=s), "initial_state": dict(excursion_share=s)}
    if "at" in p: out["at_s"] = p["at"] * st.recs[p["record"]].n / st.recs[p["record"]].fs
    out.update(named.get(kind, dict(amplitude_m=s * st.noise)))
    return {k: float(v) if isinstance(v, np.floating) else v for k, v in out.items()}


def _toml(st, two):
    amp = f"gain_V_per_V = {st.gain:g}\nbandwidth_Hz = {st.amp_sheet:g}\noutput_min_V = {-10 * st.gain if st.mid == 0 else -2 * st.gain:g}\noutput_max_V = {10 * st.gain:g}\n"
    sen = f"bandwidth_Hz = {st.sen_sheet:g}\n"
    text = f'[rig]\nname = "stage {st.seed}"\n\n'
    if two: text += f"[axis.x.amplifier]\n{amp}\n[axis.y.amplifier]\n{amp}\n[axis.x.sensor]\n{sen}"
    else: text += f"[amplifier]\n{amp}\n[sensor]\n{sen}"
    text += f"\n[acquisition]\nsampling_rate_Hz = {max(c.fs for c in st.recs)}\ndac_bits = 16\nadc_bits = 16\ninput_range_V = [-10, 10]\n"
    for c in st.recs:
        text += f'\n[[recording]]\nfile = "{c.file}"\naxis = "x"\n'
        if two: text += 'columns = { voltage = "voltage_x [V]", displacement = "displacement_x [um]" }\n'
    return text


def _break_clock(t, columns, p, share):
    """Samples lost (with or without a gap in the clock), or a clock that stands still for a while."""
    k, m = int(p["at"] * len(t)), max(int(share * len(t)), 3)
    if p["form"] == "clock_stalled": t = t.copy(); t[k:k + m] = t[k]; return t, columns
    keep = np.r_[0:k, k + m:len(t)]
    return (t[keep] if p["form"] == "lost_gap" else t[:len(keep)]), [c[keep] for c in columns]


def write(seed, kinds, size, folder, measure=True):
    st, folder = _stage(int(seed)), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    fx = {}
    for k in _KINDS:                                                  # a fixed order, whatever the order asked for
        if k in kinds:
            fx[k] = _strength(int(seed), k, float(size))
    if set(kinds) - set(fx): raise ValueError(f"unknown effects {sorted(set(kinds) - set(fx))}")
    two, data, rows = bool(NEEDS_Y & set(fx)), [_record(st, c, fx) for c in st.recs], {}
    for c, (v, vy, x) in zip(st.recs, data):
        t, cols = np.arange(c.n) / c.fs, [v] + [vy] * two + [x * 1e6]
        if "timestamp_fault" in fx and fx["timestamp_fault"][0]["record"] == c.index: t, cols = _break_clock(t, cols, *fx["timestamp_fault"])
        head = "time [s],voltage_x [V],voltage_y [V],displacement_x [um]" if two else "time [s],voltage [V],displacement [um]"
        np.savetxt(folder / c.file, np.stack([t] + cols, 1), fmt=["%.6f"] + ["%.5f"] * len(cols), delimiter=",", header=head, comments="")
        rows[c.file] = {"kind": c.kind, "rate_Hz": c.fs, "samples": len(t), "noise_m": float(c.noise)}
    (folder / "lab.toml").write_text(_toml(st, two))
    effects = []
    for k, (p, s) in fx.items():
        by = {}
        if measure:
            less = {j: e for j, e in fx.items() if j != k}
            for c, d in zip(st.recs, data):
                rms, seen = (None, None) if k == "timestamp_fault" else [r / st.noise for r in _visible(d[2], _record(st, c, less)[2])]
                by[c.file] = {"rms_over_noise": rms, "beyond_gain_and_offset": seen}
        effects.append({"kind": k, "catalogue": _KINDS[k][0], "coordinate": _KINDS[k][1], "parameters": _parameters(k, p, s, st), "by_recording": by})
    mode = (float(st.mode), float(st.Q)) if "resonance" in fx else (0., 0.)
    return {"seed": int(seed), "law": st.law, "noise_m": float(st.noise), "stroke_m": float(st.stroke), "polarity": st.polarity,
            "mode_Hz": mode[0], "mode_Q": mode[1], "amplifier_Hz": float(st.amp), "sensor_Hz": float(st.sen), "loop_opening": float(st.opening),
            "recordings": rows, "decoys": list(st.decoys), "effects": effects}
