"""A plan asks what was left open, stays inside the limits, and its promise comes true.

The laboratory knows what each effect really changed: it records everything again without it. How
well that change can be told from another is computed here by plain least squares, apart from the
code that promised it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from zlib import crc32

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import nnls

from piezoid.diagnosis.diagnosis import Diagnosis, Finding, HeldOut, Size
from piezoid.diagnosis.experiment import Plan, plan
from piezoid.diagnosis.planning.candidate_drives import (
    EXPERIMENTS,
    drive_of,
    multisine_period,
    odd_lines,
)
from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits
from piezoid.diagnosis.planning.plan_file import SCHEMA, plan_files, sentences
from piezoid.digests import unseal
from piezoid.errors import ExcitationError, LabFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays
from piezoid.records.lab import Amplifier, Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import healthy, named, record_all
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.effects.effect import Fault
from piezoid_datasets.virtual_lab.plans import PLANS, cycled_history_V, run_of
from piezoid_datasets.virtual_lab.rig import Rig as LabRig
from piezoid_datasets.virtual_lab.rig import draw_rig
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, record
from piezoid_datasets.virtual_lab.truths import TRUTHS
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model

THRESHOLD_V = np.array([0.0, 0.15, 0.4, 0.8, 1.3, 2.0, 2.8, 3.6, 4.5])
MIDDLE_V = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Hidden:
    """A stage with effects in it, and what it recorded."""

    rig: LabRig
    stage: Stage
    faults: Mapping[str, Fault]
    runs: tuple[Run, ...]

    def played(self, drive: Drive | None) -> tuple[tuple[Rows, ...], dict[str, tuple[Rows, ...]]]:
        """Return all recordings, the planned one last, and the same without each effect."""
        runs = self.runs if drive is None else (*self.runs, self._run(drive))
        without = {
            name: record_all(self.stage, runs, {k: v for k, v in self.faults.items() if k != name})
            for name in self.faults
        }
        return record_all(self.stage, runs, self.faults), without

    def _run(self, drive: Drive) -> Run:
        return Run(
            name="planned",
            sampling_rate_Hz=drive.sampling_rate_Hz,
            command_V=np.array(drive.voltage_V[:, 0]),
            history_V=cycled_history_V(self.rig),
            others_V={axis: drive.voltage_V[:, 1 + k] for k, axis in enumerate(drive.axes[1:])},
        )


def hidden(
    seed: int, sizes_percent: Mapping[str, float], plans: Sequence[str], truth: str = "preisach"
) -> Hidden:
    """Draw a stage and hide effects of these sizes in it."""
    rig = draw_rig(_chance(seed, "rig"))
    ceramic = named(TRUTHS, truth).draw(_chance(seed, "ceramic"))
    stage = Stage(rig=rig, ceramic=ceramic, seed=seed)
    runs = tuple(run_of(named(PLANS, name), rig, _chance(seed, name)) for name in plans)
    bench = healthy(stage, runs)
    faults = {
        effect.name: effect.install(
            sizes_percent[effect.name] / 100.0 * rig.stroke_m, bench, _chance(seed, effect.name)
        )
        for effect in EFFECTS
        if effect.name in sizes_percent
    }
    return Hidden(rig=rig, stage=stage, faults=faults, runs=runs)


def model_of(case: Hidden) -> ActuatorModel:
    """Return a plain Prandtl-Ishlinskii model of the healthy ceramic, by least squares."""
    sweep = next(run for run in case.runs if run.name == "sweep")
    rows = record(replace(case.stage, acts=()), sweep)
    drive_V = rows.voltage_V - MIDDLE_V
    memory_V = np.clip(0.0, drive_V[0] - THRESHOLD_V, drive_V[0] + THRESHOLD_V)
    columns, _ = play_columns(drive_V, THRESHOLD_V, memory_V)
    memory_after = np.concatenate(
        [-np.ones((len(columns), 1)), np.ones((len(columns), 1))], axis=1
    )
    weight, _ = nnls(np.hstack([columns * 1e-6, memory_after * 1e-6]), rows.displacement_m)
    plays = PrandtlIshlinskii(threshold=THRESHOLD_V, weight=weight[: len(THRESHOLD_V)] * 1e-6)
    known = axis_model(recordings=())
    slew_V_per_s = max(
        float(np.abs(np.diff(run.command_V)).max()) * run.sampling_rate_Hz for run in case.runs
    )
    axis = replace(
        known,
        hysteresis=ModifiedPrandtlIshlinskii(
            plays=plays, dead_zones=LINEAR, voltage_offset_V=MIDDLE_V
        ),
        rig=Rig(),
        certificate=replace(known.certificate, slew_V_per_s=slew_V_per_s),
    )
    return stage_model(axis)


def recordings_of(rows: Sequence[Rows]) -> tuple[Recording, ...]:
    """Return recordings as they would be read from the laboratory's files."""
    return tuple(
        from_arrays(
            voltage_V=one.voltage_V,
            displacement_m=one.displacement_m,
            sampling_rate_Hz=one.run.sampling_rate_Hz,
            axis="x",
            name=f"{one.run.name}.csv",
        )
        for one in rows
    )


