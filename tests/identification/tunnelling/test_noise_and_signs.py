"""What is told of a junction's signs: noise has none, a drive counted the wrong way is refused."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.weighted_fit import CurrentNoise
from piezoid_datasets.virtual_lab.junction import Junction
from tests.identification.tunnelling.loops import identified, record_of


def test_noise_is_that_of_the_size_of_a_current_whichever_way_it_flows() -> None:
    noise = CurrentNoise(floor_A=1e-12, relative=0.01, quantisation_A=0.0)
    mean_A = np.array([0.0, 1e-9, 1e-8])
    expected = 1e-24 + (0.01 * mean_A) ** 2
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(noise.variance(sign * mean_A), expected)


def test_a_current_that_falls_as_the_drive_rises_is_refused() -> None:
    record = record_of(Junction(), 10)
    turned = replace(record, drive_V=-record.drive_V)
    with pytest.raises(ExcitationError, match="the current falls as the drive rises"):
        identified(turned, Junction())
