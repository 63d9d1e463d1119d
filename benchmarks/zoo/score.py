"""Score of one diagnosis: the named effects against the effects hidden in a simulated stage.

An effect counts as hidden only if its simulated size reaches a tenth of the requested size. It
counts as named only if a finding bears its name; effects that a finding declares inseparable do
not count. `something_else` on a healthy stage is a false alarm. On other stages it is counted
separately, as it names no effect.
"""

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from math import sqrt
from pathlib import Path
from typing import Any

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.errors import PiezoidError
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import Campaign
from piezoid_datasets.virtual_lab.effects.effect import Measure
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.write import write_campaign

MIN_SIZE_RATIO = 0.1  # of the requested size, from which an effect counts as hidden
UNNAMED = "something_else"
LOOP_SHAPE = "loop_shape"  # a property of the model class, which most laws of the zoo show
INITIAL_STATE = "initial_state"
Numbers = Mapping[str, float | str]


def cut_off_percent(numbers: Numbers, rig: Rig) -> float:
    """Return the largest share of the drive range beyond a limit of the amplifier, in percent."""
    low_V, high_V = (rig.amplifier_gain_V_per_V * v for v in (rig.drive_min_V, rig.drive_max_V))
    above_V = high_V - float(numbers.get("high_V", high_V))
    below_V = float(numbers.get("low_V", low_V)) - low_V
    return 100.0 * max(above_V, below_V) / (high_V - low_V)


def delay_us(numbers: Numbers, campaign: Campaign) -> float:
    """Return a delay given as a time, or as rows of the recording with the highest rate."""
    if "delay_s" in numbers:
        return 1e6 * float(numbers["delay_s"])
    fastest_Hz = max(1.0 / (rows.time_s[1] - rows.time_s[0]) for rows in campaign.recordings)
    return 1e6 * float(numbers["rows"]) / float(fastest_Hz)


def hum_percent(numbers: Numbers, rig: Rig) -> float:
    """Return the rms of all mains harmonics, in percent of the stroke."""
    amplitude_m = [float(a) for key, a in numbers.items() if key.startswith("amplitude_")]
    return 100.0 * sqrt(sum(a * a for a in amplitude_m) / 2.0) / rig.stroke_m


# True size of an effect in the unit that its finding states.
TRUE_SIZE: dict[str, Callable[[Numbers, Campaign], float]] = {
    "creep": lambda n, _: 100.0 * float(n["creep_per_decade"]),
    "delay": delay_us,
    "lag": lambda n, _: 1e6 * float(n["time_constant_s"]),
    "resonance": lambda n, _: float(n["frequency_Hz"]),
    "slew_limit": lambda n, c: float(n["slew_V_per_s"]) / c.rig.amplifier_gain_V_per_V,
    "gain_change": lambda n, _: 100.0 * float(n["relative_change"]),
    "amplifier_saturation": lambda n, c: cut_off_percent(n, c.rig),
    "mains_interference": lambda n, c: hum_percent(n, c.rig),
    "sensor_periodic_error": lambda n, _: 1e9 * float(n["amplitude_m"]),
    "quantisation": lambda n, _: 1e9 * float(n["step_m"]),
}
# Their size is the standard deviation over the stroke, in the recording with the largest one.
ADDED = ("thermal_drift", "cross_coupling", "rate_dependence")


@dataclass(frozen=True, kw_only=True)
class ScoredFinding:
    """One finding with its p-value and size; ``truth`` is the true size, if it is known."""

    name: str
    p_value: float
    rms_percent: float
    value: float
    unit: str
    ci95: tuple[float, float]
    not_separable_from: tuple[str, ...] = ()
    truth: float | None = None

    @property
    def is_covered(self) -> bool | None:
        """Whether the interval contains the true size; None if the true size is unknown."""
        if self.truth is None:
            return None
        return bool(self.ci95[0] <= self.truth <= self.ci95[1])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One stage and the findings of its diagnosis.

    kind           as on the command line: healthy, single, pair, triple
    size           share of the full effect size
    unexplained    p-value of the remaining structure, or None if the diagnosis has none
    past_percent   largest rms change of a recording, in percent of the stroke, if all drives had
                   cycled into a steady state before
    noise_percent  rms noise of the sensor, in percent of the stroke
    times_noise    residual of the widest hysteresis class over the noise
    failed         reason for which there is no diagnosis
    """

    law: str
    kind: str
    size: float
    seed: int
    hidden: tuple[str, ...]
    findings: tuple[ScoredFinding, ...] = ()
    unexplained: float | None = None
    past_percent: float | None = None
    noise_percent: float = 0.0
    times_noise: float = 0.0
    samples: int = 0
    time_s: float = 0.0
    failed: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Named effects of the catalogue."""
        return tuple(finding.name for finding in self.findings if finding.name != UNNAMED)

    @property
    def wrong(self) -> tuple[ScoredFinding, ...]:
        """Findings of effects that are neither hidden nor a true initial state."""
        right = {*self.hidden, UNNAMED, *((INITIAL_STATE,) if self.has_initial_state else ())}
        return tuple(finding for finding in self.findings if finding.name not in right)

    @property
    def has_initial_state(self) -> bool:
        """Whether the drive before the recordings changes one of them by more than the noise."""
        return (self.past_percent or 0.0) > self.noise_percent

    @property
    def is_only_initial_state(self) -> bool:
        """Whether the initial state is true and the only finding."""
        return self.has_initial_state and {f.name for f in self.findings} == {INITIAL_STATE}

    def row(self) -> dict[str, Any]:
        """Return the line of the results file as a dictionary."""
        return asdict(self)


