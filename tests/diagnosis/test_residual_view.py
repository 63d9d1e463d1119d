"""A view knows how much noise its readings have."""

import numpy as np

from .play_stage import NOISE_m, clean, healthy, view_with

HUM_m = 4.0 * NOISE_m


def test_the_noise_of_a_healthy_stage_is_what_was_put_in() -> None:
    assert np.isclose(healthy().noise * healthy().half_stroke_m, NOISE_m, rtol=0.1)


def test_a_hum_at_every_other_sample_is_no_more_noise_than_it_leaves() -> None:
    reading_m = clean("walk")[2]
    hum_m = HUM_m * (-1.0) ** np.arange(len(reading_m))
    view = view_with(walk=reading_m + hum_m)
    truth_m = np.sqrt(NOISE_m**2 + HUM_m**2 / len(view.tracks))
    assert np.isclose(view.noise * view.half_stroke_m, truth_m, rtol=0.1)
