"""Plausibility of drive and response: sense of rotation of the loop, limits of the amplifier."""

import numpy as np
import pytest

from piezoid.records.collection import collect
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import LAWS, triangles, write


def quantities_of(recording: Recording) -> set[str]:
    return {problem.quantity for problem in recording.statements}


@pytest.mark.parametrize("truth", ZOO, ids=[truth.name for truth in ZOO])
def test_exchanged_headings_are_reported_with_their_columns(truth, tmp_path):
    field = triangles(5, 240, 0.15)
    ceramic = truth.draw(np.random.default_rng(41))
    displacement_um = 20 * sum(ceramic.respond(field, np.array([1.0, -1.0])))
    displacement_um += 0.01 * np.random.default_rng(2).standard_normal(len(field))
    right = write(tmp_path / "right.csv", field, np.asarray(displacement_um))
    assert "leads" not in quantities_of(collect([right])[0])
    exchanged = write(tmp_path / "exchanged.csv", displacement_um / 5 - 2, 5 * field)
    (text,) = [
        statement.text
        for statement in collect([exchanged])[0].statements
        if statement.quantity == "leads"
    ]
    assert 'columns = { voltage = "displacement [um]"' in text


def test_exchanged_headings_of_a_random_drive_are_reported(tmp_path):
    """Its loops are small against the box of its range."""
    noise = np.random.default_rng(9).standard_normal(6000)
    smooth = np.convolve(noise, np.hanning(60), mode="valid")
    field = smooth / np.abs(smooth).max()
    displacement_um = 10.0 * LAWS["plays"](field)
    right = write(tmp_path / "right.csv", field, displacement_um)
    exchanged = write(tmp_path / "exchanged.csv", displacement_um / 5.0, 5.0 * field)
    assert "leads" not in quantities_of(collect([right])[0])
    assert "leads" in quantities_of(collect([exchanged])[0])


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["", "with a noisy drive"])
def test_a_single_branch_has_no_sense_of_rotation(noise, tmp_path):
    field = np.linspace(-1.0, 1.0, 400) + noise * np.random.default_rng(3).standard_normal(400)
    for displacement in (field + 0.3 * field**2, field - 0.3 * field**2):
        assert "leads" not in quantities_of(
            collect([write(tmp_path / "one.csv", field, displacement)])[0]
        )


@pytest.mark.parametrize("law", LAWS)
def test_a_limit_of_the_amplifier_is_reported_in_volts(law, tmp_path):
    field = triangles(6, 300, 0.05)
    noise_um = 0.008 * np.random.default_rng(7).standard_normal(len(field))

    def stops_V(drive: np.ndarray) -> list[float | None]:
        path = write(tmp_path / "a.csv", field, 10.0 * LAWS[law](drive) + noise_um)
        return [s.value for s in collect([path])[0].statements if s.quantity == "stands"]

    assert stops_V(field) == []
    assert stops_V(np.minimum(field, 0.7)) == [pytest.approx(3.5, abs=0.15)]
    both_V = stops_V(np.clip(field, -0.7, 0.7))
    assert both_V == [pytest.approx(3.5, abs=0.15), pytest.approx(-3.5, abs=0.15)]


@pytest.mark.parametrize("law", LAWS)
def test_steps_and_rests_of_the_drive_are_no_limit(law, tmp_path):
    rng = np.random.default_rng(8)
    steps = np.repeat(rng.uniform(-1.0, 1.0, 60), 30)
    rests = np.concatenate(
        [np.r_[part, np.full(60, part[-1])] for part in np.split(triangles(6, 300), 12)]
    )
    for field in (steps, rests):
        noise_um = 0.008 * rng.standard_normal(len(field))
        path = write(tmp_path / "a.csv", field, 10.0 * LAWS[law](field) + noise_um)
        assert "stands" not in quantities_of(collect([path])[0])
