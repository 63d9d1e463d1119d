"""Every law of the zoo has the properties of its publication and solves its equation."""

import itertools
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.laboratory import draw_laboratory
from piezoid_datasets.virtual_lab.truths import TRUTHS, ZOO
from piezoid_datasets.virtual_lab.truths.closed_form import bent_scale, dahl_memory, duhem_memory
from piezoid_datasets.virtual_lab.truths.differential import (
    coleman_hodgdon_memory,
    generalised_bouc_wen_memory,
    jiles_atherton_memory,
    lugre_memory,
)
from piezoid_datasets.virtual_lab.truths.return_point import (
    DOWN,
    THRESHOLDS,
    UP,
    MaxwellSlip,
    krasnoselskii_pokrovskii_memory,
    lorentzian_everett,
    maxwell_slip_memory,
    ridge,
    takacs_memory,
)
from piezoid_datasets.virtual_lab.truths.truth import FLOOR, Ceramic, Truth

from .fields import EXACT, Array, strain, walk

SEEDS = range(2)

WIPES_OUT = set(
    ["preisach", "preisach_lorentzian", "krasnoselskii_pokrovskii", "takacs", "maxwell_slip"]
)

every_law = pytest.mark.parametrize("law", ZOO, ids=lambda law: law.name)


def ceramics_of(law: Truth) -> list[Ceramic]:
    return [law.draw(np.random.default_rng(seed)) for seed in SEEDS]


def test_the_zoo_has_at_least_twelve_laws_and_begins_with_the_truths():
    assert len({law.name for law in ZOO}) == len(ZOO) >= 12
    assert ZOO[: len(TRUTHS)] == TRUTHS


@every_law
def test_the_major_loop_spans_the_stroke_and_opens_like_a_piezo(law):
    for ceramic in ceramics_of(law):
        up, down = np.split(strain(ceramic, walk(-1.0, 1.0, -1.0, points=300)), 2)
        assert abs(up[-1] - up[0] - 1.0) < 0.01  # laws that forget by and by still settle
        assert 0.07 < np.max(down[::-1] - up) < 0.16
        assert 0.0 < ceramic.share < 1.0


@every_law
def test_the_strain_lags_the_field_in_loops_of_every_size(law):
    for ceramic in ceramics_of(law):
        for low, high in ((-1.0, 1.0), (-0.6, 0.6), (-0.9, -0.2), (0.2, 0.9), (-0.1, 0.3)):
            rounds = strain(ceramic, walk(-1.0, *(low, high) * 30, low))
            up, down = rounds[-120:-60], rounds[-60:]  # settled: the loop closes
            assert np.max(np.abs(up[0] - down[-1])) < 1e-3
            assert np.sum(down[::-1] - up) > 0.0


@every_law
def test_more_field_is_never_less_strain(law):
    for ceramic in ceramics_of(law):
        field = walk(-1.0, 0.9, -0.7, 0.2, -0.3, 1.0, -0.95, 0.1)
        assert np.all(np.diff(strain(ceramic, field)) * np.sign(np.diff(field)) >= -1e-12)


@every_law
def test_a_law_does_not_depend_on_the_sampling_of_its_path(law):
    turns = (-1.0, 0.8, -0.4, 0.5, -0.9, 1.0)
    for ceramic in ceramics_of(law):
        slow = strain(ceramic, walk(*turns, points=500))
        fast = strain(ceramic, walk(*turns, points=2))
        at_turns = slow[[0, *range(499, 2500, 500)]] - fast[[0, *range(1, 10, 2)]]
        assert np.max(np.abs(at_turns)) < 1e-7


