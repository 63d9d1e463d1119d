"""Hurried recordings of piezo stages with known truth, and the verdict a careful physicist would give.

    cases() -> {kind: one line}          write(kind, seed, folder) -> {truth, verdict, must, must_not}

Everything is drawn from (kind, seed). Chain: DAC (16 bits, held) -> amplifier pole -> hysteresis law
-> log creep -> (lightly damped mode) -> sensor pole -> disturbance + white noise -> 16-bit ADC.
A reading is taken just before the DAC is renewed: row n knows the drive up to row n-1 (one sample of
delay). Texts are in verdicts.toml beside this file; numbers are put into them here. Metres inside, um in files.
"""
import math, string, sys, tomllib
from pathlib import Path
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from dogwood_stage import Lab, opening, pole, wave      # noqa: E402

def bursts(r, n, share, longest):
    bad = np.zeros(n, bool)
    while bad.mean() < share:
        i = r.integers(1, n)
        bad[i:i + r.integers(1, longest + 1)] = True
    return bad

# ---------------------------------------------------------------- kinds
KINDS = {}

def kind(line, name=None):
    def put(f):
        KINDS[name or f.__name__] = (line, f)
        return f
    return put

def spoiled(value, name):
    @kind(f"0.5-5 % of the readings lost and written as {name}", "lost_" + name.replace(" ", "_"))
    def make(L):
        v, fs = L.cycles()
        share = 10 ** L.r.uniform(math.log10(.005), math.log10(.05))
        bad = bursts(L.r, v.size, share, 40 if name == "last value" else int(L.r.choice([1, 5, 40])))
        full = L.stroke * L.margin / 2
        def spoil(d):
            d = np.where(bad, {"0": 0., "9999": 9999e-6, "full scale": full}.get(name, 0.), d)
            if name == "last value":
                d = d[np.maximum.accumulate(np.where(bad, 0, np.arange(d.size)))]
            return d, ~bad
        L.record("loops.csv", v, fs, L.respond(v, fs), spoil=spoil)
        L.put |= {"lost_share": float(bad.mean()), "written_as": name}
        L.F |= {"share": 100 * bad.mean(), "value": name}
for _n in ("0", "9999", "last value", "full scale"):
    spoiled(None, _n)

@kind("two honest files, two speeds and amplitudes: nothing is wrong (guard against false alarms)")
def healthy_two_files(L):
    v, fs = L.cycles()
    L.record("large.csv", v, fs, L.respond(v, fs))
    n, f = 4, L.F["f"] * L.r.uniform(2, 5)
    fs = L.rate(n / f)
    v = L.volts(L.r.uniform(.4, .7) * wave(np.arange(min(30000, int(n / f * fs))) / fs * f, L.F["shape"]))
    L.record("small.csv", v, fs, L.respond(v, fs))

@kind("one speed; the loop is mostly lag of a filter left at a low setting, little hysteresis")
def lag_one_speed(L):
    L.set(open=L.r.uniform(.003, .012), creep=0., sen=1.)
    L.toml["sen"] = None if L.r.random() < .5 else L.r.uniform(3000, 10000)     # the sheet, not the setting
    v, fs = L.cycles(f=10 ** L.r.uniform(.3, 1.3), least=1000)
    lag = L.r.uniform(.07, .2)                            # phase; sine loop opens by about so much
    L.sen = L.F["f"] / lag
    L.record("loops.csv", v, fs, L.respond(v, fs))
    L.put |= {"slow_pole_Hz": L.sen, "lag_s": 1 / (2 * np.pi * L.sen)}
    L.F["lag_ms"] = 1e3 / (2 * np.pi * L.sen) + 1e3 / fs

@kind("one speed; the loop is hysteresis, electronics fast")
def hysteresis_one_speed(L):
    L.set(creep=0., amp=L.r.uniform(3000, 8000), sen=L.r.uniform(5000, 15000))
    v, fs = L.cycles(f=10 ** L.r.uniform(-.3, .2), shape="triangle")
    L.record("loops.csv", v, fs, L.respond(v, fs))
    L.F["lag_max"] = 400 * L.F["f"] * (1 / fs + 1 / (2 * np.pi * L.amp) + 1 / (2 * np.pi * L.sen))