def case_of_row(row: Mapping[str, Any]) -> Case:
    """Return the case of one line of the results file."""
    findings = tuple(
        ScoredFinding(
            **{
                **finding,
                "ci95": tuple(finding["ci95"]),
                "not_separable_from": tuple(finding["not_separable_from"]),
            }
        )
        for finding in row["findings"]
    )
    return Case(**{**row, "findings": findings, "hidden": tuple(row["hidden"])})


@dataclass(frozen=True, kw_only=True)
class StageRequest:
    """Law, kind and seed of a stage, and its hidden effects with their sizes in percent."""

    law: str
    kind: str
    seed: int
    size: float = 1.0
    hidden: Mapping[str, float] = field(default_factory=dict)


def score_stage(request: StageRequest, draw: Callable[..., Campaign]) -> Case:
    """Simulate a stage, diagnose it and compare the findings with the hidden effects.

    draw  (request, settled=...) -> campaign; with settled=True all drives start in a steady cycle
    """
    values: dict[str, Any] = {
        "law": request.law,
        "kind": request.kind,
        "size": request.size,
        "seed": request.seed,
    }
    try:
        campaign = draw(request)
    except ValueError as error:  # its recordings cannot show the effect
        return Case(**values, hidden=(), failed=f"not made: {error}")
    values["hidden"] = tuple(
        effect.name
        for effect in campaign.answer.effects
        if effect.measured_percent > MIN_SIZE_RATIO * effect.asked_percent
    )
    change_m = max(
        Measure.RMS.of(rows.noise_free_m - settled.noise_free_m)
        for rows, settled in zip(
            campaign.recordings, draw(request, settled=True).recordings, strict=True
        )
    )
    values["past_percent"] = 100.0 * change_m / campaign.rig.stroke_m
    values["noise_percent"] = 100.0 * campaign.rig.noise_rms_m / campaign.rig.stroke_m
    values["samples"] = sum(len(rows.time_s) for rows in campaign.recordings)
    try:
        diagnosis, time_s = diagnose_campaign(campaign)
    except PiezoidError as error:
        return Case(**values, failed=str(error))
    return Case(
        **values,
        findings=tuple(
            _score_finding(finding, campaign, values["hidden"])
            for finding in diagnosis.findings
            if finding.effect != LOOP_SHAPE
        ),
        unexplained=diagnosis.unexplained.p_value if diagnosis.unexplained else None,
        times_noise=diagnosis.envelope_rms_m / diagnosis.noise_floor_rms_m,
        time_s=time_s,
    )


def read_campaign(campaign: Campaign) -> tuple[tuple[Recording, ...], Lab]:
    """Write the files of a campaign and read them as a user does."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_campaign(campaign, folder)
        lab = read_lab(folder / "recordings/lab.toml")
        files = [folder / f"recordings/{rows.run.name}.csv" for rows in campaign.recordings]
        return tuple(collect(files, lab).recordings), lab


def diagnose_campaign(campaign: Campaign) -> tuple[Diagnosis, float]:
    """Return the diagnosis and its processor time in seconds."""
    recordings, lab = read_campaign(campaign)
    start_s = time.process_time()
    return diagnose(recordings, lab=lab), time.process_time() - start_s


def _score_finding(finding: Finding, campaign: Campaign, hidden: tuple[str, ...]) -> ScoredFinding:
    truth = None
    if finding.effect in hidden:
        effect = next(e for e in campaign.answer.effects if e.name == finding.effect)
        if finding.effect in TRUE_SIZE:
            truth = TRUE_SIZE[finding.effect](effect.numbers, campaign)
        elif finding.effect in ADDED:
            truth = effect.moving_percent
    return ScoredFinding(
        name=finding.effect,
        p_value=float(finding.p_value),
        rms_percent=float(finding.rms_percent),
        value=float(finding.size.value),
        unit=finding.size.unit,
        ci95=(float(finding.size.ci95[0]), float(finding.size.ci95[1])),
        not_separable_from=finding.not_separable_from,
        truth=truth,
    )
