"""The record of a verification, and its file ``verification.json``."""

from dataclasses import dataclass

from piezoid.digests import seal
from piezoid.formatting import significant, with_unit
from piezoid.record_json import (
    RecordLayout,
    Unbounded,
    fields_of,
    read_sealed,
    refusing,
    to_json,
)
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.summary import Summarised, Summary
from piezoid.verification.criteria import Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.rebuild import Proof
from piezoid.verification.tracking import (
    MethodName,
    Motion,
    Plottable_Hz,
    Plottable_m,
    SpiralTrace,
)

SCHEMA = "piezoid.verification/1"
_MIN_RADIUS_m = 1e-15  # of a spiral that a picture can show


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One method at one frequency; see ``Tracking`` for the numbers."""

    method: MethodName
    frequency_Hz: Plottable_Hz
    rms_m: float
    rms_percent: float
    max_m: float
    aligned_rms_m: Plottable_m
    delay_s: float


@dataclass(frozen=True, kw_only=True)
class ErrorBound:
    """Figures of the largest error of one axis at one speed; see ``verification.bounds``.

    slew_m_per_s   of the fastest reference, or of the surface under a tip
    bound_m        of the certificate, for a tip of its linear loop, each with three standard
                   deviations of noise; None: no bound within the range
    probable_m     bound of the largest error in half a second with this probability, on stages
                   that the recordings allow
    worst_found_m  by a search over references, histories and stages
    simulated_m    on the identified stage, median of the same references
    runs           number of runs from which probable_m follows
    """

    axis: str
    slew_m_per_s: float
    bound_m: float | None
    probable_m: Unbounded
    probability: float
    worst_found_m: float
    simulated_m: float
    runs: int

    @property
    def is_exceeded(self) -> bool:
        """Whether the error on a drawn stage exceeds the bound, whose conditions it violates.

        A certificate bounds the discrepancy of the model class by the held-out residual; some
        drawn stages have a larger discrepancy.
        """
        return self.bound_m is not None and self.worst_found_m > self.bound_m


@dataclass(frozen=True, kw_only=True)
class SpiralRow:
    """Radial and pitch errors of one method on a spiral of one frequency; see ``Tracking``."""

    method: MethodName
    frequency_Hz: float
    radial_rms_m: float
    pitch_error: float | None


@dataclass(frozen=True, kw_only=True)
class CurrentRow:
    """Figures of the tunnelling loop in a scenario.

    ln_current_std     standard deviation of ln i
    height_rms_m       the equivalent distance
    largest_ratio      of the current to its set point
    retracted_samples  number of samples with the tip retracted
    """

    scenario: str
    ln_current_std: float
    height_rms_m: float
    largest_ratio: float
    retracted_samples: int


@dataclass(frozen=True, kw_only=True)
class CouplingRow:
    """Motion of one axis in response to the reference of another, both in closed loop.

    moved           axis whose reference moves, in the displacements of the sensors
    answers         axis that responds
    frequency_Hz    of the motion
    percent         amplitude of the response, of that of the motion
    without_percent  the same without the decoupling matrix; None: the loops diverge
    """

    moved: str
    answers: str
    frequency_Hz: float
    percent: float
    without_percent: float | None


@dataclass(frozen=True, kw_only=True, repr=False)
class Verification(Summarised):
    """Simulation of the compiled controllers on the identified stage, with a verdict per limit.

    name             of the stage
    methods          shipped, by axis
    radius_m         of every path; percentages are of the diameter; 0 without a lateral axis
    comparison       by frequency and method
    spirals, currents   additional figures of spirals, and of tunnelling loops
    traces           of a few spirals, for plots
    motions          traces of rasters and steps, for plots; not in the file if empty
    coupling         between coupled axes in closed loop; not in the file if empty
    bounds           of the largest errors, on request; not in the file if empty
    verdicts         of all scenarios
    proofs           comparisons of builds, on request
    limit_proofs     by abstract interpretation, for every input; not in the file if empty
    plants           label and axis of every simulated plant
    parameters_digest, runtime_digest   of params.json, and of the runtime's source
    lab_digest       of lab.toml, for converters and limits; empty without one
    """

    name: str
    methods: dict[str, MethodName]
    radius_m: Plottable_m
    comparison: tuple[ComparisonRow, ...]
    spirals: tuple[SpiralRow, ...]
    currents: tuple[CurrentRow, ...]
    traces: tuple[SpiralTrace, ...]
    verdicts: tuple[Verdict, ...]
    proofs: tuple[Proof, ...]
    plants: tuple[str, ...]
    parameters_digest: str
    runtime_digest: str
    lab_digest: str = ""
    limit_proofs: tuple[LimitProof, ...] = ()
    motions: tuple[Motion, ...] = ()
    coupling: tuple[CouplingRow, ...] = ()
    bounds: tuple[ErrorBound, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all verdicts, comparisons of builds and proofs passed.

        A proof for which no compiler, emulator or analyser is installed is no failure.
        """
        proofs = (*(p.passed for p in self.proofs), *(p.passed for p in self.limit_proofs))
        return all(v.passed for v in self.verdicts) and all(proofs)

    def summary(self) -> Summary:
        """Return a table of the rms tracking error per method and frequency, and failed verdicts.

        >>> print(shipping.verification.summary())
        Verification of ...: passed, ... of ... checks
        method ...
        """
        passed = sum(verdict.passed for verdict in self.verdicts)
        failed = [verdict for verdict in self.verdicts if not verdict.passed]
        errors = {(row.method, row.frequency_Hz): row.rms_m for row in self.comparison}
        frequencies_Hz = sorted({frequency_Hz for _, frequency_Hz in errors})
        return Summary(
            title=f"Verification of {self.name}: {'passed' if self.passed else 'failed'}, "
            f"{passed} of {len(self.verdicts)} checks",
            headings=("method", *(with_unit(f_Hz, "Hz") for f_Hz in frequencies_Hz)),
            rows=[
                (
                    METHOD_NAMES[method],
                    *(with_unit(errors[method, f_Hz], "m") for f_Hz in frequencies_Hz),
                )
                for method in dict.fromkeys(row.method for row in self.comparison)
            ],
            notes=(
                "simulated rms tracking error on spirals of radius "
                f"{with_unit(self.radius_m, 'm')}",
                *(
                    f"failed: {v.name} ({v.scenario}): {significant(v.value)} {v.unit}, "
                    f"limit {significant(v.limit)}"
                    for v in failed
                ),
            ),
        )

    def to_json(self) -> bytes:
        """Return ``verification.json``, sealed.

        >>> shipping.verification.to_json()[:1]
        b'{'
        """
        return seal(SCHEMA, {"passed": self.passed, **to_json(self, LAYOUTS)})


