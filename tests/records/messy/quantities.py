"""Recordings in unusual units, of unusual gain or polarity, or in closed loop."""

import numpy as np

from tests.records.messy.writers import (
    BY_NUMBER,
    COUNTS,
    NAMES,
    Messy,
    closed_loop_file,
    lines,
    scaled,
    text,
)

FILES: tuple[Messy, ...] = (
    Messy(
        "counts.csv",
        "a sensor in counts",
        scaled(1, 1, 1e4, names=(*NAMES[:2], "position [counts]")),
        entry=COUNTS,
        true_rows=np.zeros(0, dtype=int),
    ),
    Messy(
        "codes.csv",
        "counts of both converters under their own names",
        scaled(
            *(1, 1e3, 1e4),
            names=("time [s]", "DAC [codes]", "ADC [codes]"),
            written="{:.6g}".format,
        ),
        entry='columns = { time = 1, voltage = "DAC [codes]", displacement = "ADC [codes]" }\n'
        'units = { voltage = "codes", displacement = "codes" }\n'
        "scale = { voltage = 0.001, displacement = 1e-10 }\n",
    ),
    Messy(
        "tube.csv",
        "150 mV that move 16 um",
        scaled(1, 3.75, 1, names=("time [s]", "voltage [mV]", "position [um]")),
        entry="scale = { voltage = 266.6666666666667 }\n",
    ),
    Messy(
        "kilovolts.csv",
        "kilovolts under a heading of volts, beside a clean file",
        scaled(1, 1e-3, 1, written="{:.7f}".format),
        entry="scale = { voltage = 1000 }\n",
        needs_clean_file=True,
    ),
    Messy(
        "monitor.csv",
        "the 1/15 monitor of the drive, beside a clean file",
        scaled(1, 1 / 15, 1, written="{:.7f}".format),
        entry="scale = { voltage = 15 }\n",
        needs_clean_file=True,
    ),
    Messy(
        "polarity.csv",
        "the other polarity, beside a clean file",
        scaled(1, -1, 1),
        entry="scale = { voltage = -1 }\n",
        needs_clean_file=True,
    ),
    Messy(
        "exchanged.csv",
        "the headings of drive and displacement exchanged",
        text(lines(names=("time [s]", "position [um]", "voltage [V]"))),
        entry=BY_NUMBER,
    ),
    Messy(
        "nanometres.csv",
        "the same run in nanometres, beside the clean file",
        scaled(1, 1, 1e3, names=(*NAMES[:2], "position [nm]")),
        needs_clean_file=True,
    ),
    Messy(
        "held.csv",
        "the sensor held by a feedback while the drive creeps",
        closed_loop_file,
        true_rows=np.zeros(0, dtype=int),
    ),
)
