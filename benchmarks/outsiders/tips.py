"""Tips of an outsider: loops and sweeps to a controller, then that controller on the tip."""

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.simulators import Driven, RATE_Hz, Simulator, drive, simulator
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.runtime.controller import Controller, Status
from piezoid_cli.calibration import calibrate

SOUND, NAN, FROZEN, DEAD, REVERSED, FULL = range(6)
BACK = 0.3  # nepers from the set point: the tip is back
SETTLE_s, TRIAL_s = 0.2, 1.6


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One thing that happens to a tip: a step of the surface, or a fault of its preamplifier."""

    name: str
    step_m: float = 0.0
    fault: int = SOUND
    fault_s: float = math.inf
    away_m: float = 0.0


TRIALS = (
    *(
        Trial(name=f"step {way} {size * 1e9:g} nm", step_m=sign * size)
        for way, sign in (("up", 1.0), ("down", -1.0))
        for size in (1e-10, 3e-10, 1e-9, 2e-9)
    ),
    Trial(name="NaN for 1.25 ms", fault=NAN, fault_s=1.25e-3),
    Trial(name="frozen for 20 ms", fault=FROZEN, fault_s=0.02, step_m=2e-11),
    Trial(name="dead for 50 ms", fault=DEAD, fault_s=0.05),
    Trial(name="full for 20 ms", fault=FULL, fault_s=0.02),
    Trial(name="NaN for good", fault=NAN),
    Trial(name="frozen for good", fault=FROZEN, step_m=2e-11),
    Trial(name="dead for good", fault=DEAD),
    Trial(name="reversed for good", fault=REVERSED),
    Trial(name="full for good", fault=FULL),
    Trial(name="approach from 5 nm", away_m=5e-9),
)


@dataclass(frozen=True, kw_only=True)
class TipResult:
    """What became of one tip.

    covered        of the 95 % intervals of barrier and delay: whether they hold the truth
    closest_m      by how much the tip came nearer than set point and the surface's own step, most
    least_gap_m    the smallest gap in a trial whose surface did not step up
    slowest_s      the longest way back to the set point
    crashes        trials in which the controller, not the surface, closed the gap
    not_latched    faults that stayed and did not end latched
    latched        trials whose fault ended, or that had none, and that ended latched
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


def judge(name: str, seed: int, folder: Path | None = None) -> TipResult:
    """Record a tip, calibrate it, and let happen to it what may."""
    made = simulator(name)
    truth = made.campaigns.tip_truth(seed, made.library)
    with TemporaryDirectory() as scratch:
        place = Path(scratch) if folder is None else folder / f"{name}-tip-{seed}"
        place.mkdir(parents=True, exist_ok=True)
        made.campaigns.write_tip(seed, place, made.library)
        files = sorted([*place.glob("*.csv"), *place.glob("*.dat")])
        found = calibrate(files, place / "lab.toml", lambda _: None)
    known = {"simulator": name, "seed": seed, "covered": _covered(found.model.tunnelling, truth)}
    if "params.json" not in found.files:
        reason = found.controllers.reason
        return TipResult(**known, ships=False, reason=reason)
    shipped = from_json(found.files["params.json"], "params.json").axes[0]
    outcomes = [(trial, _run(made, seed, shipped, trial)) for trial in TRIALS]
    stays = [(t, o) for t, o in outcomes if t.fault != SOUND and math.isinf(t.fault_s)]
    ends = [(t, o) for t, o in outcomes if (t, o) not in stays]
    back = [o for t, o in ends if not o.latched]
    return TipResult(
        **known,
        ships=True,
        closest_m=max(o.closest_m for _, o in outcomes),
        least_gap_m=min(o.least_gap_m for t, o in outcomes if t.step_m < 1e-10),
        slowest_s=max((o.back_s for o in back if not math.isinf(o.back_s)), default=0.0),
        crashes=tuple(t.name for t, o in outcomes if o.least_gap_m <= 0.0 and t.step_m < 3e-10),
        not_latched=tuple(t.name for t, o in stays if not o.latched),
        latched=tuple(t.name for t, o in ends if o.latched or math.isinf(o.back_s)),
    )


def _covered(tip, truth: dict) -> dict[str, bool | None]:
    """Tell which intervals hold the truth; None where there is no such interval."""
    barrier_eV = truth["barrier_eV"]
    delay_s = next(truth[key] for key in ("loop_delay_s", "delay_s", "loop_delay") if key in truth)
    law, loop = (None, None) if tip is None else (tip.gap_law, tip.loop_plant)

    def holds(interval, value: float) -> bool:
        return bool(interval[0] <= value <= interval[1])

    return {
        "sweeps": None if law is None else holds(law.barrier_interval_eV, barrier_eV),
        "loop": None if loop is None else holds(loop.barrier_interval_eV, barrier_eV),
        "delay": None if loop is None else holds(loop.delay_interval_s, delay_s),
    }


@dataclass(frozen=True, kw_only=True)
class _Outcome:
    closest_m: float
    least_gap_m: float
    back_s: float
    latched: bool


def _run(made: Simulator, seed: int, shipped: AxisParameters, trial: Trial) -> _Outcome:
    """Run one trial from the set point, or from farther away."""
    library, values = made.library, shipped.values
    set_point_A = float(values["current_reference_A"])
    controller = Controller(values)
    tip = library.tip_open(seed, 5, trial.away_m)
    controller.start(0.0, set_point_A if not trial.away_m else 0.0)
    settled = _go(made, controller, tip, set_point_A, SETTLE_s, set_point_A)
    gap_m = float(np.median(settled.position[-1000:]))
    if trial.step_m:
        library.tip_move_surface(tip, trial.step_m)
        _go(made, controller, tip, set_point_A, 1e-4, settled.measured[-1])
    library.tip_fault(tip, trial.fault)
    ends_s = 0.0 if math.isinf(trial.fault_s) or trial.fault == SOUND else trial.fault_s
    parts = []
    if ends_s:
        parts.append(_go(made, controller, tip, set_point_A, ends_s, settled.measured[-1]))
        library.tip_fault(tip, SOUND)
    seconds = TRIAL_s if not trial.away_m else 4.0
    parts.append(_go(made, controller, tip, set_point_A, seconds, settled.measured[-1]))
    library.tip_close(tip)
    gap = np.concatenate([part.position for part in parts])
    away = np.abs(np.log(np.clip(np.abs(parts[-1].measured), 1e-15, None) / set_point_A))
    far = np.flatnonzero(away > BACK + 0.7)
    last = int(far[-1]) + 1 if len(far) else 0
    is_back = last < len(away) - 2000
    near_m = gap_m - max(trial.step_m, 0.0) if not trial.away_m else math.inf
    return _Outcome(
        closest_m=max(near_m - float(gap.min()), 0.0) if not trial.away_m else 0.0,
        least_gap_m=float(gap.min()),
        back_s=last / RATE_Hz if is_back else math.inf,
        latched=bool(parts[-1].status[-1] & np.uint32(Status.LATCHED)),
    )


def _go(
    made: Simulator,
    controller: Controller,
    tip: int,
    set_point_A: float,
    seconds: float,
    first: float,
) -> Driven:
    reference = np.full(max(round(seconds * RATE_Hz), 1), set_point_A)
    return drive(controller, made.library.tip_step, tip, reference, first)
