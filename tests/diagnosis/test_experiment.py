"""A plan addresses an open question within the limits and separates effects as predicted.

The laboratory repeats every recording without an effect, which gives its true contribution. Plain
least squares, independent of the planner, computes how well two contributions can be separated.
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
    Playback,
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
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays
from piezoid.records.lab import Amplifier, Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import healthy, member_named, record_all
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
class HiddenStage:
    """A stage with hidden effects and its recordings."""

    rig: LabRig
    stage: Stage
    faults: Mapping[str, Fault]
    runs: tuple[Run, ...]

    def repeat(self, drive: Drive | None) -> tuple[tuple[Rows, ...], dict[str, tuple[Array, ...]]]:
        """Return all recordings, the planned one last, and the contribution of each effect, m."""
        runs = self.runs if drive is None else (*self.runs, self._run(drive))
        rows = record_all(self.stage, runs, self.faults)
        contributions_m = {}
        for name in self.faults:
            remaining = {k: v for k, v in self.faults.items() if k != name}
            without = record_all(self.stage, runs, remaining)
            contributions_m[name] = tuple(
                a.noise_free_m - b.noise_free_m for a, b in zip(rows, without, strict=True)
            )
        return rows, contributions_m

    def _run(self, drive: Drive) -> Run:
        return Run(
            name="planned",
            sampling_rate_Hz=drive.sampling_rate_Hz,
            command_V=np.array(drive.voltage_V[:, 0]),
            history_V=cycled_history_V(self.rig),
            others_V={axis: drive.voltage_V[:, 1 + k] for k, axis in enumerate(drive.axes[1:])},
        )


def hidden_stage(
    seed: int, sizes_percent: Mapping[str, float], plans: Sequence[str], truth: str = "preisach"
) -> HiddenStage:
    """Draw a stage and hide effects of these sizes in it."""
    rig = draw_rig(_rng(seed, "rig"))
    ceramic = member_named(TRUTHS, truth).draw(_rng(seed, "ceramic"))
    stage = Stage(rig=rig, ceramic=ceramic, seed=seed)
    runs = tuple(run_of(member_named(PLANS, name), rig, _rng(seed, name)) for name in plans)
    bench = healthy(stage, runs)
    faults = {
        effect.name: effect.install(
            sizes_percent[effect.name] / 100.0 * rig.stroke_m, bench, _rng(seed, effect.name)
        )
        for effect in EFFECTS
        if effect.name in sizes_percent
    }
    return HiddenStage(rig=rig, stage=stage, faults=faults, runs=runs)


def model_of(case: HiddenStage) -> ActuatorModel:
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
    template = axis_model(recordings=())
    slew_V_per_s = max(
        float(np.abs(np.diff(run.command_V)).max()) * run.sampling_rate_Hz for run in case.runs
    )
    axis = replace(
        template,
        hysteresis=ModifiedPrandtlIshlinskii(
            plays=plays, dead_zones=LINEAR, voltage_offset_V=MIDDLE_V
        ),
        rig=Rig(),
        certificate=replace(template.certificate, slew_V_per_s=slew_V_per_s),
    )
    return stage_model(axis)


def recordings_of(recorded_rows: Sequence[Rows]) -> tuple[Recording, ...]:
    """Return recordings as they are read from the files of the laboratory."""
    return tuple(
        from_arrays(
            voltage_V=rows.voltage_V,
            displacement_m=rows.displacement_m,
            sampling_rate_Hz=rows.run.sampling_rate_Hz,
            axis="x",
            name=f"{rows.run.name}.csv",
        )
        for rows in recorded_rows
    )


def diagnosis_of(case: HiddenStage, findings: Sequence[Finding]) -> Diagnosis:
    """Return a diagnosis with these findings; other effects are bounded by a thousandth."""
    diagnosis, residual_m = diagnosed(*findings), 1e-3 * case.rig.stroke_m
    return replace(
        diagnosis,
        stroke_m=case.rig.stroke_m,
        final=HeldOut(rms_m=residual_m, rms_percent=0.1),
        envelope_rms_m=residual_m,
        noise_floor_rms_m=case.rig.noise_rms_m,
        not_detected=tuple(
            replace(absent, upper_bound_m=residual_m, detection_limit_m=residual_m)
            for absent in diagnosis.not_detected
        ),
    )


def finding_of_size(
    effect: str, *, share_percent: float, confounded: tuple[str, ...] = (), half_width: float = 0.1
) -> Finding:
    """Return a finding of this size and the relative half width of its interval."""
    ci95 = (share_percent * (1.0 - half_width), share_percent * (1.0 + half_width))
    size = Size(value=share_percent, unit="percent", ci95=ci95)
    return replace(finding(effect, share_percent / 100.0, confounded), size=size)


def change_percent(case: HiddenStage, name: str) -> float:
    """Return the size of an effect in all recordings, rms about the mean of each."""
    square = np.mean([np.var(change_m) for change_m in case.repeat(None)[1][name]])
    return 100.0 * float(np.sqrt(square)) / case.rig.stroke_m


def true_separability(
    case: HiddenStage,
    axis: AxisModel,
    names: tuple[str, str],
    drive: Drive | None,
    *,
    is_drift: bool,
) -> float:
    """Return 1 - R^2 of the true effect regressed on its rival and the model.

    is_drift  the rival is a quadratic drift of each recording instead of its true contribution
    """
    recorded, contributions_m = case.repeat(drive)
    effect_m, rival_m = (contributions_m[name] for name in names)
    picks = [np.linspace(0, len(c) - 1, 1500).astype(int) for c in effect_m]
    zeros = block_diag(*(np.ones((len(p), 1)) for p in picks))
    states = [_model_columns(axis, rows)[p] for rows, p in zip(recorded, picks, strict=True)]
    model = np.hstack([np.vstack(states), zeros])
    if is_drift:
        rival = block_diag(*(np.column_stack([p / p[-1], (p / p[-1]) ** 2]) for p in picks))
    else:
        rival = np.concatenate([c[p] for c, p in zip(rival_m, picks, strict=True)])[:, None]
    effect = np.concatenate([c[p] for c, p in zip(effect_m, picks, strict=True)])
    residual, remainder = _residual(effect, model), _residual(effect, np.hstack([model, rival]))
    return float((remainder**2).sum() / (residual**2).sum())


def _model_columns(axis: AxisModel, rows: Rows) -> Array:
    """Return play states, and squares and cubes of their output for the dead zones."""
    drive_V = rows.voltage_V - MIDDLE_V
    history_V = np.array([MIDDLE_V, -MIDDLE_V] * 2 + [float(drive_V[0])])
    _, memory_V = play_columns(history_V, THRESHOLD_V, np.zeros(len(THRESHOLD_V)))
    states, _ = play_columns(drive_V, THRESHOLD_V, memory_V)
    h = states @ axis.hysteresis.plays.weight
    h = h / np.abs(h).max()
    return np.hstack([states, np.column_stack([h**2, h**3])])


def _residual(values: Array, columns: Array) -> Array:
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-10)[0])


def _rng(seed: int, purpose: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(purpose.encode())])


CLOCK_Hz = 20_000.0
CREEP_OR_DRIFT = ("creep", "thermal_drift")
DELAY_OR_LAG = ("delay", "lag")


@cache
def _slow_case() -> tuple[HiddenStage, Diagnosis]:
    case = hidden_stage(3, {"creep": 0.6, "thermal_drift": 0.3}, ("sweep", "long_hold"))
    share = change_percent(case, "creep")
    return case, diagnosis_of(
        case, [finding_of_size("creep", share_percent=share, confounded=CREEP_OR_DRIFT[1:])]
    )


@cache
def _slow_plan() -> Plan:
    case, diagnosis = _slow_case()
    recordings = recordings_of(case.repeat(None)[0])
    return plan(model_of(case), diagnosis, recordings=recordings, clock_Hz=CLOCK_Hz)


def test_creep_and_drift_after_one_hold_are_separated_by_random_levels():
    planned = _slow_plan()
    assert planned.question.kind == "separate"
    assert planned.question.effects == CREEP_OR_DRIFT
    assert planned.drive.name in ("held_levels", "held_levels_mirrored")


def test_a_planned_recording_separates_creep_from_drift_as_predicted():
    case, _ = _slow_case()
    slow_plan, axis = _slow_plan(), model_of(case).axes["x"]
    recorded, planned = (
        true_separability(case, axis, CREEP_OR_DRIFT, drive, is_drift=True)
        for drive in (None, slow_plan.drive)
    )
    predicted = slow_plan.planned.separability
    assert slow_plan.recorded.separability < 0.2
    assert recorded < 0.2
    assert planned > 2.0 * recorded
    assert predicted / 2 < planned < 2.5 * predicted


def test_a_fast_small_multisine_separates_delay_from_lag_as_predicted():
    case = hidden_stage(4, {"delay": 0.5, "lag": 0.4}, ("sweep", "rates"), "bouc_wen")
    model = model_of(case)
    size_percent = change_percent(case, "delay")
    delay = finding_of_size("delay", share_percent=size_percent, confounded=DELAY_OR_LAG[1:])
    recordings = recordings_of(case.repeat(None)[0])
    diagnosis = diagnosis_of(case, [delay])
    delay_plan = plan(model, diagnosis, recordings=recordings, clock_Hz=CLOCK_Hz)
    axis = model.axes["x"]
    assert delay_plan.drive.name == "small_multisine"
    promised = delay_plan.planned.separability / delay_plan.recorded.separability
    achieved = true_separability(case, axis, DELAY_OR_LAG, delay_plan.drive, is_drift=False)
    achieved /= true_separability(case, axis, DELAY_OR_LAG, None, is_drift=False)
    assert promised > 5.0
    assert promised / 4 < achieved < promised * 4


def test_a_wide_interval_is_tightened_and_a_narrow_one_is_not():
    case, _ = _slow_case()
    model = model_of(case)
    wide = diagnosis_of(case, [finding_of_size("creep", share_percent=0.3, half_width=0.6)])
    wide_plan = plan(model, wide, clock_Hz=CLOCK_Hz)
    assert (wide_plan.question.kind, wide_plan.question.effects) == ("tighten", ("creep",))
    narrow = diagnosis_of(case, [finding_of_size("creep", share_percent=0.3, half_width=0.05)])
    assert plan(model, narrow, clock_Hz=CLOCK_Hz).question.kind == "detect"


def test_an_undetectable_effect_is_planned_for():
    case, _ = _slow_case()
    diagnosis = diagnosis_of(case, [])
    not_detected = tuple(
        replace(a, upper_bound_m=None, detection_limit_m=None) if a.effect == "delay" else a
        for a in diagnosis.not_detected
    )
    diagnosis = replace(diagnosis, not_detected=not_detected)
    planned = plan(model_of(case), diagnosis, clock_Hz=CLOCK_Hz)
    assert planned.question.effects == ("delay",)
    assert "cannot show delay" in sentences(planned)[0]


@pytest.mark.parametrize("slew_V_per_s", [60.0, 30_000.0])
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda experiment: experiment.name)
def test_every_candidate_drive_stays_inside_range_and_slew_rate(experiment, slew_V_per_s):
    limits = DriveLimits(voltage_min_V=1.0, voltage_max_V=8.0, slew_V_per_s=slew_V_per_s)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz, other_limits={"y": limits})
    drive = drive_of(experiment, bench, 0)
    assert drive.voltage_V.min() >= 1.0
    assert drive.voltage_V.max() <= 8.0
    jumps_V = np.abs(np.diff(drive.voltage_V, axis=0)).max()
    assert jumps_V * drive.sampling_rate_Hz <= 1.01 * slew_V_per_s
    assert (drive.voltage_V[[0, -1]] == 1.0).all()
    if experiment.waveform is not None:  # within the range before drive_of limits it
        body_V = experiment.waveform(Playback(limits=limits, rate_Hz=drive.sampling_rate_Hz))
        assert body_V.min() >= limits.voltage_min_V - 1e-9
        assert body_V.max() <= limits.voltage_max_V + 1e-9


@pytest.mark.parametrize(
    ("clock_Hz", "slew_V_per_s", "fastest_Hz"),
    [
        pytest.param(24_800.0, 1e5, (310.0, 310.0, 97.0), id="mechanics"),
        pytest.param(24_800.0, 3100.0, (310.0, 310.0, 97.0), id="slew"),
        pytest.param(1000.0, 1e5, (31.0, 31.0, 31.0), id="clock"),
    ],
)
def test_each_sine_of_the_grid_has_half_a_second_or_three_cycles(
    clock_Hz, slew_V_per_s, fastest_Hz
):
    """Mechanics allow 100 Hz at the full range, the slew limit 99 Hz, the clock 50 Hz."""
    limits = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=slew_V_per_s)
    bench = Bench(axis="x", limits=limits, clock_Hz=clock_Hz)
    drive = drive_of(next(e for e in EXPERIMENTS if e.name == "sine_grid"), bench, 0)
    offset_V = drive.voltage_V[:, 0] - limits.middle_V
    rising = np.flatnonzero((offset_V[:-1] <= 1e-9) & (offset_V[1:] > 1e-9))
    period_s = np.diff(rising) / drive.sampling_rate_Hz
    peak_V = np.maximum.reduceat(offset_V, rising)[:-1]
    for amplitude_V, highest_Hz in zip((0.5, 1.5, 5.0), fastest_Hz, strict=True):
        sines_s = period_s[np.isclose(peak_V, amplitude_V, rtol=0.02)]
        assert 1.0 / sines_s.min() == pytest.approx(highest_Hz, rel=0.05)
        for frequency_Hz in (highest_Hz, 0.97):
            cycles_s = sines_s[np.isclose(sines_s * frequency_Hz, 1.0, rtol=0.06)]
            # the first and the last cycle may join those of the neighbouring sines
            assert len(cycles_s) >= 2
            assert cycles_s.sum() > 0.5 - 2.0 / frequency_Hz


def test_a_drive_for_coupling_requires_another_axis():
    limits = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1e3)
    bench = Bench(axis="x", limits=limits, clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="no other axis"):
        drive_of(next(e for e in EXPERIMENTS if e.name == "other_axis"), bench, 0)


def test_a_multisine_contains_its_lines_only_and_has_rms_one(rng):
    lines = odd_lines(20, 800, 10.0, left_out_of=4, rng=rng)
    period = multisine_period(lines, 1000, rng)
    spectrum = np.abs(np.fft.rfft(period))
    unexcited_lines = np.setdiff1d(np.arange(501), lines)
    assert np.ptp(spectrum[lines]) < 1e-9 * spectrum.max()
    assert spectrum[unexcited_lines].max() < 1e-9 * spectrum.max()
    assert np.bincount((lines - 2) // 8)[:9].tolist() == [3] * 9  # of each four odd lines
    assert (lines % 2 == 1).all()
    assert period.std() == pytest.approx(1.0, rel=1e-9)


def test_limits_are_the_narrower_of_lab_toml_and_the_recordings():
    case, diagnosis = _slow_case()
    amplifier = Amplifier(
        gain_V_per_V=15.0, output_min_V=-30.0, output_max_V=120.0, slew_V_per_s=900.0
    )
    planned = plan(model_of(case), diagnosis, lab=Lab(amplifier=amplifier), clock_Hz=CLOCK_Hz)
    limits = planned.limits
    assert (limits.voltage_min_V, limits.voltage_max_V, limits.slew_V_per_s) == (0.0, 8.0, 60.0)


def test_the_files_of_a_plan_are_read_back(tmp_path):
    planned = _slow_plan()
    files = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    content = unseal(files["plan.json"], SCHEMA, "plan.json")
    assert content["drive"]["name"] == planned.drive.name
    assert content["why"] == " ".join(sentences(planned))
    assert len(content["alternatives"]) == len(EXPERIMENTS)
    path = tmp_path / "drive.csv"
    path.write_bytes(files["drive.csv"])
    (recording,) = collect([path], Lab()).recordings
    assert np.array_equal(recording.voltage_V("x"), planned.drive.voltage_V[:, 0])
    second_files = plan_files(planned, model_digest="sha256:a", diagnosis_digest="sha256:b")
    assert second_files == files


def test_no_drive_is_planned_for_a_fault_of_the_data_or_an_unknown_effect():
    case, diagnosis = _slow_case()
    with pytest.raises(ExcitationError, match="no drive can be planned"):
        plan(model_of(case), diagnosis, effect="outliers", clock_Hz=CLOCK_Hz)
    with pytest.raises(ExcitationError, match="Name one of these"):
        plan(model_of(case), diagnosis, effect="gremlins", clock_Hz=CLOCK_Hz)


def test_a_plan_without_any_sampling_rate_names_the_line_for_lab_toml():
    case, diagnosis = _slow_case()
    with pytest.raises(LabFileError, match="sampling_rate_Hz"):
        plan(model_of(case), diagnosis)
