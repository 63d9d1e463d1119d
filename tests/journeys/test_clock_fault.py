"""`piezoid fit` names clock slips in a stage whose loops are not a sum of plays.

Other effects, and none, are hidden in the same stage in tests/diagnosis/test_hidden_effects.py.
"""

import pytest

from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.numerics.arrays import Array
from tests.diagnosis.bench import causes, finding_of
from tests.diagnosis.play_stage import with_slip
from tests.diagnosis.test_hidden_effects import ONE_SPEED, RATE_Hz, recorded
from tests.journeys.command import run
from tests.laws import write

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")]

INSTANT, LOST = 1400, 9  # samples


def with_lost_samples(name: str, _: Array, response: Array) -> Array:
    """Remove samples of one recording: all later readings are too early."""
    return with_slip(response, INSTANT, -LOST) if name == "loops" else response


def test_a_clock_that_loses_samples_is_named_with_their_number(tmp_path):
    files = [
        write(
            tmp_path / f"{recording.name}.csv",
            recording.voltage_V() / 5.0 - 1.0,
            1e6 * recording.displacement_m(),
            rate_Hz=RATE_Hz,
        )
        for recording in recorded(ONE_SPEED, with_lost_samples)
    ]
    status, output = run("fit", *files, "--out", tmp_path / "stage", "--processes", "1")
    assert status == 0, output
    (diagnosis,) = read_diagnoses((tmp_path / "stage/diagnosis.json").read_bytes())
    assert causes(diagnosis) == ("timestamp_fault",)
    finding = finding_of(diagnosis, "timestamp_fault")
    assert finding.size.unit == "samples"
    assert finding.size.value == -LOST
    assert finding.size.ci95[0] < -LOST < finding.size.ci95[1]
    assert diagnosis.final.rms_m < 0.3 * diagnosis.baseline.rms_m
    assert "timestamp fault" in " ".join(output.split())
