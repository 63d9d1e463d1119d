"""Design X and Y: a disturbance observer in both forms, chosen among its tunings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.certificate import Certificate, Disturbances, Operation, certify
from piezoid.design.damping import describe_obstacle, must_damp
from piezoid.design.design import (
    AxisDesign,
    Candidate,
    LoopDesign,
    REPORTED_Hz,
    reached_margins,
    rejections,
)
from piezoid.design.feasibility import (
    at_feasible_bandwidth,
    refuse,
    severity,
    unmet,
)
from piezoid.design.feedforward import ReferencePath, fit_reference_path
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.observer import linear_controller
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.rst import RstController
from piezoid.design.specification import Specification
from piezoid.design.templates import Violation
from piezoid.design.tuning import DAMPED, METHODS, TunedObserver, tune_observer
from piezoid.errors import DesignError, TemplateError
from piezoid.runtime.schema import MAX_ORDER

NO_DISTURBANCES = Disturbances()
SLEW_SHARE = 0.5  # of what the amplifier follows: the rest is the feedback's
_LOOP_OF_FORM = {"inverse": "mpi_dob", "affine": "dob"}
_FIGURE = "predicted tracking error with noise, rms, worst member"


def design_lateral(
    axis: str,
    families: Mapping[str, PlantFamily],
    specification: Specification,
    *,
    model: Plant | None = None,
    bounds: Mapping[str, HysteresisBounds] | None = None,
    disturbances: Disturbances = NO_DISTURBANCES,
) -> AxisDesign:
    """Design the disturbance observer of one lateral axis, in every requested form.

    families  by form, ``inverse`` and/or ``affine``: the affine form leaves the slope sector of
              the hysteresis in the loop, so its family has more gain variation; see
              ``with_sector``
    model     what the observer computes with; by default a nominal member, a delay for which the
              runtime has no states as a pole (``Plant.with_late_pole``)
    bounds    by form, for the certificate; a form without has none
    disturbances  what recordings showed beside drive and noise, for the certificate

    Raises ``TemplateError`` where the first form (the inverse one, if asked for) cannot meet the
    specification. A further form that cannot is designed at its nearest feasible bandwidth, for
    comparison, and left out where there is none.
    """
    loops: list[LoopDesign] = []
    for form in (form for form in _LOOP_OF_FORM if form in families):
        designer = _LoopDesigner(
            axis=axis,
            form=form,
            family=families[form],
            model=model or _with_room(axis, families[form].nominal, specification),
            bounds=(bounds or {}).get(form),
            disturbances=disturbances,
        )
        if not loops:
            loops.append(designer.design(specification))
            continue
        try:
            loops.append(at_feasible_bandwidth(designer.design, specification))
        except TemplateError:
            continue
    return AxisDesign(
        axis=axis,
        output_unit=next(iter(families.values())).nominal.output_unit,
        specification=specification,
        loops=tuple(loops),
    )


def with_sector(family: PlantFamily, bounds: HysteresisBounds) -> PlantFamily:
    """Return the family with the nominal gain at both ends of the hysteresis' slope sector."""
    nominal = family.nominal
    members = [
        replace(
            nominal,
            label=f"slope x{slope:.3g}",
            input_taps=nominal.input_taps * slope,
            B=nominal.B * slope,
        )
        for slope in (bounds.slope_min, bounds.slope_max)
    ]
    return PlantFamily(members=(*family.members, *members))


def _with_room(axis: str, plant: Plant, specification: Specification) -> Plant:
    """Return the plant with no more states than the runtime holds beside its oscillators."""
    max_states = MAX_ORDER - 2 * len(specification.oscillation_Hz)
    excess = len(plant.realised()[0]) - max_states
    if excess <= 0:
        return plant
    if excess < plant.delay_samples:
        return plant.with_late_pole(excess + 1)
    raise DesignError(
        f"axis {axis}: at {plant.sampling_rate_Hz:g} Hz the plant has {max_states + excess} "
        f"states, of which {plant.delay_samples} are delay",
        needed=f"at most {max_states}, as many as the controller holds, a delay counted as one",
        remedy="Design with fewer resonant_harmonics, or fit fewer modes.",
    )


