"""Recordings of the simulated test bench: piezo stages and tunnelling tips.

    library = build(folder)
    write_stage(seed, folder, library)     # *.csv and lab.toml of one lateral axis
    write_tip(seed, folder, library)       # loop_*.csv, approach_*.dat and lab.toml of axis z
    stage_truth(seed, library), tip_truth(seed, library)

Time stamps.  At tick k of the 20 kHz controller (time k * 50 us) the converter is read and a voltage is
written: row k holds that reading and that voltage.  The reading of row k is therefore what the call k - 1
of stage_step returned, and the voltage of row k is the argument of call k.  It reaches the amplifier
`delay_ticks` ticks after its time stamp (one whole tick and a fraction).  The same holds for tips.  Slow files
keep every M-th row.  All files of a stage are cut out of one run of one stage, with moves and
rests between them that were not recorded; the run is open loop.

Only numpy is needed.
"""
from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np

TICK = 5e-5
RATE = 20000
LAWS = ("Coleman-Hodgdon", "Jiles-Atherton domain walls", "Krasnosel'skii-Pokrovskii", "Preisach bimodal",
        "Preisach Lorentzian", "generalised Bouc-Wen", "Takacs T(x) with Madelung memory", "Iwan power law",
        "homogenised energy", "Dahl walls")
STAGE_TRUTHS = {
    0: "law", 1: "opening", 2: "stroke_m", 3: "polarity", 4: "mode_Hz", 5: "mode_Q", 6: "mode2_Hz",
    7: "mode2_share", 8: "mode2_Q", 9: "amplifier_gain", 10: "amplifier_Hz", 11: "amplifier_declared_Hz",
    12: "output_min_V", 13: "output_max_V", 14: "slew_V_per_s", 15: "slew_declared_V_per_s", 16: "sensor_Hz",
    17: "sensor_declared_Hz", 18: "sensor_gain_V_per_m", 19: "sensor_gain_declared", 20: "delay_ticks",
    21: "creep_per_decade", 22: "creep_tilt", 23: "noise_rms_m", 24: "slow_noise_rms_m",
    25: "sensor_quadratic", 26: "sensor_cubic", 27: "dac_low_V", 28: "dac_high_V", 29: "rest_V",
    30: "rest_displacement_m", 31: "least_slope_over_mean", 32: "opening_of_a_fifth_of_the_stroke",
}
TIP_TRUTHS = {
    0: "barrier_eV", 1: "kappa_per_m", 2: "extension_m_per_dac_V", 3: "amplifier_gain", 4: "amplifier_Hz",
    5: "amplifier_declared_Hz", 6: "preamplifier_Hz", 7: "preamplifier_declared_Hz", 8: "delay_s",
    9: "mode_Hz", 10: "mode_Q", 11: "set_point_A", 12: "floor_A", 13: "ceiling_A", 14: "feedback_ohm",
    15: "offset_A", 16: "noise_rms_A", 17: "drift_m_per_s", 18: "hum_A", 19: "hum_m", 20: "set_gap_m",
    21: "bias_V", 22: "full_scale_A", 23: "preamplifier_declared",
}


def build(folder: Path) -> ctypes.CDLL:
    """Compile simulator.c (beside this file) into `folder` and load it."""
    folder = Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    source = Path(__file__).resolve().with_name("simulator.c")
    target = folder / "simulator.so"
    subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", "-o", str(target), str(source), "-lm"], check=True)
    library = ctypes.CDLL(str(target))
    handle, real, count = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
    one = ctypes.POINTER(ctypes.c_double)
    u32 = ctypes.c_uint32
    for name, result, arguments in (
            ("stage_open", handle, [u32, u32]), ("stage_step", None, [handle, real, one, one]),
            ("stage_close", None, [handle]), ("stage_rest", None, [handle, one, one]),
            ("stage_truth", real, [u32, ctypes.c_int]), ("stage_run", None, [handle, one, one, one, count]),
            ("stage_law", None, [u32, one, one, count]),
            ("tip_open", handle, [u32, u32, real]), ("tip_step", None, [handle, real, one, one]),
            ("tip_move_surface", None, [handle, real]), ("tip_fault", None, [handle, ctypes.c_int]),
            ("tip_close", None, [handle]), ("tip_truth", real, [u32, ctypes.c_int]),
            ("tip_loop", None, [handle, real, real, one, one, one, count, one]),
            ("tip_drive", None, [handle, one, one, one, count])):
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def stage_truth(seed: int, library) -> dict:
    truth = {name: library.stage_truth(seed, which) for which, name in STAGE_TRUTHS.items()}
    truth["law"] = LAWS[int(truth["law"])]
    truth["delay_s"] = truth["delay_ticks"] * TICK
    return truth


