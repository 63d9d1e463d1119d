"""ActuatorModel: the identified model of a whole stage, axis by axis."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import IdentificationError
from piezoid.formatting import count_of, significant, with_unit, words
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.fit_statements import GOOD_SCORE, grade_of
from piezoid.identification.loop_model import to_control, to_scipy
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import Comparison, compare, predict
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.raw_counts import in_counts
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid.summary import Summarised, Summary

if TYPE_CHECKING:
    from pandas import DataFrame
    from scipy.signal import StateSpace

MAX_NAMES = 5  # of missing recordings that a sentence lists

# Units at the end of names, longest first: ``m_per_V`` is not ``V``.
_ENDINGS = (
    ("_m_per_V", "m/V"), ("_V_per_s", "V/s"), ("_m_per_s", "m/s"), ("_per_V", "1/V"),
    ("_Hz", "Hz"), ("_V", "V"), ("_m", "m"), ("_s", "s"), ("_K", "K"),
)  # fmt: skip


SourceFile = Recording | RawTable | FrequencyResponseRecord


class DiagnosedAxis(Protocol):
    """Fields of a diagnosis from which a stage is extended."""

    @property
    def axis(self) -> str:
        """Name of the diagnosed axis."""

    @property
    def model(self) -> AxisModel | None:
        """The refitted axis with all detected effects; None without a model."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ActuatorModel(Summarised):
    """Model of a stage: one axis model per axis, and the tunnelling junction if there is one.

    stage       name of the stage
    axes        models by axis; empty if only the tunnelling current was recorded
    sources     digest of every recording by name
    lab         digest of lab.toml, or None
    tunnelling  model of the junction if its current was recorded
    remarks     problems of the recordings
    controller_rate_Hz  declared sampling rate of the controller; None: unknown
    coupled     model of axes whose drives act on all of their displacements; ``axes`` then are
                the decoupled axes. None: each drive acts on one displacement
    """

    stage: str
    axes: Mapping[str, AxisModel]
    sources: Mapping[str, str]
    lab: str | None = None
    tunnelling: TunnellingModel | None = None
    remarks: tuple[str, ...] = ()
    controller_rate_Hz: float | None = None
    coupled: CoupledStage | None = None

    def __post_init__(self) -> None:
        for name, axis in self.axes.items():
            if axis.axis != name:
                raise ValueError(f"axes: axis {axis.axis!r} is stored under {name!r}")

    def __getitem__(self, axis: str) -> AxisModel:
        """Return one axis, or raise an error that lists the fitted axes."""
        if axis not in self.axes:
            raise IdentificationError(
                f"{self.stage}: no axis {axis!r} in the model, only {', '.join(self.axes)}",
                needed="an axis that was fitted",
                remedy="Fit a recording of that axis, or name another axis.",
            )
        return self.axes[axis]

    def missing_recordings(self, files: Iterable[SourceFile], *, axis: str = "") -> str:
        """Return a sentence that names recordings of the fit outside ``files``, or empty.

        files  available recordings, compared by name and digest
        axis   ignore recordings that only other axes were fitted to; empty: ignore none

        >>> model.missing_recordings(recordings)
        ''
        """
        fitted = {name: {start.recording for start in a.starts} for name, a in self.axes.items()}
        irrelevant = set[str]()
        if axis:
            irrelevant = set().union(*fitted.values()) - fitted[axis]
        digests = {name: d for name, d in self.sources.items() if name not in irrelevant}
        available = {(file.name, file.digest) for file in files}
        missing = [name for name, digest in digests.items() if (name, digest) not in available]
        if not missing:
            return ""
        further = len(missing) - MAX_NAMES
        names = ", ".join(missing[:MAX_NAMES]) + (f" and {further} more" if further > 0 else "")
        verb = "is" if len(missing) == 1 else "are"
        share = f"{len(missing)} of {count_of(len(digests), 'recording')}"
        return f"{share} of the fit {verb} missing: {names}."

    def summary(self) -> Summary:
        """Return a table with one row per axis: error, noise, drive range, order and grade.

        >>> print(model.summary())
        Stage ...
        axis  held-out error ...
        """
        rows, notes = [], []
        for axis in self.axes.values():
            quality, grade = axis.quality, grade_of(axis).value
            modes_Hz = () if axis.dynamics is None else axis.dynamics.mode_frequency_Hz
            low_V, high_V = axis.voltage_V
            row = (
                axis.axis,
                f"{with_unit(quality.held_out_rms_m, 'm')} rms, "
                f"{quality.held_out_rms_percent:.2f} %",
                f"{quality.noise_bound}{with_unit(quality.noise_rms_m, 'm')} rms",
                f"{significant(low_V)} to {significant(high_V)} V",
                axis.order,
                ", ".join(with_unit(mode_Hz, "Hz") for mode_Hz in modes_Hz) or "none identified",
                grade,
            )
            rows.append(row)
            reasons = [limit.reason for limit in quality.limits if limit.most < GOOD_SCORE]
            if not axis.verdict.applies:
                reason = axis.verdict.reason
                notes.append(f"axis {axis.axis}: the model class does not apply: {reason}")
            elif reasons:
                notes.append(f"axis {axis.axis}: {grade}, because {'; '.join(reasons)}")
            if axis.extensions:
                kinds = ", ".join(words(extension.kind) for extension in axis.extensions)
                notes.append(f"axis {axis.axis}: extended by {kinds}")
        return Summary(
            title=f"Stage {self.stage}",
            headings=("axis", "held-out error", "noise", "drive", "hysteresis", "modes", "grade"),
            rows=rows,
            notes=tuple(notes),
            counted=self.counted,
        )

    @property
    def counted(self) -> tuple[str, ...]:
        """Quantities that were recorded in counts: ``displacement`` and ``voltage``."""
        return tuple(
            sorted({quantity for axis in self.axes.values() for quantity in axis.counted})
        )

    @property
    def applies(self) -> bool:
        """Whether the model class applies to every axis."""
        return all(axis.verdict.applies for axis in self.axes.values())

    def one(self, axis: str | None = None) -> AxisModel:
        """Return the named axis, or the only axis; without a name, several axes are an error.

        >>> model.one().axis
        'x'
        """
        if axis is None and len(self.axes) != 1:
            raise IdentificationError(
                f"{self.stage}: no axis named; the model has {', '.join(self.axes) or 'none'}",
                needed="the name of one axis",
                remedy="Pass it, as in axis='x', or select it by model['x'].",
            )
        return self[next(iter(self.axes)) if axis is None else axis]

    def with_axis(self, axis: AxisModel) -> "ActuatorModel":
        """Return the stage with one axis replaced, or added.

        >>> list(model.with_axis(model["x"]).axes)
        ['x']
        """
        return replace(self, axes={**self.axes, axis.axis: axis})

    def decoupled(self, recording: Recording) -> Recording:
        """Return a recording decoupled into single axes; unchanged if no axes are coupled.

        >>> model.decoupled(recordings["check.csv"]) is recordings["check.csv"]
        True
        """
        if self.coupled is None:
            return recording
        from piezoid.identification.coupled.from_recordings import decoupled

        return decoupled([recording], self.coupled)[0]

    def extended(self, *diagnoses: DiagnosedAxis) -> "ActuatorModel":
        """Return the stage with the effects that diagnoses of its axes detected.

        Raises ``IdentificationError`` for a diagnosis without a model: one that was made without
        a model, or read from a file.

        >>> model.extended(diagnosis)["x"].extensions == diagnosis.model.extensions
        True
        """
        stage = self
        for diagnosis in diagnoses:
            if diagnosis.model is None:
                raise IdentificationError(
                    f"{self.stage}: the diagnosis of axis {diagnosis.axis} contains no model",
                    needed="a diagnosis made with model=, and not read from a file",
                    remedy="Diagnose the recordings again with the model.",
                )
            stage = stage.with_axis(diagnosis.model)
        return stage

    def simulate(
        self,
        voltage_V: ArrayLike,
        sampling_rate_Hz: float,
        memory_V: Array | None = None,
        *,
        zero_m: float | None = None,
        axis: str | None = None,
    ) -> Array:
        """Simulate the displacement of an axis for a drive, as ``AxisModel.simulate``.

        >>> drive_V = 5.0 + 2.0 * np.sin(np.linspace(0.0, 20.0, 1000))
        >>> model.simulate(drive_V, 1000.0, axis="x").shape
        (1000,)
        """
        return self.one(axis).simulate(voltage_V, sampling_rate_Hz, memory_V, zero_m=zero_m)

    def predict(self, recording: Recording, *, axis: str | None = None) -> Array:
        """Predict the displacement of an axis for a recording; default: the axis of the recording.

        >>> model.predict(recordings["check.csv"]).shape
        (2500,)
        """
        return predict(self[axis or recording.axis], recording)

    def compare(self, recording: Recording, *, axis: str | None = None) -> Comparison:
        """Compare a recording with ``predict``.

        >>> model.compare(recordings["check.csv"]).rms_percent < 1.0
        True
        """
        return compare(self[axis or recording.axis], recording)

    def inverse(
        self,
        displacement_m: ArrayLike,
        memory_V: Array | None = None,
        *,
        zero_m: float | None = None,
        axis: str | None = None,
    ) -> Array:
        """Return the voltage of an axis for a displacement, as ``AxisModel.inverse``.

        >>> reference_m = model["x"].zero_m + np.linspace(0.0, 1e-6, 1000)
        >>> model.inverse(reference_m).shape
        (1000,)
        """
        return self.one(axis).inverse(displacement_m, memory_V, zero_m=zero_m)

    def parameters(self) -> "DataFrame":
        """Return every number of the model with unit and 95 % interval, by axis and name.

        The columns are ``value``, ``unit``, ``low`` and ``high``; unknown intervals are NaN.

        >>> list(model.parameters())
        ['value', 'unit', 'low', 'high']
        """
        from pandas import concat

        return concat(
            {name: parameters_of(axis) for name, axis in self.axes.items()}, names=["axis", "name"]
        )

    def to_scipy(
        self, sampling_rate_Hz: float | None = None, *, axis: str | None = None
    ) -> "StateSpace":
        """Return the linear part of an axis, V to m, as ``scipy.signal.StateSpace``.

        sampling_rate_Hz  of a discrete system behind a zero-order hold, with the delay as states;
                          None: continuous time

        The hysteresis is replaced by the middle of its slope sector. Raises
        ``IdentificationError`` for a system with delay in continuous time.

        >>> model.to_scipy(20e3).dt
        5e-05
        """
        return to_scipy(self.one(axis), sampling_rate_Hz)

    def to_control(self, sampling_rate_Hz: float | None = None, *, axis: str | None = None) -> Any:
        """Return the system of ``to_scipy`` as ``control.StateSpace`` of python-control.

        >>> model.to_control(20e3).isdtime()
        True
        """
        return to_control(self.one(axis), sampling_rate_Hz)


