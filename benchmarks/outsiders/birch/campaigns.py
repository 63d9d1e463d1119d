"""Recordings of a university laboratory that built its own stages and tips: see simulator.c for the physics.

Rows and delay. Every file is logged by the controller's own loop at 20 kHz (slow files keep every n-th row).
In tick k the loop reads the ADC and then writes the DAC: row k holds the voltage written in tick k and the
reading taken in tick k, which is what the step call of tick k-1 returned. The written voltage reaches the
amplifier one tick (and the drawn fraction) after the instant of its row, in the files as in closed loop
(`delay_ticks` of stage_truth, `loop_delay_s` of tip_truth): with measured[k], volts[k] the columns of a
20 kHz file, measured[k + 1] is the return of stage_step(volts[k]).
"""
from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
RATE = 20000

LAWS = ("Preisach, lognormal-normal", "Preisach, two Lorentzians", "Bouc-Wen, generalised asymmetric",
        "Coleman-Hodgdon", "Duhem, semilinear", "Dahl or LuGre walls", "Maxwell slip behind a bent curve",
        "Jiles-Atherton for strain", "Krasnosel'skii-Pokrovskii")

STAGE_TRUTH = (  # the number of stage_truth is the place in this list
    "law_number", "mode_Hz", "mode_Q", "second_mode_Hz", "second_mode_Q", "second_mode_share", "delay_ticks",
    "amplifier_Hz", "sensor_Hz", "creep_per_decade", "noise_rms_m", "stroke_m", "opening", "polarity",
    "volts_min", "volts_max", "amplifier_gain", "amplifier_gain_nominal", "amplifier_Hz_nominal",
    "output_min_V", "output_max_V", "slew_V_per_s", "sensor_Hz_nominal", "sensor_V_per_m", "adc_step_m",
    "offset_m", "hum_amplitude_m", "least_slope_over_mean", "pinning_threshold")  # the last: of half the range

TIP_TRUTH = (
    "barrier_eV", "two_kappa_per_m", "extension_m_per_V", "loop_delay_s", "drift_m_per_s", "amplifier_Hz",
    "preamplifier_Hz", "set_point_A", "feedback_ohm", "offset_A", "noise_rms_A", "gap_at_set_point_m",
    "mode_Hz", "mode_Q", "mode_share", "hum_amplitude_A", "vibration_rms_m", "bias_V", "amplifier_gain",
    "actuator_m_per_V", "floor_A", "ceiling_A", "amplifier_Hz_nominal", "preamplifier_Hz_nominal")


def build(folder: Path) -> ctypes.CDLL:
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "simulator_birch.so"
    subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", "-o", str(target), str(HERE / "simulator.c"), "-lm"],
                   check=True)
    library = ctypes.CDLL(str(target.resolve()))
    _declare(library)
    return library


def _declare(library) -> None:
    real, pointer, u32, whole, long = ctypes.c_double, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_long
    out = ctypes.POINTER(real)
    for name, result, arguments in (
            ("stage_open", pointer, (u32, u32)),
            ("stage_open_at", pointer, (u32, u32, real, whole)),
            ("stage_step", None, (pointer, real, out, out)),
            ("stage_close", None, (pointer,)),
            ("stage_rest", None, (pointer, out, out)),
            ("stage_record", None, (pointer, pointer, long, long, pointer)),
            ("stage_truth", real, (u32, whole)),
            ("tip_open", pointer, (u32, u32, real)),
            ("tip_step", None, (pointer, real, out, out)),
            ("tip_move_surface", None, (pointer, real)),
            ("tip_fault", None, (pointer, whole)),
            ("tip_close", None, (pointer,)),
            ("tip_truth", real, (u32, whole)),
            ("tip_loop", real, (pointer, real, real, real, pointer, long, pointer, pointer)),
            ("tip_sweep", None, (pointer, real, pointer, long, long, long, pointer, pointer))):
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments


