"""A constructed model with an amplifier, a sensor and a tip, so that no test fits it."""

from dataclasses import replace

from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.dynamics.bandwidth import unmeasured
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import Lag
from piezoid.identification.tunnelling.junction import TunnellingModel
from tests.design.junction_lab import loop_plant
from tests.reports.known_stage import axis_model
from tests.verification.rig import lateral_parameters

SOURCES = {"sweep.csv": "sha256:" + "0" * 64}


def fitted():
    axis = replace(
        axis_model(),
        lag=Lag(kind="first_order", time_s=2.5e-4),
        rig=Rig(amplifier_bandwidth_Hz=4e3, sensor_bandwidth_Hz=8.5e3),
        bandwidth=unmeasured(12e3, "nothing was recorded"),  # of the data sheet
    )
    return ActuatorModel(stage="known", axes={"x": axis}, sources=SOURCES)


def junction_model(ratios=(1.0, 0.8, 1.25)):
    loop = loop_plant(ratios=ratios, further_members=())
    return replace(fitted(), tunnelling=TunnellingModel(gap_law=None, loop_plant=loop))


def shipped(method):
    """Hand-placed parameters with the known stage's centre."""
    offsets = {"voltage_offset_V": 5.0, "displacement_offset_m": 2e-6}
    return lateral_parameters().for_method(method).with_values(offsets)
