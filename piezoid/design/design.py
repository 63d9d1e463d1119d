"""The record of a design, and its file ``design.json``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from piezoid.design.certificate import Certificate
from piezoid.design.decoupling import Decoupling
from piezoid.design.feedforward import ReferencePath, fit_reference_path
from piezoid.design.loop_search import Solution
from piezoid.design.observer import DisturbanceObserver
from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import Margins, closed_loop_polynomial, margins, sensitivities
from piezoid.design.specification import Specification
from piezoid.digests import seal
from piezoid.errors import DesignError
from piezoid.formatting import significant, with_unit
from piezoid.identification.loop_model import control
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.polynomial import product
from piezoid.record_json import RecordLayout, fields_of, read_sealed, to_json
from piezoid.summary import Summarised, Summary

if TYPE_CHECKING:
    from scipy.signal import TransferFunction

SCHEMA = "piezoid.design/1"
METHODS = ("dob", "mpi_dob", "rst")
_REPORTED_Hz = (1.0, 10.0, 100.0)


@dataclass(frozen=True, kw_only=True)
class Rejection:
    """Magnitude of the output sensitivity |Syp| at one frequency.

    nominal, worst   of the nominal plant and over the family; 1 without feedback
    worst_member     label of the member with the largest magnitude
    """

    frequency_Hz: float
    nominal: float
    worst: float
    worst_member: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """One candidate controller of a loop; all are reported, one is chosen.

    name         ``placed``, ``kalman``, ``band-stop`` or ``convex``
    is_chosen    true for one candidate of a loop
    is_feasible  every member meets every limit on a fine grid
    figure       cost that the choice minimises; ``figure_name`` describes it
    parameters   result of the search, by name
    R, S         coefficients in q^-1
    """

    name: str
    is_chosen: bool
    is_feasible: bool
    figure: float
    figure_name: str
    parameters: dict[str, float]
    R: Array
    S: Array

    def __post_init__(self) -> None:
        freeze(self, "R", "S")


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopDesign:
    """One loop of one axis, ready to be exported.

    method       ``dob``, ``mpi_dob`` or ``rst``
    observer     gains of a disturbance observer; None for ``rst``
    bandwidth_Hz the requested bandwidth, or less for a loop that is not recommended
    R, S, T      the same loop as S u = T r' - R y, from which every margin was computed
    A_0          anti-windup polynomial, monic and stable
    reference    filter and preview that make r' from r
    margins      of each member of the family, in its order
    rejections   at 1, 10, 100 Hz and at the bandwidth
    certificate  None without bounds of the hysteresis
    candidates   all controllers that were designed for this loop
    members      the family this loop was designed for, nominal first
    """

    method: str
    observer: DisturbanceObserver | None
    bandwidth_Hz: float
    R: Array
    S: Array
    T: Array
    A_0: Array
    reference: ReferencePath
    margins: tuple[Margins, ...]
    rejections: tuple[Rejection, ...]
    certificate: Certificate | None
    candidates: tuple[Candidate, ...]
    members: tuple[Fraction, ...]

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method is {self.method!r}, expected one of {METHODS}")
        if not self.members or len(self.margins) != len(self.members):
            raise ValueError(
                f"{len(self.margins)} margins of {len(self.members)} members, expected one of each"
            )
        freeze(self, "R", "S", "T", "A_0")

    @property
    def worst_modulus_margin(self) -> float:
        """The smallest of the family."""
        return min(m.modulus_margin for m in self.margins)

    @property
    def worst_delay_margin_s(self) -> float | None:
        """Smallest delay margin of the family; None if no delay destabilises any member."""
        margins_s = [m.delay_margin_s for m in self.margins if m.delay_margin_s is not None]
        return min(margins_s) if margins_s else None

    def to_scipy(self, part: str = "controller") -> "TransferFunction":
        """Return a part of the nominal loop S u = T r' - R y as ``scipy.signal.TransferFunction``.

        part  ``controller`` R / S, ``prefilter`` T / R, ``plant`` B / A, ``sensitivity``
              A S / P, or ``closed_loop`` T B / P from r' to the reading; P = A S + B R

        >>> type(design.axis("x").recommended.to_scipy("closed_loop")).__name__
        'TransferFunctionDiscrete'
        """
        from scipy.signal import TransferFunction

        numerator, denominator = _fraction_of(self, part)
        leading_zeros = int(np.flatnonzero(numerator)[0])  # scipy warns of them
        interval_s = 1.0 / self.members[0].sampling_rate_Hz
        return TransferFunction(numerator[leading_zeros:], denominator, dt=interval_s)

    def to_control(self, part: str = "controller") -> Any:
        """Return the same part for python-control, ``control.TransferFunction``.

        >>> design.axis("x").recommended.to_control("sensitivity").isdtime()
        True
        """
        numerator, denominator = _fraction_of(self, part)
        return control().tf(numerator, denominator, 1.0 / self.members[0].sampling_rate_Hz)


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisDesign:
    """All loops of one axis; the first is recommended.

    axis           ``x``, ``y``, ``z``
    output_unit    ``m``, or ``1`` for the logarithm of a current
    specification  requirements that the loops were designed for
    loops          at least one
    """

    axis: str
    output_unit: str
    specification: Specification
    loops: tuple[LoopDesign, ...]

    def __post_init__(self) -> None:
        if not self.loops:
            raise ValueError(f"axis {self.axis} has no loop")

    @property
    def sampling_rate_Hz(self) -> float:
        """Samples per second of the controller."""
        return self.loops[0].members[0].sampling_rate_Hz

    @property
    def recommended(self) -> LoopDesign:
        """The loop that is exported by default."""
        return self.loops[0]

    def loop(self, method: str) -> LoopDesign:
        """Return the loop of a method; raises ``KeyError`` if there is none.

        >>> design.axis("x").loop("dob").method
        'dob'
        """
        for loop in self.loops:
            if loop.method == method:
                return loop
        raise KeyError(f"axis {self.axis} has no loop {method!r}")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Design(Summarised):
    """Controllers of a stage, with the plants and the specification that they were designed for.

    axes           one per axis
    model_digest   of the model the plants were taken from
    lab_digest     of lab.toml; empty without one
    rig_digest     of the declarations in lab.toml that the design used, ``Lab.rig_digest``
    remarks        remaining coupling, axes without a design and unused declarations, as sentences
    refused        by axis, why no controller of it meets the specification
    decoupling     of the axes whose drives act on all of their displacements; None: no such axes
    """

    axes: tuple[AxisDesign, ...]
    model_digest: str
    lab_digest: str = ""
    rig_digest: str = ""
    remarks: tuple[str, ...] = ()
    refused: dict[str, str] = field(default_factory=dict)
    decoupling: Decoupling | None = None

    def summary(self) -> Summary:
        """Return a table with one row per loop: bandwidth, worst margins and guaranteed error.

        >>> print(design.summary())
        Design ...
        axis  loop ...
        """
        rows = []
        for axis, loop in [(design, loop) for design in self.axes for loop in design.loops]:
            certificate, delay_s = loop.certificate, loop.worst_delay_margin_s
            error = "none"
            if certificate is not None and certificate.is_guaranteed:
                error = with_unit(certificate.guaranteed_error_m, "m")
            rows.append(
                (
                    axis.axis,
                    f"{loop.method} (recommended)" if loop is axis.recommended else loop.method,
                    with_unit(loop.bandwidth_Hz, "Hz"),
                    significant(loop.worst_modulus_margin, 2),
                    "unlimited" if delay_s is None else with_unit(delay_s, "s", 2),
                    error,
                )
            )
        margins = ("modulus margin", "delay margin", "guaranteed error")
        return Summary(
            title=f"Design for {len(self.axes)} axes",
            headings=("axis", "loop", "bandwidth", *margins),
            rows=rows,
            notes=tuple(
                f"axis {axis}: no controller: {text}" for axis, text in self.refused.items()
            ),
        )

    def to_json(self) -> bytes:
        """Return the sealed file ``design.json``.

        >>> design.to_json()[:1]
        b'{'
        """
        return seal(SCHEMA, to_json(self, LAYOUTS))

    def axis(self, name: str) -> AxisDesign:
        """Return one axis; ``KeyError`` if it was not designed.

        >>> design.axis("x").recommended.worst_modulus_margin >= 0.5
        True
        """
        for axis in self.axes:
            if axis.axis == name:
                return axis
        raise KeyError(f"no axis {name!r} in this design")


LAYOUTS = (
    RecordLayout(
        kind=Design,
        write=lambda design: {
            name: value
            for name, value in fields_of(design).items()
            if name != "decoupling" or value is not None
        },
    ),
)


def design_from_json(content: bytes, source: str = "design.json") -> Design:
    """Read ``design.json`` back, exactly; a changed bit or another schema is refused."""
    remedy = "Design the controllers again with this version."
    return read_sealed(Design, content, SCHEMA, source, remedy=remedy)


def assemble_loop(
    method: str,
    members: tuple[Fraction, ...],
    bandwidth_Hz: float,
    solutions: Sequence[Solution],
    figure_name: str,
) -> LoopDesign:
    """Return the best feasible solution with reference path, margins and rejections.

    The rejections are |Syp| at 1, 10, 100 Hz and at the bandwidth, nominal and worst.

    solutions    at least one meets the specification
    figure_name  describes the figure by which they are compared
    """
    best = min((s for s in solutions if not s.violations), key=lambda solution: solution.figure)
    controller = best.controller
    R, S = controller.R, controller.S
    frequency_Hz = (*_REPORTED_Hz, bandwidth_Hz)
    grid = np.array(frequency_Hz)
    magnitude = np.stack([np.abs(sensitivities(m, R, S, grid).Syp) for m in members])
    worst = magnitude.argmax(axis=0)
    rejections = tuple(
        Rejection(
            frequency_Hz=f,
            nominal=float(magnitude[0, k]),
            worst=float(magnitude[worst[k], k]),
            worst_member=members[int(worst[k])].label,
        )
        for k, f in enumerate(frequency_Hz)
    )
    return LoopDesign(
        method=method,
        observer=best.observer,
        bandwidth_Hz=bandwidth_Hz,
        R=R,
        S=S,
        T=controller.T,
        A_0=np.ones(1),
        reference=fit_reference_path(members, R, S, controller.T, band_Hz=bandwidth_Hz),
        margins=tuple(margins(member, R, S) for member in members),
        rejections=rejections,
        certificate=None,
        candidates=tuple(
            Candidate(
                name=solution.name,
                is_chosen=solution is best,
                is_feasible=not solution.violations,
                figure=solution.figure,
                figure_name=figure_name,
                parameters=solution.parameters,
                R=solution.controller.R,
                S=solution.controller.S,
            )
            for solution in solutions
        ),
        members=members,
    )


def _fraction_of(loop: LoopDesign, part: str) -> tuple[Array, Array]:
    """Return numerator and denominator of a part of the nominal loop, in z, highest power first.

        S u = T r' - R y,   A y = B u,   P = A S + B R          [Landau & Zito 2006]

    Raises ``DesignError`` for an unknown part.
    """
    R, S, T, B, A = loop.R, loop.S, loop.T, loop.members[0].B, loop.members[0].A
    P = closed_loop_polynomial(loop.members[0], R, S)
    parts = {
        "controller": (R, S),
        "prefilter": (T, R),
        "plant": (B, A),
        "sensitivity": (product(A, S), P),
        "closed_loop": (product(T, B), P),
    }
    if part not in parts:
        raise DesignError(
            f"{part!r} is not a part of a loop",
            needed=f"one of {', '.join(parts)}",
            remedy="Name one of these parts.",
        )
    # Polynomials of equal length in q^-1 have the same coefficients in z.
    length = max(map(len, parts[part]))
    numerator, denominator = (np.pad(p, (0, length - len(p))) for p in parts[part])
    return numerator, denominator