def tip_truth(seed: int, library) -> dict:
    """The drift is the growth of the gap per second (negative: the surface comes nearer), everywhere the same."""
    truth = {name: library.tip_truth(seed, which) for which, name in TIP_TRUTHS.items()}
    truth["loop_delay_s"] = truth["delay_s"]
    plan = _tip_plan(seed, truth)
    truth["approach"] = [{"file": f"approach_{i + 1}.dat", "duration_s": 2 * a["points"] * a["dwell"] * TICK,
                          "drift_m_per_s": truth["drift_m_per_s"], "clips": a["clips"]}
                         for i, a in enumerate(plan["approaches"])]
    truth["loops"] = [{"file": f"loop_{i + 1}.csv", "crossover_Hz": a["crossover"]}
                      for i, a in enumerate(plan["loops"])]
    return truth


# ---------------------------------------------------------------- lateral stages

class _Bench:
    """One stage, run without a break; what is recorded is cut out."""

    def __init__(self, seed: int, library):
        self.library = library
        self.stage = library.stage_open(seed, 1)
        volts, shown = ctypes.c_double(), ctypes.c_double()
        library.stage_rest(self.stage, ctypes.byref(volts), ctypes.byref(shown))
        self.volts, self.reading = volts.value, shown.value
        self.run(np.full(8, self.volts))

    def close(self):
        self.library.stage_close(self.stage)

    def run(self, volts: np.ndarray):
        """Volts written at each tick; returns what the DAC rounds them to and the readings before each."""
        lsb = 20.0 / 65536.0
        volts = np.ascontiguousarray(np.clip(np.round(volts / lsb), -32768, 32767) * lsb)
        out = np.empty_like(volts)
        self.library.stage_run(self.stage, _pointer(volts), _pointer(out), None, len(volts))
        readings = np.concatenate(([self.reading], out[:-1]))
        self.volts, self.reading = volts[-1], out[-1]
        return volts, readings

    def go(self, to: float, seconds: float, wait: float):
        n = max(2, int(seconds * RATE))
        ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)
        self.run(self.volts + (to - self.volts) * ramp)
        self.run(np.full(max(1, int(wait * RATE)), to))


def _cycles(rng, t):
    """Several full sine cycles at two or three speeds, one after the other."""
    mid, half = t["mid"], t["half"] * rng.uniform(0.93, 1.0)
    speeds = [np.exp(rng.uniform(np.log(0.25), np.log(1.2))), rng.uniform(2.0, 6.0)]
    if rng.random() < 0.6:
        speeds.append(rng.uniform(8.0, 22.0))
    if rng.random() < 0.3:
        speeds.reverse()
    start = rng.choice([-0.5 * np.pi, 0.0]) if rng.random() < 0.8 else rng.uniform(-np.pi, np.pi)
    parts = []
    for f in speeds:
        n = int(round(rng.integers(2, 5) * RATE / f)) if f < 2 else int(round(rng.integers(3, 9) * RATE / f))
        whole = np.round(n * f / RATE)
        parts.append(mid + half * np.sin(start + 2 * np.pi * whole * np.arange(n) / n))
        if rng.random() < 0.4:
            parts.append(np.full(int(rng.uniform(0.05, 0.5) * RATE), mid + half * np.sin(start)))
    return np.concatenate(parts), int(rng.choice([500, 1000, 2000])), "cycles"


def _triangles(rng, t):
    mid, half = t["mid"], t["half"] * rng.uniform(0.93, 1.0)
    parts = []
    for _ in range(int(rng.integers(1, 3))):
        f = np.exp(rng.uniform(np.log(0.4), np.log(8.0)))
        count = int(rng.integers(2, 5)) + int(2 * f)
        n = int(RATE / f)
        u = np.arange(n * count) / n % 1.0
        parts.append(mid + half * np.where(u < 0.5, 4 * u - 1, 3 - 4 * u))
    return np.concatenate(parts), int(rng.choice([1000, 2000, 4000])), "triangles"


