"""A plant with what a diagnosis added to its model.

Limits of the amplifier stand in front of the hysteresis: saturation as flat ends of the envelope,
the slew limit as it is. Creep and modes are linear and stand behind it, a lag or delay with them.
Where the model has identified dynamics, modes, lag and delay are in those already. A changed gain
holds from its instant on, so the stage has it now.

Drift, hum, another axis' answer and a sensor's cyclic error come from outside the loop, and what
is irreversible is as quick as the rest: the plant is silent on these.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.identification.extensions.amplifier_limits import AmplifierLimits
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.delay import Delay
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.extensions.slew_limit import SlewLimit
from piezoid.identification.model import AxisModel
from piezoid.operators.dead_zone import DeadZones, from_slopes
from piezoid.operators.linear import ContinuousSystem
from piezoid.verification.loop_plant import cascade
from piezoid.verification.plant import AxisPlant, Hysteresis

LEAST_SLOPE = 1e-9  # of a saturated envelope: nearly flat, and still increasing


def extended_plant(plant: AxisPlant, model: AxisModel) -> AxisPlant:
    """Return the plant of a model with the extensions a loop can feel."""
    known = model.dynamics is not None
    behind = [system_of(e) for e in model.extensions if _acts_behind(e, known=known)]
    late_s = sum(
        e.late_s(plant.sampling_rate_Hz)
        for e in model.extensions
        if isinstance(e, Delay) and not known
    )
    gain = float(np.prod([e.ratio for e in model.extensions if isinstance(e, GainChange)]))
    found = replace(
        plant,
        response=_limited(plant, model.extensions),
        delay_s=plant.delay_s + late_s,
        slew_V_per_s=_slew_of(model.extensions),
    )
    if not behind and gain == 1.0:
        return found
    crept = float(np.prod([rest_gain(system) for system in behind]))
    return replace(
        found,
        mechanics=(),
        sensor=(),
        measured=_in_series([_whole(plant), *behind]),
        measured_gain=crept * gain,
    )


def system_of(extension: Extension) -> ContinuousSystem:
    """Return creep, a mode or a lag as the linear system it is."""
    if isinstance(extension, CreepLadder):
        rate = 1.0 / np.array(extension.time_s)
        return ContinuousSystem(
            A=-np.diag(rate),
            B=rate[:, None],
            C=np.array([extension.share]),
            D=np.ones((1, 1)),
        )
    if isinstance(extension, LinearMode):
        w, part = 2.0 * np.pi * extension.frequency_Hz, extension.participation
        return ContinuousSystem(
            A=np.array([[0.0, w], [-w, -w / extension.quality]]),
            B=np.array([[0.0], [w]]),
            C=np.array([[part, 0.0]]),
            D=np.array([[1.0 - part]]),
        )
    if isinstance(extension, FirstOrderLag):
        rate_per_s = 1.0 / extension.lag_s
        return ContinuousSystem(
            A=np.array([[-rate_per_s]]),
            B=np.array([[rate_per_s]]),
            C=np.ones((1, 1)),
            D=np.zeros((1, 1)),
        )
    raise TypeError(f"{extension.kind} is no linear system")


def rest_gain(system: ContinuousSystem) -> float:
    """Return the gain at rest."""
    return float((system.D - system.C @ np.linalg.solve(system.A, system.B))[0, 0])


def _acts_behind(extension: Extension, *, known: bool) -> bool:
    if isinstance(extension, CreepLadder):
        return True
    if isinstance(extension, FirstOrderLag):
        return not known and extension.lag_s > 0.0
    return isinstance(extension, LinearMode) and not known


def _whole(plant: AxisPlant) -> ContinuousSystem:
    """Return what stands behind the response already, from drive to reading, gain 1 at rest."""
    if plant.measured is not None:
        rest = rest_gain(plant.measured)
        return replace(plant.measured, C=plant.measured.C / rest, D=plant.measured.D / rest)
    A, B, outputs = cascade((*plant.mechanics, *plant.sensor))
    C = np.zeros((1, len(A)))
    if outputs:
        C[0, outputs[-1]] = 1.0
    direct = np.zeros((1, 1)) if outputs else np.ones((1, 1))
    return ContinuousSystem(A=A, B=B[:, None], C=C, D=direct)


def _in_series(systems: Sequence[ContinuousSystem]) -> ContinuousSystem:
    whole, *rest = systems
    for system in rest:
        first, last = len(whole.A), len(system.A)
        A = np.zeros((first + last, first + last))
        A[:first, :first], A[first:, first:] = whole.A, system.A
        A[first:, :first] = system.B @ whole.C
        whole = ContinuousSystem(
            A=A,
            B=np.vstack([whole.B, system.B @ whole.D]),
            C=np.hstack([system.D @ whole.C, system.C]),
            D=system.D @ whole.D,
        )
    return whole


def _slew_of(extensions: Sequence[Extension]) -> float | None:
    limits = [e.limit_V_per_s for e in extensions if isinstance(e, SlewLimit)]
    return min(limits) if limits else None


def _limited(plant: AxisPlant, extensions: Sequence[Extension]) -> Hysteresis:
    response = plant.response
    assert isinstance(response, Hysteresis)
    for extension in extensions:
        if isinstance(extension, AmplifierLimits):
            operator = response.operator
            envelope = saturated(operator.envelope, extension, operator.voltage_offset_V)
            response = replace(response, operator=replace(operator, envelope=envelope))
    return response


def saturated(envelope: DeadZones, limits: AmplifierLimits, offset_V: float) -> DeadZones:
    """Return an envelope whose ends are flat beyond the limits, gamma(clip(u))."""
    low = -np.inf if limits.low_V is None else limits.low_V - offset_V
    high = np.inf if limits.high_V is None else limits.high_V - offset_V
    given = envelope.threshold
    inner = given[(given > low) & (given < high)]
    ends = [end for end in (low, high) if np.isfinite(end)]
    knots = np.sort(np.concatenate([inner, ends]))
    middles = np.concatenate([[knots[0] - 1.0], (knots[1:] + knots[:-1]) / 2, [knots[-1] + 1.0]])
    slope = envelope.slope[np.searchsorted(given, middles)]
    slope[(middles < low) | (middles > high)] = LEAST_SLOPE
    return from_slopes(knots, slope)
