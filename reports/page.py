"""Records of a page, and quantities that several sections derive from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from piezoid.design.design import AxisDesign, Design, LoopDesign
from piezoid.design.design_statements import guaranteed_error_m
from piezoid.diagnosis.compare import ModelComparison
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid.statement import Level, Statement
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid.verification.verification import Verification
from piezoid_reports.quantities import number
from piezoid_reports.traces import Trace, traces_of

MAX_PLOTTED = 2  # recordings per axis, those with the largest residual; a table lists all
SPIRAL_Hz = 10.0  # rate of the spiral whose tracking error the page shows


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
        facts = (
            next((fact for fact in self.statements if fact.level is level), None)
            for level in (Level.ACTION, Level.WARNING)
        )
        return tuple(fact for fact in facts if fact is not None)

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
        return next(
            (design.recommended for design in self.axis_designs if design.axis == axis), None
        )

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
    """Return the rms error of the shipped controller on the spiral, or empty without one."""
    verification = page.verification
    if verification is None:
        return ""
    for row in verification.comparison:
        if (row.method, row.frequency_Hz) == (verification.methods.get(axis), SPIRAL_Hz):
            return number(row.rms_m, "m")
    return ""


def guarantee(page: Page, axis: AxisModel) -> str:
    """Return the guaranteed error of the loop of an axis, or why it has no useful one."""
    loop, verification = page.loop_of(axis.axis), page.verification
    certificate = None if loop is None else loop.certificate
    bound_m = guaranteed_error_m(certificate, axis, is_verified=page.ships(axis.axis))
    if isinstance(bound_m, str):
        return bound_m
    assert certificate is not None
    assert verification is not None
    speed_m_per_s = spiral_speed_m_per_s(SPIRAL_Hz, verification.radius_m)
    slow_m = certificate.guaranteed_at(speed_m_per_s)
    fastest = number(certificate.reference_slew_m_per_s, "m/s")
    limit = f"{number(bound_m, 'm')} up to {fastest}; faster: not covered"
    return f"{number(slow_m, 'm')} at {SPIRAL_Hz:g} Hz, {limit}" if slow_m < bound_m else limit


def guaranteed_limit(page: Page, axis: AxisModel) -> str:
    """Return the guaranteed error at every covered speed, or why the axis has no useful one."""
    loop = page.loop_of(axis.axis)
    certificate = None if loop is None else loop.certificate
    bound_m = guaranteed_error_m(certificate, axis, is_verified=page.ships(axis.axis))
    return bound_m if isinstance(bound_m, str) else number(bound_m, "m")
