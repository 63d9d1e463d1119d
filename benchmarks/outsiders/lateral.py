"""Calibrate stages of a third-party simulator, then run the shipped controller on its plant."""

from collections.abc import Callable
from dataclasses import dataclass
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.outsiders.simulators import LoopRun, RATE_Hz, Simulator, load_simulator, track
from piezoid.design.certificate import Certificate
from piezoid.design.design import design_from_json
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Status
from piezoid.verification.scenarios import Path as ScanPath
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid.verification.tracking import Tracking
from piezoid.verification.tracking import track as track_error
from piezoid_cli.calibration import calibrate

Prepare = Callable[[Simulator, int, Path], None]
FREQUENCIES_Hz = (1.0, 5.0, 10.0, 20.0, 50.0)
TURNS = 5.0
RADIUS = 0.7  # of half the reference range
APPROACH_s = 0.4
DIVERGED = 0.25  # of the diameter: rms error above which a loop counts as unstable
OSCILLATES = 0.01  # of the diameter: rms at a constant reference above which a loop is unstable
BOUND_RUNS = 60
SPEEDS = (1.0, 0.3, 0.1)  # of the fastest reference of the certificate, in turn
BOUND_s = 0.5
# Status bits of a run outside the conditions of a bound.
LIMITED = Status.VOLTAGE_LIMITED | Status.REFERENCE_LIMITED | Status.VOLTAGE_STEP


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """Result of one stage; the tables in ``__main__`` explain the quantities."""

    simulator: str
    seed: int
    law: str
    mode_Hz: float
    quality: float
    applies: bool
    ships: bool
    reason: str
    bandwidth_Hz: float = 0.0
    guaranteed_m: float | None = None
    noise_m: float = 0.0
    stable: bool = False
    worst_percent: float = 0.0
    error_10_m: float = 0.0
    none_10_m: float = 0.0
    ratios: tuple[tuple[str, float, float], ...] = ()
    bound_runs: int = 0
    bound_broken: int = 0
    worst_to_bound: float = 0.0
    seconds: float = 0.0

    def loop_summary(self, decimals: int = 0) -> str:
        """Return stability, bandwidth, error at 10 Hz and broken bounds as text."""
        return (
            f"{'stable' if self.stable else 'UNSTABLE'}, {self.bandwidth_Hz:.{decimals}f} Hz, "
            f"at 10 Hz {self.error_10_m * 1e9:.1f} nm of {self.none_10_m * 1e9:.0f} nm; bound "
            f"{self.bound_broken} of {self.bound_runs} broken, worst {self.worst_to_bound:.2f}"
        )


def evaluate_stage(
    name: str, seed: int, folder: Path | None = None, prepare: Prepare | None = None
) -> StageResult:
    """Record and calibrate a stage, and run the shipped controller on it.

    folder   parent of the folder that keeps recordings and results
    prepare  changes the folder of recordings before the calibration
    """
    simulator, start_s = load_simulator(name), perf_counter()
    truth = simulator.campaigns.stage_truth(seed, simulator.library)
    values = {
        "simulator": name,
        "seed": seed,
        "law": str(truth.get("law", "?")),
        "mode_Hz": float(truth.get("mode_Hz", truth.get("mode_frequency_Hz", np.nan))),
        "quality": float(truth.get("mode_Q", truth.get("quality", np.nan))),
    }
    with TemporaryDirectory() as scratch:
        stage_folder = Path(scratch) if folder is None else folder / f"{name}-{seed}"
        recordings = stage_folder / "recordings"
        recordings.mkdir(parents=True, exist_ok=True)
        simulator.campaigns.write_stage(seed, recordings, simulator.library)
        if prepare is not None:
            prepare(simulator, seed, recordings)
        files = sorted(recordings.glob("*.csv"))
        try:
            result = calibrate(files, recordings / "lab.toml", lambda _: None)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            return StageResult(**values, applies=False, ships=False, reason=reason)
        if folder is not None:
            for path, content in result.files.items():
                (stage_folder / path).parent.mkdir(parents=True, exist_ok=True)
                (stage_folder / path).write_bytes(content)
    axis = next(iter(result.model.axes.values()))
    values |= {"applies": axis.verdict.applies, "seconds": perf_counter() - start_s}
    if "params.json" not in result.files:
        reason = axis.verdict.reason or result.controllers.reason or _failed_verdicts(result)
        return StageResult(**values, ships=False, reason=reason)
    shipped = from_json(result.files["params.json"], "params.json").axes[0]
    loop = design_from_json(result.files["design.json"]).axes[0].loops[0]
    comparison = loads(result.files["verification.json"])["comparison"]
    return StageResult(
        **values,
        ships=True,
        reason="",
        bandwidth_Hz=loop.bandwidth_Hz,
        **_track_spirals(simulator, seed, shipped, comparison),
        **_check_bound(simulator, seed, shipped, loop.certificate),
    )


