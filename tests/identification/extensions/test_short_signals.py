"""Every extension on signals of no, one, two and three samples, constant ones, and one turn."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extensions.extension import Extension
from tests.identification.extensions.samples import RATE_Hz, one_of_each, where

SIGNALS = {
    "none": np.zeros(0),
    "one": np.array([0.3]),
    "two": np.array([0.3, -0.2]),
    "three": np.array([0.3, -0.2, 0.9]),
    "constant": np.full(50, 0.4),
    "one turn": np.concatenate([np.linspace(0.0, 1.0, 20), np.linspace(1.0, 0.5, 20)]),
}


@pytest.mark.parametrize("length", SIGNALS)
@pytest.mark.parametrize("extension", one_of_each(), ids=lambda extension: extension.kind)
def test_an_extension_is_finite_and_of_the_length_of_its_signal(
    extension: Extension, length: str
) -> None:
    signal = SIGNALS[length]
    piece = replace(where(len(signal)), samples=len(signal))
    moved = 1e-6 * signal
    outputs = {
        "drive": extension.drive(signal, RATE_Hz),
        "irreversible": extension.irreversible(moved, RATE_Hz),
        "response": extension.response(moved, piece),
        "reading": extension.reading(moved, piece),
        "added": extension.added(piece) + np.zeros(len(signal)),
        "gain": extension.gain(piece) * np.ones(len(signal)),
    }
    for place, output in outputs.items():
        assert np.shape(output) == signal.shape, place
        assert np.isfinite(output).all(), place
