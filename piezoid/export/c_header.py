"""piezo_params.h: the parameter file as constants of the shipped structure.

Numbers are printed as the shortest decimals that read as the same doubles. If pz_real is float,
the compiler rounds them once more, as the packaged library does. The initialiser names its
members, so that a misspelt member does not compile.
"""

import ctypes
import re
import textwrap
from importlib.metadata import version
from typing import Any

import numpy as np

from piezoid.export.parameter_file import ParameterFile, used_values
from piezoid.runtime.library import PRECISIONS, SEALED, library
from piezoid.runtime.schema import PARAMETERS, TIP_PARAMETERS, VERSION

_UNSAFE = re.compile(r"[^A-Za-z0-9 .,:;()+=_-]")

_TOP = """\
/* Parameters of the piezoid runtime for the stage: {name}
 * {digest}
 * Written by piezoid {piezoid}. Do not edit: pz_check compares checksums; README.md states how
 * parameters are changed. Include this file in one source file only, because every file that
 * includes it gets a copy of the table. Comments: meaning [unit].
 */
#ifndef PIEZO_PARAMS_H
#define PIEZO_PARAMS_H

#include "piezoid_runtime.h"

#if PZ_SCHEMA_VERSION != {version}
#error "piezo_params.h has schema version {version}: take piezoid_runtime.h from its bundle"
#endif

#define PIEZO_PARAMS_DIGEST "{digest}"

enum {{ {enumerators}, PIEZO_AXES }};

/* Bit i: axis i is a tip axis, which regulates a current. */
#define PIEZO_TIP_AXES {tip_axes}u

#ifdef PZ_REAL_FLOAT
{sealed_float}
#else
{sealed_double}
#endif

typedef char piezo_params_fit_the_runtime[sizeof(pz_parameters) == PIEZO_PARAMS_SIZE ? 1 : -1];

static const pz_parameters piezo_params[PIEZO_AXES] = {{
"""

_BOTTOM = """\
}};
{decoupling}
#endif
"""

_DECOUPLING = """
/* In front of pz_step, for references and for readings alike, in the order {axes}:
 *     decoupled[i] = sum over k of piezo_decoupling[i][k] * axis[k]
 */
#define PIEZO_DECOUPLED {count}

static const pz_real piezo_decoupling[PIEZO_DECOUPLED][PIEZO_DECOUPLED] = {{
{rows}
}};
"""


def c_header(file: ParameterFile, digest: str) -> str:
    """Return the text of ``piezo_params.h``.

    digest  of ``params.json``, ``sha256:`` and 64 hexadecimal digits
    """
    sealed = {}
    for precision in PRECISIONS:
        opened = library(precision)
        lines = [f"#define PIEZO_PARAMS_SIZE {ctypes.sizeof(opened.parameters)}"]
        for axis in file.axes:
            checksum: int = opened.pack(axis.values).checksum
            lines.append(f"#define PIEZO_CHECKSUM_{axis.axis.upper()} 0x{checksum:08x}u")
        sealed[f"sealed_{precision}"] = "\n".join(lines)
    decoupling = ""
    if file.decoupled is not None:
        decoupling = _DECOUPLING.format(
            axes=", ".join(map(plain_ascii, file.decoupled.axes)),
            count=len(file.decoupled.axes),
            rows="\n".join(f"    {_literal(row)}," for row in file.decoupled.matrix),
        )
    top = _TOP.format(
        name=plain_ascii(file.name),
        digest=digest,
        piezoid=version("piezoid"),
        version=VERSION,
        enumerators=", ".join(
            f"PIEZO_AXIS_{axis.axis.upper()} = {index}" for index, axis in enumerate(file.axes)
        ),
        tip_axes=sum(1 << i for i, axis in enumerate(file.axes) if axis.is_tip),
        **sealed,
    )
    axes = []
    for axis in file.axes:
        name = axis.axis.upper()
        constants = ("PZ_SCHEMA_VERSION", "PIEZO_PARAMS_SIZE", f"PIEZO_CHECKSUM_{name}")
        symbols = dict(zip(SEALED, constants, strict=True))
        symbols["method"] = f"PZ_METHOD_{axis.method.upper()}"
        lines = []
        for parameter in PARAMETERS:
            value = symbols.get(parameter.name)
            is_for_tips = parameter.name in TIP_PARAMETERS and not axis.is_tip
            if is_for_tips and not axis.values[parameter.name].any():
                continue  # C sets the members that are left out to 0
            if value is None:
                used = used_values(parameter, axis.values[parameter.name])
                value = str(int(used)) if parameter.kind == "integer" else _literal(used)
            unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
            lines.append(f"        /* {parameter.meaning}{unit} */")
            lines += textwrap.wrap(
                f".{parameter.name} = {value},",
                width=99,
                initial_indent=" " * 8,
                subsequent_indent=" " * 12,
                break_long_words=False,
                break_on_hyphens=False,
            )
        if not axis.is_tip:
            lines.append("        /* All other members belong to a tip axis, and are 0. */")
        axes.append(f"    [PIEZO_AXIS_{name}] = {{\n" + "\n".join(lines) + "\n    },\n")
    return top + "".join(axes) + _BOTTOM.format(decoupling=decoupling)


def _literal(value: Any) -> str:
    """Return a number, or nested braces; an array of zeros alone is {PZ_REAL(0)}."""
    if value.ndim == 0:
        return f"PZ_REAL({float(value)!r})"
    rows = [_literal(np.asarray(row)) for row in value]
    return "{" + ", ".join(rows or ["{PZ_REAL(0)}" if value.ndim > 1 else "PZ_REAL(0)"]) + "}"


def plain_ascii(text: str, *, length: int = 80) -> str:
    """Return ``text`` as ASCII that is safe inside C comments, C strings and Markdown.

    Every character other than letters, digits, spaces and plain punctuation becomes ``_``, for
    example a star and slash, a backslash, a line end, a quotation mark or a trigraph.
    """
    return _UNSAFE.sub("_", text.replace("µ", "u"))[:length]