def stage_truth(seed: int, library) -> dict:
    _declare(library)
    truth = {name: library.stage_truth(seed, i) for i, name in enumerate(STAGE_TRUTH)}
    truth["law"] = LAWS[int(truth["law_number"])]
    truth["delay_s"] = truth["delay_ticks"] / RATE
    return truth


def tip_truth(seed: int, library) -> dict:
    _declare(library)
    truth = {name: library.tip_truth(seed, i) for i, name in enumerate(TIP_TRUTH)}
    truth["drift_during_sweeps_m_per_s"] = truth["drift_m_per_s"]  # positive: the gap grows
    return truth


# ------------------------------------------------------------------------------------------------ wave forms

def _triangle(phase):
    return 2.0 / np.pi * np.arcsin(np.clip(np.sin(2.0 * np.pi * phase), -1.0, 1.0))


def _ramps(points, speed):
    """Straight travel between `points` at `speed` (units per second), one value a tick."""
    pieces = []
    for a, b in zip(points[:-1], points[1:]):
        n = max(2, int(round(abs(b - a) / speed * RATE)))
        pieces.append(a + (b - a) * np.arange(n) / n)
    return np.concatenate(pieces)


def _wave(kind, frequency, amplitudes, middle):
    """One period after another, of the amplitudes given, around `middle`."""
    n = int(round(RATE / frequency))
    phase = np.arange(n) / n
    shape = _triangle(phase) if kind == "triangle" else np.sin(2.0 * np.pi * phase)
    return np.concatenate([middle + a * shape for a in amplitudes])


def _hold(value, seconds):
    return np.full(int(round(seconds * RATE)), float(value))


