"""A co-simulation unit in FMPy."""

import pytest

from tests.verification.rig import RATE_Hz

INTEGERS = ("noise_seed", "status")


class Slave:
    """A unit whose master steps ``samples`` periods at once and sums up the time."""

    def __init__(self, path, folder, *, samples=1, **start):
        fmpy = pytest.importorskip("fmpy")
        description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        unzipped = fmpy.extract(str(path), str(folder / path.stem))
        self.slave = fmpy.instantiate_fmu(unzipped, description, fmi_type="CoSimulation")
        for name, value in start.items():
            self.put(name, value)
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.now_s, self.step_s = 0.0, samples / RATE_Hz

    def put(self, name, value):
        if name in INTEGERS:
            self.slave.setInteger([self.references[name]], [value])
        else:
            self.slave.setReal([self.references[name]], [float(value)])

    def get(self, name):
        read = self.slave.getInteger if name in INTEGERS else self.slave.getReal
        return read([self.references[name]])[0]

    def step(self):
        self.slave.doStep(currentCommunicationPoint=self.now_s, communicationStepSize=self.step_s)
        self.now_s += self.step_s

    def close(self):
        self.slave.terminate()
        self.slave.freeInstance()