@every_law
def test_return_point_laws_wipe_out_turning_points_and_close_loops(law):
    path, detour = walk(-1.0, 0.7, -0.5, 0.2), walk(-1.0, 0.7, -0.5, 0.2, -0.3, 0.1, -0.1, 0.2)
    memory_error: list[float] = []  # what an inner loop leaves behind
    closure_error: list[float] = []  # of a minor loop
    span_error: list[float] = []  # spans of equal minor loops after unlike pasts
    for ceramic in ceramics_of(law):
        memory_error.append(abs(strain(ceramic, path)[-1] - strain(ceramic, detour)[-1]))
        output = strain(ceramic, walk(-1.0, 0.2, -0.2, 0.2))
        closure_error.append(abs(output[-1] - output[59]))
        shapes = [
            strain(ceramic, walk(*turns, 0.3, -0.2, 0.3, -0.2, points=40))[-80:]
            for turns in ((-1.0, 0.9, -0.2), (1.0, -0.8, 0.9, -0.2), (-1.0, -0.2))
        ]
        span_error += [abs(np.ptp(shape) - np.ptp(shapes[0])) for shape in shapes[1:]]
    if law.name in WIPES_OUT:
        assert max(*memory_error, *closure_error, *span_error) < EXACT
    else:
        assert min(max(memory_error), max(closure_error)) > 1e-3
        assert max(span_error) > 1e-5


@every_law
def test_no_law_is_a_sum_of_plays(law):
    """Settled loops of a sum of plays would be equal at every bias."""
    for ceramic in ceramics_of(law):
        low, high = (
            strain(ceramic, walk(-1.0, *limits * 30, limits[0]))[-120:]
            for limits in ((-0.8, -0.3), (0.3, 0.8))
        )
        assert np.max(np.abs((low - low[0]) - (high - high[0]))) > 0.004 * np.ptp(low)


PATH = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, 0.7, points=8000)
BOUC_WEN = SimpleNamespace(sharpness=1.4, shape=(2.0, 0.1, -0.12, 0.09, 0.14, -0.07), centre=0.1)
DAHL = SimpleNamespace(stiffness=1.5, exponent=1.3, bend=0.2)
LUGRE = SimpleNamespace(stiffness=1.9, tilt=0.2, hump=0.15, centre=0.1, width=0.8)
BOUC_WEN_STEEPEST = 1.0 + (2.0 + 0.52) / (2.0 - 0.52)
LUGRE_STEEPEST = 1.9 * (1.0 + 1.35 / 0.8)
COLEMAN = SimpleNamespace(pull=1.3, share=0.55, centre=0.1, knee=0.9, beyond=0.7)
JILES = SimpleNamespace(
    width=0.7, pinning=0.4, mean_field=0.3, reversible=0.2, bias=0.1, electrostriction=0.2
)
DUHEM = SimpleNamespace(rate=1.8, centre=0.1, coercive=(0.6, 0.7), width=(0.5, 0.55))


def midpoint(
    slope: Callable[[float, float, float], float], start: float, path: Array = PATH
) -> Array:
    """Return the state along the path by the midpoint rule, sample by sample."""
    state = np.empty_like(path)
    state[0] = start
    for k in range(1, len(path)):
        step = float(path[k] - path[k - 1])
        sign, now = float(np.sign(step)), float(state[k - 1])
        half = now + 0.5 * step * slope(float(path[k - 1]), now, sign)
        state[k] = now + step * slope(float(0.5 * (path[k] + path[k - 1])), half, sign)
    return state


def bouc_wen_slope(e: float, z: float, s: float) -> float:
    b = BOUC_WEN.shape
    x = e - BOUC_WEN.centre
    psi = sum(
        weight * float(np.sign(sign))
        for weight, sign in zip(b, (s * z, s * x, x * z, s, z, x), strict=True)
    )
    return 1.0 - abs(z) ** BOUC_WEN.sharpness * psi


def dahl_slope(e: float, z: float, s: float) -> float:
    scale = 1.0 + DAHL.bend * e / float(np.sqrt(1.0 + e * e))
    return scale * DAHL.stiffness * max(1.0 - s * z, 0.0) ** DAHL.exponent


def lugre_slope(e: float, z: float, s: float) -> float:
    position = (e - LUGRE.centre) / LUGRE.width
    level = 1.0 + LUGRE.tilt * np.tanh(position) + LUGRE.hump * np.exp(-(position**2))
    return float(LUGRE.stiffness * (1.0 - s * z / level))