def _low_passed(rng, n, cutoff):
    """Gaussian noise of unit variance, flat to the cutoff and then falling (in the Fourier domain, no transient)."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    f = np.fft.rfftfreq(n, 1.0 / RATE)
    spectrum *= 1.0 / (1.0 + (f / cutoff) ** 8)
    spectrum[0] = 0.0
    x = np.fft.irfft(spectrum, n)
    return x / x.std()


class _Session:
    """One stage on the bench: its voltages in units of half the range used, and what is written to disk."""

    def __init__(self, seed, folder, library, truth, rng, start):
        self.library, self.folder, self.rng = library, folder, rng
        self.middle = 0.5 * (truth["volts_min"] + truth["volts_max"])
        self.half = 0.5 * (truth["volts_max"] - truth["volts_min"])
        self.stage = library.stage_open_at(seed, 900001, self.volts(start), int(rng.integers(4)))
        self.at = start
        self.files = []

    def volts(self, u):
        step = 20.0 / 65536.0
        return np.clip(np.round((self.middle + self.half * np.asarray(u)) / step) * step, -10.0, 10.0 - step)

    def drive(self, u, every=1):
        v = np.ascontiguousarray(self.volts(u), dtype=float)
        kept = np.zeros((len(v) + every - 1) // every)
        self.library.stage_record(self.stage, v.ctypes.data, len(v), every, kept.ctypes.data)
        self.at = float(u[-1])
        return v[::every], kept

    def travel(self, to, seconds=0.3):
        """Unrecorded, gently."""
        n = int(seconds * RATE)
        x = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)
        self.drive(self.at + (to - self.at) * x)

    def rest(self, seconds):
        self.drive(_hold(self.at, seconds))

    def record(self, name, u, rate, skip=0.0):
        """`skip` seconds at the beginning are driven but not recorded: the file starts in mid-motion."""
        every = RATE // rate
        cut = int(skip * RATE)
        if cut:
            self.drive(u[:cut])
            u = u[cut:]
        v, d = self.drive(u, every)
        t = np.arange(len(v)) * (every / RATE)
        np.savetxt(self.folder / name, np.column_stack([t, v, d * 1e6]), delimiter=",", fmt=("%.5f", "%.6f", "%.5f"),
                   header="time [s],voltage [V],displacement [um]", comments="")
        self.files.append(name)

    def close(self):
        self.library.stage_close(self.stage)


def _slow(s, rng, name, quick=False):
    """Triangles or sines, in most cases of decreasing amplitude."""
    kind = "triangle" if rng.random() < 0.6 else "sine"
    middle = 0.0 if rng.random() < 0.7 else float(rng.uniform(-0.2, 0.2))
    top = (1.0 if not quick else rng.uniform(0.5, 1.0)) - abs(middle)
    pick = rng.random()
    count = int(rng.integers(4, 8))
    if pick < 0.6:
        amplitudes = top * np.linspace(1.0, rng.uniform(0.12, 0.3), count)
    elif pick < 0.8:
        amplitudes = top * rng.uniform(0.6, 0.8) ** np.arange(count)
    else:
        amplitudes = np.full(max(3, count - 2), top)
    amplitudes = np.concatenate([[amplitudes[0]], amplitudes])
    if quick:
        frequency = float(np.exp(rng.uniform(np.log(4.0), np.log(30.0))))
        amplitudes = np.repeat(amplitudes, max(1, int(frequency / 6)))
        rate = int(rng.choice([5000, 10000, 20000]))
    else:
        frequency = float(np.exp(rng.uniform(np.log(0.2), np.log(1.5))))
        rate = int(rng.choice([500, 1000, 1000, 2000]))
    u = _wave(kind, frequency, amplitudes, middle)
    start = s.at
    from_end = (not quick) and rng.random() < 0.35     # from the lower end of the range, as a cautious student does
    if from_end:
        lead = _ramps([start, -top + middle, middle], 4.0 * top * frequency)
        u = np.concatenate([lead, u])
    elif abs(start - middle) > 1e-9:
        u = np.concatenate([_ramps([start, middle], 4.0 * top * frequency), u])
    if rng.random() < 0.5:
        u = np.concatenate([_hold(u[0], rng.uniform(0.05, 0.5)), u])
    if rng.random() < 0.5:
        u = np.concatenate([u, _hold(u[-1], rng.uniform(0.1, 1.5))])
    skip = rng.uniform(0.05, 0.9) / frequency if rng.random() < 0.3 else 0.0
    s.record(name, u, rate, skip)


def _minor(s, rng, name):
    """Minor loops on both branches: by hand, as reversal curves, or at random."""
    speed = float(np.exp(rng.uniform(np.log(1.0), np.log(5.0))))
    pick = rng.random()
    points = [s.at]
    if pick < 0.4:         # stairs of small loops on the way up and down
        size = rng.uniform(0.2, 0.5)
        points += [-1.0]
        for c in np.linspace(-0.6, 0.9, int(rng.integers(3, 6))):
            points += [c, c - size] * int(rng.integers(1, 3))
        points += [1.0]
        for c in np.linspace(0.6, -0.9, int(rng.integers(3, 6))):
            points += [c, c + size]
        points += [-1.0, 0.0]
    elif pick < 0.7:       # first-order reversal curves
        for c in np.linspace(0.7, -0.7, int(rng.integers(5, 9))):
            points += [1.0, c]
        points += [1.0, 0.0]
    else:
        points += [1.0, -1.0] + [float(x) for x in rng.uniform(-1.0, 1.0, int(rng.integers(12, 24)))]
    u = _ramps(points, speed)
    if rng.random() < 0.4:
        u = np.concatenate([u, _hold(u[-1], rng.uniform(0.2, 1.0))])
    skip = rng.uniform(0.1, 0.6) if rng.random() < 0.25 else 0.0
    s.record(name, u, int(rng.choice([500, 1000, 2000, 4000])), skip)


def _dynamic(s, rng, truth, name):
    """Filtered noise or a chirp at 20 kHz that reaches beyond the mode."""
    f0, q = truth["mode_Hz"], truth["mode_Q"]
    n = int(rng.uniform(0.5, 3.0) * RATE)
    bias = float(rng.uniform(-0.3, 0.3))
    room = 1.0 - abs(bias)
    s.travel(bias)
    s.rest(float(rng.uniform(0.2, 2.0)))
    if rng.random() < 0.5:
        cutoff = min(9000.0, f0 * rng.uniform(1.5, 3.5))
        # `boost`: rms motion of the resonant platform over that at rest; kept to what a user would dare
        boost = np.sqrt(1.0 + 0.5 * np.pi * f0 * q / cutoff)
        rms = min(float(np.exp(rng.uniform(np.log(0.03), np.log(0.3)))), 0.3 * room,
                  float(np.exp(rng.uniform(np.log(0.05), np.log(0.2)))) / boost)
        x = np.clip(rms * _low_passed(rng, n, cutoff), -room, room)
        if rng.random() < 0.35:                         # on top of a slow swing
            x = np.clip(x + 0.4 * room * np.sin(2.0 * np.pi * rng.uniform(0.7, 4.0) * np.arange(n) / RATE), -room, room)
    else:
        low, high = rng.uniform(2.0, 30.0), min(9000.0, f0 * rng.uniform(1.7, 4.0))
        peak = 1.0 + 0.7 * q
        amplitude = min(float(np.exp(rng.uniform(np.log(0.02), np.log(0.4)))), 0.9 * room,
                        float(np.exp(rng.uniform(np.log(0.08), np.log(0.4)))) / peak)
        t = np.arange(n) / RATE
        span = n / RATE
        if rng.random() < 0.6:
            ratio = np.log(high / low)
            phase = low * span / ratio * np.expm1(ratio * t / span)
        else:
            phase = low * t + 0.5 * (high - low) * t ** 2 / span
        if rng.random() < 0.2:
            phase = phase[-1] - phase[::-1]             # downwards
        x = amplitude * np.sin(2.0 * np.pi * phase)
    u = bias + x
    pick = rng.random()
    skip = 0.0
    if pick < 0.3:         # rests before and after
        ramp = np.minimum(1.0, np.arange(n) / 200.0)
        u = np.concatenate([_hold(bias, rng.uniform(0.02, 0.2)), bias + ramp * x * ramp[::-1],
                            _hold(bias, rng.uniform(0.05, 0.4))])
    elif pick < 0.5:       # the recorder was started late
        skip = float(rng.uniform(0.01, 0.1))
    s.record(name, u, RATE, skip)
    s.travel(bias, 0.1)


def write_stage(seed: int, folder: Path, library) -> None:
    _declare(library)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    truth = stage_truth(seed, library)
    rng = np.random.default_rng([seed, 77])
    start = 0.0 if rng.random() < 0.5 else float(rng.uniform(-0.6, 0.6))
    if rng.random() < 0.25:
        start = -1.0
    s = _Session(seed, folder, library, truth, rng, start)
    style = int(rng.integers(3))
    names = {0: ("loops_decreasing.csv", "minor_loops.csv", "faster.csv", "dynamic.csv", "second_dynamic.csv"),
             1: ("2_slow.csv", "3_inner.csv", "4_fast.csv", "5_wideband.csv", "6_wideband.csv"),
             2: ("x_hyst.csv", "x_minor.csv", "x_scan.csv", "x_resonance.csv", "x_resonance_b.csv")}[style]
    jobs = [("slow", names[0])]
    if rng.random() < 0.8:
        jobs.append(("minor", names[1]))
    if rng.random() < 0.5:
        jobs.append(("quick", names[2]))
    if rng.random() < 0.93 or len(jobs) < 2:
        jobs.append(("dynamic", names[3]))
        if rng.random() < 0.3:
            jobs.append(("dynamic", names[4]))
    if rng.random() < 0.5:
        jobs = [jobs[i] for i in rng.permutation(len(jobs))]
    for what, name in jobs:
        if what == "slow":
            _slow(s, rng, name)
        elif what == "minor":
            _minor(s, rng, name)
        elif what == "quick":
            _slow(s, rng, name, quick=True)
        else:
            _dynamic(s, rng, truth, name)
        s.rest(float(np.exp(rng.uniform(np.log(0.2), np.log(8.0)))))
    s.close()
    lines = ["[rig]", f'name = "home-built stage {seed}"', "", "[amplifier]",
             f"gain_V_per_V = {truth['amplifier_gain_nominal']:g}",
             f"bandwidth_Hz = {truth['amplifier_Hz_nominal']:g}",
             f"output_min_V = {truth['output_min_V']:g}", f"output_max_V = {truth['output_max_V']:g}"]
    if truth["slew_V_per_s"] > 0.0:
        lines.append(f"slew_V_per_s = {truth['slew_V_per_s']:.3e}")
    lines += ["", "[sensor]", f"bandwidth_Hz = {truth['sensor_Hz_nominal']:g}"]
    if rng.random() < 0.7:
        lines.append(f"gain_V_per_m = {truth['sensor_V_per_m']:.6e}")
    lines += ["", "[acquisition]", f"sampling_rate_Hz = {RATE}", "dac_bits = 16", "adc_bits = 16",
              "input_range_V = [-10, 10]"]
    for name in s.files:
        lines += ["", "[[recording]]", f'file = "{name}"', 'axis = "x"']
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")


# ------------------------------------------------------------------------------------------------ tips

def tip_gain(truth: dict, crossover_hz: float) -> float:
    """Integral gain (volts a tick and neper) of the laboratory's controller for a crossover frequency."""
    return 2.0 * np.pi * crossover_hz / RATE / (truth["two_kappa_per_m"] * truth["extension_m_per_V"])


