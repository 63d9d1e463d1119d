"""From recordings of a piezo stage to a calibrated, verified controller.

    import piezoid

    recordings = piezoid.read("sweep.csv", "check.csv", lab="lab.toml")
    model = piezoid.fit(recordings, lab="lab.toml")
    diagnosis = piezoid.diagnose(recordings, model=model, lab="lab.toml")
    model = model.extended(diagnosis)
    design = piezoid.design(model, lab="lab.toml")
    shipping = piezoid.export(model, design, lab="lab.toml")

Each verb takes frozen records and returns one frozen record: recordings -> ActuatorModel ->
Diagnosis -> Design -> ParameterFile and Verification. ``__all__`` is the public interface; a name
is imported when it is first used.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

# Name to the module that holds it.
_PUBLIC = {
    **dict.fromkeys(
        (
            *("calibrate", "design", "diagnose", "export", "fit", "learn", "plan"),
            *("read", "read_lab", "report", "simulate_loop", "verify"),
        ),
        "piezoid.verbs",
    ),
    "ActuatorModel": "piezoid.identification.actuator_model",
    "AxisDesign": "piezoid.design.design",
    "AxisModel": "piezoid.identification.model",
    "Calibration": "piezoid.calibration.calibrate",
    "Channel": "piezoid.records.recording",
    "Collection": "piezoid.records.collection",
    "Comparison": "piezoid.identification.prediction",
    "CoupledStage": "piezoid.identification.coupled.coupled_stage",
    "Design": "piezoid.design.design",
    "Diagnosis": "piezoid.diagnosis.diagnosis",
    "Finding": "piezoid.diagnosis.diagnosis",
    "Lab": "piezoid.records.lab",
    "Learned": "piezoid.learning.learn",
    "LoopDesign": "piezoid.design.design",
    "LoopRecord": "piezoid.verification.closed_loop",
    "ParameterFile": "piezoid.export.parameter_file",
    "PeriodicData": "piezoid.identification.dynamics.periodic_estimate",
    "PiezoidError": "piezoid.errors",
    "Plan": "piezoid.diagnosis.experiment",
    "Quantity": "piezoid.records.recording",
    "Recording": "piezoid.records.recording",
    "Shipping": "piezoid.verification.release",
    "Verification": "piezoid.verification.verification",
    "VirtualStage": "piezoid.virtual_stage",
    "fit_coupled": "piezoid.identification.coupled.fit_coupled",
    "from_arrays": "piezoid.records.frames",
    "from_frame": "piezoid.records.frames",
    "load": "piezoid.sealed_files",
    "plot": "piezoid.figures",
    "save": "piezoid.sealed_files",
    "simulate": "piezoid.virtual_stage",
    "to_frame": "piezoid.records.frames",
}

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration
    from piezoid.design.design import AxisDesign, Design, LoopDesign
    from piezoid.diagnosis.diagnosis import Diagnosis, Finding
    from piezoid.diagnosis.experiment import Plan
    from piezoid.errors import PiezoidError
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.figures import plot
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.identification.coupled.coupled_stage import CoupledStage
    from piezoid.identification.coupled.fit_coupled import fit_coupled
    from piezoid.identification.dynamics.periodic_estimate import PeriodicData
    from piezoid.identification.model import AxisModel
    from piezoid.identification.prediction import Comparison
    from piezoid.learning.learn import Learned
    from piezoid.records.collection import Collection
    from piezoid.records.frames import from_arrays, from_frame, to_frame
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Channel, Quantity, Recording
    from piezoid.sealed_files import load, save
    from piezoid.verbs import (
        calibrate,
        design,
        diagnose,
        export,
        fit,
        learn,
        plan,
        read,
        read_lab,
        report,
        simulate_loop,
        verify,
    )
    from piezoid.verification.closed_loop import LoopRecord
    from piezoid.verification.release import Shipping
    from piezoid.verification.verification import Verification
    from piezoid.virtual_stage import VirtualStage, simulate

__all__ = (
    "ActuatorModel",
    "AxisDesign",
    "AxisModel",
    "Calibration",
    "Channel",
    "Collection",
    "Comparison",
    "CoupledStage",
    "Design",
    "Diagnosis",
    "Finding",
    "Lab",
    "Learned",
    "LoopDesign",
    "LoopRecord",
    "ParameterFile",
    "PeriodicData",
    "PiezoidError",
    "Plan",
    "Quantity",
    "Recording",
    "Shipping",
    "Verification",
    "VirtualStage",
    "__version__",
    "calibrate",
    "design",
    "diagnose",
    "export",
    "fit",
    "fit_coupled",
    "from_arrays",
    "from_frame",
    "learn",
    "load",
    "plan",
    "plot",
    "read",
    "read_lab",
    "report",
    "save",
    "simulate",
    "simulate_loop",
    "to_frame",
    "verify",
)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'piezoid' has no public name {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)


class _Package(ModuleType):
    """Package whose ``design`` and ``export`` stay the verbs, although folders have these names.

    Importing ``piezoid.design.design_stage`` would otherwise replace the verb by the folder.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _PUBLIC and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