def coleman_slope(e: float, p: float, s: float) -> float:
    x = e - COLEMAN.centre
    inside = abs(x) < COLEMAN.knee
    f = x if inside else np.sign(x) * (COLEMAN.knee + COLEMAN.beyond * (abs(x) - COLEMAN.knee))
    return float(COLEMAN.pull * s * (f - p) + (COLEMAN.share if inside else COLEMAN.beyond))


def duhem_slope(e: float, p: float, s: float) -> float:
    centre = DUHEM.centre + (DUHEM.coercive[0] if s > 0 else -DUHEM.coercive[1])
    width = DUHEM.width[0 if s > 0 else 1]
    return float(DUHEM.rate * np.exp(-(((e - centre) / width) ** 2)) * (1.0 - s * p))


def polarised(e: float, m: float) -> tuple[float, float]:
    """Return A and P of Jiles and Atherton, by bisection of what must be zero."""
    low, high = -1.0, 1.0
    for _ in range(45):
        p = 0.5 * (low + high)
        x = (e + JILES.bias + JILES.mean_field * p) / JILES.width
        towards = x / 3.0 if abs(x) < 1e-4 else float(1.0 / np.tanh(x) - 1.0 / x)
        if JILES.reversible * towards + (1.0 - JILES.reversible) * m > p:
            low = p
        else:
            high = p
    return towards, p


def jiles_slope(e: float, m: float, s: float) -> float:
    gap = polarised(e, m)[0] - m
    return gap / (s * JILES.pinning - JILES.mean_field * gap) if s * gap > 0 else 0.0


def test_the_steepest_slope_bounds_a_friction():
    for steepest, output in (
        (BOUC_WEN_STEEPEST, generalised_bouc_wen_memory(PATH, **vars(BOUC_WEN))),
        (LUGRE_STEEPEST, lugre_memory(PATH, **vars(LUGRE))),
    ):
        friction = steepest * PATH - output
        assert np.max(np.abs(np.diff(friction))) <= steepest * np.max(np.abs(np.diff(PATH)))


@pytest.mark.parametrize(
    ("state", "slope", "error"),
    [
        (
            lambda p: BOUC_WEN_STEEPEST * p - generalised_bouc_wen_memory(p, **vars(BOUC_WEN)),
            bouc_wen_slope,
            3e-4,  # error of the midpoint rule at the kinks
        ),
        (lambda p: LUGRE_STEEPEST * p - lugre_memory(p, **vars(LUGRE)), lugre_slope, 3e-4),
        (
            lambda p: (
                DAHL.stiffness * 2.0**DAHL.exponent * bent_scale(p, DAHL.bend)
                - dahl_memory(p, **vars(DAHL))
            ),
            dahl_slope,
            1e-5,
        ),
        (lambda p: coleman_hodgdon_memory(p, **vars(COLEMAN)), coleman_slope, 3e-4),
        (lambda p: duhem_memory(p, **vars(DUHEM)), duhem_slope, 1e-5),
    ],
    ids=["generalised_bouc_wen", "lugre", "dahl", "coleman_hodgdon", "duhem"],
)
def test_a_law_solves_its_equation(state, slope, error):
    states = state(PATH)
    start = -1.0 if slope in (dahl_slope, duhem_slope) else float(states[0])
    assert np.max(np.abs(states - midpoint(slope, start))) < error


def test_jiles_and_atherton_solve_their_equation():
    path = PATH[::20]
    output = jiles_atherton_memory(path, **vars(JILES))
    first = -1.0 + JILES.width / (-FLOOR - JILES.bias + JILES.mean_field)
    state = midpoint(jiles_slope, first, path)
    polarisation = np.array(
        [polarised(float(e), float(m))[1] for e, m in zip(path, state, strict=True)]
    )
    stepped = polarisation + JILES.electrostriction * polarisation**2
    assert np.max(np.abs(output - stepped)) < 1e-4