def _safe_crossover(truth: dict) -> float:
    """From the lags of the loop and the height of the mode's peak."""
    lag = (truth["loop_delay_s"] + 0.75 / RATE + 1.0 / (2.0 * np.pi * truth["amplifier_Hz"])
           + 1.0 / (2.0 * np.pi * truth["preamplifier_Hz"]))
    limit = 0.6 / lag / (2.0 * np.pi)
    if truth["mode_share"] > 0.0:
        limit = min(limit, 0.4 * truth["mode_Hz"] / (1.0 + truth["mode_share"] * truth["mode_Q"]))
    return limit


def write_tip(seed: int, folder: Path, library) -> None:
    _declare(library)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    truth = tip_truth(seed, library)
    rng = np.random.default_rng([seed, 78])
    safe = _safe_crossover(truth)
    loops = []
    reach = 8.0 * truth["extension_m_per_V"]
    for number in (1, 2):
        tip = library.tip_open(seed, 910000 + number, float(rng.uniform(-0.5, 0.5)) * min(reach, 20e-9)
                               if rng.random() < 0.5 else 0.0)
        # a controller by trial and error: the second one sharper or gentler than the first
        ki = tip_gain(truth, safe * float(rng.uniform(0.25, 0.9)))
        kp = ki * float(rng.uniform(0.2, 0.8)) if rng.random() < 0.4 else 0.0
        settle = int(rng.uniform(0.4, 0.8) * RATE)
        drive = library.tip_loop(tip, 0.0, 0.3 * ki, 0.0, None, settle, None, None)
        n = int(rng.uniform(0.5, 3.0) * RATE)
        dither = _low_passed(rng, n, float(rng.uniform(1500.0, 9000.0))) * float(rng.uniform(0.2, 0.3))
        dither = np.ascontiguousarray(dither)
        volts, current = np.zeros(n), np.zeros(n)
        library.tip_loop(tip, drive, ki, kp, dither.ctypes.data, n, volts.ctypes.data, current.ctypes.data)
        library.tip_close(tip)
        name = f"loop_{number}.csv"
        np.savetxt(folder / name, np.column_stack([volts, current * 1e9, dither]), delimiter=",",
                   fmt=("%.7f", "%.7f", "%.6f"), header="drive_z [V],current_z [nA],dither of ln set point", comments="")
        loops.append(name)
    for number in range(int(rng.integers(1, 4))):
        _approach(seed, number + 1, folder, library, truth, rng, safe)
    lines = ["[rig]", f'name = "home-built microscope {seed}"', "", "[acquisition]", f"sampling_rate_Hz = {RATE}",
             "dac_bits = 20", "adc_bits = 16", "input_range_V = [-10, 10]", "", "[tunnelling]",
             f"set_point_A = {truth['set_point_A']:.9e}", f"floor_A = {truth['floor_A']:g}",
             f"ceiling_A = {truth['ceiling_A']:g}", f"feedback_ohm = {truth['feedback_ohm']:.3e}"]
    if rng.random() < 0.7:
        lines.append(f"bandwidth_Hz = {truth['preamplifier_Hz_nominal']:g}")
    lines += ["", "[axis.z.amplifier]", f"gain_V_per_V = {truth['amplifier_gain']:g}",
              f"bandwidth_Hz = {truth['amplifier_Hz_nominal']:g}", "", "[axis.z.actuator]",
              f"gain_m_per_V = {truth['actuator_m_per_V']:.4e}"]
    for name in loops:
        lines += ["", "[[recording]]", f'file = "{name}"', 'axis = "z"',
                  'columns = { voltage = "drive_z [V]", current = "current_z [nA]", reference = 3 }']
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")