def diagnosis_of(case: Hidden, findings: Sequence[Finding]) -> Diagnosis:
    """Return a diagnosis that found these and not the rest, each from a thousandth on."""
    known, left_m = diagnosed(*findings), 1e-3 * case.rig.stroke_m
    return replace(
        known,
        stroke_m=case.rig.stroke_m,
        final=HeldOut(rms_m=left_m, rms_percent=0.1),
        envelope_rms_m=left_m,
        noise_floor_rms_m=case.rig.noise_rms_m,
        not_detected=tuple(
            replace(absent, upper_bound_m=left_m, detection_limit_m=left_m)
            for absent in known.not_detected
        ),
    )


def found(
    effect: str, *, share_percent: float, confounded: tuple[str, ...] = (), half: float = 0.1
) -> Finding:
    """Return a finding of this size, its interval ``half`` of it to both sides."""
    ci95 = (share_percent * (1.0 - half), share_percent * (1.0 + half))
    size = Size(value=share_percent, unit="percent", ci95=ci95)
    return replace(finding(effect, share_percent / 100.0, confounded), size=size)


def change_percent(case: Hidden, name: str) -> float:
    """Return the size of an effect in the recordings there are, rms about each one's mean."""
    full, without = case.played(None)
    changes = [a.noise_free_m - b.noise_free_m for a, b in zip(full, without[name], strict=True)]
    square = np.mean([np.var(change) for change in changes])
    return 100.0 * float(np.sqrt(square)) / case.rig.stroke_m


def really_separable(
    case: Hidden, axis: AxisModel, names: tuple[str, str], drive: Drive | None, *, drifting: bool
) -> float:
    """Return 1 - R^2 of one effect's real change explained by the other beside the model.

    drifting  the other is slow motion of any straight or bent kind, in each recording its own
    """
    full, without = case.played(drive)
    one = [a.noise_free_m - b.noise_free_m for a, b in zip(full, without[names[0]], strict=True)]
    two = [a.noise_free_m - b.noise_free_m for a, b in zip(full, without[names[1]], strict=True)]
    picks = [np.linspace(0, len(c) - 1, 1500).astype(int) for c in one]
    zeros = block_diag(*(np.ones((len(p), 1)) for p in picks))
    states = [_model_columns(axis, rows)[p] for rows, p in zip(full, picks, strict=True)]
    model = np.hstack([np.vstack(states), zeros])
    if drifting:
        alternative = block_diag(*(np.column_stack([p / p[-1], (p / p[-1]) ** 2]) for p in picks))
    else:
        alternative = np.concatenate([c[p] for c, p in zip(two, picks, strict=True)])[:, None]
    effect = np.concatenate([c[p] for c, p in zip(one, picks, strict=True)])
    alone = _left(effect, model)
    return float((_left(effect, np.hstack([model, alternative])) ** 2).sum() / (alone**2).sum())


