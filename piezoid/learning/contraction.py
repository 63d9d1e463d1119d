"""Learning filter of periodic motion, and its reduction of the error per period.

    f <- f + Q L E,   E <- (1 - Q L G (1 + D)) E,   |D| <= rho

G is the displacement per volt of the table, harmonic by harmonic, for each plant of the identified
family; rho the half width of the hysteresis' slope sector over its middle. Contraction is the
condition of [Norrlof & Gunnarsson 2002] on every member, with the sector added:

    max_h |1 - Q L G| + rho max_h |Q L G| < 1        over learnt harmonics h, for every member

Hysteresis couples the harmonics, hence one maximum for each term. The condition is not a proof:
the sector bounds the slope of each branch, not the operator in every norm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.design.lateral import with_sector
from piezoid.design.lateral_task import affine_bounds_of, plant_family, unseen
from piezoid.design.plant import Plant
from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import Response, polynomial_response, unit_circle
from piezoid.runtime.library import Values
from piezoid.runtime.schema import METHODS

_SHARES = np.linspace(0.05, 1.0, 20)  # of the nominal inverse, candidates for L
_MAX_REMAINING = 0.95  # of the error after a period; a smaller reduction is not worth a recording
_LIMITS = np.arange(_MAX_REMAINING, 0.0, -0.05)  # of the contraction of a single harmonic
# Harmonics with a response below this share of the plant's gain would need large voltages; 0.1 is
# the result for the waveform target on a plant with a mode at 630 Hz.
_MIN_RESPONSE = 0.1
_MODEL_SHARE = 0.8  # of the nominal inverse; below 1, because slopes may exceed the middle slope
_PROBE_SHARES = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3])  # of the nominal inverse
_MAX_PROBED = 1.15  # remaining share of a harmonic after a probing step on the worst plant
_REST_TOLERANCE = 1e-12  # of z - 1: an integrator has no response at rest


@dataclass(frozen=True, kw_only=True, eq=False)
class LearningFilter:
    """Filter from the error of a period to the change of the table.

    harmonic_Hz    (harmonics,)
    L_V_per_m      (harmonics,)  complex, 0 for harmonics that are not learnt
    model_V_per_m  (harmonics,)  the same for the nominal plant alone, where it responds
    sensed         (harmonics,)  complex, reading over position of the nominal plant
    learns         (harmonics,)  Q, which is 0 or 1
    probe_V_per_m  (harmonics,)  a small step for harmonics that do not contract on all plants, to
                   measure their response; at most ``_MAX_PROBED`` of the harmonic remains
    contraction    largest remaining share of the error after a period, at full gain
    sector         rho
    worst          member of the family with that share
    """

    harmonic_Hz: Array
    L_V_per_m: Response
    model_V_per_m: Response
    sensed: Response
    learns: NDArray[np.bool_]
    probe_V_per_m: Response
    contraction: float
    sector: float
    worst: str

    @property
    def learns_to_Hz(self) -> float:
        """Frequency of the highest harmonic that is learnt."""
        return float(self.harmonic_Hz[self.learns].max())


def learning_filter(
    model: AxisModel,
    values: Values | None,
    *,
    points: int,
    sampling_rate_Hz: float,
    gain: float = 1.0,
) -> LearningFilter:
    """Return the filter that contracts on every plant of the family, with the widest band.

    values  of the controller that closes the loop; None: the table alone drives the plant
    points  of a period
    gain    factor of the L that is best for the worst member

    The mean is not learnt: a loop's integrator controls it, and without a loop it drifts.

    Raises ``DesignError`` if the first harmonic does not contract.
    """
    family, bounds = plant_family(model, sampling_rate_Hz), affine_bounds_of(model)
    if values is not None and METHODS[int(values["method"])] == "dob":
        family = with_sector(family, bounds)
    members, sector, seen_Hz = family.members, bounds.increment_gain, unseen(model).from_Hz
    harmonic_Hz = sampling_rate_Hz / points * np.arange(points // 2 + 1, dtype=np.float64)
    q = unit_circle(harmonic_Hz, sampling_rate_Hz)
    responses, nominal = np.stack([table_response(m, values, q) for m in members]), members[0]
    responds = np.abs(responses[0]) >= _MIN_RESPONSE * abs(nominal.gain)
    responds &= (harmonic_Hz > 0.0) & (harmonic_Hz < 0.5 * sampling_rate_Hz)
    usable = responds & (harmonic_Hz <= seen_Hz)
    relative = responses / np.where(responses[0] == 0.0, 1.0, responses[0])
    remaining = np.stack([_remaining(share * relative, sector) for share in _SHARES])
    share = gain * _SHARES[np.argmin(remaining, axis=0)]
    applied = share * relative
    worst_case = _remaining(applied, sector)
    # The lowest harmonics, as many as contract together, below the limit with the most of them.
    learns = np.zeros(len(q), dtype=bool)
    for limit in _LIMITS:
        candidates = np.flatnonzero(usable & (worst_case <= limit))
        errors = np.maximum.accumulate(np.abs(1.0 - applied[:, candidates]), axis=1)
        sizes = np.maximum.accumulate(np.abs(applied[:, candidates]), axis=1)
        together = candidates[(errors + sector * sizes).max(axis=0) <= _MAX_REMAINING]
        if len(together) > np.count_nonzero(learns):
            learns[:] = False
            learns[together] = True
    if not learns[1]:
        raise _no_contraction(model.axis, applied, sector, harmonic_Hz, seen_Hz, members, gain)
    by_member = np.abs(1.0 - applied[:, learns]).max(axis=1)
    by_member += sector * np.abs(applied[:, learns]).max(axis=1)

    # the largest probing step with at most ``_MAX_PROBED`` remaining on every plant
    probed = np.stack([_remaining(probe * relative, sector) for probe in _PROBE_SHARES])
    probe = np.where(probed <= _MAX_PROBED, _PROBE_SHARES[:, None], 0.0).max(axis=0)

    def inverse(rows: NDArray[np.bool_], share: Array | float) -> Response:
        """Return a share of the nominal inverse at some harmonics, 0 elsewhere."""
        result = np.zeros(len(q), dtype=complex)
        result[rows] = np.broadcast_to(share, q.shape)[rows] / responses[0][rows]
        return result

    return LearningFilter(
        harmonic_Hz=harmonic_Hz,
        L_V_per_m=inverse(learns, share),
        model_V_per_m=inverse(responds, _MODEL_SHARE),
        sensed=polynomial_response(nominal.B, q) / polynomial_response(nominal.B_position, q),
        learns=learns,
        probe_V_per_m=inverse(usable & ~learns, probe),
        contraction=float(by_member.max()),
        sector=sector,
        worst=members[int(np.argmax(by_member))].label,
    )


def table_response(member: Plant, values: Values | None, q: Response) -> Response:
    """Return the displacement per volt of the table at each harmonic, m/V, of the shipped loop.

    These are the equations of the runtime in phasors. Its observer includes the voltage of the
    table, so that only the difference between plant and observer is fed back.

        (z - 1) d = L_d nu,   z x = A (x + L nu) + B (u + d + L_d nu),   nu = P u - C x
        u = 1 - F (K (x + L nu) + d + L_d nu)

    F are the sections on the command, L_d is ``l_d`` in the code. Without an observer u = 1.
    """
    A = polynomial_response(member.A, q)
    position = polynomial_response(member.B_position, q) / A
    if values is None or METHODS[int(values["method"])] not in ("dob", "mpi_dob"):
        return np.asarray(position)
    polarity, n = float(values["polarity"]), int(values["observer_order"])
    P, z = polarity * polynomial_response(member.B, q) / A, 1.0 / q
    A_e, B_e = values["observer_A"][:n, :n], values["observer_B"][:n]
    C, L = values["observer_C"][:n], values["observer_L"][:n]
    K, l_d = values["feedback_K_V"][:n], float(values["observer_disturbance_L_V_per_m"])
    command = np.ones(len(q), dtype=complex)
    for b0, b1, b2, a1, a2 in values["command_section"][: int(values["command_section_count"])]:
        command *= (b0 + b1 * q + b2 * q**2) / (1.0 + a1 * q + a2 * q**2)
    correct = np.eye(n) - np.outer(L, C)  # I - L C
    rows = np.zeros((len(q), n + 2, n + 2), dtype=complex)  # of x, d, u
    rows[:, :n, :n] = z[:, None, None] * np.eye(n) - A_e @ correct + l_d * np.outer(B_e, C)
    rows[:, :n, n] = -B_e
    rows[:, :n, n + 1] = -B_e - P[:, None] * (A_e @ L + l_d * B_e)
    rows[:, n, :n], rows[:, n, n], rows[:, n, n + 1] = l_d * C, z - 1.0, -l_d * P
    rows[np.abs(z - 1.0) < _REST_TOLERANCE, n, n] = _REST_TOLERANCE
    rows[:, n + 1, :n] = command[:, None] * (K @ correct - l_d * C)
    rows[:, n + 1, n] = command
    rows[:, n + 1, n + 1] = 1.0 + command * P * (float(K @ L) + l_d)
    impulse = np.zeros((len(q), n + 2, 1), dtype=complex)
    impulse[:, n + 1] = 1.0
    return np.asarray(position * np.linalg.solve(rows, impulse)[:, n + 1, 0])


def _remaining(applied: Response, sector: float) -> Array:
    """Return the remaining share of the error after a period on the worst plant, (harmonics,)."""
    return np.asarray((np.abs(1.0 - applied) + sector * np.abs(applied)).max(axis=0))


def _no_contraction(
    axis: str,
    applied: Response,
    sector: float,
    harmonic_Hz: Array,
    seen_Hz: float,
    members: Sequence[Plant],
    gain: float,
) -> DesignError:
    first_Hz = float(harmonic_Hz[1])
    if first_Hz > seen_Hz:
        return DesignError(
            f"axis {axis}: a period of {with_unit(first_Hz, 'Hz')}, and the recordings show the "
            f"response up to {with_unit(seen_Hz, 'Hz')} only",
            needed="a recorded response at the harmonics of the motion",
            remedy="Record a chirp or multisine beyond it and fit again, or move slower.",
        )
    remaining = np.abs(1.0 - applied[:, 1]) + sector * np.abs(applied[:, 1])
    worst = int(np.argmax(remaining))
    return DesignError(
        f"axis {axis}: a learning filter that does not contract: at {with_unit(first_Hz, 'Hz')} "
        f"and a learning gain of {gain:g}, a period may leave {remaining[worst]:.3g} of the "
        f"error on the plant '{members[worst].label}', {sector * abs(applied[worst, 1]):.3g} of "
        "it by the slope sector of the hysteresis",
        needed=f"at most {_MAX_REMAINING:g} on every plant that the recordings allow",
        remedy="Lower the learning gain, record more so that the family is narrower, or scan "
        "slower.",
    )
