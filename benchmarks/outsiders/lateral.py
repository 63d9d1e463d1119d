"""Stages of an outsider: recordings to a controller, then that controller on the stage."""

from collections.abc import Callable
from dataclasses import dataclass
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.simulators import RATE_Hz, Simulator, simulator, track
from piezoid.design.certificate import Certificate
from piezoid.design.design import design_from_json
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Status
from piezoid.verification.scenarios import constant_angular_velocity
from piezoid.verification.tracking import Tracking
from piezoid.verification.tracking import track as compared
from piezoid_cli.calibration import calibrate

Prepare = Callable[[Simulator, int, Path], None]
COMPARED_Hz = (1.0, 5.0, 10.0, 20.0, 50.0)
TURNS = 5.0
RADIUS = 0.7
LED_s = 0.4
DIVERGED = 0.25  # of the diameter: what a loop that shipped may be off at most
SWINGS = 0.01  # of the diameter, rms, at rest: a loop that swings within its limits
BOUND_RUNS = 60
SPEEDS = (1.0, 0.3, 0.1)  # of the certificate's fastest reference, in turn
BOUND_s = 0.5


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """What became of one stage; see the heads of the table in ``__main__``."""

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


def judge(
    name: str, seed: int, folder: Path | None = None, prepare: Prepare | None = None
) -> StageResult:
    """Record a stage, calibrate it, and drive what ships on the stage itself.

    prepare  changes the folder of recordings before it is calibrated
    """
    from time import perf_counter

    made, begun = simulator(name), perf_counter()
    truth = made.campaigns.stage_truth(seed, made.library)
    known = {
        "simulator": name,
        "seed": seed,
        "law": str(truth.get("law", "?")),
        "mode_Hz": float(truth.get("mode_Hz", truth.get("mode_frequency_Hz", np.nan))),
        "quality": float(truth.get("mode_Q", truth.get("quality", np.nan))),
    }
    with TemporaryDirectory() as scratch:
        place = Path(scratch) if folder is None else folder / f"{name}-{seed}"
        recordings = place / "recordings"
        recordings.mkdir(parents=True, exist_ok=True)
        made.campaigns.write_stage(seed, recordings, made.library)
        if prepare is not None:
            prepare(made, seed, recordings)
        files = sorted(recordings.glob("*.csv"))
        try:
            found = calibrate(files, recordings / "lab.toml", lambda _: None)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            return StageResult(**known, applies=False, ships=False, reason=reason)
        if folder is not None:
            for path, content in found.files.items():
                (place / path).parent.mkdir(parents=True, exist_ok=True)
                (place / path).write_bytes(content)
    axis = next(iter(found.model.axes.values()))
    seconds = perf_counter() - begun
    if "params.json" not in found.files:
        reason = axis.verdict.reason or found.controllers.reason or _failed(found)
        return StageResult(
            **known, applies=axis.verdict.applies, ships=False, reason=reason, seconds=seconds
        )
    shipped = from_json(found.files["params.json"], "params.json").axes[0]
    design = design_from_json(found.files["design.json"]).axes[0].loops[0]
    own = loads(found.files["verification.json"])["comparison"]
    return StageResult(
        **known,
        applies=axis.verdict.applies,
        ships=True,
        reason="",
        bandwidth_Hz=design.bandwidth_Hz,
        seconds=seconds,
        **_driven(made, seed, shipped, own),
        **_bound(made, seed, shipped, design.certificate),
    )


def _failed(found) -> str:
    made = found.controllers
    if made.verification is None:
        return "no controller"
    return "; ".join(f"{v.name}, {v.scenario}" for v in made.verification.verdicts if not v.passed)


def is_stable_on(name: str, seed: int, params: Path) -> bool:
    """Return whether a shipped controller follows spirals, and rests, on the simulated stage."""
    shipped = from_json(params.read_bytes(), params.name).axes[0]
    return bool(_driven(simulator(name), seed, shipped, [])["stable"])


