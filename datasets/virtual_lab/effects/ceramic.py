"""Effects of the ceramic: domain walls with rates, mobilities and relaxation times."""

import math

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Bench,
    Fault,
    Place,
    Scene,
    Trace,
    bisected,
    effect,
    proportional,
)
from piezoid_datasets.virtual_lab.signals import Array, first_order
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

TIME_CONSTANTS_s = (2e-5, 0.2)  # of walls that respond with a delay
FINE_ENOUGH_Hz = 20e3  # sufficient for the scaling
POINTS = 401
BIAS, HALF_SPAN = 0.5, 0.25  # of the loops that tell at which end walls are freer
CYCLES, STEPS = 6, 100  # after which a loop closes; of each branch
DECADES = (-2.0, 4.0)  # of relaxation time in seconds
PER_DECADE = 8
EDGE_DECADES = 0.5
CYCLED_s = 5.0  # duration of the cycles before the rest: slow domains hardly respond


@effect(0.15, shown_by=("rates",))
def rate_dependence(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Rate dependence: domain walls that respond with a delay.

    The irreversible strain w approaches its quasi-static value q by thermally activated jumps over
    barriers that the lag lowers:

        dw/dt = (s / tau) sinh((q - w) / s)

    Slow drives lag like a filter with time constant tau, fast drives only by s asinh(rate tau /
    s), which grows with the logarithm of the rate. The reversible part does not lag. Over a time h
    with constant q, ``tanh(e / 2s)`` of the lag e decays by ``exp(-h / tau)``: this step is exact.

    Draw the strain scale of the barriers and search for the time constant.

    Source: Fulcher, Cole & Bishop kinetics of activated walls as in Smith, Smart Material Systems
    (2005), chapter 2.
    """
    scale = float(rng.uniform(0.005, 0.03))

    def change(trace: Trace, tau_s: float) -> Array:
        stride = max(round(trace.scene.rate_Hz / FINE_ENOUGH_Hz), 1)
        quasi_static = trace.irreversible[::stride]
        lagging = follow_slowly(quasi_static, tau_s, scale, trace.scene.rate_Hz / stride)
        return bench.rig.stroke_m * (lagging - quasi_static)

    tau_s = bisected(size_m, bench.traces, change, TIME_CONSTANTS_s)
    return Fault(
        Place.IRREVERSIBLE,
        lambda quasi_static, scene, _: follow_slowly(quasi_static, tau_s, scale, scene.rate_Hz),
        {"time_constant_s": tau_s, "barrier_strain": scale},
    )


def follow_slowly(quasi_static: Array, tau_s: float, scale: float, rate_Hz: float) -> Array:
    """Return the irreversible strain that lags behind its quasi-static value."""
    decay = math.exp(-1.0 / (tau_s * rate_Hz))
    lagging = np.empty_like(quasi_static)
    wall = float(quasi_static[0])
    for k, target in enumerate(quasi_static.tolist()):
        lag = target - wall
        wall = target - 2.0 * scale * math.atanh(decay * math.tanh(lag / (2.0 * scale)))
        lagging[k] = wall
    return lagging


@effect(0.3, shown_by=("sweep", "check"))
def non_congruence(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Non-congruence: equal minor loops have different shapes at different biases.

    Domain walls are more mobile at one end of the range than at the other, so the irreversible
    strain has wider loops there:

        w + c E (w - m(E)),      m the middle line of the major loop, E from -1 to 1

    Loops between the same two fields then depend on the history, which no Preisach operator
    allows. The mobility increases at the end at which the loops are already wider, because the
    opposite sign would compensate the asymmetry of a pinned ceramic.

    Increase the mobility at the end with wider loops, and scale the effect.

    Source: Mayergoyz, Mathematical Models of Hysteresis (1991), the nonlinear (input-dependent)
    model.
    """
    # Middle line of the major loop of the irreversible part.
    field = np.linspace(-1.0, 1.0, POINTS)
    both_branches = np.concatenate((field[::-1], field))
    loop = bench.ceramic.respond(both_branches, np.array([-1.0, 1.0]))[1]
    middle = 0.5 * (loop[:POINTS][::-1] + loop[POINTS:])

    def opened(irreversible: Array, at: Array) -> Array:
        return at * (irreversible - np.interp(at, field, middle))

    unit = [
        bench.rig.stroke_m * opened(trace.irreversible, trace.scene.field)
        for trace in bench.traces
    ]
    size_m *= freer_end(bench.ceramic)
    freedom = proportional(size_m, unit, why="no loop is opened")
    return Fault(
        Place.IRREVERSIBLE,
        lambda quasi_static, scene, _: quasi_static + freedom * opened(quasi_static, scene.field),
        {"opening_per_field": freedom},
    )


def freer_end(ceramic: Ceramic) -> float:
    """Return the end of the range at which loops of one span are wider, -1 or 1."""
    corners = np.tile([-HALF_SPAN, HALF_SPAN], CYCLES)
    phase = np.arange((2 * CYCLES - 1) * STEPS + 1) / STEPS
    path = np.interp(phase, np.arange(2 * CYCLES), corners)
    widths = []  # of a closed small loop in the middle of its span
    for bias in (BIAS, -BIAS):
        _, loop = ceramic.respond(bias + path, np.array([-1.0, 1.0]))
        widths.append(abs(loop[-STEPS // 2 - 1] - loop[-3 * STEPS // 2 - 1]))
    return 1.0 if widths[0] >= widths[1] else -1.0


@effect(0.6, shown_by=("sweep",))
def asymmetry(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Asymmetry: strain is proportional to the square of the polarisation of a poled ceramic.

    Around the remanent polarisation the square has a slope, which is the piezoelectric effect, and
    a curvature, which bends rising and falling branches to the same side:

        s + 4 a s (1 - s),      s from 0 to 1 over the stroke

    The ends of the stroke are unchanged.

    Draw the sign of the curvature, and scale it to the size.

    Source: electrostriction, s = Q P^2; Damjanovic, Rep. Prog. Phys. 61 (1998).
    """
    stroke_m = bench.rig.stroke_m

    def bent(ceramic_m: Array) -> Array:
        return 4.0 * ceramic_m * (1.0 - ceramic_m / stroke_m)

    unit = [bent(trace.displacement_m) for trace in bench.traces]
    size_m *= float(rng.choice([-1.0, 1.0]))
    curvature = proportional(size_m, unit, why="the stage does not move")
    return Fault(
        Place.CERAMIC,
        lambda ceramic_m, _scene, _: ceramic_m + curvature * bent(ceramic_m),
        {"curvature": curvature},
    )


@effect(0.5, shown_by=("staircase", "long_hold"))
def creep(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Creep: domains that continue to switch for hours after a change of the field.

    Domain walls cross barriers of widely distributed heights, so the relaxation times are
    uniformly distributed over the logarithm of time:

        x(t) = h(t) + integral g(tau) h_tau(t) d log10 tau,    tau dh_tau/dt = h - h_tau

    with h the response of the domains that switch instantly. The spectrum g is flat over six
    decades with soft ends. The integral is computed with eight relaxation times per decade, many
    more than a fit would use.

    Scale the spectrum to the size of the additional displacement.

    Source: Jung & Gweon, Rev. Sci. Instrum. 71 (2000); spectrum after Vieira, IBM J. Res. Dev. 30
    (1986).
    """
    tilt = float(rng.uniform(-0.15, 0.15))
    unit = [_crept(trace.displacement_m, trace.scene, tilt) for trace in bench.traces]
    per_decade = proportional(size_m, unit, why="the stage does not move")
    return creep_of(per_decade, tilt)


def creep_of(per_decade: float, tilt: float) -> Fault:
    """Return creep of a given strength, the fraction of a step per decade of time."""
    return Fault(
        Place.CERAMIC,
        lambda ceramic_m, scene, _: ceramic_m + per_decade * _crept(ceramic_m, scene, tilt),
        {"creep_per_decade": per_decade, "spectrum_tilt_per_decade": tilt},
    )


def _crept(response_m: Array, scene: Scene, tilt: float) -> Array:
    """Return the integral over a spectrum of one per decade."""
    first_decade, last_decade = DECADES
    decades = (
        first_decade
        + (np.arange(round((last_decade - first_decade) * PER_DECADE)) + 0.5) / PER_DECADE
    )
    edge_distance = np.minimum(decades - first_decade, last_decade - decades)
    weight = (
        np.clip(edge_distance / EDGE_DECADES, 0.0, 1.0)
        * (1.0 + tilt * (decades - 1.0))
        / PER_DECADE
    )
    middle_m = 0.5 * float(np.min(response_m) + np.max(response_m))
    crept = np.zeros_like(response_m)
    for log_tau, share in zip(decades, weight, strict=True):
        tau_s = 10.0 ** float(log_tau)
        remaining = -np.expm1(-CYCLED_s / tau_s) * np.exp(-scene.rest_s / tau_s)
        start = float(response_m[0] + (middle_m - response_m[0]) * remaining)
        crept += share * first_order(response_m, tau_s, scene.rate_Hz, start)
    return crept