def _approach(seed, number, folder, library, truth, rng, safe) -> None:
    """A Z spectroscopy: the loop is held open, the tip withdraws and comes back."""
    tip = library.tip_open(seed, 920000 + number, 0.0)
    drive = library.tip_loop(tip, 0.0, tip_gain(truth, 0.3 * safe), 0.0, None, int(0.3 * RATE), None, None)
    decades = float(rng.uniform(1.2, 3.0))
    length = decades * np.log(10.0) / truth["two_kappa_per_m"]
    first = 0.0 if rng.random() < 0.6 else -float(rng.uniform(0.1, 0.6)) * length / decades
    if rng.random() < 0.15:                 # too greedy: the preamplifier clips at the near end
        first = -(np.log(10.0 / truth["feedback_ohm"] / truth["set_point_A"]) + 0.3) / truth["two_kappa_per_m"]
        first = max(first, -0.3e-9)
    points = int(rng.choice([64, 100, 128, 200, 256]))
    seconds = float(np.exp(rng.uniform(np.log(0.1), np.log(5.0))))
    dwell = max(2, int(round(seconds * RATE / (2 * points))))
    settle = min(dwell - 1, max(1, int(0.3 * dwell)))
    zrel = np.ascontiguousarray(np.linspace(first, length, points))
    for z in np.linspace(0.0, first, 60):   # feedback is off before the tip is brought to the first point
        library.tip_step(tip, drive - z / truth["extension_m_per_V"], None, None)
    forward, backward = np.zeros(points), np.zeros(points)
    library.tip_sweep(tip, drive, zrel.ctypes.data, points, dwell, settle, forward.ctypes.data, backward.ctypes.data)
    library.tip_close(tip)
    head = ["Experiment\tZ spectroscopy\t", f"Date\t{1 + number:02d}.03.2019 17:{10 + number}:00\t", "User\tstudent\t",
            f"Bias>Bias (V)\t{truth['bias_V']:.4g}\t",
            f"Z Spectroscopy>Initial Z-offset (m)\t{first:.6e}\t",
            f"Z Spectroscopy>Sweep distance (m)\t{length - first:.6e}\t",
            f"Z Spectroscopy>Number of points\t{points}\t",
            f"Z Spectroscopy>Settling time (s)\t{settle / RATE:.4e}\t",
            f"Z Spectroscopy>Integration time (s)\t{(dwell - settle) / RATE:.4e}\t",
            "", "[DATA]", "Z rel (m)\tCurrent (A)\tCurrent [bwd] (A)"]
    rows = [f"{z:.9e}\t{a:.9e}\t{b:.9e}" for z, a, b in zip(zrel, forward, backward)]
    (folder / f"Z-Spectroscopy{number:03d}.dat").write_text("\n".join(head + rows) + "\n")