@kind("one loop with one reversal, once")
def single_loop(L):
    v, fs = L.cycles(n=1, shape="triangle")
    L.record("loop.csv", v, fs, L.respond(v, fs))

@kind("half a stroke: one branch, no reversal")
def half_stroke(L):
    f = 10 ** L.r.uniform(-1, .3)
    fs = L.rate(.5 / f)
    v = L.volts(L.r.choice([-1, 1]) * np.linspace(-1, 1, int(.5 / f * fs)))
    L.record("branch.csv", v, fs, L.respond(v, fs))
    L.put |= {"seconds": .5 / f}

def rest(L):
    fs = int(L.r.choice([500, 1000]))
    n = int(L.r.integers(8000, 30000))
    v = L.volts(np.full(n, L.r.uniform(-.8, .8)))
    return v, fs, np.arange(n) / fs, np.full(n, L.zero * L.stroke)

@kind("drive at rest, the reading drifts")
def rest_drift(L):
    v, fs, t, x = rest(L)
    size = L.stroke * L.r.uniform(.003, .03) * L.r.choice([-1, 1])
    tau = t[-1] * L.r.uniform(.3, 3)
    dist = size * (1 - np.exp(-t / tau)) / (1 - np.exp(-t[-1] / tau))
    L.record("rest.csv", v, fs, x, dist)
    L.put |= {"drift_m": size, "seconds": float(t[-1])}
    L.F |= {"drift_nm": size * 1e9, "rate_nm": size * 1e9 / t[-1], "T": t[-1]}

@kind("drive at rest, mains hum in the reading")
def rest_hum(L):
    v, fs, t, x = rest(L)
    a, f = L.noise * L.r.uniform(1.5, 8), 50 + L.r.normal(0, .02)
    ph = L.r.uniform(0, 6, 2)
    L.record("rest.csv", v, fs, x, a * (np.sin(2 * np.pi * f * t + ph[0]) + .3 * np.sin(6 * np.pi * f * t + ph[1])))
    L.put |= {"hum_amplitude_m": a, "hum_Hz": f, "third_harmonic": .3}
    L.F["hum_nm"] = a * 1e9

@kind("drive at rest, nothing but noise")
def rest_nothing(L):
    v, fs, t, x = rest(L)
    L.record("rest.csv", v, fs, x)

@kind("many equal cycles, the gain changes slowly")
def cycles_gain_changes(L):
    L.creep = 0.
    v, fs = L.cycles(n=int(L.r.integers(25, 60)), f=10 ** L.r.uniform(.5, 1), least=2000)
    det, g = L.respond(v, fs), L.r.uniform(.015, .06) * L.r.choice([-1, 1])
    ramp = 1 - np.exp(-np.linspace(0, L.r.uniform(.3, 3), v.size))
    pivot = det - L.zero * L.stroke                       # the zero stays where it is
    L.record("cycles.csv", v, fs, det, pivot * g * ramp / ramp[-1])
    L.put["gain_change"] = g
    L.F["g"] = 100 * g

@kind("many equal cycles, the zero drifts")
def cycles_zero_drifts(L):
    L.creep = 0.
    v, fs = L.cycles(n=int(L.r.integers(15, 60)), f=10 ** L.r.uniform(.3, 1), least=2000)
    z, t = L.stroke * L.r.uniform(.02, .1) * L.r.choice([-1, 1]), np.linspace(0, 1, v.size)
    L.record("cycles.csv", v, fs, L.respond(v, fs), z * t ** L.r.uniform(.6, 1.3))
    L.put["zero_drift_m"] = z
    L.F |= {"z_um": z * 1e6, "z_pct": 100 * z / L.stroke, "T": v.size / fs}

