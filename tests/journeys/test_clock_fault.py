"""`piezoid fit` names a clock that slips in a stage whose loops are no sum of plays.

The other effects of the catalogue are hidden in the same stage in tests/diagnosis.
"""

from pathlib import Path

import pytest

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.numerics.arrays import Array
from tests.diagnosis.bench import causes
from tests.diagnosis.play_stage import slipped
from tests.diagnosis.test_hidden_effects import ONE_SPEED, RATE_Hz, Reading, as_it_is, recorded
from tests.journeys.command import run
from tests.laws import write

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]

INSTANT, LOST = 1400, 9  # samples


def with_lost_samples(name: str, _: Array, response: Array) -> Array:
    """Lose samples of one recording: all later readings come early."""
    return slipped(response, INSTANT, -LOST) if name == "loops" else response


def diagnosed(folder: Path, read: Reading) -> tuple[Diagnosis, str]:
    """Return the diagnosis that `piezoid fit` writes, and what it prints."""
    files = [
        write(
            folder / f"{recording.name}.csv",
            recording.voltage_V() / 5.0 - 1.0,
            1e6 * recording.displacement_m(),
            rate_Hz=RATE_Hz,
        )
        for recording in recorded(ONE_SPEED, read)
    ]
    status, shown = run("fit", *files, "--out", folder / "stage", "--processes", "1")
    assert status == 0, shown
    (diagnosis,) = read_diagnoses((folder / "stage/diagnosis.json").read_bytes())
    return diagnosis, " ".join(shown.split())


def test_a_clock_that_loses_samples_is_named_with_their_number(tmp_path: Path) -> None:
    diagnosis, shown = diagnosed(tmp_path, with_lost_samples)
    assert causes(diagnosis) == ("timestamp_fault",)
    finding = next(one for one in diagnosis.findings if one.effect == "timestamp_fault")
    assert finding.size.unit == "samples"
    assert finding.size.value == -LOST
    assert finding.size.ci95[0] < -LOST < finding.size.ci95[1]
    assert diagnosis.final.rms_m < 0.3 * diagnosis.baseline.rms_m
    assert "timestamp fault" in shown


def test_the_healthy_twin_of_a_stage_with_a_clock_fault_is_not_accused(tmp_path: Path) -> None:
    diagnosis, shown = diagnosed(tmp_path, as_it_is)
    assert causes(diagnosis) == ()
    assert "timestamp fault" not in shown