def parameters_of(axis: AxisModel) -> "DataFrame":
    """Return a table of all parameters by name: ``value``, ``unit``, ``low``, ``high``.

    Intervals of the hysteresis come from leaving out blocks of cycles; a weight of 0 has a
    one-sided limit. Intervals of dynamics and extensions are normal, from their standard errors.
    """
    from pandas import DataFrame

    uncertainty, dynamics = axis.uncertainty, axis.dynamics
    half = NORMAL_95 * np.sqrt(np.diag(uncertainty.covariance))
    rows: list[tuple[str, float, float, float]] = []  # name, value, low, high
    for name, value, spread in zip(uncertainty.names, uncertainty.values, half, strict=True):
        limit = uncertainty.upper_limit.get(name)
        low, high = (value - spread, value + spread) if limit is None else (value, limit)
        rows.append((name, float(value), float(low), float(high)))
    if dynamics is not None:
        of_modes = (dynamics.mode_frequency_Hz, dynamics.mode_frequency_interval_Hz())
        for name, (values, intervals) in {
            "mode_frequency_Hz": of_modes,
            "mode_damping": (dynamics.mode_damping, dynamics.mode_damping_interval()),
            "lag_frequency_Hz": (dynamics.lag_frequency_Hz, dynamics.lag_frequency_interval_Hz()),
        }.items():
            for k, (value, (low, high)) in enumerate(zip(values, intervals, strict=True)):
                rows.append((f"{name}[{k}]", float(value), float(low), float(high)))
        low_s, high_s = dynamics.delay_interval_s().tolist()
        rows.append(("delay_s", dynamics.delay_s, low_s, high_s))
    for extension in axis.extensions:
        # The ends of an interval are the fields of the extension at the ends of its free numbers.
        free, half = extension.free(), NORMAL_95 * np.array(extension.std)
        stated = _numbers(extension)
        limits = [dict.fromkeys(stated, np.nan)] * 2
        if len(half) == len(free.value) > 0:
            bounds = [np.clip(free.value + step, free.lower, free.upper) for step in (-half, half)]
            limits = [_numbers(extension.moved_to(value)) for value in bounds]
        for name, value in stated.items():
            low, high = sorted((limits[0][name], limits[1][name]))
            if not low < high:  # not a free number
                low = high = np.nan
            rows.append((f"{extension.kind}.{name}", value, low, high))
    names, numbers, lows, highs = zip(*rows, strict=True)
    units = []
    for name in names:  # the unit is at the end of the name
        stem = name.partition("[")[0]
        unit = next((unit for ending, unit in _ENDINGS if stem.endswith(ending)), "1")
        units.append(in_counts(unit, axis.counted))
    table = {"value": numbers, "unit": units, "low": lows, "high": highs}
    return DataFrame(table, index=list(names))


def _numbers(extension: Extension) -> dict[str, float]:
    """Return the numbers of an extension by name, without those of single recordings."""
    numbers: dict[str, float] = {}
    for entry in fields(extension):
        value = getattr(extension, entry.name)
        if entry.name == "std":
            continue
        if isinstance(value, float):
            numbers[entry.name] = value
        elif isinstance(value, tuple) and all(isinstance(number, float) for number in value):
            numbers |= {f"{entry.name}[{k}]": number for k, number in enumerate(value)}
    return numbers