def _failed_verdicts(result) -> str:
    verification = result.controllers.verification
    if verification is None:
        return "no controller"
    return "; ".join(f"{v.name}, {v.scenario}" for v in verification.verdicts if not v.passed)


def is_stable_on(name: str, seed: int, params: Path) -> bool:
    """Return whether a shipped controller follows spirals, and rests, on the simulated stage."""
    shipped = from_json(params.read_bytes(), params.name).axes[0]
    return bool(_track_spirals(load_simulator(name), seed, shipped, [])["stable"])


def reference_range(shipped: AxisParameters) -> tuple[float, float]:
    """Return the centre of the references and half their range [m]."""
    low, high = (float(shipped.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    return 0.5 * (low + high), 0.5 * (high - low)


def approach(target_m: float, rest_m: float) -> Array:
    """Return a slow reference from rest to a target, followed by a pause."""
    ticks = round(APPROACH_s * RATE_Hz)
    ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, ticks))
    return np.concatenate([rest_m + (target_m - rest_m) * ramp, np.full(ticks // 2, target_m)])


def spiral_error(
    run: LoopRun, path: ScanPath, *, frequency_Hz: float, radius_m: float, centre_m: float
) -> Tracking:
    """Compare the position with a spiral that follows an ``approach``."""
    start = round(1.5 * APPROACH_s * RATE_Hz) - 1  # positions are those at the ends of ticks
    return track_error(
        {"x": radius_m * path.x},
        {"x": run.position[start : start + len(path.x)] - centre_m},
        path=path,
        radius_m=radius_m,
        frequency_Hz=frequency_Hz,
        sampling_rate_Hz=RATE_Hz,
    )


def _track_spirals(
    simulator: Simulator, seed: int, shipped: AxisParameters, comparison: list
) -> dict:
    """Track spirals with every method, and compare the errors with those of the verification."""
    predicted = {(row["method"], row["frequency_Hz"]): row["rms_m"] for row in comparison}
    ratios, rms_m, worst = [], {}, 0.0
    centre_m, half_range_m = reference_range(shipped)
    radius_m = RADIUS * half_range_m
    for f in FREQUENCIES_Hz:
        path = constant_angular_velocity(RATE_Hz, frequency_Hz=f, turns=TURNS)
        for method in shipped.methods:
            axis = shipped.for_method(method)
            preview = int(axis.values["preview_samples"])
            future = np.minimum(np.arange(len(path.x)) + preview, len(path.x) - 1)
            reference_m = centre_m + radius_m * path.x[future]
            run = track(
                simulator,
                seed,
                7,
                axis.values,
                lambda rest_m, r=reference_m: np.concatenate([approach(centre_m, rest_m), r]),
            )
            rms_m[method, f] = spiral_error(
                run, path, frequency_Hz=f, radius_m=radius_m, centre_m=centre_m
            ).rms_m
            if method == shipped.method:
                worst = max(worst, rms_m[method, f] / (2.0 * radius_m))
            if predicted.get((method, f), 0.0) > 0.0:
                ratios.append((method, f, rms_m[method, f] / predicted[method, f]))
    hold_m = np.full(round(BOUND_s * RATE_Hz), centre_m)
    run = track(
        simulator,
        seed,
        7,
        shipped.values,
        lambda rest_m: np.concatenate([approach(centre_m, rest_m), hold_m]),
    )
    oscillation = float(np.std(run.position[-round(0.5 * BOUND_s * RATE_Hz) :])) / (2.0 * radius_m)
    return {
        "stable": bool(worst < DIVERGED and oscillation < OSCILLATES),
        "worst_percent": 100.0 * worst,
        "error_10_m": rms_m[shipped.method, 10.0],
        "none_10_m": rms_m["none", 10.0],
        "ratios": tuple(ratios),
    }


def _check_bound(
    simulator: Simulator, seed: int, shipped: AxisParameters, certificate: Certificate | None
) -> dict:
    """Track references that satisfy the conditions of the certificate; count broken bounds.

    Two of three references are slower. Their errors are compared with the guarantee at that speed.
    """
    if certificate is None or not certificate.is_guaranteed:
        return {}
    if not np.isfinite(certificate.guaranteed_error_m):
        return {}
    rng = np.random.default_rng([seed, 99])
    runs, broken, worst = 0, 0, 0.0
    for number in range(BOUND_RUNS):
        slew = certificate.reference_slew_m_per_s * SPEEDS[number % len(SPEEDS)]
        error_m = largest_error_m(
            simulator,
            seed,
            100 + number,
            shipped,
            slew_m_per_s=slew,
            rng=rng,
            excluded=LIMITED | Status.UNCERTIFIED,
        )
        if error_m is None:
            continue
        ratio = error_m / (certificate.guaranteed_at(slew) + certificate.noise_error_m)
        runs, broken, worst = runs + 1, broken + (ratio > 1.0), max(worst, ratio)
    return {
        "guaranteed_m": certificate.guaranteed_error_m,
        "noise_m": certificate.noise_error_m,
        "bound_runs": runs,
        "bound_broken": broken,
        "worst_to_bound": worst,
    }


def largest_error_m(
    simulator: Simulator,
    seed: int,
    noise_seed: int,
    shipped: AxisParameters,
    *,
    slew_m_per_s: float,
    rng: np.random.Generator,
    excluded: Status,
) -> float | None:
    """Return the largest error along a random reference, or None if its conditions are not met.

    slew_m_per_s  fastest reference
    excluded      status bits of a run outside the conditions
    """
    references: list[Array] = []
    slew = 0.999 * slew_m_per_s  # rounding must not exceed the limit

    def reference_from(rest_m: float) -> Array:
        centre_m, half_range_m = reference_range(shipped)
        reference_m = centre_m + _random_reference(rng, slew, 0.95 * half_range_m)
        path = np.concatenate([approach(centre_m, rest_m), reference_m])
        references.append(_slew_limited(path, slew, rest_m))
        return references[0]

    run = track(simulator, seed, noise_seed, shipped.values, reference_from)
    start = len(references[0]) - int(BOUND_s * RATE_Hz)  # a stage may rest outside its range
    if np.any(run.status[start:] & np.uint32(excluded)):
        return None
    preview = int(shipped.values["preview_samples"])
    position = np.concatenate([[run.rest], run.position[:-1]])
    delayed = np.concatenate([np.full(preview, run.rest), references[0]])[: len(position)]
    return float(np.abs(position - delayed)[start:].max())


def _random_reference(rng: np.random.Generator, slew_m_per_s: float, reach_m: float) -> Array:
    """Return a random reference about 0 with limits of amplitude and speed, (ticks,)."""
    ticks = int(BOUND_s * RATE_Hz)
    t = np.arange(ticks) / RATE_Hz
    amplitude_m = reach_m * rng.uniform(0.1, 1.0)
    shape = rng.integers(4)
    if shape == 0:  # a sine up to the speed limit
        f = rng.uniform(0.2, 1.0) * slew_m_per_s / (2.0 * np.pi * amplitude_m)
        return np.asarray(amplitude_m * np.sin(2.0 * np.pi * f * t))
    if shape == 1:  # a triangle
        f = rng.uniform(0.2, 1.0) * slew_m_per_s / (4.0 * amplitude_m)
        return np.asarray(amplitude_m * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * f * t)))
    if shape == 2:  # steps, as ramps at the speed limit
        levels = rng.uniform(-amplitude_m, amplitude_m, 12)
        targets = np.repeat(levels, ticks // 12 + 1)[:ticks]
    else:  # a sum of sines
        f = rng.uniform(0.5, 100.0, 5)
        phase = 2.0 * np.pi * np.outer(t, f) + rng.uniform(0, 6, 5)
        targets = amplitude_m / 5.0 * np.sin(phase).sum(axis=1)
    return _slew_limited(targets, slew_m_per_s, 0.0)


def _slew_limited(targets: Array, slew_m_per_s: float, start_m: float) -> Array:
    """Return a path that follows its targets with limited speed."""
    step_m, path_m = slew_m_per_s / RATE_Hz, np.empty(len(targets))
    position_m = start_m
    for k, target_m in enumerate(targets.tolist()):
        position_m += min(max(target_m - position_m, -step_m), step_m)
        path_m[k] = position_m
    return path_m
