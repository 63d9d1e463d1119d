"""Where hysteresis stands: before a mode, behind it, or in its spring.

    before   y = G[H[u]]     Hammerstein: the ceramic bends the drive
    behind   y = H[G[u]]     Wiener: what is read has a memory
    inside   m y'' + c y' + k y + z(y) = u: joints slip, a flexure creaks

Each is fitted to half of the blocks of one recording, with plays and with a Bouc-Wen state for H
or z, and judged on the other half. The best of one place must beat the best of the others block
by block; else the recording does not tell, and the experiment that would is named.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.restoring_force.equation_error import second_order, weighed
from piezoid.identification.restoring_force.fit import FAINT, LAWS, simulated_apart
from piezoid.identification.restoring_force.task import BLOCKS, Task, drive_and_motion, task_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import on_one_thread
from piezoid.numerics.levenberg_marquardt import Rows, Rule, minimise
from piezoid.numerics.robust import student_quantile
from piezoid.operators.hysteretic_mode import Hold, bouc_wen_states, fine_drive
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import play_columns
from piezoid.record_json import Unbounded
from piezoid.records.recording import Recording
from piezoid.showing import shown

Place = Literal["before", "behind", "inside", "not separable"]

NAMES = {
    "before": "before the mode (Hammerstein)",
    "behind": "behind the mode (Wiener)",
    "inside": "inside the mode (restoring force)",
}
FINER = 4  # of the filters, per sample
PLAYS = 10
KNEES = ((1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (0.5, 0.5, 2.0))  # starts: beta, gamma, n
KNEE_BOUNDS = ((-10.0, 10.0), (-10.0, 10.0), (1.0, 6.0))
DAMPINGS = (0.03, 0.3)  # starts
TUNING = (np.log(1e-2), np.log(1e2))  # of the mode against the start, in logarithms
DIFFERENCE = 1e-5
RULE = Rule(tolerance=1e-4, iterations=15)
FARTHEST = 10.0  # sizes of the drive; an unbounded state fits what it saw, and nothing else
# Of rms errors. On six development stages of each kind right places led by 1.49 to 21 and the
# one wrong one by 1.10.
MARGIN = 1.1
SHARE = 0.1  # of the drive's power about the mode


@dataclass(frozen=True, kw_only=True)
class HysteresisPlacement:
    """Where the hysteresis of one recording stands, and how well each place predicts.

    place           of the hysteresis, or ``not separable``
    left_out_rms_m  by place, of its better law
    law             by place: ``maxwell_slip`` (plays) or ``bouc_wen``
    without_rms_m   left out, of the best mode without hysteresis: linear or bent, simulated or
                    late by a part of a sample
    mode_Hz         of the mode alone; None, like the errors, where no mode shows
    margin          rms of the second over that of the first
    text            the verdict in one sentence; where the recording does not tell, what would
    """

    place: Place
    left_out_rms_m: dict[str, float]
    law: dict[str, str]
    without_rms_m: float | None
    mode_Hz: float | None
    margin: Unbounded
    text: str

    def _repr_html_(self) -> str:
        rows = [
            (NAMES[place], f"{rms:.3g} m with {LAWS[self.law[place]]}")
            for place, rms in sorted(self.left_out_rms_m.items(), key=lambda item: item[1])
        ]
        if self.without_rms_m is not None:
            rows.append(("no hysteresis", f"{self.without_rms_m:.3g} m"))
        return shown("Where the hysteresis stands", [("verdict", self.text), *rows])


@on_one_thread
def place_hysteresis(
    recording: Recording, *, axis: str | None = None, hold: Hold = "zero_order"
) -> HysteresisPlacement:
    """Say whether hysteresis stands before a mode, behind it or inside, by predicted blocks.

        y = G[H[u]],    y = H[G[u]],    m y'' + c y' + k y + z(y) = u

    recording  a drive through the resonance, at levels that bring the hysteresis out
    axis       whose; default: the recording's own
    hold       of the drive between its samples, as in ``identify_restoring_force``

    What goes wrong: one mode is assumed and no delay; a second mode within the drive's band is
    taken for whatever fits it best. Far below its resonance a mode is a number and all three
    places are the same: the answer is then ``not separable``.

    Raises ``RecordingError`` and ``ExcitationError`` like ``identify_restoring_force``.

    >>> piezoid.place_hysteresis(swinging).place
    'before'
    """
    drive, motion_m = drive_and_motion(recording, axis)
    return placed(drive, motion_m, recording.sampling_rate_Hz, hold=hold)


def placed(
    drive: Array, displacement_m: Array, sampling_rate_Hz: float, *, hold: Hold = "zero_order"
) -> HysteresisPlacement:
    """Place hysteresis on arrays, (samples,), whatever the unit of the drive."""
    task = task_of(drive, displacement_m, sampling_rate_Hz, hold)
    block = np.arange(len(drive)) * BLOCKS // len(drive)
    counted = block > 0  # the first block is judged by what happened before the record
    chosen = ~task.is_left_out
    try:
        inside, natural = simulated_apart(task, chosen)
    except ExcitationError as refused:
        return HysteresisPlacement(
            place="not separable", left_out_rms_m={}, law={}, without_rms_m=None, mode_Hz=None,
            margin=1.0, text=f"Not separable on this recording: {refused.found}. {refused.remedy}",
        )  # fmt: skip
    without = [inside.pop(law) for law in ("linear", "duffing")]
    cascades = _Cascades.of(task, chosen, natural)
    # The same filters without memory, late by any part of a sample: plays in front of a mode turn
    # its phase as a delay does, and a simulated mode has neither.
    without += [cascades.predicted(place, "bent") for place in ("before", "behind")]
    found = {
        "before": {law: cascades.predicted("before", law) for law in inside},
        "behind": {law: cascades.predicted("behind", law) for law in inside},
        "inside": inside,
    }
    judged = task.is_left_out & counted
    return _verdict(task, found, without, natural, judged)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cascades:
    """Fits of H and G one behind the other: what is linear in H is eliminated.

    drive    (rows,)     between the samples, from -1 to 1
    target   (samples,)  in sizes of the motion
    chosen   (samples,)  bool: what may be learnt from
    natural  a and b of G = 1 / (p^2 + a p + b) where a search begins
    """

    drive: Array
    target: Array
    chosen: NDArray[np.bool_]
    natural: tuple[float, float]
    rate_Hz: float
    size_m: float
    middle_m: float

    @staticmethod
    def of(task: Task, chosen: NDArray[np.bool_], natural: tuple[float, float]) -> "_Cascades":
        fine = fine_drive(task.drive, task.sampling_rate_Hz, FINER // 2, task.hold).values
        motion_m = task.displacement_m
        middle_m, size_m = _middle_and_half(motion_m)
        return _Cascades(
            drive=_normalised(fine),
            target=(motion_m - middle_m) / size_m,
            chosen=chosen,
            natural=natural,
            rate_Hz=FINER * task.sampling_rate_Hz,
            size_m=size_m,
            middle_m=middle_m,
        )

    def predicted(self, place: str, law: str) -> Array:
        """Return the motion that the best of several searches predicts, (samples,) m."""
        knees = KNEES if law == "bouc_wen" else ((),)
        reached = []
        for knee in knees:
            tried = [self.at(place, law, np.array([np.log(d), 0.0, *knee])) for d in DAMPINGS]
            begin = min(tried, key=lambda one: one.cost)
            bounds = np.array([TUNING, TUNING, *KNEE_BOUNDS[: len(knee)]]).T
            found = minimise(
                lambda x: self.at(place, law, x),
                begin.x,
                (bounds[0], bounds[1]),
                rule=RULE,
                longest=0.5,
            )
            reached.append(found.point)
        best = min(reached, key=lambda point: point.cost)
        return self.middle_m + self.size_m * best.everywhere

    def at(self, place: str, law: str, x: Array) -> "_Cascade":
        return _Cascade(of=self, place=place, law=law, x=x)

    def columns(self, place: str, law: str, x: Array) -> Array:
        """Return what H and G make of the drive, with a free decay and a zero, (samples, columns).

        x  logarithms of damping and of frequency against the start, then the knee, if any
        """
        frequency = np.sqrt(self.natural[1]) * np.exp(x[1])
        natural = 2.0 * np.exp(x[0]) * frequency, frequency**2
        top, bottom = second_order([frequency**2], natural, self.rate_Hz)
        if place == "before":
            states = _states(self.drive, law, x[2:])
            made = np.column_stack(
                [recursive_filter(top, bottom, one) for one in (states - states[0]).T]
            )
        else:
            moved = _normalised(recursive_filter(top, bottom, self.drive - self.drive[0]))
            made = _states(moved, law, x[2:])
        if law == "bent":
            late = np.concatenate([np.repeat(made[:1], FINER, axis=0), made[:-FINER]])
            made = np.column_stack([made, late])
        impulse = np.zeros(len(self.drive))
        impulse[0] = 1.0
        free = recursive_filter(top, bottom, impulse)
        free /= np.abs(free).max()
        late = np.concatenate([[0.0], free[:-1]])
        return np.column_stack([made, free, late, np.ones(len(free))])[::FINER]


def _middle_and_half(signal: Array) -> tuple[float, float]:
    return 0.5 * float(signal.max() + signal.min()), 0.5 * float(np.ptp(signal))


def _normalised(signal: Array) -> Array:
    middle, half = _middle_and_half(signal)
    return np.asarray((signal - middle) / half)


def _states(signal: Array, law: str, knee: Array) -> Array:
    """Return the signal, bent as well, and what follows it with memory, (rows, columns)."""
    powers = np.column_stack([signal, signal**2, signal**3])
    if law == "bent":
        return powers
    if law == "bouc_wen":
        beta, gamma, n = map(float, knee)
        state = bouc_wen_states(signal, beta, gamma, n)
        return np.column_stack([powers, np.nan_to_num(state, nan=np.inf)])
    threshold = np.arange(1, PLAYS + 1) / (PLAYS + 1)
    columns, _ = play_columns(signal, threshold, np.full(PLAYS, signal[0]))
    return np.column_stack([powers, columns])


class _Cascade:
    """One cascade: its mode and knee, and H at its best for them."""

    def __init__(self, *, of: _Cascades, place: str, law: str, x: Array) -> None:
        self.of, self.place, self.law, self.x = of, place, law, x
        self.columns = of.columns(place, law, x)
        self.is_bounded = bool(np.abs(self.columns).max() < FARTHEST)
        solvable = self.columns if self.is_bounded else self.columns[:, -3:]
        self.best = weighed(solvable[of.chosen], of.target[of.chosen])

    @property
    def cost(self) -> float:
        """Return the sum of squares of the error, in sizes; infinite where a state runs off."""
        return float(self.best.residual @ self.best.residual) if self.is_bounded else np.inf

    @property
    def everywhere(self) -> Array:
        """Return the motion on every sample, (samples,), in sizes."""
        return np.asarray(self.columns @ self.best.coefficients)

    def linearised(self) -> Rows:
        """Return the error about this cascade, by differences."""
        columns = []
        for i in range(len(self.x)):
            moved = self.x.copy()
            moved[i] += DIFFERENCE
            other = self.of.at(self.place, self.law, moved)
            columns.append((other.best.residual - self.best.residual) / DIFFERENCE)
        return Rows(factor=np.column_stack(columns), residual=self.best.residual)


def _verdict(
    task: Task,
    found: dict[str, dict[str, Array]],
    without: list[Array],
    natural: tuple[float, float],
    judged: NDArray[np.bool_],
) -> HysteresisPlacement:
    motion_m = task.displacement_m
    power = {
        place: {law: _block_power(motion_m - y, judged) for law, y in laws.items()}
        for place, laws in found.items()
    }
    law = {
        place: min(laws, key=lambda one: float(laws[one].mean())) for place, laws in power.items()
    }
    best = {place: power[place][law[place]] for place in power}
    rms = {place: float(np.sqrt(values.mean())) for place, values in best.items()}
    without_m = min(float(np.sqrt(_block_power(motion_m - y, judged).mean())) for y in without)
    first, second, _ = sorted(rms, key=lambda place: rms[place])
    mode_Hz = float(np.sqrt(natural[1]) / (2.0 * np.pi))
    margin = rms[second] / rms[first] if rms[first] > 0.0 else np.inf
    told = f"{rms[first]:.3g} m against {rms[second]:.3g} m"
    place: Place = "not separable"
    if not rms[first] * (1.0 + FAINT) < without_m:
        text = (
            f"A mode without hysteresis predicts as well ({without_m:.3g} m): not separable on "
            f"this recording. Drive at a level at which the loops open, through {mode_Hz:.4g} Hz."
        )
    elif margin > MARGIN and _wins(best[first], best[second]):
        place = first  # type: ignore[assignment]
        text = f"The hysteresis stands {NAMES[place]}: left-out blocks to {told} {NAMES[second]}."
    else:
        text = (
            f"Hysteresis {NAMES[first]} and {NAMES[second]} predict left-out blocks alike "
            f"({told}): not separable on this recording. {_experiment(task, mode_Hz)}"
        )
    return HysteresisPlacement(
        place=place, left_out_rms_m=rms, law=law, without_rms_m=without_m, mode_Hz=mode_Hz,
        margin=margin, text=text,
    )  # fmt: skip


def _block_power(error_m: Array, judged: NDArray[np.bool_]) -> Array:
    """Return the mean square of the error in every part of the judged samples, (parts,)."""
    return np.array([float(np.mean(part**2)) for part in np.array_split(error_m[judged], BLOCKS)])


def _wins(first: Array, second: Array) -> bool:
    """Return whether the errors of blocks differ, in logarithms, by more than chance does."""
    ratio = np.log(np.maximum(second, 1e-300)) - np.log(np.maximum(first, 1e-300))
    half = student_quantile(0.975, len(ratio) - 1) * ratio.std(ddof=1) / np.sqrt(len(ratio))
    return bool(ratio.mean() > half)


def _experiment(task: Task, mode_Hz: float) -> str:
    """Return what would tell, in numbers of this recording."""
    spectrum = np.abs(np.fft.rfft(task.drive - task.drive.mean())) ** 2
    frequency_Hz = np.fft.rfftfreq(len(task.drive), 1.0 / task.sampling_rate_Hz)
    near = (frequency_Hz > 0.7 * mode_Hz) & (frequency_Hz < 1.4 * mode_Hz)
    share = float(spectrum[near].sum() / spectrum.sum())
    wide = f"a random-phase multisine from {0.1 * mode_Hz:.3g} to {3.0 * mode_Hz:.3g} Hz"
    if share < SHARE:
        return (
            f"Only {100.0 * share:.2g} % of the drive's power lies about the mode at "
            f"{mode_Hz:.4g} Hz: record {wide}."
        )
    return (
        f"Record {wide}, at this level and at twice this level, sampled at {50 * mode_Hz:.3g} Hz."
    )
