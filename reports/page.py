"""Records of a page, traces of its recordings, and quantities that several sections share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from piezoid.design.certificate import guaranteed_error_m
from piezoid.design.design import AxisDesign, Design, LoopDesign
from piezoid.diagnosis.compare import ModelComparison
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_fitted_rows
from piezoid.numerics.arrays import Array
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid.statement import Level, Statement
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid.verification.verification import Verification
from piezoid_reports.quantities import number

MAX_PLOTTED = 2  # recordings per axis, those with the largest residual; a table lists all
WIDE_SHARE = 0.9  # of the widest drive range: above, a recording shows the loop
SPIRAL_Hz = 10.0  # rate of the spiral whose tracking error the page shows


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One recording of one axis and its simulation.

    recording   of this axis
    time_s      (samples,)  s, from the first sample
    voltage_V   (samples,)  V
    measured_m  (samples,)  m; NaN where no displacement was measured: a gap in every curve
    modelled_m  (samples,)  m; NaN in rows that the fit left out
    line_m      (samples,)  m; straight line with the common slope of all recordings of the axis
                and the zero of this one: the model without hysteresis. NaN where modelled_m is
    """

    recording: Recording
    time_s: Array
    voltage_V: Array
    measured_m: Array
    modelled_m: Array
    line_m: Array

    @property
    def range_m(self) -> float:
        """Range of the measured displacement."""
        return float(np.nanmax(self.measured_m) - np.nanmin(self.measured_m))

    @property
    def residual_m(self) -> Array:
        """Measured minus modelled, (samples,)."""
        return np.asarray(self.measured_m - self.modelled_m)

    @property
    def line_residual_m(self) -> Array:
        """Measured minus the straight line, (samples,)."""
        return np.asarray(self.measured_m - self.line_m)


