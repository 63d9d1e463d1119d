"""A stage of the virtual laboratory, a model of it made without the fit, and planned drives on it.

The laboratory knows what each effect really changed: it records everything again without it. How
well that change can be told from another is computed here by plain least squares, apart from the
code that promised it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from piezoid.diagnosis.diagnosis import Diagnosis, Finding, HeldOut, Size
from piezoid.diagnosis.planning.drive_limits import Drive
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from piezoid.records.frames import from_arrays
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
