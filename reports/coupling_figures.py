"""Coupled axes: coupling matrix, error of the model, and changes with the level of the drive."""

import numpy as np

from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Heading, Part, Prose, Table
from piezoid_reports.quantities import MINUS, number, percent, significant

GAINS_Hz = 3  # frequencies at which the change of the gain is reported
LARGEST = 0.42  # of a cell: half the side of the square of the largest entry


def coupling_parts(page: Page, coupled: CoupledStage) -> list[Part]:
    """Return the parts of the dynamics section about coupled axes."""
    parts: list[Part] = [
        Heading(text="Coupled axes"),
        Prose(
            text="Every drive moves every displacement; behind the inverse of the matrix each "
            "axis answers to its own drive. The other sections show decoupled displacements."
        ),
        _picture(coupled),
        _matrix(coupled),
        _errors(coupled),
        _modes(coupled),
        *_gain(coupled),
    ]
    if page.verification is not None and page.verification.coupling:
        parts.append(_closed(page))
    return parts


def _picture(coupled: CoupledStage) -> Figure:
    """Draw the matrix as squares with areas proportional to its entries [Hinton diagram]."""
    gain = coupled.coupling_m_per_V
    x, y = (
        axis_over(label, [np.array([0.5, count + 0.5])], "")
        for label, count in (("drive", gain.shape[1]), ("displacement", gain.shape[0]))
    )
    canvas = Canvas(x=x, y=y)
    squares = {"model": "", "before": ""}
    for i, k in np.ndindex(*gain.shape):
        half = LARGEST * float(np.sqrt(abs(gain[i, k]) / np.abs(gain).max()))
        across, up = np.array([k + 1 - half, k + 1 + half]), np.full(2, float(i + 1))
        role = "model" if gain[i, k] >= 0.0 else "before"
        squares[role] += canvas.band(role, "", across, up - half, up + half).path
    names = {"model": "in the sense of the drive", "before": "against it"}
    layers = tuple(
        Layer(role=role, name=names[role], path=path, kind="area")
        for role, path in squares.items()
        if path
    )
    largest = number(float(np.abs(gain).max()), "m/V")
    return Figure(
        title="Which drive moves which displacement",
        caption=f"Columns are the drives {', '.join(coupled.inputs)}, rows from the bottom the "
        f"displacements {', '.join(coupled.outputs)}. The area of a square is the size of an "
        f"entry, the largest {largest}.",
        guide="Good: large squares along the rising diagonal. Bad: a large one beside it, which "
        "the decoupling must take away, or a small one on it.",
        canvas=canvas,
        layers=layers,
    )


def _matrix(coupled: CoupledStage) -> Table:
    return Table(
        caption="Displacement for each volt of a drive, and the matrix that decouples. It "
        "multiplies references and readings in front of the controllers.",
        columns=(
            "displacement",
            *(f"per volt of {name}" for name in coupled.inputs),
            *(f"of {name}" for name in coupled.outputs),
        ),
        rows=tuple(
            (
                name,
                *(number(float(v), "m/V") for v in gain),
                *(significant(float(v), 4) for v in row),
            )
            for name, gain, row in zip(
                coupled.outputs, coupled.coupling_m_per_V, coupled.decoupling, strict=True
            )
        ),
    )


def _errors(coupled: CoupledStage) -> Table:
    kind = (
        "each realisation left out of the fit once"
        if coupled.error_is_left_out
        else "in sample, for there are too few realisations to leave one out"
    )
    rows = [
        (
            number(float(level), "V"),
            name,
            percent(float(coupled.error_rms_m[k, i] / coupled.moved_rms_m[k, i])),
            number(float(coupled.error_rms_m[k, i]), "m"),
            percent(float(coupled.noise_rms_m[k, i] / coupled.moved_rms_m[k, i])),
        )
        for k, level in enumerate(coupled.levels_V)
        for i, name in enumerate(coupled.outputs)
    ]
    return Table(
        caption=f"Error of the model at each level of the drive, {kind}. Means of the periods, "
        "simulated from the drives alone; the noise is that of one period.",
        columns=("level, rms", "displacement", "error", "rms", "noise"),
        rows=tuple(rows),
    )


def _modes(coupled: CoupledStage) -> Table:
    low, high = float(coupled.levels_V[0]), float(coupled.levels_V[-1])
    rows = [
        (
            number(float(low_Hz), "Hz", 4),
            number(float(high_Hz), "Hz", 4),
            ", ".join(number(float(end), "Hz", 4) for end in interval)
            if np.isfinite(interval).all()
            else "",
            significant(float(low_damping)),
            significant(float(high_damping)),
            _signed(change[0]),
            ", ".join(map(_signed, change[1:])) if np.isfinite(change).all() else "",
        )
        for low_Hz, high_Hz, interval, low_damping, high_damping, change in zip(
            coupled.mode_frequency_Hz(low),
            coupled.mode_frequency_Hz(high),
            coupled.mode_frequency_interval_Hz(high),
            coupled.mode_damping(low),
            coupled.mode_damping(high),
            coupled.frequency_change(),
            strict=True,
        )
    ]
    return Table(
        caption=f"Modes at {number(low, 'V')} and {number(high, 'V')} rms, with 95 % intervals.",
        columns=(
            *("at the lowest level", "at the highest", "from, to", "damping", "damping"),
            *("change", "from, to"),
        ),
        rows=tuple(rows),
    )


def _gain(coupled: CoupledStage) -> list[Part]:
    if len(coupled.levels_V) < 2:
        return []
    first_Hz = float(coupled.mode_frequency_Hz(float(coupled.levels_V[0])).min())
    f = np.geomspace(coupled.band_Hz[0], 0.5 * first_Hz, GAINS_Hz)
    changes = [
        f"by {_signed(change)} at {number(float(frequency_Hz), 'Hz')}"
        for frequency_Hz, change in zip(f, coupled.gain_change(f), strict=True)
    ]
    return [
        Prose(text=f"From the lowest level to the highest the gain changes {', '.join(changes)}.")
    ]


def _closed(page: Page) -> Table:
    assert page.verification is not None
    rows = page.verification.coupling
    return Table(
        caption=f"Compiled controllers, {number(rows[0].frequency_Hz, 'Hz')}. "
        "One axis is moved, the other is to rest; amplitude of the other over that of the motion.",
        columns=("moved", "to rest", "with the matrix", "without it"),
        rows=tuple(
            (
                row.moved,
                row.answers,
                f"{significant(row.percent)} %",
                "does not settle"
                if row.without_percent is None
                else f"{significant(row.without_percent)} %",
            )
            for row in rows
        ),
    )


def _signed(share: float) -> str:
    """Return a change in percent with its sign."""
    sign = "+" if share >= 0.0 else MINUS
    return f"{sign}{significant(abs(100.0 * float(share)), 2)} %"
