"""Calibrate tips of a third-party simulator, then run the shipped controller on the tip."""

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.simulators import LoopRun, RATE_Hz, Simulator, drive, load_simulator
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.runtime.controller import Controller, Status
from piezoid_cli.calibration import calibrate

NO_FAULT, NAN, FROZEN, DEAD, REVERSED, FULL_SCALE = range(6)
RECOVERED = 1.0  # nepers from the set point, within which the tip has recovered
SETTLE_s, TRIAL_s, APPROACH_s = 0.2, 1.6, 4.0


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One disturbance of a tip: a step of the surface, or a fault of its preamplifier.

    fault_s  duration of the fault
    away_m   initial distance beyond the set point
    """

    name: str
    step_m: float = 0.0
    fault: int = NO_FAULT
    fault_s: float = math.inf
    away_m: float = 0.0

    @property
    def is_permanent(self) -> bool:
        """Whether the fault lasts until the end of the trial."""
        return self.fault != NO_FAULT and math.isinf(self.fault_s)


TRIALS = (
    *(
        Trial(name=f"step {direction} {size * 1e9:g} nm", step_m=sign * size)
        for direction, sign in (("up", 1.0), ("down", -1.0))
        for size in (1e-10, 3e-10, 1e-9, 2e-9)
    ),
    Trial(name="NaN for 1.25 ms", fault=NAN, fault_s=1.25e-3),
    Trial(name="frozen for 20 ms", fault=FROZEN, fault_s=0.02, step_m=2e-11),
    Trial(name="dead for 50 ms", fault=DEAD, fault_s=0.05),
    Trial(name="full for 20 ms", fault=FULL_SCALE, fault_s=0.02),
    Trial(name="NaN for good", fault=NAN),
    Trial(name="frozen for good", fault=FROZEN, step_m=2e-11),
    Trial(name="dead for good", fault=DEAD),
    Trial(name="reversed for good", fault=REVERSED),
    Trial(name="full for good", fault=FULL_SCALE),
    Trial(name="approach from 5 nm", away_m=5e-9),
)


@dataclass(frozen=True, kw_only=True)
class TipResult:
    """Result of one tip.

    covered        whether the 95 % intervals of barrier and delay contain the truth
    closest_m      largest approach beyond the set point and the step of the surface
    least_gap_m    smallest gap in trials whose surface does not step up
    slowest_s      longest recovery of the set point
    crashes        trials in which the controller, not the surface, closed the gap
    not_latched    permanent faults after which the controller is not latched
    latched        other trials that end latched or without recovery
    """

    simulator: str
    seed: int
    ships: bool
    reason: str = ""
    covered: dict[str, bool | None]
    closest_m: float = 0.0
    least_gap_m: float = math.inf
    slowest_s: float = 0.0
    crashes: tuple[str, ...] = ()
    not_latched: tuple[str, ...] = ()
    latched: tuple[str, ...] = ()


def evaluate_tip(name: str, seed: int) -> TipResult:
    """Record and calibrate a tip, and run all trials on it."""
    simulator = load_simulator(name)
    truth = simulator.campaigns.tip_truth(seed, simulator.library)
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        simulator.campaigns.write_tip(seed, folder, simulator.library)
        files = sorted([*folder.glob("*.csv"), *folder.glob("*.dat")])
        result = calibrate(files, folder / "lab.toml", lambda _: None)
    covered = _coverage(result.model.tunnelling, truth)
    if "params.json" not in result.files:
        reason = result.controllers.reason
        return TipResult(simulator=name, seed=seed, covered=covered, ships=False, reason=reason)
    shipped = from_json(result.files["params.json"], "params.json").axes[0]
    outcomes = [(trial, _run(simulator, seed, shipped, trial)) for trial in TRIALS]
    temporary = [(trial, o) for trial, o in outcomes if not trial.is_permanent]
    recoveries_s = [o.recovery_s for _, o in temporary if not o.latched]
    return TipResult(
        simulator=name,
        seed=seed,
        covered=covered,
        ships=True,
        closest_m=max(o.closest_m for _, o in outcomes),
        least_gap_m=min(o.least_gap_m for trial, o in outcomes if trial.step_m < 1e-10),
        slowest_s=max((s for s in recoveries_s if not math.isinf(s)), default=0.0),
        crashes=tuple(
            trial.name for trial, o in outcomes if o.least_gap_m <= 0.0 and trial.step_m < 3e-10
        ),
        not_latched=tuple(
            trial.name for trial, o in outcomes if trial.is_permanent and not o.latched
        ),
        latched=tuple(
            trial.name for trial, o in temporary if o.latched or math.isinf(o.recovery_s)
        ),
    )


def _coverage(tip, truth: dict) -> dict[str, bool | None]:
    """Return whether each interval contains the truth; None if there is no interval."""
    barrier_eV = truth["barrier_eV"]
    delay_s = next(truth[key] for key in ("loop_delay_s", "delay_s", "loop_delay") if key in truth)
    law, loop = (None, None) if tip is None else (tip.gap_law, tip.loop_plant)

    def contains(interval, value: float) -> bool:
        return bool(interval[0] <= value <= interval[1])

    return {
        "sweeps": None if law is None else contains(law.barrier_interval_eV, barrier_eV),
        "loop": None if loop is None else contains(loop.barrier_interval_eV, barrier_eV),
        "delay": None if loop is None else contains(loop.delay_interval_s, delay_s),
    }


@dataclass(frozen=True, kw_only=True)
class _Outcome:
    closest_m: float
    least_gap_m: float
    recovery_s: float
    latched: bool


def _run(simulator: Simulator, seed: int, shipped: AxisParameters, trial: Trial) -> _Outcome:
    """Run one trial from the set point, or from farther away."""
    library, values = simulator.library, shipped.values
    set_point_A = float(values["current_reference_A"])
    controller = Controller(values)
    tip = library.tip_open(seed, 5, trial.away_m)
    controller.start(0.0, set_point_A if not trial.away_m else 0.0)

    def run(duration_s: float, first_A: float) -> LoopRun:
        reference_A = np.full(max(round(duration_s * RATE_Hz), 1), set_point_A)
        return drive(controller, library.tip_step, tip, reference_A, first_A)

    settled = run(SETTLE_s, set_point_A)
    gap_m = float(np.median(settled.position[-1000:]))
    if trial.step_m:
        library.tip_move_surface(tip, trial.step_m)
        run(1e-4, settled.measured[-1])
    library.tip_fault(tip, trial.fault)
    runs = []
    if trial.fault != NO_FAULT and not trial.is_permanent:
        runs.append(run(trial.fault_s, settled.measured[-1]))
        library.tip_fault(tip, NO_FAULT)
    runs.append(run(APPROACH_s if trial.away_m else TRIAL_s, settled.measured[-1]))
    library.tip_close(tip)
    lowest_m = min(float(run.position.min()) for run in runs)
    current = np.clip(np.abs(runs[-1].measured), 1e-15, None)
    deviating = np.flatnonzero(np.abs(np.log(current / set_point_A)) > RECOVERED)
    recovery = int(deviating[-1]) + 1 if len(deviating) else 0
    is_recovered = recovery < len(current) - 2000
    expected_m = gap_m - max(trial.step_m, 0.0)
    return _Outcome(
        closest_m=max(expected_m - lowest_m, 0.0) if not trial.away_m else 0.0,
        least_gap_m=lowest_m,
        recovery_s=recovery / RATE_Hz if is_recovered else math.inf,
        latched=bool(runs[-1].status[-1] & np.uint32(Status.LATCHED)),
    )
