"""Published examples, to nine digits."""

import numpy as np

from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

NINE_DIGITS = 1e-9


def test_example_1_of_al_janaideh_has_its_outputs_area_and_inverse():
    t = np.arange(150001) * 2e-5
    v = 4 * np.sin(2 * np.pi * t)
    operator = PrandtlIshlinskii(
        threshold=np.array([0, 0.45, 0.9, 1.35, 1.8, 2.25, 2.7]),
        weight=np.array([0.72, 0.6, 0.48, 0.36, 0.24, 0.12, 0.012]),
    )
    y, _ = operator.run(v, operator.virgin_memory())
    assert abs(y.max() - 8.2056) < NINE_DIGITS
    assert abs(y.min() + 8.2056) < NINE_DIGITS
    assert abs(y[75000] - 1.8456) < NINE_DIGITS
    assert abs(y[50000] + 1.8456) < NINE_DIGITS
    last_cycle = slice(100000, 150001)
    area = abs(np.trapezoid(y[last_cycle], v[last_cycle]))
    assert abs(area - 20.202480) < 1e-5  # the sampled loop's polygon
    inverse = operator.inverse()
    np.testing.assert_allclose(
        inverse.threshold, [0, 0.324, 0.918, 1.728, 2.7, 3.78, 4.914], rtol=NINE_DIGITS
    )
    np.testing.assert_allclose(
        inverse.weight,
        [
            *(1.3888888889, -0.6313131313, -0.2020202020, -0.0925925926),
            *(-0.0462962963, -0.0198412698, -0.0018806891),
        ],
        rtol=2e-8,  # the printed digits
    )
    recovered, _ = inverse.run(y, operator.inverse_memory(operator.virgin_memory()))
    assert np.abs(recovered - v).max() < 1e-14


def test_example_4_of_al_janaideh_dead_zones_before_plays():
    t = np.arange(10001) * 3 / 10000
    v = 5 * np.sin(2 * np.pi * t)
    positive = np.array([0.4, 0.75, 1, 1.25, 1.5, 1.75, 2, 2.25, 2.5, 2.75, 3])
    weight = np.array(
        [
            *(-1.1275, -1.1155, -0.7925, -0.5975, -0.413, -0.2705),
            *(-0.1715, -0.106, -0.066, -0.041, -0.025),
        ]
    )
    zones = DeadZones(
        threshold=np.concatenate([-positive[::-1], [0], positive]),
        weight=np.concatenate([weight[::-1], [4.7645], weight]),
    )
    w = zones.run(v)
    assert abs(w.max() - 5.046625) < NINE_DIGITS
    assert abs(zones.slope[-1] - 0.0385) < NINE_DIGITS
    r = 0.45 * np.arange(7)
    plays = PrandtlIshlinskii(threshold=r, weight=0.65 * np.exp(-7.75e-4 * r))
    y, _ = plays.run(w, plays.virgin_memory())
    assert abs(y.max() - 16.8049127635) < NINE_DIGITS
    assert abs(y[5000] - 5.9040113436) < NINE_DIGITS