def _stair(rng, t):
    mid, half = t["mid"], t["half"] * rng.uniform(0.7, 0.97)
    levels = int(rng.integers(4, 10))
    up = np.linspace(-1, 1, levels)
    kind = rng.random()
    if kind < 0.6:
        seq = np.concatenate((up, up[-2::-1]))
    elif kind < 0.8:
        seq = np.concatenate((up, up[-2::-1], up[1::2]))
    else:
        seq = rng.uniform(-1, 1, 2 * levels)
    dwell = int(rng.uniform(0.08, 0.5) * RATE)
    rise = int(rng.choice([0, 0, rng.uniform(0.001, 0.01)]) * RATE)
    if t["mode_Q"] > 25 and rng.random() < 0.7:
        rise = max(rise, int(rng.uniform(0.004, 0.012) * RATE))
    parts, last = [], seq[0]
    for level in seq:
        ramp = last + (level - last) * np.arange(1, rise + 1) / max(rise, 1)
        parts += [ramp, np.full(dwell, level)]
        last = level
    return mid + half * np.concatenate(parts), int(rng.choice([1000, 2000, 5000])), "stair"


def _chirp(rng, t):
    """Small (or as large as the resonance permits) about mid range, to beyond the mode."""
    f0 = rng.uniform(5.0, 30.0)
    f1 = min(t["mode_Hz"] * rng.uniform(1.4, 2.3), 8600.0)
    if t["mode_Hz"] > 2500:
        f1 = min(t["mode_Hz"] * rng.uniform(1.25, 1.8), 8600.0)
    large = rng.random() < 0.25
    amplitude = t["half"] * (rng.uniform(0.08, 0.3) if large else np.exp(rng.uniform(np.log(0.01), np.log(0.06))))
    amplitude = min(amplitude, t["half"] * (0.8 if large else 0.5) / t["mode_Q"])
    if t["slew_V_per_s"] > 0 and rng.random() < 0.85:
        amplitude = min(amplitude, 0.9 * t["slew_V_per_s"] / (2 * np.pi * f1 * t["amplifier_gain"]))
    amplitude = max(amplitude, 0.004 * t["half"])
    length = np.exp(rng.uniform(np.log(0.6), np.log(5.0)))
    n = int(length * RATE)
    s = np.arange(n) / n
    if rng.random() < 0.5:
        phase = 2 * np.pi * length * (f0 * s + 0.5 * (f1 - f0) * s * s)
    else:
        k = np.log(f1 / f0)
        phase = 2 * np.pi * length * f0 * np.expm1(k * s) / k
    if rng.random() < 0.15:
        phase = phase[-1] - phase[::-1]                        # downwards
    centre = t["mid"] + t["half"] * (rng.uniform(-0.08, 0.08) if rng.random() < 0.75 else rng.uniform(-0.4, 0.4))
    drive = centre + amplitude * np.sin(phase)
    cut = int(n * rng.uniform(0.01, 0.06)) if rng.random() < 0.4 else 0        # begins in mid-motion
    if cut == 0:
        drive = np.concatenate((np.full(int(rng.uniform(0.02, 0.25) * RATE), centre), drive))
    if rng.random() < 0.6:
        drive = np.concatenate((drive, np.full(int(rng.uniform(0.02, 0.2) * RATE), centre)))
    rate = 10000 if f1 < 3200 and rng.random() < 0.25 else 20000
    return drive, rate, "chirp", centre, cut


def _multisine(rng, t):
    """Random phases; slow and large, or wide and small."""
    wide = rng.random() < 0.35
    if wide:
        top = min(t["mode_Hz"] * rng.uniform(1.2, 1.9), 8000.0)
        amplitude = min(rng.uniform(0.03, 0.12), 2.0 / t["mode_Q"])
        rate = 20000
    else:
        top = np.exp(rng.uniform(np.log(8.0), np.log(min(150.0, 0.3 * t["mode_Hz"]))))
        amplitude = rng.uniform(0.2, 0.75)
        rate = next(r for r in (1000, 2000, 4000, 5000, 10000, 20000) if r >= 16 * top)
    length = rng.uniform(1.0, 4.0)
    n = int(length * RATE)
    spectrum = np.zeros(n // 2 + 1, complex)
    last = min(len(spectrum) - 1, int(top * length))
    first = max(1, int(rng.uniform(0.3, 2.0) * length))
    lines = np.arange(first, last + 1, int(rng.integers(1, 4)))
    pink = rng.random() < 0.5 and not wide
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines))) * (lines ** -0.5 if pink else 1.0)
    wave = np.fft.irfft(spectrum, n)
    wave *= t["half"] * amplitude / np.max(np.abs(wave))
    centre = t["mid"] + t["half"] * (1 - amplitude) * rng.uniform(-0.7, 0.7)
    wave = np.tile(wave, int(rng.integers(1, 3))) if length < 2.5 else wave
    return centre + wave, rate, "multisine"


