"""The identified plant as a unit: no finding of FMPy's, and verification's loop to the bit."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from piezoid.export.fmu import fmu_files
from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.model import Discrepancy
from piezoid.operators.linear import first_order
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.targets.fmu_plant import plant_units
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import target_files
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import Hysteresis, Junction
from tests.runtime.compiler import found, run, write_files
from tests.targets.slave import Slave
from tests.verification.rig import PLANTS, RATE_Hz, junction, lateral, operator, stage

SEED = 7


def everything():
    """A lateral plant with everything that may stand beside the operator, large enough to see."""
    second = Discrepancy(
        threshold_V=np.array([0.2, 1.0]),
        weight_m=np.array([[2e-7, 1e-7], [1e-8, 2e-8]]),
        centre_V=0.1,
        reach_V=8.0,
        steepest_m_per_V=1e-7,
    )
    response = Hysteresis(
        operator=operator(1.05, 0.5),
        polarity=-1,
        history_V=(5.0, -4.0),
        discrepancy=second,
        low_V=-6.0,
        high_V=6.0,
        activation_s=0.01,
        activation_m=1e-7,
    )
    return lateral(
        response=response,
        rest_voltage_V=0.5,
        delay_s=2.3 / RATE_Hz,
        slew_V_per_s=2e3,
        sensor=(first_order(8.5e3),),
        reading_step=3e-10,
        reading_zero=2e-8,
        hums=((50.0, 4e-9), (150.0, 2e-9)),
        noise_bandwidth_Hz=2e3,
        cyclic=PeriodicError(wavelength_m=1e-6, cosine_m=(3e-9, 0.0), sine_m=(1e-9, 2e-9)),
    )


def behind_functions():
    """The same with plays behind functions."""
    edge_V = np.linspace(-6.0, 6.0, 4)
    straight = PreisachPlays(step_V=2.0, edge_V=edge_V, value_m=np.tile(edge_V, (3, 1)))
    rise_m = np.array([[9e-6, 7e-6, 8e-6], [2e-6, 1e-6, 5e-6], [4e-6, 3e-6, 0.0]])
    plant = everything()
    return replace(
        plant, axis="y", response=replace(plant.response, operator=straight.with_rises(rise_m))
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    found("cc", "gcc", "clang")
    folder = tmp_path_factory.mktemp("plants")
    exported = TargetInputs(file=stage("x"), plants=(PLANTS[0], PLANTS[2]))
    others, _ = fmu_files(
        plant_units("other", (everything(), behind_functions(), tip_elsewhere()))
    )
    written = {
        f"rig/{place}": made for place, made in target_files(exported, ["fmu"]).files.items()
    }
    written |= {f"other/fmu/{place}": made for place, made in others.items()}
    return write_files(folder, written)


def tip_elsewhere():
    return replace(junction(), rest_voltage_V=-2.5)


@pytest.fixture
def unit(made, tmp_path):
    opened = []

    def opens(which, **start):
        opened.append(Slave(made / which, tmp_path / str(len(opened)), **start))
        return opened[-1]

    yield opens
    for slave in opened:
        slave.close()
    shutil.rmtree(tmp_path, ignore_errors=True)


def driven(plant, voltage_V, disturbance=None):
    """Position and reading of the unit under a table of commands."""
    unit = "A" if "withdrawn_m" in plant.at else "m"
    entry = "withdrawn_m" if unit == "A" else "disturbance_m"
    rows = []
    for k, command in enumerate(voltage_V):
        rows.append((plant.get(f"position_{unit}"), plant.get(f"measured_{unit}")))
        plant.put("voltage_V", command)
        if disturbance is not None:
            plant.put(entry, disturbance[min(k + 1, len(disturbance) - 1)])
        plant.step()
    return np.array(rows).T


def looped(controller, plant, reference, unit="m"):
    """A master that steps the controller, then the plant: the order of a digital loop."""
    position = np.empty(len(reference))
    for k, wanted in enumerate(reference):
        position[k] = plant.get(f"position_{unit}")
        controller.put(f"reference_{unit}", wanted)
        controller.put(f"measured_{unit}", plant.get(f"measured_{unit}"))
        controller.step()
        plant.put("voltage_V", controller.get("voltage_V"))
        plant.step()
    return position


def swing(samples, amplitude, frequency_Hz=20.0):
    k = np.arange(samples)
    return amplitude * np.sin(2 * np.pi * frequency_Hz * k / RATE_Hz) * k / samples


@pytest.mark.parametrize("name", ["rig/fmu/x", "rig/fmu/z", "other/fmu/x"])
def test_fmpy_has_no_finding_and_units_are_declared(made, name):
    validation = pytest.importorskip("fmpy.validation")
    place = made / f"{name}_plant_fmi2.fmu"
    assert validation.validate_fmu(str(place)) == []
    import fmpy

    units = {v.name: v.unit for v in fmpy.read_model_description(str(place)).modelVariables}
    reading = "A" if name.endswith("z") else "m"
    assert units["voltage_V"] == "V"
    assert units[f"measured_{reading}"] == units[f"position_{reading}"] == reading


def test_a_loop_of_two_units_is_verifications_loop_to_the_last_bit(unit):
    """Without noise, because it is drawn by another generator."""
    parameters = stage("x").axis("x")
    reference = swing(3000, 1e-5)
    quiet = replace(PLANTS[0], noise_rms=0.0)
    wanted = run_axis(quiet, parameters, reference, rng=np.random.default_rng(0))
    ahead = np.minimum(np.arange(3000) + int(parameters.values["preview_samples"]), 2999)
    position = looped(
        unit("rig/fmu/x_controller_fmi2.fmu"),
        unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0.0),
        reference[ahead],
    )
    assert np.ptp(position) > 1e-6
    np.testing.assert_array_equal(position, wanted.position)


@pytest.mark.parametrize(
    "plant", [everything(), behind_functions()], ids=("dead zones", "functions")
)
def test_every_part_of_a_plant_answers_as_in_verification_to_the_last_bit(unit, plant):
    quiet = replace(plant, noise_rms=0.0, hums=())
    disturbance_m = swing(3000, 2e-7, 90.0)
    wanted = run_axis(
        quiet,
        stage("x").axis("x").for_method("none"),
        swing(3000, 2.5e-5),
        rng=np.random.default_rng(0),
        disturbance=disturbance_m,
    )
    assert np.ptp(wanted.voltage_V) > 10
    slave = unit(f"other/fmu/{plant.axis}_plant_fmi2.fmu", noise_factor=0.0)
    position, measured = driven(slave, wanted.voltage_V, disturbance_m)
    np.testing.assert_array_equal(position, wanted.position)
    np.testing.assert_array_equal(measured, wanted.measured)


@pytest.mark.parametrize("which", ["rig", "other"])
def test_a_tip_over_a_surface_reads_the_current_of_verification(unit, which):
    plant = PLANTS[2] if which == "rig" else tip_elsewhere()
    parameters, samples = stage().axis("z"), 3000
    assert isinstance(plant.response, Junction)
    height_m = swing(samples, 3e-10)
    wanted = run_axis(
        replace(plant, noise_rms=0.0),
        parameters,
        np.full(samples, float(parameters.values["current_reference_A"])),
        rng=np.random.default_rng(0),
        disturbance=plant.response.decay_per_m * height_m,
    )
    slave = unit(f"{which}/fmu/z_plant_fmi2.fmu", noise_factor=0.0)
    position, measured = driven(slave, wanted.voltage_V, height_m)
    assert np.ptp(wanted.position) > 1e-12
    np.testing.assert_allclose(position, wanted.position, rtol=1e-12)
    np.testing.assert_allclose(measured, wanted.measured, rtol=1e-12)


def test_a_plant_begins_at_rest_under_the_disturbance_that_is_there(unit):
    begun = driven(
        unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0, disturbance_m=3e-7), [0.0] * 50
    )
    calm = driven(unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0), [0.0] * 50)
    np.testing.assert_allclose(begun - calm, 3e-7, rtol=1e-9)


def test_noise_has_the_identified_size_and_bandwidth_and_comes_back_with_its_seed(unit):
    place, still = "other/fmu/x_plant_fmi2.fmu", np.full(20000, 0.5)
    first, again, other, none = (
        driven(unit(place, noise_seed=seed, noise_factor=factor), still)[1]
        for seed, factor in ((SEED, 1.0), (SEED, 1.0), (SEED + 1, 1.0), (SEED, 0.0))
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    added = first - none
    time_s = np.arange(len(added)) / RATE_Hz
    lines = {f: 2 * abs(np.mean(added * np.exp(-2j * np.pi * f * time_s))) for f in (50, 150)}
    assert lines[50] == pytest.approx(4e-9, rel=0.05)
    assert lines[150] == pytest.approx(2e-9, rel=0.05)
    hum_power = (lines[50] ** 2 + lines[150] ** 2) / 2
    assert (np.var(added) - hum_power) / 1e-18 == pytest.approx(1.0, rel=0.1)
    pole = np.exp(-2 * np.pi * 2e3 / RATE_Hz)
    slow = [np.cos(2 * np.pi * f / RATE_Hz) * lines[f] ** 2 / 2 for f in lines]
    near = np.mean((added[1:] - added.mean()) * (added[:-1] - added.mean())) - sum(slow)
    assert near / 1e-18 == pytest.approx(pole, rel=0.1)


def test_what_is_not_a_number_is_refused_and_a_parameter_is_fixed_once_it_runs(unit):
    slave = unit("rig/fmu/x_plant_fmi2.fmu")
    for name, value in (("voltage_V", np.nan), ("noise_factor", 0.5), ("noise_seed", 3)):
        with pytest.raises(Exception, match=r"fmi2Set"):
            slave.put(name, value)


def test_the_sources_inside_compile_with_every_warning(made, tmp_path):
    import zipfile

    strict = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
    for which in ("rig/fmu/z", "other/fmu/x"):
        folder = tmp_path / which.replace("/", "_")
        with zipfile.ZipFile(made / f"{which}_plant_fmi2.fmu") as zipped:
            zipped.extractall(folder)
        source = folder / "sources" / "fmu2.c"
        run(found("cc", "gcc", "clang"), *strict, "-c", str(source), "-o", str(tmp_path / "u.o"))
