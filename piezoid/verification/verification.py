"""The record of a verification, and its file ``verification.json``."""

from dataclasses import dataclass
from typing import Any

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
from piezoid.runtime.schema import METHOD_NAMES, METHODS
from piezoid.summary import Summarised, Summary
from piezoid.verification.criteria import Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.plotted_paths import Motion, SpiralTrace
from piezoid.verification.rebuild import Proof

SCHEMA = "piezoid.verification/1"
_LARGEST_m, _SMALLEST_m = 1e3, 1e-15  # no stage moves further, and no picture shows less
_SLOWEST_Hz, _FASTEST_Hz = 1e-9, 1e9


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One method at one frequency; see ``Tracking`` for the numbers."""

    method: str
    frequency_Hz: float
    rms_m: float
    rms_percent: float
    max_m: float
    aligned_rms_m: float
    delay_s: float


@dataclass(frozen=True, kw_only=True)
class ErrorBound:
    """Figures of the largest error of one axis at one speed; see ``verification.bounds``.

    slew_m_per_s   of the fastest reference, or of the surface under a tip
    bound_m        of the certificate, of a tip of its linear loop, each with three standard
                   deviations of noise; None: there is none within the range
    probable_m     that half a second's largest error stays below with this probability, on stages
                   like those that recordings allow
    worst_found_m  by a search over references, pasts and stages
    simulated_m    on the identified stage, median of the same references
    runs           from which probable_m was taken
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
        """Whether a drawn stage exceeds the bound, so that its conditions do not hold.

        A certificate takes what no model of the class explains for no more than it left of rows
        left out; stages are drawn that are farther from the class.
        """
        return self.bound_m is not None and self.worst_found_m > self.bound_m


@dataclass(frozen=True, kw_only=True)
class SpiralRow:
    """Errors across the turns of a spiral, by method and frequency."""

    method: str
    frequency_Hz: float
    radial_rms_m: float
    pitch_error: float | None


@dataclass(frozen=True, kw_only=True)
class CurrentRow:
    """The tunnelling loop during a scenario of the exported controller.

    ln_current_std     of ln i
    height_rms_m       the same as a distance
    largest_ratio      of the current to its set point
    retracted_samples  with the tip retracted
    """

    scenario: str
    ln_current_std: float
    height_rms_m: float
    largest_ratio: float
    retracted_samples: int


@dataclass(frozen=True, kw_only=True)
class CouplingRow:
    """Motion of one axis while another one moves to and fro, both in closed loop.

    moved           axis whose reference moves, in the displacements of the sensors
    answers         the other one
    frequency_Hz    of the motion
    percent         amplitude of the other, of that of the motion
    without_percent  the same without the matrix in front; None: the loops do not settle
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
    methods          what ships, by axis
    radius_m         of every path; percents are of twice that; 0 without a lateral axis
    comparison       by frequency and method
    spirals, currents   further numbers
    traces           a few spirals place by place, for pictures
    motions          rasters and steps in time, likewise; not in the file if empty
    coupling         what coupled axes do to each other in closed loop; not in the file if empty
    bounds           of the largest errors, on request; not in the file if empty
    verdicts         all of them
    proofs           builds that gave the same bits; empty if none was asked for
    limit_proofs     what abstract interpretation says of every input; not in the file if empty
    plants           label and axis of every plant that was run
    parameters_digest, runtime_digest   of params.json, and of the runtime's source
    lab_digest       of the lab.toml whose converters and limits were taken; empty without one
    """

    name: str
    methods: dict[str, str]
    radius_m: float
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
        """Whether every verdict passed, every build gave the same bits and every proof holds.

        A proof for which this machine has no compiler, emulator or analyser is no failure.
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


def _fields(verification: Verification) -> dict[str, Any]:
    """Return the entries of the file; what came later only where there is any."""
    later = ("limit_proofs", "motions", "coupling", "bounds")
    return {k: v for k, v in fields_of(verification).items() if v or k not in later}


LAYOUTS = (
    RecordLayout(kind=Verification, write=_fields),
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
        methods = [row.method for row in verification.comparison]
        methods += [row.method for row in verification.spirals]
        methods += [row.method for row in verification.traces]
        for method in (*verification.methods.values(), *methods):
            METHODS.index(method)  # the report has a word for each of these and no other
        spirals = {(row.method, row.frequency_Hz) for row in verification.spirals}
        for row in verification.comparison:
            if (row.method, row.frequency_Hz) not in spirals:
                raise ValueError(f"no spiral of {row.method} at {row.frequency_Hz} Hz")
        _check_pictures(verification)
    return verification


def _check_pictures(verification: Verification) -> None:
    """Raise ``ValueError`` for numbers that no stage has and no picture can show."""
    frequencies_Hz = [row.frequency_Hz for row in verification.comparison]
    for frequency_Hz in (*frequencies_Hz, *(trace.frequency_Hz for trace in verification.traces)):
        if not _SLOWEST_Hz <= frequency_Hz <= _FASTEST_Hz:
            raise ValueError(f"frequency_Hz is {frequency_Hz}")
    sizes_m = [abs(row.aligned_rms_m) for row in verification.comparison]
    for trace in verification.traces:
        if not len(trace.x_m) == len(trace.y_m) == len(trace.shape_error_m) > 0:
            raise ValueError(f"{len(trace.x_m)} places of a spiral and other numbers of the rest")
        sizes_m += map(abs, (*trace.x_m, *trace.y_m, *trace.shape_error_m))
    for motion in verification.motions:
        if motion.axis not in verification.methods:
            raise ValueError(f"axis {motion.axis} moved and does not ship")
        sizes_m += map(abs, _positions_m(motion))
    if verification.traces and not verification.radius_m >= _SMALLEST_m:
        raise ValueError(f"radius_m is {verification.radius_m}")
    largest_m = max([verification.radius_m, *sizes_m])
    if largest_m > _LARGEST_m:
        raise ValueError(f"a path reaches {largest_m} m")
    if max((abs(verdict.limit) for verdict in verification.verdicts), default=0.0) > _FASTEST_Hz:
        raise ValueError("a limit is larger than anything that is judged")


def _positions_m(motion: Motion) -> tuple[float, ...]:
    """Return all positions of a motion; ``ValueError`` if they are not of one run."""
    count, n_uncompensated = len(motion.reference_m), len(motion.uncompensated_m)
    if not 1.0 / _FASTEST_Hz <= motion.duration_s <= 1.0 / _SLOWEST_Hz:
        raise ValueError(f"duration_s is {motion.duration_s}")
    if not (len(motion.shipped_m) == count > 1 and n_uncompensated in (0, count)):
        raise ValueError(f"{count} places of a reference and other numbers of the rest")
    return (*motion.reference_m, *motion.shipped_m, *motion.uncompensated_m)
