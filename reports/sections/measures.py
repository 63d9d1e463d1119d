"""Five measures of one error, on one scale: what each means, and which may be quoted."""

import math

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid_reports.chart import decades_over
from piezoid_reports.page import Ladder, Page, Part, Rung, Section, scale_of_errors
from piezoid_reports.traces import Trace

LEAST_m = 1e-13


def render(page: Page) -> Section | None:
    """Return a ladder for each axis whose model applies."""
    parts: list[Part] = [_ladder(page, axis) for axis in page.axes if axis.verdict.applies]
    if not parts:
        return None
    return Section(
        anchor="measures",
        title="Which error to quote",
        lead="Noise, rms, 95 %, worst case and guarantee are answers to different questions; each "
        "step to the right promises more, and so allows more.",
        parts=tuple(parts),
    )


def _ladder(page: Page, axis: AxisModel) -> Ladder:
    rungs = tuple(sorted(_rungs(page, axis), key=lambda rung: rung.value_m))
    unit = scale_of_errors(axis)
    places = np.array([math.log10(rung.value_m / unit.factor) for rung in rungs])
    ends = np.array([places.min() - 0.3, places.max() + 0.3])
    scale = decades_over("error", [ends], unit.unit)
    return Ladder(title=f"Axis {axis.axis}", axis=scale, unit=unit, rungs=rungs)


def _rungs(page: Page, axis: AxisModel) -> list[Rung]:
    quality = axis.quality
    where = "data left out" if quality.is_tested else "the data of the fit"
    rungs = [
        Rung(
            name="sensor noise, rms",
            value_m=quality.noise_rms_m,
            meaning="of the sensor, not of the model; nothing below it can be seen",
            is_quotable=False,
        ),
        Rung(
            name="model error, rms",
            value_m=quality.held_out_rms_m,
            meaning=f"the usual error on {where}: quote it as the accuracy of the model",
            is_quotable=quality.is_tested,
        ),
        *_of_traces(page.traces.get(axis.axis, ())),
        Rung(
            name="bound of the model",
            value_m=axis.certificate.bound_m,
            meaning="without feedback, any drive in its range, 95 % confidence: quote it with its "
            "conditions",
            is_quotable=True,
        ),
        *_guaranteed(page, axis.axis),
    ]
    return [rung for rung in rungs if math.isfinite(rung.value_m) and rung.value_m > LEAST_m]


def _of_traces(traces: tuple[Trace, ...]) -> list[Rung]:
    if not traces:
        return []
    left = np.abs(np.concatenate([trace.residual_m for trace in traces]))
    left = left[np.isfinite(left)]
    return [
        Rung(
            name="model error, 95 % of the time",
            value_m=float(np.quantile(left, 0.95)),
            meaning="on the data of the fit: for orientation",
            is_quotable=False,
        ),
        Rung(
            name="model error, worst sample",
            value_m=float(left.max()),
            meaning="on the data of the fit; the next recording may hold a worse one",
            is_quotable=False,
        ),
    ]


def _guaranteed(page: Page, name: str) -> list[Rung]:
    found = page.verification
    if page.design is None or found is None or not found.passed or name not in found.methods:
        return []
    proven = [a.recommended.certificate for a in page.design.axes if a.axis == name]
    stroke_m = page.model.axes[name].quality.range_m
    return [
        Rung(
            name="guaranteed error of the loop",
            value_m=one.guaranteed_error_m,
            meaning="with feedback, against the delayed reference, never exceeded on the "
            "conditions of the chapter on controllers: quote it with them",
            is_quotable=True,
        )
        for one in proven
        if one is not None and one.is_guaranteed and one.guaranteed_error_m <= stroke_m
    ]
