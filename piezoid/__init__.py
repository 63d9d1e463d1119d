"""Turn recordings of a piezo stage into a calibrated, verified controller.

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

_MODULES = {
    "calibration.calibrate": ("Calibration",),
    "control_verbs": ("design", "export", "learn", "simulate_loop", "verify"),
    "design.design": ("AxisDesign", "Design", "LoopDesign"),
    "diagnosis.diagnosis": ("Diagnosis", "Finding"),
    "diagnosis.experiment": ("Plan",),
    "errors": ("PiezoidError",),
    "export.parameter_file": ("ParameterFile",),
    "figures": ("plot",),
    "identification.actuator_model": ("ActuatorModel",),
    "identification.coupled.coupled_stage": ("CoupledStage",),
    "identification.coupled.fit_coupled": ("fit_coupled",),
    "identification.dynamics.frequency_response": ("PeriodicData",),
    "identification.model": ("AxisModel",),
    "identification.simulation": ("Comparison",),
    "learning.learn": ("Learned",),
    "records.collection": ("Collection",),
    "records.frames": ("from_arrays", "from_frame", "to_frame"),
    "records.lab": ("Lab",),
    "records.recording": ("Channel", "Quantity", "Recording"),
    "sealed_files": ("load", "save"),
    "verbs": ("calibrate", "diagnose", "fit", "plan", "read", "read_lab", "report"),
    "verification.tracking": ("LoopRecord",),
    "verification.verification": ("Verification",),
    "verification.verify_stage": ("Shipping",),
    "virtual_stage": ("VirtualStage", "simulate"),
}
# Module of each public name.
_PUBLIC = {name: f"piezoid.{module}" for module, names in _MODULES.items() for name in names}

if TYPE_CHECKING:  # at run time __getattr__ imports these names
    from piezoid.calibration.calibrate import Calibration as Calibration
    from piezoid.control_verbs import design as design
    from piezoid.control_verbs import export as export
    from piezoid.control_verbs import learn as learn
    from piezoid.control_verbs import simulate_loop as simulate_loop
    from piezoid.control_verbs import verify as verify
    from piezoid.design.design import AxisDesign as AxisDesign
    from piezoid.design.design import Design as Design
    from piezoid.design.design import LoopDesign as LoopDesign
    from piezoid.diagnosis.diagnosis import Diagnosis as Diagnosis
    from piezoid.diagnosis.diagnosis import Finding as Finding
    from piezoid.diagnosis.experiment import Plan as Plan
    from piezoid.errors import PiezoidError as PiezoidError
    from piezoid.export.parameter_file import ParameterFile as ParameterFile
    from piezoid.figures import plot as plot
    from piezoid.identification.actuator_model import ActuatorModel as ActuatorModel
    from piezoid.identification.coupled.coupled_stage import CoupledStage as CoupledStage
    from piezoid.identification.coupled.fit_coupled import fit_coupled as fit_coupled
    from piezoid.identification.dynamics.frequency_response import PeriodicData as PeriodicData
    from piezoid.identification.model import AxisModel as AxisModel
    from piezoid.identification.simulation import Comparison as Comparison
    from piezoid.learning.learn import Learned as Learned
    from piezoid.records.collection import Collection as Collection
    from piezoid.records.frames import from_arrays as from_arrays
    from piezoid.records.frames import from_frame as from_frame
    from piezoid.records.frames import to_frame as to_frame
    from piezoid.records.lab import Lab as Lab
    from piezoid.records.recording import Channel as Channel
    from piezoid.records.recording import Quantity as Quantity
    from piezoid.records.recording import Recording as Recording
    from piezoid.sealed_files import load as load
    from piezoid.sealed_files import save as save
    from piezoid.verbs import calibrate as calibrate
    from piezoid.verbs import diagnose as diagnose
    from piezoid.verbs import fit as fit
    from piezoid.verbs import plan as plan
    from piezoid.verbs import read as read
    from piezoid.verbs import read_lab as read_lab
    from piezoid.verbs import report as report
    from piezoid.verification.tracking import LoopRecord as LoopRecord
    from piezoid.verification.verification import Verification as Verification
    from piezoid.verification.verify_stage import Shipping as Shipping
    from piezoid.virtual_stage import VirtualStage as VirtualStage
    from piezoid.virtual_stage import simulate as simulate

__all__ = tuple(sorted(("__version__", *_PUBLIC)))


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
    """Package whose attributes ``design`` and ``export`` remain the verbs.

    Importing ``piezoid.design.design_stage`` would otherwise replace the verb by the subpackage.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _PUBLIC and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
