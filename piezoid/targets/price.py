"""What a box loses beside the exported controller: rejection over the plants, in one sentence."""

from collections.abc import Mapping

import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.design.from_model import plant_family
from piezoid.design.hysteresis_bounds import affine_bounds
from piezoid.design.lateral import with_sector
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import sensitivities
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import decibel

FREQUENCIES_Hz = np.geomspace(1.0, 1000.0, 61)
_TOLD_Hz = (1.0, 10.0, 100.0)


def felt_family(model: AxisModel, rate_Hz: float) -> PlantFamily:
    """Return the plants as a box without an inverse of the hysteresis feels them."""
    bounds = affine_bounds(
        model.operator, model.certificate.reach_V, remainder_m=model.certificate.bound_m
    )
    return with_sector(plant_family(model, rate_Hz), bounds)


def shipped_rejection_dB(design: AxisDesign) -> Array:
    """Return the worst |Syp| of the exported controller over its family, (frequencies,)."""
    loop = design.recommended
    found = [np.abs(sensitivities(m, loop.R, loop.S, FREQUENCIES_Hz).Syp) for m in loop.members]
    return np.asarray(decibel(np.max(found, axis=0)))


def loss(structure: str, own_dB: Array, box_dB: Array) -> str:
    """Say what a structure loses below the frequency up to which the exported controller rejects.

    own_dB, box_dB  (frequencies,)  worst |Syp| at ``FREQUENCIES_Hz``
    """
    rejects = own_dB < 0.0
    last = len(rejects) if rejects.all() else int(np.argmin(rejects))
    if last == 0:
        return "the exported controller itself rejects nothing from 1 Hz on"
    at = {f: int(np.argmin(np.abs(FREQUENCIES_Hz - f))) for f in _TOLD_Hz}
    parts = ", ".join(
        f"{box_dB[k]:.1f} dB instead of {own_dB[k]:.1f} dB at {f:g} Hz"
        for f, k in at.items()
        if k < last
    )
    loss_dB = float(np.max((box_dB - own_dB)[:last]))
    how = "lose up to" if loss_dB > 0.0 else "gain at least"
    below = with_unit(float(FREQUENCIES_Hz[last - 1]), "Hz")
    return (
        f"with {structure} you {how} {abs(loss_dB):.1f} dB of rejection below {below} "
        f"({parts}; worst plants)"
    )


def rejection_csv(columns: tuple[str, ...], by_axis: Mapping[str, Array]) -> str:
    """Return the curves as a table: (frequencies, columns) of each axis, dB."""
    lines = [",".join(["axis", "frequency_Hz", *(f"{name}_dB" for name in columns)])]
    for axis, curves_dB in by_axis.items():
        for f, row in zip(FREQUENCIES_Hz, curves_dB, strict=True):
            lines.append(",".join([axis, f"{f:.6g}", *(f"{value:.3f}" for value in row)]))
    return "\n".join([*lines, ""])