def _model_columns(axis: AxisModel, rows: Rows) -> Array:
    """Return states, and squares and cubes of what they make: weights and dead zones."""
    drive_V = rows.voltage_V - MIDDLE_V
    history_V = np.array([MIDDLE_V, -MIDDLE_V] * 2 + [float(drive_V[0])])
    _, memory_V = play_columns(history_V, THRESHOLD_V, np.zeros(len(THRESHOLD_V)))
    states, _ = play_columns(drive_V, THRESHOLD_V, memory_V)
    h = states @ axis.hysteresis.plays.weight
    h = h / np.abs(h).max()
    return np.hstack([states, np.column_stack([h**2, h**3])])


def _left(values: Array, columns: Array) -> Array:
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-10)[0])


def _chance(seed: int, part: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(part.encode())])


CLOCK_Hz = 20_000.0
SLOW = ("creep", "thermal_drift")
LATE = ("delay", "lag")


@cache
def _slow() -> tuple[Hidden, Diagnosis]:
    case = hidden(3, {"creep": 0.6, "thermal_drift": 0.3}, ("sweep", "long_hold"))
    share = change_percent(case, "creep")
    return case, diagnosis_of(case, [found("creep", share_percent=share, confounded=SLOW[1:])])


@cache
def _planned() -> Plan:
    case, diagnosis = _slow()
    before = recordings_of(case.played(None)[0])
    return plan(model_of(case), diagnosis, recordings=before, clock_Hz=CLOCK_Hz)


def test_creep_and_drift_after_one_hold_are_sent_to_levels_of_random_sign():
    planned = _planned()
    assert planned.question.kind == "separate"
    assert planned.question.effects == SLOW
    assert planned.drive.name in ("held_levels", "held_levels_mirrored")


def test_the_laboratory_plays_the_plan_and_separates_creep_from_drift_as_promised():
    case, _ = _slow()
    planned, axis = _planned(), model_of(case).axes["x"]
    before = really_separable(case, axis, SLOW, None, drifting=True)
    after = really_separable(case, axis, SLOW, planned.drive, drifting=True)
    assert planned.recorded is not None
    assert planned.recorded.separability < 0.2
    assert before < 0.2
    assert after > 2.0 * before
    assert planned.planned.separability / 2 < after < 2.5 * planned.planned.separability


def test_the_laboratory_separates_delay_from_lag_once_small_motion_is_fast():
    case = hidden(4, {"delay": 0.5, "lag": 0.4}, ("sweep", "rates"), "bouc_wen")
    model = model_of(case)
    late = found("delay", share_percent=change_percent(case, "delay"), confounded=LATE[1:])
    before = recordings_of(case.played(None)[0])
    diagnosis = diagnosis_of(case, [late])
    planned = plan(model, diagnosis, recordings=before, clock_Hz=CLOCK_Hz)
    axis = model.axes["x"]
    assert planned.drive.name == "small_multisine"
    assert planned.recorded is not None
    promised = planned.planned.separability / planned.recorded.separability
    kept = really_separable(case, axis, LATE, planned.drive, drifting=False)
    kept /= really_separable(case, axis, LATE, None, drifting=False)
    assert promised > 5.0
    assert promised / 4 < kept < promised * 4


def test_a_wide_interval_is_tightened_and_a_narrow_one_left_alone():
    case, _ = _slow()
    model = model_of(case)
    wide = diagnosis_of(case, [found("creep", share_percent=0.3, half=0.6)])
    planned = plan(model, wide, clock_Hz=CLOCK_Hz)
    assert (planned.question.kind, planned.question.effects) == ("tighten", ("creep",))
    narrow = diagnosis_of(case, [found("creep", share_percent=0.3, half=0.05)])
    assert plan(model, narrow, clock_Hz=CLOCK_Hz).question.kind == "detect"


