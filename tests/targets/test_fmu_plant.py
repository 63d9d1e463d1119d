"""The identified plant as FMI unit: valid for FMPy, and bit for bit that of the verification."""

import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.model import Discrepancy
from piezoid.operators.linear import first_order
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.targets.fmu import fmu_files, plant_units
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import target_files
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import Hysteresis, Junction
from tests.runtime.compiler import require_tool, run, write_files
from tests.targets.slave import Slave
from tests.verification.rig import PLANTS, RATE_Hz, junction, lateral, operator, stage, swing

SEED = 7


def complete_plant():
    """Return a lateral plant with every optional part, each of a visible size."""
    discrepancy = Discrepancy(
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
        discrepancy=discrepancy,
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


def complete_plant_with_functions():
    """Return the complete plant with plays behind functions."""
    edge_V = np.linspace(-6.0, 6.0, 4)
    straight = PreisachPlays(step_V=2.0, edge_V=edge_V, value_m=np.tile(edge_V, (3, 1)))
    rise_m = np.array([[9e-6, 7e-6, 8e-6], [2e-6, 1e-6, 5e-6], [4e-6, 3e-6, 0.0]])
    plant = complete_plant()
    return replace(
        plant, axis="y", response=replace(plant.response, operator=straight.with_rises(rise_m))
    )


@pytest.fixture(scope="module")
def unit_folder(tmp_path_factory):
    require_tool("cc", "gcc", "clang")
    folder = tmp_path_factory.mktemp("plants")
    exported = TargetInputs(file=stage("x"), plants=(PLANTS[0], PLANTS[2]))
    other_files, _ = fmu_files(
        plant_units("other", (complete_plant(), complete_plant_with_functions(), withdrawn_tip()))
    )
    files = {
        f"rig/{name}": content for name, content in target_files(exported, ["fmu"])[0].items()
    }
    files |= {f"other/fmu/{name}": content for name, content in other_files.items()}
    return write_files(folder, files)


def withdrawn_tip():
    return replace(junction(), rest_voltage_V=-2.5)


@pytest.fixture
def unit(unit_folder, tmp_path):
    slaves = []

    def open_unit(name, **start):
        slaves.append(Slave(unit_folder / name, tmp_path / str(len(slaves)), **start))
        return slaves[-1]

    yield open_unit
    for slave in slaves:
        slave.close()
    shutil.rmtree(tmp_path, ignore_errors=True)


def run_open_loop(plant, voltage_V, disturbance=None):
    """Return position and reading of the unit for a table of commands."""
    unit_name = "A" if "withdrawn_m" in plant.references else "m"
    entry = "withdrawn_m" if unit_name == "A" else "disturbance_m"
    rows = []
    for k, command in enumerate(voltage_V):
        rows.append((plant.get(f"position_{unit_name}"), plant.get(f"measured_{unit_name}")))
        plant.put("voltage_V", command)
        if disturbance is not None:
            plant.put(entry, disturbance[min(k + 1, len(disturbance) - 1)])
        plant.step()
    return np.array(rows).T


def run_closed_loop(controller, plant, reference, unit="m"):
    """Step the controller, then the plant, as a digital loop does; return the position."""
    position = np.empty(len(reference))
    for k, sample in enumerate(reference):
        position[k] = plant.get(f"position_{unit}")
        controller.put(f"reference_{unit}", sample)
        controller.put(f"measured_{unit}", plant.get(f"measured_{unit}"))
        controller.step()
        plant.put("voltage_V", controller.get("voltage_V"))
        plant.step()
    return position


@pytest.mark.parametrize("name", ["rig/fmu/x", "rig/fmu/z", "other/fmu/x"])
def test_fmpy_has_no_finding_and_units_are_declared(unit_folder, name):
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    path = unit_folder / f"{name}_plant_fmi2.fmu"
    assert validation.validate_fmu(str(path)) == []
    units = {v.name: v.unit for v in fmpy.read_model_description(str(path)).modelVariables}
    reading = "A" if name.endswith("z") else "m"
    assert units["voltage_V"] == "V"
    assert units[f"measured_{reading}"] == units[f"position_{reading}"] == reading


def test_a_loop_of_two_units_is_verifications_loop_to_the_last_bit(unit):
    """Both have no noise, because their random generators differ."""
    parameters = stage("x").axis("x")
    reference = swing(3000, 1e-5)
    noiseless = replace(PLANTS[0], noise_rms=0.0)
    expected = run_axis(noiseless, parameters, reference, rng=np.random.default_rng(0))
    preview = np.minimum(np.arange(3000) + int(parameters.values["preview_samples"]), 2999)
    position = run_closed_loop(
        unit("rig/fmu/x_controller_fmi2.fmu"),
        unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0.0),
        reference[preview],
    )
    assert np.ptp(position) > 1e-6
    np.testing.assert_array_equal(position, expected.position)


