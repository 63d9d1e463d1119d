"""Learning filter of periodic motion, and the required reduction of the error per period.

    f <- f + Q L E,   E <- (1 - Q L G (1 + D)) E,   |D| <= rho

G is what a volt of the table moves, harmonic by harmonic, on each plant of the identified family;
rho the half width of the hysteresis' slope sector over its middle. Contraction is the condition of
[Norrlof & Gunnarsson 2002] on every member, with the sector beside it:

    max_h |1 - Q L G| + rho max_h |Q L G| < 1        over learnt harmonics h, for every member

Harmonics of a hysteresis mix, hence one maximum for each term. What stands beside that: a play
that rests repeats what it met before, so a sector bounds it branch by branch, not in all norms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.design.lateral_task import lateral_task, unseen
from piezoid.design.plant import Plant
from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response, polynomial_response, unit_circle
from piezoid.runtime.library import Values
from piezoid.runtime.schema import METHODS

_SHARES = np.linspace(0.05, 1.0, 20)  # of the nominal inverse, among which L is chosen
_MAX_REMAINING = 0.95  # of the error by a period: less is no progress worth a recording
_LIMITS = np.arange(_MAX_REMAINING, 0.0, -0.05)  # of a harmonic's own contraction
# Where the plant answers with less than this of its gain, the table would grow to no avail; the
# waveform target found 0.1 on a plant with a mode at 630 Hz.
_MIN_RESPONSE = 0.1
_MODEL_SHARE = 0.8  # of the nominal inverse: less than 1, a slope may be above the middle one
_PROBE_SHARES = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3])  # of the nominal inverse
_MAX_PROBED = 1.15  # of the harmonic, what a step may leave on the worst plant
_REST_TOLERANCE = 1e-12  # of z - 1: an integrator has no response at rest


@dataclass(frozen=True, kw_only=True, eq=False)
class LearningFilter:
    """Filter from the error of a period to the change of the table.

    harmonic_Hz  (harmonics,)
    L_V_per_m    (harmonics,)  complex, 0 where nothing is learnt
    model_V_per_m  (harmonics,)  likewise for the nominal plant alone, wherever it answers
    sensed       (harmonics,)  complex, reading over position of the nominal plant
    learns       (harmonics,)  Q, which is 0 or 1
    probe_V_per_m  (harmonics,)  a small step where nothing contracts on all plants, from which the
                 response can be measured: it leaves at most ``_MAX_PROBED`` of the harmonic
    contraction  at most this share of the error is left by a period, at full gain
    sector       rho
    worst        the member of the family that shrinks it least
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
    def moves(self) -> NDArray[np.bool_]:
        """Harmonics that a table may be changed at, (harmonics,)."""
        return self.learns | (np.abs(self.probe_V_per_m) > 0.0)

    def share_learnt(self, wanted_m: Array) -> float:
        """Return how much of a motion's power, its mean aside, lies in learnt harmonics."""
        power = np.abs(np.fft.rfft(wanted_m - wanted_m.mean())) ** 2
        return float(power[self.learns].sum() / max(power.sum(), np.finfo(float).tiny))

    @property
    def learns_to_Hz(self) -> float:
        """The highest harmonic that is learnt."""
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

    values  of the controller that closes the loop; None: the table drives the plant alone
    points  of a period
    gain    times the L that is best for the worst member

    The mean is not learnt: a loop's integrator holds it, and without a loop it drifts.

    Raises ``DesignError`` where the first harmonic does not contract, with what a period leaves.
    """
    task = lateral_task(model, sampling_rate_Hz)
    is_affine = values is not None and METHODS[int(values["method"])] == "dob"
    members = task.families["affine" if is_affine else "inverse"].members
    sector, known_Hz = task.bounds["affine"].increment_gain, unseen(model).from_Hz
    harmonic_Hz = sampling_rate_Hz / points * np.arange(points // 2 + 1, dtype=np.float64)
    q = unit_circle(harmonic_Hz, sampling_rate_Hz)
    responses, nominal = np.stack([table_response(m, values, q) for m in members]), members[0]
    answers = np.abs(responses[0]) >= _MIN_RESPONSE * abs(nominal.gain)
    answers &= (harmonic_Hz > 0.0) & (harmonic_Hz < 0.5 * sampling_rate_Hz)
    usable = answers & (harmonic_Hz <= known_Hz)
    relative = responses / np.where(responses[0] == 0.0, 1.0, responses[0])
    remaining = np.stack([_remaining(share * relative, sector) for share in _SHARES])
    share = gain * _SHARES[np.argmin(remaining, axis=0)]
    applied = share * relative
    worst_case = _remaining(applied, sector)
    bands = [_contracting(applied, sector, usable & (worst_case <= limit)) for limit in _LIMITS]
    learns = max(bands, key=np.count_nonzero)
    if not learns[1]:
        raise _no_contraction(model.axis, applied, sector, harmonic_Hz, known_Hz, members, gain)
    by_member = np.abs(1.0 - applied[:, learns]).max(axis=1)
    by_member += sector * np.abs(applied[:, learns]).max(axis=1)

    def inverse(rows: NDArray[np.bool_], part: Array | float) -> Response:
        """Return a part of the nominal inverse at some harmonics, 0 elsewhere."""
        filtered = np.zeros(len(q), dtype=complex)
        filtered[rows] = np.broadcast_to(part, q.shape)[rows] / responses[0][rows]
        return filtered

    return LearningFilter(
        harmonic_Hz=harmonic_Hz,
        L_V_per_m=inverse(learns, share),
        model_V_per_m=inverse(answers, _MODEL_SHARE),
        sensed=polynomial_response(nominal.B, q) / polynomial_response(nominal.B_position, q),
        learns=learns,
        probe_V_per_m=inverse(usable & ~learns, _probe_shares(relative, sector)),
        contraction=float(by_member.max()),
        sector=sector,
        worst=members[int(np.argmax(by_member))].label,
    )


def table_response(member: Plant, values: Values | None, q: Response) -> Response:
    """Return the displacement per volt of the table at each harmonic, m/V, of the shipped loop.

    The runtime's own equations in phasors; its observer knows what the table applied, so that
    only the difference between plant and observer is fed back.

        (z - 1) d = L_d nu,   z x = A (x + L nu) + B (u + d + L_d nu),   nu = P u - C x
        u = 1 - F (K (x + L nu) + d + L_d nu)

    F: the sections on the command, L_d in the code: slow. Without an observer u = 1.
    """
    A = polynomial_response(member.A, q)
    position = polynomial_response(member.B_position, q) / A
    if values is None or METHODS[int(values["method"])] not in ("dob", "mpi_dob"):
        return np.asarray(position)
    polarity, n = float(values["polarity"]), int(values["observer_order"])
    P, z = polarity * polynomial_response(member.B, q) / A, 1.0 / q
    moves, driven = values["observer_A"][:n, :n], values["observer_B"][:n]
    C, L = values["observer_C"][:n], values["observer_L"][:n]
    K, slow = values["feedback_K_V"][:n], float(values["observer_disturbance_L_V_per_m"])
    command = np.ones(len(q), dtype=complex)
    for b0, b1, b2, a1, a2 in values["command_section"][: int(values["command_section_count"])]:
        command *= (b0 + b1 * q + b2 * q**2) / (1.0 + a1 * q + a2 * q**2)
    correct = np.eye(n) - np.outer(L, C)  # of x by its own part of nu
    rows = np.zeros((len(q), n + 2, n + 2), dtype=complex)  # of x, d, u
    rows[:, :n, :n] = z[:, None, None] * np.eye(n) - moves @ correct + slow * np.outer(driven, C)
    rows[:, :n, n] = -driven
    rows[:, :n, n + 1] = -driven - P[:, None] * (moves @ L + slow * driven)
    rows[:, n, :n], rows[:, n, n], rows[:, n, n + 1] = slow * C, z - 1.0, -slow * P
    rows[np.abs(z - 1.0) < _REST_TOLERANCE, n, n] = _REST_TOLERANCE
    rows[:, n + 1, :n] = command[:, None] * (K @ correct - slow * C)
    rows[:, n + 1, n] = command
    rows[:, n + 1, n + 1] = 1.0 + command * P * (float(K @ L) + slow)
    impulse = np.zeros((len(q), n + 2, 1), dtype=complex)
    impulse[:, n + 1] = 1.0
    return np.asarray(position * np.linalg.solve(rows, impulse)[:, n + 1, 0])


def _remaining(applied: Response, sector: float) -> Array:
    """Return the remaining share of the error after a period on the worst plant, (harmonics,)."""
    return np.asarray((np.abs(1.0 - applied) + sector * np.abs(applied)).max(axis=0))


def _probe_shares(relative: Response, sector: float) -> Array:
    """Return the largest step that leaves at most ``_MAX_PROBED`` on every plant, (harmonics,)."""
    remaining = np.stack([_remaining(share * relative, sector) for share in _PROBE_SHARES])
    allowed = np.where(remaining <= _MAX_PROBED, _PROBE_SHARES[:, None], 0.0)
    return np.asarray(allowed.max(axis=0))


def _contracting(
    applied: Response, sector: float, candidates: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the lowest candidate harmonics, as many as contract together."""
    indices = np.flatnonzero(candidates)
    remaining = np.maximum.accumulate(np.abs(1.0 - applied[:, indices]), axis=1)
    driven = np.maximum.accumulate(np.abs(applied[:, indices]), axis=1)
    together = (remaining + sector * driven).max(axis=0)
    learns = np.zeros_like(candidates)
    learns[indices[together <= _MAX_REMAINING]] = True
    return learns