def test_an_effect_the_recordings_could_not_show_is_planned_for():
    case, _ = _slow()
    diagnosis = diagnosis_of(case, [])
    absent = tuple(
        replace(one, upper_bound_m=None, detection_limit_m=None) if one.effect == "delay" else one
        for one in diagnosis.not_detected
    )
    planned = plan(model_of(case), replace(diagnosis, not_detected=absent), clock_Hz=CLOCK_Hz)
    assert planned.question.effects == ("delay",)
    assert "cannot show delay" in sentences(planned)[0]


@pytest.mark.parametrize("slew_V_per_s", [60.0, 30_000.0])
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda one: one.name)
def test_every_drive_of_the_menu_stays_inside_range_and_slew(experiment, slew_V_per_s):
    limits = DriveLimits(voltage_min_V=1.0, voltage_max_V=8.0, slew_V_per_s=slew_V_per_s)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz, other_limits={"y": limits})
    drive = drive_of(experiment, bench, 0)
    assert drive.voltage_V.min() >= 1.0
    assert drive.voltage_V.max() <= 8.0
    jumps_V = np.abs(np.diff(drive.voltage_V, axis=0)).max()
    assert jumps_V * drive.sampling_rate_Hz <= 1.01 * slew_V_per_s
    assert (drive.voltage_V[[0, -1]] == 1.0).all()


def test_other_axes_are_asked_for_where_none_is_known():
    limits = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1e3)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="no other axis"):
        drive_of(next(one for one in EXPERIMENTS if one.name == "other_axis"), bench, 0)


def test_a_multisine_has_its_lines_at_rms_one_and_no_others(rng):
    lines = odd_lines(20, 800, 10.0, left_out_of=4, rng=rng)
    period = multisine_period(lines, 1000, rng)
    spectrum = np.abs(np.fft.rfft(period))
    silent = np.setdiff1d(np.arange(501), lines)
    assert np.ptp(spectrum[lines]) < 1e-9 * spectrum.max()
    assert spectrum[silent].max() < 1e-9 * spectrum.max()
    assert np.bincount((lines - 2) // 8)[:9].tolist() == [3] * 9  # of each four odd lines
    assert (lines % 2 == 1).all()
    assert period.std() == pytest.approx(1.0, rel=1e-9)


def test_limits_are_those_of_lab_toml_inside_what_was_driven():
    case, diagnosis = _slow()
    amplifier = Amplifier(
        gain_V_per_V=15.0, output_min_V=-30.0, output_max_V=120.0, slew_V_per_s=900.0
    )
    planned = plan(model_of(case), diagnosis, lab=Lab(amplifier=amplifier), clock_Hz=CLOCK_Hz)
    limits = planned.limits
    assert (limits.voltage_min_V, limits.voltage_max_V, limits.slew_V_per_s) == (0.0, 8.0, 60.0)


def test_the_files_of_a_plan_are_read_back(tmp_path):
    planned = _planned()
    files = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    content = unseal(files["plan.json"], SCHEMA, "plan.json")
    assert content["drive"]["name"] == planned.drive.name
    assert content["why"] == " ".join(sentences(planned))
    assert len(content["alternatives"]) == len(EXPERIMENTS)
    place = tmp_path / "drive.csv"
    place.write_bytes(files["drive.csv"])
    (recording,) = collect([place], Lab()).recordings
    assert np.array_equal(recording.voltage_V("x"), planned.drive.voltage_V[:, 0])
    again = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    assert again == files


def test_no_drive_is_planned_for_a_fault_of_the_data_or_an_unknown_name():
    case, diagnosis = _slow()
    with pytest.raises(ExcitationError, match="No drive helps"):
        plan(model_of(case), diagnosis, effect="outliers", clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="Name one of these"):
        plan(model_of(case), diagnosis, effect="gremlins", clock_Hz=CLOCK_Hz)


def test_without_any_rate_the_line_for_lab_toml_is_asked_for():
    case, diagnosis = _slow()
    with pytest.raises(LabFileError, match="sampling_rate_Hz"):
        plan(model_of(case), diagnosis)