def rms(values: Array) -> float:
    """Return the root mean square of the values that are not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def traces_of(axis_model: AxisModel, recordings: Sequence[Recording]) -> tuple[Trace, ...]:
    """Return a trace for every recording of the axis in the fit, largest residual first.

    Recordings of a clearly smaller drive than the widest come last: they show no full loop.
    """
    fitted = [r for r in recordings if axis_model.starts_of(r)]
    modelled = [simulate_fitted_rows(axis_model, recording) for recording in fitted]
    axis = axis_model.axis
    modelled_pairs = [
        (r.voltage_V(axis)[np.isfinite(m)], r.displacement_m(axis)[np.isfinite(m)])
        for r, m in zip(fitted, modelled, strict=True)
    ]
    covariance = sum(float(np.sum((u - u.mean()) * (y - y.mean()))) for u, y in modelled_pairs)
    variance = sum(float(np.sum((u - u.mean()) ** 2)) for u, _ in modelled_pairs)
    slope = covariance / variance if variance > 0.0 else 0.0
    traces = []
    for recording, modelled_m in zip(fitted, modelled, strict=True):
        voltage_V, measured_m = recording.voltage_V(axis), recording.displacement_m(axis).copy()
        measured_m[list(recording.bridged)] = np.nan
        is_modelled = np.isfinite(modelled_m)
        zero_m = float(np.nanmean((measured_m - slope * voltage_V)[is_modelled]))
        traces.append(
            Trace(
                recording=replace(recording, axis=axis),
                time_s=np.arange(recording.samples) / recording.sampling_rate_Hz,
                voltage_V=voltage_V,
                measured_m=measured_m,
                modelled_m=modelled_m,
                line_m=np.where(is_modelled, zero_m + slope * voltage_V, np.nan),
            )
        )
    min_range_V = WIDE_SHARE * max((np.ptp(trace.voltage_V) for trace in traces), default=0.0)
    return tuple(
        sorted(traces, key=lambda t: (np.ptp(t.voltage_V) < min_range_V, -rms(t.residual_m)))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Page:
    """Records shown on one page.

    Args:
        model: the fitted stage.
        recordings: available recordings, including those outside the fit.
        sweeps: Z spectroscopies to which the junction was fitted.
        responses: measured frequency responses.
        design: controllers, if they were designed.
        undesigned: reason if no controllers were designed, or empty.
        diagnoses: one for each diagnosed axis.
        undiagnosed: reasons why other axes have no diagnosis, in complete sentences.
        verification: of the shipped controllers.
        unshipped: by axis, the reason why its controller does not ship.
        files: sealed files of the folder by name, for the chain of digests.
        lab: declarations of the laboratory.
        comparison: of an earlier model with these recordings, if one was named.
        model_digest: of model.json; empty if the model is saved in no file.
        statements: about the stage, the most important first.
        has_summary: whether the page begins with a summary.
    """

    model: ActuatorModel
    recordings: Sequence[Recording] = ()
    sweeps: Sequence[RawTable] = ()
    responses: Sequence[FrequencyResponseRecord] = ()
    design: Design | None = None
    undesigned: str = ""
    diagnoses: Sequence[Diagnosis] = ()
    undiagnosed: Sequence[str] = ()
    verification: Verification | None = None
    unshipped: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    lab: Lab | None = None
    comparison: ModelComparison | None = None
    model_digest: str = ""
    statements: tuple[Statement, ...] = ()
    has_summary: bool = True

    @cached_property
    def traces(self) -> Mapping[str, tuple[Trace, ...]]:
        """Measurement and simulation of every recording by axis, largest residual first."""
        return {n: traces_of(axis, self.recordings) for n, axis in self.model.axes.items()}

    @property
    def headline(self) -> tuple[Statement, ...]:
        """Statements of the summary: the most important action and the most important warning."""
        if not self.has_summary:
            return ()
        first = {fact.level: fact for fact in reversed(self.statements)}
        return tuple(first[level] for level in (Level.ACTION, Level.WARNING) if level in first)

    def text_of(self, statement: Statement) -> str:
        """Return the text of a statement, preceded by its axis if the stage has several axes."""
        is_named = len(self.model.axes) > 1 and statement.axis in self.model.axes
        return f"Axis {statement.axis}: {statement.text}" if is_named else statement.text

    @property
    def counted(self) -> tuple[str, ...]:
        """Quantities recorded in counts: ``displacement``, ``voltage``."""
        diagnosed = {name for diagnosis in self.diagnoses for name in diagnosis.counted}
        return tuple(sorted({*self.model.counted, *diagnosed}))

    @property
    def axes(self) -> tuple[AxisModel, ...]:
        """All fitted axes of the stage."""
        return tuple(self.model.axes.values())

    @property
    def axis_designs(self) -> tuple[AxisDesign, ...]:
        """The designed axes, including the tip."""
        return () if self.design is None else self.design.axes

    def loop_of(self, axis: str) -> LoopDesign | None:
        """Return the recommended loop of an axis, if it has one."""
        return {design.axis: design.recommended for design in self.axis_designs}.get(axis)

    def ships(self, axis: str) -> bool:
        """Return whether the controller of an axis passed its verification."""
        verification = self.verification
        return verification is not None and verification.passed and axis in verification.methods

    def plotted_traces(self, axis: AxisModel) -> tuple[Trace, ...]:
        """Return the recordings of an axis that are plotted."""
        return self.traces.get(axis.axis, ())[:MAX_PLOTTED]

    @property
    def points(self) -> int:
        """Number of points per curve, which falls with the number of plotted recordings."""
        n_plotted = sum(len(self.plotted_traces(axis)) for axis in self.axes)
        return max(400, min(2400, 40_000 // max(n_plotted, 1)))


def tracking_error(page: Page, axis: str) -> str:
    """Return the rms error of the shipped controllers on the spiral, or empty without one.

    The error is the distance in the plane of all axes of the spiral (`moving_axes`).
    """
    methods = {} if page.verification is None else page.verification.methods
    error_m = spiral_error_m(page, methods.get(axis, ""))
    return "" if error_m is None else number(error_m, "m")


def spiral_error_m(page: Page, method: str) -> float | None:
    """Return the rms error of a method on the spiral of ``SPIRAL_Hz``, if it was simulated."""
    rows = () if page.verification is None else page.verification.comparison
    errors_m = {row.method: row.rms_m for row in rows if row.frequency_Hz == SPIRAL_Hz}
    return errors_m.get(method)


def moving_axes(verification: Verification | None) -> str:
    """Return which axes follow the spirals, which have two dimensions."""
    methods = {} if verification is None else verification.methods
    lateral = [axis for axis, method in methods.items() if method != "rst"]
    if len(lateral) == 1:
        return f"axis {lateral[0]} with an ideal second axis"
    return f"axes {' and '.join(lateral)} together"


def guarantee(page: Page, axis: AxisModel, *, has_speeds: bool = False) -> str:
    """Return the guaranteed error of the loop of an axis, or why it has no useful one.

    has_speeds  also return the error on the spiral, and the speed up to which the error is covered
    """
    loop, verification = page.loop_of(axis.axis), page.verification
    certificate = None if loop is None else loop.certificate
    bound_m = guaranteed_error_m(certificate, axis, is_verified=page.ships(axis.axis))
    if isinstance(bound_m, str):
        return bound_m
    if not has_speeds:
        return number(bound_m, "m")
    assert certificate is not None
    assert verification is not None
    speed_m_per_s = spiral_speed_m_per_s(SPIRAL_Hz, verification.radius_m)
    slow_m = certificate.guaranteed_at(speed_m_per_s)
    fastest = number(certificate.reference_slew_m_per_s, "m/s")
    limit = f"{number(bound_m, 'm')} up to {fastest}; faster: not covered"
    return f"{number(slow_m, 'm')} at {SPIRAL_Hz:g} Hz, {limit}" if slow_m < bound_m else limit