def middle_of(shipped: AxisParameters) -> tuple[float, float]:
    """Return the middle of the references and how far they go from it."""
    low, high = (float(shipped.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    return 0.5 * (low + high), 0.5 * (high - low)


def led_to(middle_m: float, rest_m: float) -> Array:
    """Return the way from rest to the middle, slowly, and a while there."""
    ticks = round(LED_s * RATE_Hz)
    way = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, ticks))
    return np.concatenate([rest_m + (middle_m - rest_m) * way, np.full(ticks // 2, middle_m)])


def _driven(made: Simulator, seed: int, shipped: AxisParameters, own: list) -> dict:
    """Track spirals with every method, and compare with what verification said of itself."""
    rows = {(row["method"], row["frequency_Hz"]): row["rms_m"] for row in own}
    ratios, truth, worst = [], {}, 0.0
    for f in COMPARED_Hz:
        path = constant_angular_velocity(RATE_Hz, frequency_Hz=f, turns=TURNS)
        for method in shipped.methods:
            found, radius_m = _spiral(made, seed, shipped.for_method(method), path, f)
            truth[method, f] = found
            if method == shipped.method:
                worst = max(worst, found.rms_m / (2.0 * radius_m))
            if (method, f) in rows and rows[method, f] > 0.0:
                ratios.append((method, f, found.rms_m / rows[method, f]))
    return {
        "stable": bool(worst < DIVERGED and _swing(made, seed, shipped) < SWINGS),
        "worst_percent": 100.0 * worst,
        "error_10_m": truth[shipped.method, 10.0].rms_m,
        "none_10_m": truth["none", 10.0].rms_m,
        "ratios": tuple(ratios),
    }


def _spiral(
    made: Simulator, seed: int, axis: AxisParameters, path, f: float
) -> tuple[Tracking, float]:
    ahead = int(axis.values["preview_samples"])
    middle_m, reach_m = middle_of(axis)
    radius_m = RADIUS * reach_m
    led = round(1.5 * LED_s * RATE_Hz)

    def wanted(rest_m: float) -> Array:
        later = np.minimum(np.arange(len(path.x)) + ahead, len(path.x) - 1)
        return np.concatenate([led_to(middle_m, rest_m), middle_m + radius_m * path.x[later]])

    run = track(made, seed, 7, axis.values, None, wanted)
    position = run.position[led - 1 : led - 1 + len(path.x)] - middle_m
    found = compared(
        {"x": radius_m * path.x},
        {"x": position},
        path=path,
        radius_m=radius_m,
        frequency_Hz=f,
        sampling_rate_Hz=RATE_Hz,
    )
    return found, radius_m


def _swing(made: Simulator, seed: int, shipped: AxisParameters) -> float:
    """Return how much the position moves where it is to stand still, rms, of the diameter."""
    middle_m, reach_m = middle_of(shipped)

    def wanted(rest_m: float) -> Array:
        still = np.full(round(BOUND_s * RATE_Hz), middle_m)
        return np.concatenate([led_to(middle_m, rest_m), still])

    run = track(made, seed, 7, shipped.values, None, wanted)
    last = run.position[-round(0.5 * BOUND_s * RATE_Hz) :]
    return float(np.std(last)) / (2.0 * RADIUS * reach_m)


def _bound(
    made: Simulator, seed: int, shipped: AxisParameters, certificate: Certificate | None
) -> dict:
    """Drive references within the certificate's conditions, and count broken bounds.

    Every second and third one is slower, and held against what is guaranteed at its speed.
    """
    if certificate is None or not certificate.is_guaranteed:
        return {}
    if not np.isfinite(certificate.guaranteed_error_m):
        return {}
    rng = np.random.default_rng([seed, 99])
    ahead = int(shipped.values["preview_samples"])
    runs, broken, worst = 0, 0, 0.0
    for number in range(BOUND_RUNS):
        kept: dict[str, Array] = {}
        fastest = certificate.reference_slew_m_per_s * SPEEDS[number % len(SPEEDS)]
        allowed_m = certificate.guaranteed_at(fastest) + certificate.noise_error_m
        slew = 0.999 * fastest  # rounding is not faster

        def wanted(rest_m: float, kept=kept, slew=slew) -> Array:
            middle_m, reach_m = middle_of(shipped)
            asked = middle_m + _within(rng, slew, 0.95 * reach_m)
            led = led_to(middle_m, rest_m)
            kept["wanted"] = _slewed(np.concatenate([led, asked]), slew, rest_m)
            return kept["wanted"]

        run = track(made, seed, 100 + number, shipped.values, None, wanted)
        limited = Status.VOLTAGE_LIMITED | Status.REFERENCE_LIMITED | Status.VOLTAGE_STEP
        limited |= Status.UNCERTIFIED
        led = len(kept["wanted"]) - int(BOUND_s * RATE_Hz)  # a stage may rest outside its range
        if np.any(run.status[led:] & np.uint32(limited)):
            continue  # outside the conditions, and the runtime said so
        position = np.concatenate([[run.rest], run.position[:-1]])
        late = np.concatenate([np.full(ahead, run.rest), kept["wanted"]])[: len(position)]
        error = float(np.abs(position - late)[led:].max()) / allowed_m
        runs, broken, worst = runs + 1, broken + (error > 1.0), max(worst, error)
    return {
        "guaranteed_m": certificate.guaranteed_error_m,
        "noise_m": certificate.noise_error_m,
        "bound_runs": runs,
        "bound_broken": broken,
        "worst_to_bound": worst,
    }


def _within(rng: np.random.Generator, slew_m_per_s: float, reach_m: float) -> Array:
    """Return a random reference about 0 that goes at most so far and so fast, (ticks,)."""
    ticks = int(BOUND_s * RATE_Hz)
    t = np.arange(ticks) / RATE_Hz
    far = reach_m * rng.uniform(0.1, 1.0)
    kind = rng.integers(4)
    if kind == 0:  # a sine as fast as it may be, or slower
        f = rng.uniform(0.2, 1.0) * slew_m_per_s / (2.0 * np.pi * far)
        return np.asarray(far * np.sin(2.0 * np.pi * f * t))
    if kind == 1:  # a triangle
        f = rng.uniform(0.2, 1.0) * slew_m_per_s / (4.0 * far)
        return np.asarray(far * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * f * t)))
    if kind == 2:  # steps, as ramps of the allowed speed
        targets = np.repeat(rng.uniform(-far, far, 12), ticks // 12 + 1)[:ticks]
    else:  # several sines at once
        f = rng.uniform(0.5, 100.0, 5)
        targets = (
            far / 5.0 * np.sin(2.0 * np.pi * np.outer(t, f) + rng.uniform(0, 6, 5)).sum(axis=1)
        )
    return _slewed(targets, slew_m_per_s, 0.0)


def _slewed(targets: Array, slew_m_per_s: float, first: float | None = None) -> Array:
    """Return a way that follows its targets as fast as it may."""
    step, path = slew_m_per_s / RATE_Hz, np.empty(len(targets))
    at = float(targets[0]) if first is None else first
    for k, target in enumerate(targets.tolist()):
        at += min(max(target - at, -step), step)
        path[k] = at
    return path
