"""Controller: the exported C code for one axis, with its state."""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezoid.errors import ParameterFileError
from piezoid.numerics.arrays import Array
from piezoid.runtime.library import complete, library
from piezoid.runtime.schema import PARAMETERS


class Status(IntFlag):
    """Events of a sample: bits of the status word of the runtime."""

    BAD_REFERENCE = 1
    REFERENCE_LIMITED = 2
    BAD_MEASUREMENT = 4
    MEASUREMENT_LIMITED = 8
    STUCK_SENSOR = 16
    VOLTAGE_LIMITED = 32
    VOLTAGE_STEP = 64
    CURRENT_LOST = 128
    RETRACTED = 256
    RESTARTED = 512
    NOT_STARTED = 1024
    APPROACHING = 2048
    NO_CURRENT = 4096
    WRONG_SIGN = 8192
    LATCHED = 16384
    BLIND = 32768
    UNCERTIFIED = 65536


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Outputs of the controller for two arrays.

    voltage_V  (samples,)  V
    status     (samples,)  ``Status`` bits
    """

    voltage_V: Array
    status: NDArray[np.uint32]


class Controller:
    """The runtime with its parameters and state, in single or double precision.

    given      parameters by name, completed as by ``values.complete``
    precision  ``double`` or ``float``; what the target will be built with

    The parameters never change; the state changes with every step, as in the firmware. Raises
    ``ParameterFileError`` for parameters the runtime refuses.
    """

    def __init__(
        self, parameters: Mapping[str, ArrayLike | str], *, precision: str = "double"
    ) -> None:
        self.library = library(precision)
        self.parameters = self.library.pack(complete(parameters))
        self._state = (ctypes.c_uint32 * (self.library.state_size // 4))()
        self._addresses = (ctypes.addressof(self._state), ctypes.addressof(self.parameters))

    @property
    def addresses(self) -> tuple[int, int, int]:
        """Addresses of ``pz_step``, the state and the parameters, for a plant written in C.

        They are valid as long as this controller lives.
        """
        step = ctypes.cast(self.library.code.pz_step, ctypes.c_void_p).value
        assert step is not None
        return (step, *self._addresses)

    @property
    def reset_address(self) -> int:
        """Address of ``pz_reset``, as those of ``addresses``."""
        reset = ctypes.cast(self.library.code.pz_reset, ctypes.c_void_p).value
        assert reset is not None
        return reset

    @property
    def status(self) -> Status:
        """Status of the last step."""
        return Status(self._state[1])

    @property
    def status_ever(self) -> Status:
        """Every status since the start."""
        return Status(self._state[2])

    def start(self, voltage_V: float, measured: float) -> None:
        """Go to rest: the next step with reference == measured returns ``voltage_V``.

        voltage_V  V           present output of the converter
        measured   m (Z: A)    present reading of the sensor
        """
        number = self.library.code.pz_start(*self._addresses, voltage_V, measured)
        if number:
            raise ParameterFileError(
                f"the runtime cannot use {PARAMETERS[number - 1].name} any more",
                needed="parameters nobody has written to",
                remedy="Make a new Controller from the parameter file.",
            )

    def schedule(self, ratio: float) -> None:
        """Z: the plant's gain is now ``ratio`` times the one designed for."""
        self.library.code.pz_schedule(*self._addresses, ratio)

    def reset(self) -> None:
        """Continue after a latched fault, from the next step on."""
        self.library.code.pz_reset(ctypes.addressof(self._state))

    def step(self, reference: float, measured: float, feedforward_V: float | None = None) -> float:
        """Return the voltage for one sample; reference and measured in m (Z: A).

        feedforward_V  of a table, on top; None steps without one
        """
        code = self.library.code
        if feedforward_V is None:
            return float(code.pz_step(*self._addresses, reference, measured))
        return float(
            code.pz_step_feedforward(*self._addresses, reference, measured, feedforward_V)
        )

    def run(self, reference: Array, measured: Array) -> Run:
        """Step through arrays whose measurement does not depend on the output.

        reference, measured  (samples,)  m (Z: A)
        """
        if reference.ndim != 1 or reference.shape != measured.shape:
            raise ValueError(f"reference {reference.shape} and measured {measured.shape} differ")
        dtype = np.dtype(self.library.real)
        reference = np.ascontiguousarray(reference, dtype=dtype)
        measured = np.ascontiguousarray(measured, dtype=dtype)
        voltage = np.empty(len(reference), dtype=dtype)
        status = np.empty(len(reference), dtype=np.uint32)
        self.library.code.pz_run_many(
            *self._addresses,
            len(reference),
            reference.ctypes.data,
            measured.ctypes.data,
            voltage.ctypes.data,
            status.ctypes.data,
        )
        return Run(voltage_V=voltage.astype(np.float64), status=status)
