"""One co-simulation unit in FMPy, stepped by its master."""

import pytest

from tests.verification.rig import RATE_Hz

INTEGERS = ("noise_seed", "status")


class Slave:
    """One unit; its master steps ``samples`` periods at once, and sums up the time."""

    def __init__(self, place, folder, *, samples=1, **start):
        fmpy = pytest.importorskip("fmpy")
        described = fmpy.read_model_description(str(place))
        self.at = {v.name: v.valueReference for v in described.modelVariables}
        unzipped = fmpy.extract(str(place), str(folder / place.stem))
        self.slave = fmpy.instantiate_fmu(unzipped, described, fmi_type="CoSimulation")
        for name, value in start.items():
            self.put(name, value)
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.now_s, self.step_s = 0.0, samples / RATE_Hz

    def put(self, name, value):
        if name in INTEGERS:
            self.slave.setInteger([self.at[name]], [value])
        else:
            self.slave.setReal([self.at[name]], [float(value)])

    def get(self, name):
        read = self.slave.getInteger if name in INTEGERS else self.slave.getReal
        return read([self.at[name]])[0]

    def step(self):
        self.slave.doStep(currentCommunicationPoint=self.now_s, communicationStepSize=self.step_s)
        self.now_s += self.step_s

    def close(self):
        self.slave.terminate()
        self.slave.freeInstance()