def _minor(rng, t):
    """Decaying sines, or small loops upon a slow climb."""
    if rng.random() < 0.5:
        f = rng.uniform(1.0, 5.0)
        count = int(rng.integers(6, 14))
        n = int(RATE / f) * count
        u = np.arange(n) * f / RATE
        decay = np.linspace(1, 0.05, n) if rng.random() < 0.5 else 0.8 ** u
        drive = t["mid"] + 0.97 * t["half"] * decay * np.sin(2 * np.pi * u - 0.5 * np.pi)
    else:
        turns = [-0.95]
        steps = int(rng.integers(3, 7))
        for level in np.linspace(-0.95, 0.95, steps + 1)[1:]:
            turns += [level, level - rng.uniform(0.2, 0.9) * (level + 0.95)] * int(rng.integers(1, 3)) + [level]
        turns += [-0.95]
        speed = np.exp(rng.uniform(np.log(2.0), np.log(12.0)))                # half ranges per second
        parts = [np.linspace(a, b, max(4, int(abs(b - a) / speed * RATE)), endpoint=False)
                 for a, b in zip(turns[:-1], turns[1:]) if a != b]
        drive = t["mid"] + t["half"] * np.concatenate(parts)
    return drive, int(rng.choice([500, 1000, 2000])), "minor"


def write_stage(seed: int, folder: Path, library) -> None:
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    truth = stage_truth(seed, library)
    rng = np.random.default_rng([seed, 11])
    low, high = truth["dac_low_V"], truth["dac_high_V"]
    t = dict(truth, mid=0.5 * (low + high), half=0.5 * (high - low))
    kinds = [_cycles if rng.random() < 0.85 else _triangles]
    kinds.append(_chirp)
    extra = [_stair, _multisine, _minor, _triangles, _chirp]
    weight = np.array([0.34, 0.28, 0.2, 0.1, 0.08])
    for i in rng.choice(5, size=int(rng.integers(0, 4)), replace=False, p=weight):
        kinds.append(extra[i])
    kinds = [kinds[i] for i in rng.permutation(len(kinds))]
    bench = _Bench(seed, library)
    names = []
    style = int(rng.integers(3))
    axis = "x" if rng.random() < 0.7 else "y"
    if rng.random() < 0.5:                                     # the owner exercises it first
        for _ in range(int(rng.integers(1, 4))):
            bench.go(low + 0.01 * (high - low), 0.25, 0.02)
            bench.go(high - 0.01 * (high - low), 0.25, 0.02)
        bench.go(truth["rest_V"], 0.25, rng.uniform(0.5, 2.0))
    for kind in kinds:
        drive, rate, label, *more = kind(rng, t)
        drive = np.clip(drive, low, high)
        if kind is not _cycles and kind is not _chirp and rng.random() < 0.3:
            drive = np.concatenate((np.full(int(rng.uniform(0.1, 0.6) * RATE), drive[0]), drive))
        if more:                                               # chirps: from their centre, perhaps under way
            centre, cut = more
            bench.go(centre, rng.uniform(0.1, 0.5), rng.uniform(0.05, 1.5))
            if cut:
                bench.run(drive[:cut])
                drive = drive[cut:]
        else:
            bench.go(drive[0], rng.uniform(0.1, 0.5), np.exp(rng.uniform(np.log(0.02), np.log(2.5))))
        volts, readings = bench.run(drive)
        every = RATE // rate
        rows = np.arange(0, len(volts), every)
        number = len(names) + 1
        name = (f"{number:02d}_{label}.csv", f"{axis}_{label}_{number}.csv", f"rec{number}.csv")[style]
        names.append(name)
        np.savetxt(folder / name, np.column_stack((rows * TICK, volts[rows], readings[rows] * 1e6)),
                   fmt=("%.5f", "%.5f", "%.5f"), delimiter=",",
                   header="time [s],voltage [V],displacement [um]", comments="")
        if rng.random() < 0.3:
            bench.go(truth["rest_V"], 0.3, rng.uniform(0.2, 2.0))
    bench.close()
    lines = ["[rig]", f'name = "alder stage {seed}"', "", "[amplifier]",
             f"gain_V_per_V = {truth['amplifier_gain']!r}", f"bandwidth_Hz = {truth['amplifier_declared_Hz']!r}",
             f"output_min_V = {truth['output_min_V']!r}", f"output_max_V = {truth['output_max_V']!r}"]
    if truth["slew_declared_V_per_s"] > 0:
        lines.append(f"slew_V_per_s = {truth['slew_declared_V_per_s']!r}")
    lines += ["", "[sensor]", f"bandwidth_Hz = {truth['sensor_declared_Hz']!r}"]
    if truth["sensor_gain_declared"]:
        lines.append(f"gain_V_per_m = {truth['sensor_gain_V_per_m']!r}")
    lines += ["", "[acquisition]", f"sampling_rate_Hz = {RATE}", "dac_bits = 16", "adc_bits = 16",
              "input_range_V = [-10, 10]"]
    for name in names:
        lines += ["", "[[recording]]", f'file = "{name}"', f'axis = "{axis}"']
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")