@kind("coarse steps with holds that show creep, up and down")
def coarse_steps(L):
    L.set(creep=L.r.uniform(.01, .025), noise=L.stroke * 10 ** L.r.uniform(-4, -3.2))
    n = int(L.r.integers(5, 11))
    s = np.r_[-1:1:n * 1j][1:]
    s = np.r_[-1., s, s[::-1][1:], -1., s[: n // 2]]
    fs, hold = 500, L.r.uniform(1, 3)
    hold = min(hold, 59 / s.size)
    v = L.volts(np.repeat(s, int(hold * fs)))
    L.record("steps.csv", v, fs, L.respond(v, fs))
    L.put |= {"steps": int(s.size), "hold_s": hold}
    L.F |= {"hold": hold, "creep": 100 * L.creep, "steps": s.size}

@kind("a new random voltage at every sample, about a third of the range")
def random_every_sample(L):
    L.set(f0=L.r.uniform(300, 1200), Q=L.r.uniform(4, 12), creep=0., margin=3.)
    fs, n = int(L.r.choice([5000, 10000])), int(L.r.integers(10000, 20000))
    v = L.volts(L.r.uniform(.25, .45) * L.r.uniform(-1, 1, n))
    L.record("noise.csv", v, fs, L.respond(v, fs))
    L.files["noise.csv"]["opening_seen"] = float("nan")   # no branches to compare

@kind("butterfly loop of an electrostrictive or unpoled ceramic, bipolar drive")
def butterfly(L):
    L.set(lo=-L.hi, law=str(L.r.choice(["jiles_atherton", "preisach", "duhem"])), creep=0., bend=0.,
          open=L.r.uniform(.08, .15))
    v, fs = L.cycles(f=10 ** L.r.uniform(-.3, .5))
    p = L.static(v, fs) / L.stroke                        # the strain goes with the square of a lagging polarisation
    x = 4 * L.sign * p ** 2 * L.stroke
    det = pole(x, 1 / fs, 1 / (2 * np.pi * L.sen))
    L.margin = 3.
    L.record("bipolar.csv", v, fs, det)
    lo = [abs(v[k]) for k in np.where(np.diff(np.sign(p)) != 0)[0][1:]]
    L.put["turning_V"] = float(np.mean(lo))
    L.F["vt"] = float(np.mean(lo))

@kind("closed-loop stage, loop open by 0.2 % only, two speeds")
def thin_loop(L):
    L.set(open=L.r.uniform(.0015, .0025), bend=L.r.uniform(-.004, .004), creep=0., law="maxwell_slip",
          noise=L.stroke * 10 ** L.r.uniform(-4, -3.6), amp=8000., sen=15000.)
    for i, f in enumerate((L.r.uniform(.2, .4), L.r.uniform(.6, .9))):
        fs = 5000 if i else 2000                          # delay of 1/fs stays far below the loop
        v = L.volts(wave(np.arange(int(min(3, 29000 * f / fs) // 1 / f * fs)) / fs * f))
        L.record(f"speed_{i + 1}.csv", v, fs, L.respond(v, fs))
        L.F["lagpart"] = 400 * f / fs

@kind("loop open by 2 % in noise of the same size")
def loop_in_noise(L):
    L.set(open=L.r.uniform(.018, .022), noise=L.stroke * L.r.uniform(.01, .02), creep=0., bend=L.r.uniform(-.05, .05))
    v, fs = L.cycles(f=10 ** L.r.uniform(-.3, .3))
    L.record("loops.csv", v, fs, L.respond(v, fs))
    L.F["snr_sd"] = 100 * L.noise / L.stroke / math.sqrt(v.size / 2 / 36) * 1.4

@kind("the sensor saturates before the stroke ends")
def sensor_saturates(L):
    v, fs = L.cycles()
    at, top = L.r.uniform(.72, .92), L.r.choice([-1, 1])
    lim = top * (at - .5) * L.stroke + L.zero * L.stroke
    det = L.respond(v, fs)
    cut = lambda d: ((np.minimum if top > 0 else np.maximum)(d, L.quantise(lim)), (top * (d - lim) < 0))
    L.record("loops.csv", v, fs, det, spoil=cut)
    L.put |= {"limit_m": lim, "share_of_stroke_seen": at}
    L.F |= {"lim_um": lim * 1e6, "flat_pct": 100 * L.files["loops.csv"]["bad_rows"] / v.size}

@kind("the amplifier runs out of voltage before the DAC does (limit not in lab.toml)")
def amplifier_clips(L):
    v, fs = L.cycles()
    at = L.r.uniform(.72, .92)
    det = L.respond(v, fs, clip=2 * at - 1)
    vc = L.lo + (L.hi - L.lo) * at
    L.record("loops.csv", v, fs, det)
    L.put |= {"clip_at_dac_V": vc, "creep_while_clipped": L.creep}
    L.F["vc"] = vc

def pair(L, gain=1., zero=0., opening=1., names=("first.csv", "second.csv"), ratio=None):
    """Two files of equal drive and amplitude (the second faster by `ratio`); the second changed."""
    L.creep = min(L.creep, .006)
    v, fs = L.cycles()
    L.record(names[0], v, fs, L.respond(v, fs))
    f = L.F["f"] * (ratio or L.r.uniform(.6, 1.6))
    n = min(30000, max(int(3 / f * fs), 3000))
    v = L.volts(wave(np.arange(n) / fs * f, L.F["shape"]))
    sound = L.respond(v, fs)
    if opening != 1:                                      # the same law, opened differently
        L.fit(L.open * opening)
    det = (L.respond(v, fs) - L.zero * L.stroke) * gain + L.zero * L.stroke + zero
    L.record(names[1], v, fs, sound, det - sound)

@kind("two files, the sensor upside down in the second")
def upside_down(L):
    pair(L, gain=-1.)

@kind("two files of equal drive whose gain differs by 12 %")
def gain_12_percent(L):
    g = L.r.choice([1.12, .88])
    pair(L, gain=g)
    L.put["gain_ratio"] = g
    L.F["g"] = 100 * (g - 1)

@kind("two files of equal drive, the second at another (unrecorded) temperature: gain, opening, zero differ")
def other_temperature(L):
    dT = L.r.uniform(7, 15) * L.r.choice([-1, 1])
    g, o, z = 1 + .003 * dT, 1 + .008 * dT, .004 * dT * L.r.uniform(.5, 1.5) * L.stroke
    pair(L, gain=g, opening=o, zero=z)
    a, b = L.files.values()
    g = b["stroke_seen_m"] / a["stroke_seen_m"]
    L.put |= {"dT_K": dT, "stroke_ratio": g, "opening_ratio": b["opening_seen"] / a["opening_seen"], "zero_shift_m": z}
    L.F |= {"g": 100 * (g - 1), "z_um": z * 1e6, "z_pct": 100 * z / L.stroke,
            "oa": 100 * a["opening_seen"], "ob": 100 * b["opening_seen"]}

@kind("the columns of drive and displacement are swapped")
def columns_swapped(L):
    v, fs = L.cycles()
    d = L.record("loops.csv", v, fs, L.respond(v, fs))
    L.save("loops.csv", np.arange(v.size) / fs, d * 1e6, v * 1e-6)

@kind("wrong cable: the displacement of another axis, not related to the drive")
def wrong_cable(L):
    v, fs = L.cycles()
    t, f2 = np.arange(v.size) / fs, L.F["f"] * L.r.uniform(1.23, 1.77)
    other = L.r.uniform(.2, .5) * wave(t * f2 + L.r.random(), "sine") * L.stroke
    L.record("loops.csv", v, fs, np.full(v.size, L.zero * L.stroke), other, note="displacement of another axis")
    L.put["other_Hz"] = f2
    L.F["f2"] = f2

@kind("triangle turns ring a resonance")
def resonance_triangles(L):
    L.set(f0=L.r.uniform(150, 450), Q=L.r.uniform(15, 50), noise=L.stroke * 10 ** L.r.uniform(-4, -3.3), creep=0.)
    v, fs = L.cycles(f=L.r.uniform(5, 12), shape="triangle", least=5000)
    L.record("fast.csv", v, fs, L.respond(v, fs))
    ring = 4 * L.F["f"] / (2 * np.pi * L.f0)
    L.put["ring_over_stroke_per_turn"] = ring
    L.F |= {"ring": 100 * ring, "f0": L.f0, "Q": L.Q}

@kind("play of a lever behind the ceramic, two amplitudes in one file")
def lever_play(L):
    L.set(open=L.r.uniform(.01, .03), creep=0.)
    f = 10 ** L.r.uniform(-.2, .5)
    fs = L.rate(8 / f)
    t = np.arange(min(30000, int(8 / f * fs))) / fs * f
    small = L.r.uniform(.25, .4)
    k = np.searchsorted(t, 4.)                            # full cycles, then small ones about the bottom
    s = wave(t)
    s[k:] = small * (s[k:] + 1) - 1
    v, g = L.volts(s), L.r.uniform(.015, .04) * L.stroke
    x = L.static(v, fs)
    y, out = x[0] + L.sign * g / 2, []
    for u in x.tolist():
        y = min(max(y, u - g / 2), u + g / 2)
        out.append(y)
    det = pole(np.array(out), 1 / fs, 1 / (2 * np.pi * L.sen)) + L.zero * L.stroke
    L.record("two_amplitudes.csv", v, fs, det)
    L.put |= {"play_m": g, "small_amplitude": small}
    L.F |= {"play_um": g * 1e6, "play_pct": 100 * g / L.stroke, "f": f, "small": 100 * small,
            "of": 100 * opening(v[:k], det[:k]), "os": 100 * opening(v[k:], det[k:])}

def step_kind(L, jumps, sizes, name):
    v, fs = L.cycles()
    dist = np.zeros(v.size)
    at = np.sort((jumps * v.size).astype(int))
    for i, s in zip(at, sizes):
        dist[i:] += s
    L.record(name, v, fs, L.respond(v, fs), dist)
    L.put |= {"jumps_s": (at / fs).tolist(), "jumps_m": [float(s) for s in sizes]}
    L.F |= {"at": ", ".join(f"{a / fs:.4g}" for a in at), "size": ", ".join(f"{s * 1e9:+.0f}" for s in sizes)}

@kind("the mount slips once: a lasting jump in the record")
def stick_slip_jump(L):
    step_kind(L, L.r.uniform(.25, .75, 1), [L.stroke * L.r.uniform(.008, .03) * L.r.choice([-1, 1])], "loops.csv")

@kind("an interferometer loses fringes: lasting jumps by multiples of 316.4 nm")
def fringe_slips(L):
    n = int(L.r.integers(3, 7))
    L.set(stroke=L.r.uniform(8e-6, 25e-6), noise=1e-9 * L.r.uniform(3, 10))
    step_kind(L, (np.arange(n) + L.r.uniform(.2, .8, n)) / n, 316.4e-9 * L.r.choice([-2, -1, 1, 2], n, p=[.1, .4, .4, .1]), "loops.csv")

@kind("an interferometer's periodic error: ripple that repeats every 316.4 nm of displacement")
def periodic_error(L):
    L.set(stroke=L.r.uniform(5e-6, 12e-6), noise=1e-9 * L.r.uniform(1, 3))
    v, fs = L.cycles(f=10 ** L.r.uniform(-.6, 0), n=4, shape="triangle")
    det, a = L.respond(v, fs), 1e-9 * L.r.uniform(5, 15)
    L.record("loops.csv", v, fs, det, a * np.sin(2 * np.pi * det / 316.4e-9 + L.r.uniform(0, 6)))
    L.put |= {"ripple_m": a, "period_m": 316.4e-9}
    L.F |= {"rip": a * 1e9, "rip_rms": 1e9 * math.hypot(a / math.sqrt(2), L.noise)}

@kind("servo on: the sensor is held, the drive moves against drift and floor")
def sensor_held(L):
    L.set(creep=0.)
    fs, n = 1000, int(L.r.integers(8000, 20000))
    t, step, k = np.arange(-fs, n) / fs, L.stepper(0.), 2 * np.pi * L.r.uniform(12, 40) / fs
    drift = L.stroke * (L.r.uniform(.1, .3) * L.r.choice([-1, 1]) * t / t[-1] + .06 * np.sin(2 * np.pi * L.r.uniform(.15, .5) * t))
    noise, w, held = L.noise * L.r.standard_normal(n + fs), 0., L.zero * L.stroke
    v, d = np.zeros(n + fs), np.zeros(n + fs)
    for i in range(n + fs):                               # the first second, the servo settling, is not recorded
        v[i] = L.volts(w)
        d[i] = L.sign * L.stroke * step(w) + drift[i] + noise[i]
        w = float(np.clip(w - L.sign * 2 * k * d[i] / L.stroke, -1, 1))
    v, d = np.r_[v[1:], L.volts(w)], L.quantise(d + held)     # a row holds the reading and the answer to it
    t, v, d, drift = t[fs:], v[fs:], d[fs:], drift[fs:]
    L.save("held.csv", t, v, d)
    L.files["held.csv"] = dict(rate_Hz=fs, samples=n, bad_rows=0, note="integrator closed on the sensor",
        stroke_seen_m=float(np.ptp(d)), opening_seen=float("nan"), perfect_rms_m=L.noise,
        drive_only_rms_m=float(np.std(drift)), drive_only_rms_all_rows_m=float(np.std(drift)))
    L.put |= {"servo_Hz": k * fs / 2 / np.pi, "disturbance_ptp_m": float(np.ptp(drift))}
    L.F |= {"dv": float(np.ptp(v)), "sd_nm": float(np.std(d)) * 1e9}

@kind("another axis (drive not recorded) moved meanwhile and couples in")
def crosstalk(L):
    v, fs = L.cycles(n=int(L.r.integers(6, 12)))
    f2, a = L.F["f"] * L.r.uniform(2.2, 3.8), L.stroke * L.r.uniform(.005, .02)
    f2 += .13 * L.F["f"] if abs(f2 / L.F["f"] - round(f2 / L.F["f"])) < .1 else 0
    L.record("loops.csv", v, fs, L.respond(v, fs), a * wave(np.arange(v.size) / fs * f2 + L.r.random()))
    L.put |= {"other_Hz": f2, "crosstalk_amplitude_m": a}
    L.F |= {"f2": f2, "a_nm": a * 1e9, "a_rms": a / math.sqrt(3) * 1e9, "a_pct": 100 * a / L.stroke}

@kind("a block of rows is missing: the time column jumps")
def rows_missing(L):
    v, fs = L.cycles()
    L.record("loops.csv", v, fs, L.respond(v, fs))
    n, m = v.size, int(L.r.uniform(.02, .12) * v.size)
    i = int(L.r.uniform(.3, .7) * n)
    keep = np.r_[0:i, i + m:n]
    t, v, d = L.alias["loops.csv"]
    L.save("loops.csv", t[keep], v[keep], d[keep])
    L.put |= {"gap_at_s": i / fs, "gap_s": m / fs}
    L.F |= {"at": i / fs, "gap": m / fs, "rows": m}

@kind("the 'second' file is the first under another name")
def same_file_twice(L):
    v, fs = L.cycles()
    L.record("train.csv", v, fs, L.respond(v, fs))
    t, v, d = L.alias["train.csv"]
    later = L.r.choice([0., 12.5])
    L.save("test.csv", t + later, v, d)
    L.put["time_offset_s"] = float(later)
    L.files["test.csv"] = L.files["train.csv"] | {"note": "copy of train.csv"}

@kind("drive and displacement logged by two clocks that disagree: the lag grows along the record")
def two_clocks(L):
    L.creep = 0.
    v, fs = L.cycles(n=int(L.r.integers(20, 40)), f=10 ** L.r.uniform(.3, .8), shape="triangle", least=2000)
    det = L.respond(v, fs)
    slip = L.r.uniform(.015, .04) / L.F["f"] * L.r.choice([-1, 1])      # seconds at the end
    t = np.arange(v.size) / fs
    late = np.interp(t - slip * t / t[-1], t, det)
    L.record("cycles.csv", v, fs, det, late - det)
    k = int(2 / L.F["f"] * fs)
    L.put |= {"slip_s": slip, "ppm": 1e6 * slip / t[-1]}
    L.F |= {"slip_ms": 1e3 * slip, "ppm": 1e6 * slip / t[-1], "o1": 100 * opening(v[:k], late[:k]), "o2": 100 * opening(v[-k:], late[-k:])}

@kind("the displacement was smoothed afterwards with a centred window: it moves before the drive does")
def smoothed_afterwards(L):
    v, fs = L.cycles(f=10 ** L.r.uniform(-.2, .5), shape="triangle", least=1000)
    m = int(L.r.uniform(.03, .07) / L.F["f"] * fs) | 1
    sm = lambda x: np.convolve(np.pad(x, m // 2, "edge"), np.full(m, 1 / m), "valid")
    L.noise = max(L.noise, L.stroke * 5e-4)               # why they smoothed
    det = L.respond(v, fs)
    L.record("loops.csv", v, fs, det, sm(det) - det, spoil=lambda d: (L.quantise(sm(d - sm(det) + det)), np.ones(d.size, bool)))
    L.put |= {"window_samples": m, "window_s": m / fs}
    L.F |= {"m": m, "win_ms": 1e3 * m / fs}

@kind("ADC range far too wide: the reading moves in coarse codes")
def coarse_adc(L):
    L.noise = L.stroke * 10 ** L.r.uniform(-4, -3.5)
    v, fs = L.cycles()
    lsb = L.stroke * L.r.uniform(.004, .012)
    L.quantise = lambda x: np.round(x / lsb) * lsb
    L.record("loops.csv", v, fs, L.respond(v, fs))
    L.put["code_m"] = lsb
    L.F |= {"code_nm": lsb * 1e9, "code_rms": lsb / math.sqrt(12) * 1e9, "code_pct": 100 * lsb / L.stroke}

# ---------------------------------------------------------------- the two functions

def cases() -> dict[str, str]:
    return {k: line for k, (line, _) in KINDS.items()}

class Plain(string.Formatter):
    """1.1e+03 is written 1100."""
    def format_field(self, value, spec):
        out = format(value, spec)
        return f"{float(out):+.0f}"[spec[0] != "+":] if "e+" in out and float(out) > 0 else out

def plain(x):
    """Python numbers only, no NaN: fit for JSON."""
    if isinstance(x, dict):
        return {k: plain(v) for k, v in x.items()}
    if isinstance(x, (list, tuple)):
        return [plain(v) for v in x]
    x = x.item() if isinstance(x, np.generic) else x
    return None if isinstance(x, float) and not math.isfinite(x) else x

def write(kind: str, seed: int, folder: Path) -> dict:
    """Write the CSV files and lab.toml; return truth (SI units), verdict, must, must_not."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    L = Lab(kind, seed, folder)
    KINDS[kind][1](L)
    L.lab_toml()
    one = next(iter(L.files.values()))
    moved = kind not in ("wrong_cable", "rest_drift", "rest_hum", "rest_nothing", "sensor_held")
    truth = dict(kind=kind, seed=seed, law=L.law, law_opening=L.open, stroke_m=L.stroke, noise_m=L.noise,
        polarity=L.sign, range_V=[L.lo, L.hi], creep_per_decade=L.creep, amplifier_Hz=L.amp, sensor_Hz=L.sen,
        mode_Hz=L.f0, mode_Q=L.Q, delay_samples=1, adc_step_m=L.stroke * L.margin / 65536,
        reading_follows_drive=moved, put_in=L.put, files=L.files)
    F = {"law_open": 100 * L.open, "open": 100 * one["opening_seen"], "um": one["stroke_seen_m"] * 1e6, "sign": L.sign,
         "noise_nm": L.noise * 1e9, "noise_pct": 100 * L.noise / L.stroke, "fs": one["rate_Hz"],
         "lo": L.lo, "hi": L.hi, "mode0": L.f0 or 0, "Q0": L.Q or 0} | L.F
    text = tomllib.loads((Path(__file__).parent / "verdicts.toml").read_text())[kind]
    put = lambda s: " ".join(Plain().format(s, **F).split())
    return dict(truth=plain(truth), verdict=put(text["verdict"]), must=[put(s) for s in text["must"]],
                must_not=[put(s) for s in text["must_not"]])
