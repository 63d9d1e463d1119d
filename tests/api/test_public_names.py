"""The public list: these names and no others, whatever was imported before."""

import inspect
import subprocess
import sys

import pytest

import piezoid

VERBS = {
    *("calibrate", "design", "diagnose", "export", "fit", "fit_coupled", "load", "plan", "read"),
    *("from_arrays", "from_frame", "learn", "plot", "read_lab", "report", "save", "simulate"),
    *("simulate_loop", "to_frame", "verify"),
}
RECORDS = {
    *("ActuatorModel", "AxisDesign", "AxisModel", "Calibration", "Channel", "Collection"),
    *("Comparison", "CoupledStage", "Design", "Diagnosis", "Finding"),
    *("Lab", "LoopDesign", "LoopRecord", "ParameterFile", "PeriodicData", "PiezoidError", "Plan"),
    *("Quantity", "Recording", "Shipping", "Verification"),
    *("Learned", "VirtualStage"),
}


def test_the_list_is_what_users_may_rely_on() -> None:
    assert set(piezoid.__all__) == VERBS | RECORDS | {"__version__"}
    assert list(piezoid.__all__) == sorted(piezoid.__all__)
    assert dir(piezoid) == list(piezoid.__all__)


@pytest.mark.parametrize("name", sorted(VERBS | RECORDS))
def test_every_name_is_there_and_says_what_it_is(name: str) -> None:
    found = getattr(piezoid, name)
    assert inspect.isfunction(found) == (name in VERBS)
    assert inspect.getdoc(found)
    assert found.__name__ == name


def test_verbs_are_not_hidden_by_folders_of_their_name() -> None:
    code = (
        "import piezoid.design.design_stage, piezoid.export.bundle, piezoid\n"
        "from piezoid import design, export\n"
        "from piezoid.design.design_stage import design_stage\n"
        "assert callable(design) and callable(export)\n"
        "assert design is piezoid.design and piezoid.export is export\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_is_not_public_is_told() -> None:
    with pytest.raises(AttributeError, match="no public name 'calibration_of'"):
        _ = piezoid.calibration_of


def test_importing_the_package_loads_none_of_what_it_offers_and_computing_no_pictures() -> None:
    heavy = ("numpy", "scipy", "pandas", "matplotlib", "piezoid.verbs", "piezoid.control_verbs")
    code = (
        f"import sys, piezoid; print([name for name in {heavy} if name in sys.modules])\n"
        "piezoid.fit; print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["[]", "False"]
