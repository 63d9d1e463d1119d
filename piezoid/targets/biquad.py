"""The target `biquad`: PID and notches as the sections of boxes, and their price."""

from collections.abc import Mapping, Sequence

import numpy as np

from piezoid.errors import DesignError
from piezoid.export.c_header import inert
from piezoid.formatting import with_unit
from piezoid.targets.exported import Exported
from piezoid.targets.held_sections import Held, held_axis
from piezoid.targets.price import (
    FREQUENCIES_Hz,
    rejection_csv,
)
from piezoid.targets.section_boxes import BOXES

_README = """\
# {name}: second-order sections for {boxes}

The difference reference - reading is formed in front of the box's converter, for example by a
differential amplifier; its full scale is the range given below. Every section computes

    y = b0 x + b1 x' + b2 x'' + a1 y' + a2 y''

with dashes for the past and with a1 and a2 of this sign. `BOX.csv` holds the numbers, from codes
to codes, and as registers hold them; `rejection.csv` the curves of what follows. The rest of the
command is found by the integrator; begin with a small range of the output.

{sources}

{axes}
Tested: these numbers in the box's own arithmetic (rounding, saturation, limits, converters),
compared with other code of the same sources in the tests, and run at the box's rate against the
identified plant and others that the recordings allow, with hysteresis, creep, noise and the delay
of this stage's own converters. Standing still is part of it: a box that hunts or sticks is
refused. Not tested, because no such box was at hand: the firmware itself, the delay that it adds,
its analogue gains and offsets, and how settings are entered.
"""

_AXIS = """\
## Axis {axis}, {box}: {sections} sections at {rate}

Full scale of the difference +-{error}, of the output {low:.4g} V to {high:.4g} V of the command.

{price}.

| section | b0 | b1 | b2 | a1 | a2 |
| --- | --- | --- | --- | --- | --- |
{numbers}

Worst of {plants} plants: modulus margin {modulus:.2f}.

| | plant | rms error, exported controller | rms error, {box} | {box}, its best delay apart |
| --- | --- | --- | --- | --- |
{rows}
"""


def biquad_files(exported: Exported) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the folder's files by name, and sentences about what they cost.

    Raises ``DesignError`` where no box holds an axis, or not the one that was asked for.
    """
    asked = exported.box.format
    boxes = tuple(BOXES.values()) if asked is None else (BOXES[asked],)
    held: list[Held] = []
    notes = [
        f"axis {axis.axis} is not in biquad/: it regulates a current"
        for axis in exported.file.axes
        if axis.method == "rst"
    ]
    for axis in exported.lateral:
        refused: list[DesignError] = []
        for box in boxes:
            try:
                held.append(held_axis(exported, axis, box))
                notes.append(f"axis {axis.axis}: {held[-1].price}")
            except DesignError as error:
                refused.append(error)
                notes.append(f"not in biquad/: {error.found}")
        if len(refused) == len(boxes):
            raise refused[0]
    if not held:
        return {}, tuple(notes)
    names = tuple(dict.fromkeys(one.programmed.box.name for one in held))
    axes = tuple(dict.fromkeys(one.axis for one in held))
    files = {
        "README.md": _README.format(
            name=inert(exported.file.name),
            boxes=", ".join(names),
            sources="\n".join(f"- {name}: {BOXES[name].source}" for name in names),
            axes="\n".join(_section(one) for one in held),
        )
    }
    files |= {
        f"{name}.csv": _numbers_csv([one for one in held if one.programmed.box.name == name])
        for name in names
    }
    curves = {
        axis: {one.programmed.box.name: one.box_dB for one in held if one.axis == axis}
        for axis in axes
    }
    nothing = np.full(len(FREQUENCIES_Hz), np.nan)
    files["rejection.csv"] = rejection_csv(
        ("exported", *names),
        {
            axis: np.stack(
                [
                    next(one.own_dB for one in held if one.axis == axis),
                    *(curves[axis].get(name, nothing) for name in names),
                ],
                axis=1,
            )
            for axis in axes
        },
    )
    return {name: text.encode() for name, text in files.items()}, tuple(notes)


def _section(one: Held) -> str:
    chosen = one.programmed
    half = 2 ** (chosen.box.bits - 1)
    ends = (
        chosen.output_middle_V - half * chosen.output_step_V,
        chosen.output_middle_V + half * chosen.output_step_V,
    )
    return _AXIS.format(
        axis=one.axis,
        box=chosen.box.name,
        sections=len(chosen.coefficient),
        rate=with_unit(chosen.update_Hz, "Hz", 6),
        error=with_unit(half * chosen.input_step_m, "m"),
        low=ends[0],
        high=ends[1],
        price=one.price[0].upper() + one.price[1:],
        numbers="\n".join(
            f"| {k} | {' | '.join(f'{value:.9g}' for value in row)} |"
            for k, row in enumerate(chosen.coefficient)
        ),
        plants=one.plants,
        modulus=one.modulus,
        rows="\n".join(
            f"| {row.asked} | {row.plant} | {with_unit(row.own_m, 'm')} | "
            f"{with_unit(row.box_m, 'm')} | {with_unit(row.apart_m, 'm')} |"
            for row in one.rows
        ),
    )


def _numbers_csv(held: Sequence[Held]) -> str:
    lines = ["axis,section,coefficient,value,register,update_Hz"]
    for one in held:
        chosen = one.programmed
        for k, (row, raw) in enumerate(zip(chosen.coefficient, chosen.raw, strict=True)):
            for name, value, register in zip(
                ("b0", "b1", "b2", "a1", "a2"), row, raw, strict=True
            ):
                said = repr(float(register)) if chosen.box.point is None else str(int(register))
                lines.append(f"{one.axis},{k},{name},{float(value)!r},{said},{chosen.update_Hz!r}")
    return "\n".join([*lines, ""])