def _no_contraction(
    axis: str,
    applied: Response,
    sector: float,
    harmonic_Hz: Array,
    known_Hz: float,
    members: Sequence[Plant],
    gain: float,
) -> DesignError:
    first_Hz = float(harmonic_Hz[1])
    if first_Hz > known_Hz:
        return DesignError(
            f"axis {axis}: a period of {with_unit(first_Hz, 'Hz')}, and the recordings show the "
            f"response up to {with_unit(known_Hz, 'Hz')} only",
            needed="a response that is known where something is to be learnt from it",
            remedy="Record a chirp or multisine beyond it and fit again, or move slower.",
        )
    each = np.abs(1.0 - applied[:, 1]) + sector * np.abs(applied[:, 1])
    worst = int(np.argmax(each))
    return DesignError(
        f"axis {axis}: a learning filter that does not contract: at {with_unit(first_Hz, 'Hz')} "
        f"and a learning gain of {gain:g}, a period may leave {each[worst]:.3g} of the error on "
        f"the plant '{members[worst].label}', {sector * abs(applied[worst, 1]):.3g} of it by the "
        "slope sector of the hysteresis",
        needed=f"at most {_MAX_REMAINING:g} on every plant that the recordings allow",
        remedy="Lower the learning gain, record more so that the family is narrower, or scan "
        "slower.",
    )
