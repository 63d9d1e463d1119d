"""The public names of the package."""

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


def test_only_the_listed_names_are_public():
    assert set(piezoid.__all__) == VERBS | RECORDS | {"__version__"}
    assert list(piezoid.__all__) == sorted(piezoid.__all__)
    assert dir(piezoid) == list(piezoid.__all__)
    with pytest.raises(AttributeError, match="no public name 'calibration_of'"):
        _ = piezoid.calibration_of


@pytest.mark.parametrize("name", sorted(VERBS | RECORDS))
def test_every_public_name_has_a_docstring(name):
    value = getattr(piezoid, name)
    assert inspect.isfunction(value) == (name in VERBS)
    assert inspect.getdoc(value)
    assert value.__name__ == name


def test_folders_do_not_hide_verbs_of_their_name():
    code = (
        "import piezoid.design.design_stage, piezoid.export.bundle, piezoid\n"
        "from piezoid import design, export\n"
        "from piezoid.design.design_stage import design_stage\n"
        "assert callable(design) and callable(export)\n"
        "assert design is piezoid.design and piezoid.export is export\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_imports_are_lazy_and_computing_loads_no_plotting():
    heavy = ("numpy", "scipy", "pandas", "matplotlib", "piezoid.verbs", "piezoid.control_verbs")
    code = (
        f"import sys, piezoid; print([name for name in {heavy} if name in sys.modules])\n"
        "piezoid.fit; print('matplotlib' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert result.stdout.split() == ["[]", "False"]