def test_a_takacs_branch_is_a_piece_of_its_tangent():
    path = walk(FLOOR, 1.0, -0.5, 0.4)
    output = takacs_memory(path, steepness=1.1, shift=(0.3, 0.4), centre=0.1)
    for piece, shift in ((slice(0, 60), 0.3), (slice(60, 120), -0.4), (slice(120, 180), 0.3)):
        shape = np.tanh(1.1 * (path[piece] - 0.1 - shift))
        fit = np.polyfit(shape, output[piece], 1)
        assert np.max(np.abs(np.polyval(fit, shape) - output[piece])) < 1e-9


def test_kernels_follow_krasnoselskii_and_pokrovskii():
    rng = np.random.default_rng(1)
    weight = rng.uniform(0.5, 1.0, len(DOWN))
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, 0.5, points=40)
    kernels = np.full(len(DOWN), -1.0)
    summed = []
    for previous, value in itertools.pairwise(path):
        if value > previous:
            kernels = np.maximum(kernels, ridge(value - THRESHOLDS[UP]))
        elif value < previous:
            kernels = np.minimum(kernels, ridge(value - THRESHOLDS[DOWN]))
        summed.append(weight @ kernels)
    output = krasnoselskii_pokrovskii_memory(weight, path)
    assert np.allclose(output[1:], summed, atol=1e-9)


def test_maxwell_elements_stick_and_slide():
    law = MaxwellSlip(
        breaks=np.array([0.1, 0.4, 0.9]),
        stiffness=np.array([1.0, 0.7, 0.4]),
        growth=-0.3,
        bends=(0.1, -0.05),
    )
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, 0.5, points=2000)
    positions = law.scale(path)
    force = -law.limit(positions[0])
    summed = [float(law.stiffness @ (positions[0] - force))]
    for previous, value in itertools.pairwise(positions):
        edge = law.limit(value)
        force = np.clip(force + value - previous, -edge, edge)
        summed.append(float(law.stiffness @ (value - force)))
    assert np.allclose(maxwell_slip_memory(law, path), summed, atol=1e-9)


def test_the_lorentzian_everett_function_has_the_density_of_its_name():
    everett = lorentzian_everett((0.2, 0.3), (0.5, 0.7))
    a, b, h = 0.6, -0.2, 0.01
    high, low = np.array([a + h, a - h, a + h, a - h]), np.array([b, b, b - 2 * h, b - 2 * h])
    mixed = np.array([1.0, -1.0, -1.0, 1.0]) @ everett(high, low)
    up, down = (a - 0.2) / 0.5, (b - h + 0.3) / 0.7
    density = 1.0 / (1.0 + up**2) / (1.0 + down**2)
    assert -mixed / (4 * h * h) == pytest.approx(density, rel=1e-3)
    assert everett(np.array([0.3]), np.array([0.3]))[0] == 0.0


def test_laboratories_differ_in_instruments_histories_and_zeros():
    """Two laboratories with the same ceramic differ only in declared properties."""
    rng = np.random.default_rng(1)
    laboratories = [draw_laboratory(rng) for _ in range(20)]
    moving = next(lab for lab in laboratories if lab.moves_zero and lab.most_turns)
    campaign, repeated, standard = (
        draw_campaign(9, truth="takacs", plans=("sweep", "check"), laboratory=laboratory)
        for laboratory in (moving, moving, None)
    )
    assert campaign.rig.sensor_bandwidth_Hz == moving.sensor_bandwidth_Hz
    assert campaign.rig.noise_rms_m == pytest.approx(moving.noise_share * standard.rig.stroke_m)
    offsets = []
    for rows, repeated_rows, standard_rows in zip(
        campaign.recordings, repeated.recordings, standard.recordings, strict=True
    ):
        assert np.array_equal(rows.displacement_m, repeated_rows.displacement_m)
        assert np.array_equal(rows.run.history_V[:2], standard_rows.run.history_V[:2])
        assert rows.run.history_V.max() <= campaign.rig.drive_max_V
        offsets.append(float(rows.noise_free_m[-1] - standard_rows.noise_free_m[-1]))
    assert abs(offsets[0] - offsets[1]) > 1e-4 * standard.rig.stroke_m
