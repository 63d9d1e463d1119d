"""Design X and Y: a disturbance observer in both forms, the best of several tunings."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.certificate import Certificate, Disturbances, Operation, certify
from piezoid.design.damping import describe_obstacle, must_damp
from piezoid.design.design import (
    AxisDesign,
    Candidate,
    LoopDesign,
    family_margins,
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

_NO_DISTURBANCES = Disturbances()
_SLEW_SHARE = 0.5  # of the amplifier's slew rate, for references: feedback needs the rest
_LOOP_OF_FORM = {"inverse": "mpi_dob", "affine": "dob"}
_FIGURE = "predicted tracking error with noise, rms, worst member"


def design_lateral(
    axis: str,
    families: Mapping[str, PlantFamily],
    specification: Specification,
    *,
    model: Plant | None = None,
    bounds: Mapping[str, HysteresisBounds] | None = None,
    disturbances: Disturbances = _NO_DISTURBANCES,
) -> AxisDesign:
    """Design the disturbance observer of one lateral axis, in every requested form.

    families  by form, ``inverse`` and/or ``affine``: in the affine form the slope sector of the
              hysteresis is in the loop, so its family has more gain variation; see
              ``with_sector``
    model     design model of the observer; by default the nominal member, with part of its delay
              as a pole if the runtime has too few states (``Plant.with_delay_pole``)
    bounds    by form, for the certificate; a form without bounds has no certificate
    disturbances  from the recordings, for the certificate

    Raises ``TemplateError`` if the first form (the inverse form, if requested) cannot meet the
    specification. Another form is then designed at its nearest feasible bandwidth, for comparison,
    or omitted if no bandwidth is feasible.
    """
    loops: list[LoopDesign] = []
    for form in (form for form in _LOOP_OF_FORM if form in families):
        designer = _LoopDesigner(
            axis=axis,
            form=form,
            family=families[form],
            model=model or _reduce_states(axis, families[form].nominal, specification),
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
    """Add the nominal plant with the gains at both ends of the hysteresis' slope sector."""
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


def _reduce_states(axis: str, plant: Plant, specification: Specification) -> Plant:
    """Return the plant with at most as many states as the runtime has besides its oscillators."""
    max_states = MAX_ORDER - 2 * len(specification.oscillation_Hz)
    excess = len(plant.realised()[0]) - max_states
    if excess <= 0:
        return plant
    if excess < plant.delay_samples:
        return plant.with_delay_pole(excess + 1)
    raise DesignError(
        f"axis {axis}: at {plant.sampling_rate_Hz:g} Hz the plant has {max_states + excess} "
        f"states, of which {plant.delay_samples} are delay",
        needed=f"at most {max_states} states, a delay counted as one",
        remedy="Design with fewer resonant_harmonics, or fit fewer modes.",
    )


@dataclass(frozen=True, kw_only=True)
class _Tuning:
    """One tuning of the observer, and its violations of the specification, worst first."""

    observer: TunedObserver
    controller: RstController
    violations: tuple[Violation, ...]

    @property
    def error(self) -> float:
        """Predicted tracking error, rms, worst member."""
        return self.observer.figures.predicted_error


@dataclass(frozen=True, kw_only=True)
class _LoopDesigner:
    """Design of the loop of one axis in one form, for any specification."""

    axis: str
    form: str
    family: PlantFamily
    model: Plant
    bounds: HysteresisBounds | None
    disturbances: Disturbances

    def design(self, specification: Specification) -> LoopDesign:
        tunings = [self._tune(specification, m) for m in self._methods(specification)]
        feasible = [tuning for tuning in tunings if not tuning.violations]
        if not feasible:
            refuse(
                self.axis,
                specification,
                min((tuning.violations for tuning in tunings), key=severity),
                self._smallest_violations,
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
            margins=family_margins(members, R, S),
            rejections=rejections(members, R, S, specification.bandwidth_Hz),
            certificate=self._certificate(best.controller, path, specification),
            candidates=tuple(
                Candidate(
                    name=tuning.observer.method,
                    is_chosen=tuning is best,
                    is_feasible=not tuning.violations,
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
        is_damped = must_damp(self.family.nominal, specification.bandwidth_Hz)
        return (*METHODS, DAMPED) if is_damped else METHODS

    def _tune(
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
        violations = unmet(self.family.members, controller.R, controller.S, specification)
        return _Tuning(observer=observer, controller=controller, violations=violations)

    def _smallest_violations(self, specification: Specification) -> tuple[Violation, ...]:
        """Return the violations by the best tuning; empty as soon as a tuning has none."""
        violations = []
        for method in reversed(self._methods(specification)):
            violations.append(self._tune(specification, method, until_met=True).violations)
            if not violations[-1]:
                break
        return min(violations, key=severity)

    def _certificate(
        self, controller: RstController, path: ReferencePath, specification: Specification
    ) -> Certificate | None:
        """Certify the loop for references up to the speed of a full-range sine at the scan
        frequency, and up to a share of the amplifier's slew rate.
        """
        if self.bounds is None:
            return None
        gain = abs(self.family.nominal.gain)
        half_V = 0.5 * (specification.voltage_max_V - specification.voltage_min_V)
        amplitude_m = min(half_V, self.bounds.reach_V) * gain
        slew_m_per_s = 2.0 * np.pi * specification.scan_frequency_Hz * amplitude_m
        if specification.voltage_slew_V_per_s is not None:
            amplifier_m_per_s = specification.voltage_slew_V_per_s * gain
            slew_m_per_s = min(slew_m_per_s, _SLEW_SHARE * amplifier_m_per_s)
        return certify(
            self.family.members,
            *(controller.R, controller.S, controller.T),
            path=path,
            bounds=self.bounds,
            operation=Operation(
                reference_slew_m_per_s=float(slew_m_per_s),
                voltage_step_V=specification.voltage_step_V,
                sensor_noise_rms_m=specification.sensor_noise_rms,
                disturbances=self.disturbances,
            ),
        )