# ---------------------------------------------------------------- tunnelling tips

def _tip_plan(seed: int, t: dict) -> dict:
    """What the laboratory does with this tip, and the gains of its controller."""
    rng = np.random.default_rng([seed, 12])
    nepers_per_volt = 2 * t["kappa_per_m"] * t["extension_m_per_dac_V"]
    lag = t["delay_s"] + 0.5 * TICK + 1 / (2 * np.pi * t["amplifier_Hz"]) + 1 / (2 * np.pi * t["preamplifier_Hz"])
    if t["mode_Hz"] > 0:
        lag += 1 / (2 * np.pi * t["mode_Hz"] * t["mode_Q"])
    loops = []
    for _ in range(2):
        crossover = rng.uniform(0.03, 0.085) / lag
        proportional = rng.uniform(0.03, 0.15) if rng.random() < 0.4 else 0.0
        if t["mode_Hz"] > 0:
            crossover = min(crossover, 0.3 * t["mode_Hz"] / t["mode_Q"])
            proportional = min(proportional, 0.35 / t["mode_Q"])
        loops.append({"crossover": crossover, "ki": 2 * np.pi * crossover * TICK / nepers_per_volt,
                      "kp": proportional / nepers_per_volt, "seconds": float(np.exp(rng.uniform(np.log(0.5), np.log(3.0)))),
                      "dither": int(rng.integers(3)), "rms": rng.uniform(0.2, 0.3)})
    approaches = []
    for _ in range(int(rng.integers(1, 5))):
        duration = np.exp(rng.uniform(np.log(0.1), np.log(5.0)))
        if t["drift_m_per_s"] != 0:
            duration = max(0.1, min(duration, 8e-11 / abs(t["drift_m_per_s"])))
        points = int(rng.choice([64, 128, 200, 256, 512]))
        dwell = max(3, int(round(duration / (2 * points * TICK))))
        nepers = rng.uniform(3.0, 6.5)
        push = rng.uniform(0.0, 0.5) if rng.random() < 0.4 else 0.0
        over = np.log(t["full_scale_A"] / t["set_point_A"]) + rng.uniform(0.2, 0.6)
        clips = bool(rng.random() < 0.2 and over < 3.5)
        if clips:
            push = over
        approaches.append({"points": points, "dwell": dwell, "length": (nepers + push) / (2 * t["kappa_per_m"]),
                           "push": push / (2 * t["kappa_per_m"]), "clips": clips,
                           "skip": int(dwell * rng.uniform(0.0, 0.5)) if rng.random() < 0.5 else 0})
    return {"loops": loops, "approaches": approaches, "order": int(rng.integers(2))}


