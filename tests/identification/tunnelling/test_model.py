"""The family of plants covers the junctions, and the model survives its file."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.tunnelling.barrier_fit import fit_barrier
from piezoid.identification.tunnelling.closed_loop import (
    ClosedLoopFit,
    describe_loop_plant,
    spread_family,
)
from piezoid.identification.tunnelling.junction import TunnellingModel, fit_junction
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.record_json import from_json, to_json
from piezoid.records.lab import read_lab
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab.junction import Junction
from tests.identification.tunnelling.loops import identified, loop_records, record_of, rig_of
from tests.identification.tunnelling.sweeps import sweep
from tests.reports.known_stage import recording as stage_recording

LAB = """
[tunnelling]
set_point_A = 1e-9
floor_A = 1e-12
[axis.z.amplifier]
gain_V_per_V = 15
bandwidth_Hz = 4000
[axis.z.actuator]
gain_m_per_V = 1.2e-9
"""
REDUCED_PLANCK_Js, ELECTRON_kg, ELEMENTARY_C = 1.054571817e-34, 9.1093837015e-31, 1.602176634e-19


@pytest.fixture(scope="module")
def fits() -> list[ClosedLoopFit]:
    """Eight junctions of one rig with barriers around 4 eV, spread by 10 %."""
    barriers_eV = 4.0 * np.exp(0.1 * np.random.default_rng(33).standard_normal(8))
    junctions = [Junction(barrier_eV=barrier) for barrier in barriers_eV]
    records = loop_records(junctions, periods=11, seed=35)
    return [identified(r, j) for r, j in zip(records, junctions, strict=True)]


def half_gain_spread(family: Sequence[JunctionPlant]) -> float:
    _, low, high, *_ = family
    return 0.5 * float(np.log(high.gain_nepers_per_V / low.gain_nepers_per_V))


def test_the_family_covers_its_junctions(fits):
    nominal, *extremes = spread_family(fits)
    assert len(extremes) == 6
    for index, name in enumerate(("gain_nepers_per_V", "sensor_pole_Hz", "delay_s")):
        low, high = (getattr(member, name) for member in extremes[2 * index : 2 * index + 2])
        assert low < getattr(nominal, name) < high
        assert all(low <= getattr(member, name) <= high for member in extremes)
    gains = [fit.plant.gain_nepers_per_V for fit in fits]
    gain_low, gain_high, *_, delay_low, delay_high = extremes
    assert gain_low.gain_nepers_per_V < min(gains)
    assert gain_high.gain_nepers_per_V > max(gains)
    barriers_eV = []
    for member in (gain_low, gain_high):
        slope_per_m = member.gain_nepers_per_V / 18e-9  # nepers per metre of the tip's motion
        root = slope_per_m * REDUCED_PLANCK_Js / 2.0 / np.sqrt(2.0 * ELECTRON_kg)
        barriers_eV.append(root**2 / ELEMENTARY_C)
    assert barriers_eV[0] < 4.0 < barriers_eV[1]
    assert delay_low.delay_s < 30e-6 < delay_high.delay_s
    # The spread of the junctions: 5 % of gain, Student's quantile 2.36.
    assert 0.06 < half_gain_spread([nominal, *extremes]) < 0.25


def test_one_record_has_the_spread_of_its_uncertainty(fits):
    """One record shows no differences between records: its normal quantile."""
    expected = 1.96 * np.sqrt(fits[0].covariance[0, 0])
    assert half_gain_spread(spread_family(fits[:1])) == pytest.approx(expected, rel=1e-3)


def test_equal_junctions_have_no_spread_beyond_their_uncertainty():
    equal = Junction()
    fits = [identified(r, equal) for r in loop_records([equal] * 4, periods=11, seed=37)]
    uncertainty = np.sqrt(np.mean([fit.covariance[0, 0] for fit in fits]))
    assert half_gain_spread(spread_family(fits)) < 4.0 * uncertainty


def test_a_model_with_an_unbounded_interval_survives_its_file(rng, fits):
    model = TunnellingModel(
        gap_law=fit_barrier([sweep(rng)]).law,
        loop_plant=describe_loop_plant(fits, rig_of(Junction())),
    )
    weak = fit_barrier([sweep(rng, peak_A=0.02e-12, floor_A=0.05e-12)])
    assert weak.decay_interval_per_m[1] == np.inf
    for expected in (model, replace(model, gap_law=weak.law)):
        text = json.dumps(to_json(expected), allow_nan=False)
        assert from_json(TunnellingModel, json.loads(text)) == expected


def test_one_loop_among_other_recordings_gives_a_plant(tmp_path):
    (tmp_path / "lab.toml").write_text(LAB)
    lab, junction, sweep_of_x = read_lab(tmp_path / "lab.toml"), Junction(), stage_recording()
    record = record_of(junction, 9)
    loop = Recording(
        name="loop.csv",
        digest="sha256:made",
        axis="z",
        sampling_rate_Hz=record.sampling_rate_Hz,
        channels=(
            Channel(quantity=Quantity.VOLTAGE, axis="z", values=record.drive_V, label="u"),
            Channel(quantity=Quantity.CURRENT, axis="z", values=record.current_A, label="i"),
            Channel(quantity=Quantity.REFERENCE, axis="z", values=record.reference, label="r"),
        ),
    )
    kappa_per_m = np.sqrt(2.0 * ELECTRON_kg * junction.barrier_eV * ELEMENTARY_C)
    slope_per_V = 2.0 * kappa_per_m / REDUCED_PLANCK_Js * junction.drive_gain_m_per_V
    for recordings in ([loop, sweep_of_x], [sweep_of_x, loop], [loop]):
        tip = fit_junction([], recordings, lab)
        assert tip.loop_plant.plant.gain_nepers_per_V == pytest.approx(slope_per_V, rel=0.05)
        assert tip.gap_law is None
    assert fit_junction([], [sweep_of_x], lab) is None