@dataclass(frozen=True, kw_only=True)
class _Tuning:
    """One tuning of the observer, and the limits that it does not meet, worst first."""

    observer: TunedObserver
    controller: RstController
    missed: tuple[Violation, ...]

    @property
    def error(self) -> float:
        """Predicted, of the worst member."""
        return self.observer.judgement.predicted_error


@dataclass(frozen=True, kw_only=True)
class _LoopDesigner:
    """Designs the loop of one axis in one form, for any specification."""

    axis: str
    form: str
    family: PlantFamily
    model: Plant
    bounds: HysteresisBounds | None
    disturbances: Disturbances

    def design(self, specification: Specification) -> LoopDesign:
        tunings = [self._tuned(specification, m) for m in self._methods(specification)]
        feasible = [tuning for tuning in tunings if not tuning.missed]
        if not feasible:
            missed = min((tuning.missed for tuning in tunings), key=severity)
            refuse(
                self.axis,
                specification,
                missed,
                self._least_missed,
                because=describe_obstacle(self.family, specification.bandwidth_Hz),
            )
        best = min(feasible, key=lambda tuning: tuning.error)
        members = self.family.fractions
        R, S, T = best.controller.R, best.controller.S, best.controller.T
        path = fit_reference_path(members, R, S, T, band_Hz=specification.bandwidth_Hz)
        return LoopDesign(
            method=_LOOP_OF_FORM[self.form],
            observer=best.observer.observer,
            bandwidth_Hz=specification.bandwidth_Hz,
            R=R,
            S=S,
            T=T,
            A_0=np.ones(1),
            reference=path,
            margins=reached_margins(members, R, S),
            rejections=rejections(members, R, S, (*REPORTED_Hz, specification.bandwidth_Hz)),
            certificate=self._certificate(best.controller, path, specification),
            candidates=tuple(
                Candidate(
                    name=tuning.observer.method,
                    is_chosen=tuning is best,
                    is_feasible=not tuning.missed,
                    figure=tuning.error,
                    figure_name=_FIGURE,
                    parameters=tuning.observer.parameters,
                    R=tuning.controller.R,
                    S=tuning.controller.S,
                )
                for tuning in tunings
            ),
            members=members,
        )

    def _methods(self, specification: Specification) -> tuple[str, ...]:
        damps = must_damp(self.family.nominal, specification.bandwidth_Hz)
        return (*METHODS, DAMPED) if damps else METHODS

    def _tuned(
        self, specification: Specification, method: str, *, until_met: bool = False
    ) -> _Tuning:
        observer = tune_observer(
            self.family,
            specification,
            model=self.model,
            form=self.form,
            method=method,
            until_met=until_met,
        )
        controller = linear_controller(observer.observer)
        missed = unmet(self.family.members, controller.R, controller.S, specification)
        return _Tuning(observer=observer, controller=controller, missed=missed)

    def _least_missed(self, specification: Specification) -> tuple[Violation, ...]:
        """Return the limits that the best tuning misses; none once a tuning meets them all."""
        violations = []
        for method in reversed(self._methods(specification)):
            violations.append(self._tuned(specification, method, until_met=True).missed)
            if not violations[-1]:
                break
        return min(violations, key=severity)

    def _certificate(
        self, controller: RstController, path: ReferencePath, specification: Specification
    ) -> Certificate | None:
        """Certify for a sine at the scan frequency that uses the drive, as far as the amplifier
        follows it.
        """
        if self.bounds is None:
            return None
        gain = abs(self.family.nominal.gain)
        half_V = 0.5 * (specification.voltage_max_V - specification.voltage_min_V)
        amplitude_m = min(half_V, self.bounds.reach_V) * gain
        fastest_m_per_s = 2.0 * np.pi * specification.scan_frequency_Hz * amplitude_m
        if specification.voltage_slew_V_per_s is not None:
            followed_m_per_s = specification.voltage_slew_V_per_s * gain
            fastest_m_per_s = min(fastest_m_per_s, SLEW_SHARE * followed_m_per_s)
        return certify(
            self.family.members,
            *(controller.R, controller.S, controller.T),
            path=path,
            bounds=self.bounds,
            operation=Operation(
                reference_slew_m_per_s=float(fastest_m_per_s),
                voltage_step_V=specification.voltage_step_V,
                sensor_noise_rms_m=specification.sensor_noise_rms,
                disturbances=self.disturbances,
            ),
        )