# Entries that are not in the file if they are empty.
_OPTIONAL = ("limit_proofs", "motions", "coupling", "bounds")
LAYOUTS = (
    RecordLayout(
        kind=Verification,
        write=lambda verification: {
            name: value
            for name, value in fields_of(verification).items()
            if value or name not in _OPTIONAL
        },
    ),
    *(
        RecordLayout(kind=kind, write=lambda run: {**fields_of(run), "passed": run.passed})
        for kind in (Verdict, Proof)
    ),
    RecordLayout(kind=LimitProof, write=lambda row: {**fields_of(row), "verdict": row.verdict}),
)


def verification_from_json(content: bytes, source: str = "verification.json") -> Verification:
    """Read ``verification.json`` back; refuse a changed bit, another schema, a missing entry."""
    remedy = "Verify again with this version."
    verification = read_sealed(
        Verification, content, SCHEMA, source, remedy=remedy, layouts=LAYOUTS
    )
    with refusing(SCHEMA, source, remedy=remedy):
        spirals = {(row.method, row.frequency_Hz) for row in verification.spirals}
        for row in verification.comparison:
            if (row.method, row.frequency_Hz) not in spirals:
                raise ValueError(f"no spiral of {row.method} at {row.frequency_Hz} Hz")
        for trace in verification.traces:
            if not len(trace.x_m) == len(trace.y_m) == len(trace.shape_error_m) > 0:
                points = len(trace.x_m)
                raise ValueError(f"x_m of a spiral has {points} points, other arrays differ")
        for motion in verification.motions:
            if motion.axis not in verification.methods:
                raise ValueError(f"a motion is of axis {motion.axis}, which does not ship")
            count, n_uncompensated = len(motion.reference_m), len(motion.uncompensated_m)
            if not (len(motion.shipped_m) == count > 1 and n_uncompensated in (0, count)):
                raise ValueError(f"reference_m has {count} points, other arrays differ")
        if verification.traces and not verification.radius_m >= _MIN_RADIUS_m:
            raise ValueError(f"radius_m is {verification.radius_m}")
    return verification
