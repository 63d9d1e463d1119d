"""Contract of extensions: registered, without side effects, restored from JSON, bounded."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import piezoid.identification.extensions as family
from piezoid.identification.extensions import EXTENSIONS, LAYOUT_OF_EXTENSIONS
from piezoid.identification.extensions.extension import NOTHING, Extension, Where
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.numerics.arrays import Array
from piezoid.record_json import from_json, to_json
from tests.identification.extensions.samples import RATE_Hz, one_of_each, where

LAYOUTS = (LAYOUT_OF_EXTENSIONS,)
ids = {"ids": lambda extension: extension.kind}


def test_every_file_of_the_folder_is_registered():
    folder = Path(family.__file__).parent
    files = {path.stem for path in folder.glob("*.py")}
    assert files - {"__init__", "extension"} == {
        extension_class.__module__.rpartition(".")[2] for extension_class in EXTENSIONS
    }
    assert len({extension_class.kind for extension_class in EXTENSIONS}) == len(EXTENSIONS)
    assert {type(extension) for extension in one_of_each()} == set(EXTENSIONS)


def test_an_unknown_kind_is_refused_by_name():
    with pytest.raises(ValueError, match="'warp_drive'"):
        from_json(Extension, {"kind": "warp_drive"}, LAYOUTS)


@pytest.mark.parametrize("extension", one_of_each(), **ids)
def test_an_extension_survives_json_and_its_parameter_vector(extension):
    written = json.loads(json.dumps(to_json(extension, LAYOUTS)))
    assert from_json(Extension, written, LAYOUTS) == extension
    free = extension.free()
    assert extension.moved_to(free.value) == extension
    assert ((free.lower <= free.value) & (free.value <= free.upper)).all()
    assert (free.step > 0.0).all()
    rows = extension.prior()
    assert not len(rows) or rows.shape[1] == len(free.value)


def outputs_of(extension: Extension, drive_V: Array, piece: Where) -> dict[str, Array]:
    """Return the outputs of an extension for a drive, and for a displacement of 1 um/V."""
    input_m = 1e-6 * drive_V
    input_m.setflags(write=False)
    return {
        "drive": extension.drive(drive_V, RATE_Hz),
        "irreversible": extension.irreversible(input_m, RATE_Hz),
        "response": extension.response(input_m, piece),
        "reading": extension.reading(input_m, piece),
        "added": input_m + extension.added(piece),
        "gain": input_m * extension.gain(piece),
    }


@pytest.mark.parametrize("extension", one_of_each(), **ids)
def test_an_extension_changes_an_output_but_not_its_input(extension):
    piece = where()
    drive_V = 5.0 + 5.0 * np.sin(2 * np.pi * 7.0 * piece.time_s)
    original = drive_V.copy()
    outputs = outputs_of(extension, drive_V, piece)
    inputs = {name: original if name == "drive" else 1e-6 * original for name in outputs}
    assert any(np.any(outputs[name] != inputs[name]) for name in outputs)
    np.testing.assert_array_equal(drive_V, original)


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 40])
@pytest.mark.parametrize("extension", one_of_each(), **ids)
def test_short_and_constant_signals_have_finite_outputs_of_their_length(extension, samples):
    for signal in (np.full(samples, 0.4), np.resize([0.3, -0.2, 0.9], samples)):
        piece = replace(where(samples), samples=samples)
        for name, output in outputs_of(extension, signal, piece).items():
            assert np.shape(output) == signal.shape, name
            assert np.isfinite(output).all(), name


@pytest.mark.parametrize("extension", one_of_each(), **ids)
def test_a_stage_at_rest_stays_at_rest(extension):
    constant_m = np.full(3000, 2e-6)
    response_m = extension.response(constant_m, where(3000, "other.csv"))
    np.testing.assert_allclose(response_m, response_m[0], rtol=1e-12)


@pytest.mark.parametrize("extension", [e for e in one_of_each() if e.is_fast], **ids)
def test_a_slow_ramp_is_delayed_by_the_stated_group_delay(extension):
    time_s = where().time_s
    delay_s = time_s - extension.response(time_s, where())
    assert delay_s[-1] == pytest.approx(extension.group_delay_s(RATE_Hz), rel=1e-3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("extension", one_of_each(), ids=lambda extension: extension.kind)
def test_a_corner_of_a_wide_interval_is_an_extension(extension, sign):
    free = extension.free()
    for value in (free.lower, free.value, free.upper):
        bound = extension.moved_to(np.clip(value, free.lower, free.upper))
        wide = replace(bound, std=tuple(10.0 * np.abs(free.value) + 1.0))
        assert wide.at_corner(sign, sign).kind == extension.kind


def test_a_mode_without_participation_is_not_a_state_of_a_loop():
    mode = LinearMode(frequency_Hz=240.0, quality=4.0, participation=0.0)
    assert mode.loop_effect(RATE_Hz) is NOTHING