@pytest.mark.parametrize(
    "plant", [complete_plant(), complete_plant_with_functions()], ids=("dead zones", "functions")
)
def test_every_part_of_a_plant_answers_as_in_verification_to_the_last_bit(unit, plant):
    noiseless = replace(plant, noise_rms=0.0, hums=())
    disturbance_m = swing(3000, 2e-7, 90.0)
    expected = run_axis(
        noiseless,
        stage("x").axis("x").for_method("none"),
        swing(3000, 2.5e-5),
        rng=np.random.default_rng(0),
        disturbance=disturbance_m,
    )
    assert np.ptp(expected.voltage_V) > 10
    slave = unit(f"other/fmu/{plant.axis}_plant_fmi2.fmu", noise_factor=0.0)
    position, measured = run_open_loop(slave, expected.voltage_V, disturbance_m)
    np.testing.assert_array_equal(position, expected.position)
    np.testing.assert_array_equal(measured, expected.measured)


@pytest.mark.parametrize("folder", ["rig", "other"])
def test_a_tip_over_a_surface_reads_the_current_of_verification(unit, folder):
    plant = PLANTS[2] if folder == "rig" else withdrawn_tip()
    parameters, samples = stage().axis("z"), 3000
    assert isinstance(plant.response, Junction)
    height_m = swing(samples, 3e-10)
    expected = run_axis(
        replace(plant, noise_rms=0.0),
        parameters,
        np.full(samples, float(parameters.values["current_reference_A"])),
        rng=np.random.default_rng(0),
        disturbance=plant.response.decay_per_m * height_m,
    )
    slave = unit(f"{folder}/fmu/z_plant_fmi2.fmu", noise_factor=0.0)
    position, measured = run_open_loop(slave, expected.voltage_V, height_m)
    assert np.ptp(expected.position) > 1e-12
    np.testing.assert_allclose(position, expected.position, rtol=1e-12)
    np.testing.assert_allclose(measured, expected.measured, rtol=1e-12)


def test_a_plant_begins_at_rest_under_the_disturbance_that_is_there(unit):
    disturbed = run_open_loop(
        unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0, disturbance_m=3e-7), [0.0] * 50
    )
    undisturbed = run_open_loop(unit("rig/fmu/x_plant_fmi2.fmu", noise_factor=0), [0.0] * 50)
    np.testing.assert_allclose(disturbed - undisturbed, 3e-7, rtol=1e-9)


def test_noise_has_the_identified_size_and_bandwidth_and_comes_back_with_its_seed(unit):
    name, drive_V = "other/fmu/x_plant_fmi2.fmu", np.full(20000, 0.5)
    noisy, repeated, reseeded, noiseless = (
        run_open_loop(unit(name, noise_seed=seed, noise_factor=factor), drive_V)[1]
        for seed, factor in ((SEED, 1.0), (SEED, 1.0), (SEED + 1, 1.0), (SEED, 0.0))
    )
    np.testing.assert_array_equal(noisy, repeated)
    assert not np.array_equal(noisy, reseeded)
    noise_m = noisy - noiseless
    time_s = np.arange(len(noise_m)) / RATE_Hz
    lines = {f: 2 * abs(np.mean(noise_m * np.exp(-2j * np.pi * f * time_s))) for f in (50, 150)}
    assert lines[50] == pytest.approx(4e-9, rel=0.05)
    assert lines[150] == pytest.approx(2e-9, rel=0.05)
    hum_power = (lines[50] ** 2 + lines[150] ** 2) / 2
    assert (np.var(noise_m) - hum_power) / 1e-18 == pytest.approx(1.0, rel=0.1)
    pole = np.exp(-2 * np.pi * 2e3 / RATE_Hz)
    hum_products = [np.cos(2 * np.pi * f / RATE_Hz) * lines[f] ** 2 / 2 for f in lines]
    product = np.mean((noise_m[1:] - noise_m.mean()) * (noise_m[:-1] - noise_m.mean())) - sum(
        hum_products
    )
    assert product / 1e-18 == pytest.approx(pole, rel=0.1)


def test_what_is_not_a_number_is_refused_and_a_parameter_is_fixed_once_it_runs(unit):
    slave = unit("rig/fmu/x_plant_fmi2.fmu")
    for name, value in (("voltage_V", np.nan), ("noise_factor", 0.5), ("noise_seed", 3)):
        with pytest.raises(Exception, match=r"fmi2Set"):
            slave.put(name, value)


def test_the_sources_inside_compile_with_every_warning(unit_folder, tmp_path):
    strict = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
    for name in ("rig/fmu/z", "other/fmu/x"):
        folder = tmp_path / name.replace("/", "_")
        with zipfile.ZipFile(unit_folder / f"{name}_plant_fmi2.fmu") as zipped:
            zipped.extractall(folder)
        source = folder / "sources" / "fmu2.c"
        run(
            require_tool("cc", "gcc", "clang"),
            *strict,
            "-c",
            str(source),
            "-o",
            str(tmp_path / "u.o"),
        )