def _dither(rng, kind: int, rms: float, n: int) -> np.ndarray:
    if kind == 0:
        wave = rng.standard_normal(n)
    elif kind == 1:                                            # random telegraph, held one to four ticks
        hold = int(rng.integers(1, 5))
        wave = np.repeat(rng.choice([-1.0, 1.0], size=n // hold + 1), hold)[:n]
    else:                                                      # white up to some kHz
        spectrum = np.fft.rfft(rng.standard_normal(n))
        spectrum[np.fft.rfftfreq(n, TICK) > rng.uniform(2500, 7000)] = 0
        wave = np.fft.irfft(spectrum, n)
    return np.ascontiguousarray(rms * wave / np.std(wave))


def write_tip(seed: int, folder: Path, library) -> None:
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    t = {name: library.tip_truth(seed, which) for which, name in TIP_TRUTHS.items()}
    plan = _tip_plan(seed, t)
    rng = np.random.default_rng([seed, 13])
    tip = library.tip_open(seed, 1, 0.0)
    state = np.array([0.0, t["set_point_A"]])                  # integral, last reading

    def loop(a, dither, keep):
        n = len(dither)
        drive, current = (np.empty(n), np.empty(n)) if keep else (None, None)
        library.tip_loop(tip, a["ki"], a["kp"], _pointer(dither), None if drive is None else _pointer(drive),
                         None if current is None else _pointer(current), n, _pointer(state))
        return drive, current

    def record_loops():
        for number, a in enumerate(plan["loops"], 1):
            n = int(a["seconds"] * RATE)
            dither = _dither(rng, a["dither"], a["rms"], n + 4000)
            loop(a, dither[:4000], False)
            drive, current = loop(a, np.ascontiguousarray(dither[4000:]), True)
            np.savetxt(folder / f"loop_{number}.csv", np.column_stack((drive, current * 1e9, dither[4000:])),
                       fmt=("%.6f", "%.6f", "%.6f"), delimiter=",",
                       header="drive_z [V],current_z [nA],dither of ln set point", comments="")

    def hold(volts):
        out = np.empty(len(volts))
        library.tip_drive(tip, _pointer(volts), _pointer(out), None, len(volts))
        state[1] = out[-1]
        return out

    def record_approaches():
        for number, a in enumerate(plan["approaches"], 1):
            loop(plan["loops"][0], np.zeros(6000), False)
            z = np.linspace(0.0, a["length"], a["points"])
            frozen = state[0]
            start = frozen + a["push"] / t["extension_m_per_dac_V"]
            hold(np.linspace(frozen, start, 200))
            hold(np.full(int(rng.uniform(0.002, 0.015) * RATE), start))
            columns = []
            for grid in (z, z[::-1]):
                raw = hold(np.repeat(start - grid / t["extension_m_per_dac_V"], a["dwell"]))
                columns.append(raw.reshape(a["points"], a["dwell"])[:, a["skip"]:].mean(axis=1))
            hold(np.linspace(start, frozen, 200))
            loop(plan["loops"][0], np.zeros(2000), False)
            head = ["Experiment\tZ spectroscopy\t", f"Bias>Bias (V)\t{t['bias_V']:g}\t"]
            if seed % 2:
                head += [f"Current>Current (A)\t{t['set_point_A']:g}\t", f"Z Spectroscopy>Number of points\t{a['points']}\t"]
            rows = [f"{x:.9e}\t{f:.9e}\t{b:.9e}" for x, f, b in zip(z, columns[0], columns[1][::-1])]
            text = head + ["", "[DATA]", "Z rel (m)\tCurrent (A)\tCurrent [bwd] (A)"] + rows
            (folder / f"approach_{number}.dat").write_text("\n".join(text) + "\n")

    loop(plan["loops"][0], np.zeros(6000), False)
    for task in ((record_loops, record_approaches) if plan["order"] == 0 else (record_approaches, record_loops)):
        task()
    library.tip_close(tip)
    lines = ["[rig]", f'name = "alder tip {seed}"', "", "[acquisition]", f"sampling_rate_Hz = {RATE}", "dac_bits = 20",
             "adc_bits = 16", "input_range_V = [-10, 10]", "", "[tunnelling]"]
    lines += [f"{key} = {t[key]:.6g}" for key in ("set_point_A", "floor_A", "ceiling_A", "feedback_ohm")]
    if t["preamplifier_declared"]:
        lines.append(f"bandwidth_Hz = {t['preamplifier_declared_Hz']!r}")
    lines += ["", "[axis.z.amplifier]", f"gain_V_per_V = {t['amplifier_gain']!r}",
              f"bandwidth_Hz = {t['amplifier_declared_Hz']!r}", "", "[axis.z.actuator]",
              f"gain_m_per_V = {t['extension_m_per_dac_V'] / t['amplifier_gain']:.6g}"]
    for number in (1, 2):
        lines += ["", "[[recording]]", f'file = "loop_{number}.csv"', 'axis = "z"',
                  'columns = { voltage = "drive_z [V]", current = "current_z [nA]", reference = 3 }']
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")
