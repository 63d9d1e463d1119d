"""Files in other formats: workbooks, archives, arrays, waves of microscopes."""

import json

import numpy as np

from tests.records.messy.writers import (
    BY_NUMBER,
    NAMES,
    VOLTAGE_V,
    Messy,
    POSITION_um,
    TIME_s,
    columns,
    computed_cells,
    cut_excel,
    dated_array,
    dated_parquet,
    empty_jpk,
    excel,
    igor,
    jpk,
    matlab,
    matlab_table,
    merged_cells,
    plain_sheet,
    raw,
    second_sheet,
    structured,
    text,
    zipped_csv,
)
from tests.records.microscopes import write_ibw

FILES: tuple[Messy, ...] = (
    Messy(
        "run.json",
        "JSON",
        raw(json.dumps(dict(zip(NAMES, columns().T.tolist(), strict=True))).encode()),
    ),
    Messy(
        "web.xls",
        "a page of HTML that calls itself a workbook",
        text(["<html><table><tr><td>0.001</td></tr></table></html>"]),
    ),
    Messy("sheet.xlsx", "an Excel workbook", excel(plain_sheet)),
    Messy(
        "second_sheet.xlsx",
        "the run on the second sheet, a summary on the third",
        excel(second_sheet),
    ),
    Messy("cut.xlsx", "an Excel workbook cut short", cut_excel),
    Messy(
        "old.xls",
        "a workbook of Excel 97",
        raw(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600)),
    ),
    Messy(
        "curve.jpk-force",
        "a force curve of JPK, which is a zip archive",
        jpk,
        true_rows=np.zeros(0, dtype=int),
    ),
    Messy("empty.jpk-force", "a JPK archive of which most parts are missing", empty_jpk),
    Messy("run.zip", "a CSV file in a zip archive", zipped_csv),
    Messy("structured.npy", "an array with named fields", structured),
    Messy("on_its_side.mat", "a 3 x 400 matrix", matlab(data=columns().T), entry=BY_NUMBER),
    Messy("wave.ibw", "a wave of Igor, with its labels and its clock", igor),
    Messy(
        "one_quantity.ibw",
        "a wave of Igor that holds the position alone",
        lambda path: write_ibw(path, POSITION_um, unit="um", step=1e-3, step_unit="s"),
    ),
    Messy(
        "scope.wfm",
        "a waveform as a Rigol oscilloscope stores it",
        raw(b"\xa5\xa5\x00\x00" + bytes(380)),
    ),
    Messy(
        "complex.mat",
        "a complex response, and a vector of another length",
        matlab(
            time_s=TIME_s,
            voltage_V=VOLTAGE_V,
            position_um=POSITION_um,
            response=np.exp(1j * TIME_s),
            window=np.ones(77),
        ),
    ),
    Messy("timetable.mat", "a MATLAB timetable", matlab_table),
    Messy("stamps.npy", "a structured array with dates and words", dated_array),
    Messy("dates.parquet", "Parquet of a data frame with an index of dates", dated_parquet),
    Messy(
        "merged.xlsx",
        "a merged title, units below the names, a mean at the end",
        excel(merged_cells),
    ),
    Messy("formulas.xlsx", "positions as formulas without stored values", excel(computed_cells)),
)
