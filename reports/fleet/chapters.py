"""The chapters of a batch that name stages: verdict, failures, what stands out, all of them."""

from heapq import nsmallest
from itertools import islice
from urllib.parse import quote

from piezoid_reports.fleet.findings import FALSE_ALARMS, FEWEST, Distribution
from piezoid_reports.fleet.records import (
    CRASHED,
    FAILED,
    PASSED,
    REFUSED,
    STAGES,
    STATES,
    Fleet,
    FleetStage,
)
from piezoid_reports.page import Part, Prose, Section, Table
from piezoid_reports.quantities import significant, told, told_between

HALF_95 = 1.96  # standard errors
WORST = 200  # rows of a table, so that the page of any batch opens at once


def verdict(fleet: Fleet, found: tuple[Distribution, ...]) -> Section:
    """Return what must be known if nothing else is read."""
    good, whole = fleet.counts.get(PASSED, 0), len(fleet.stages)
    tone = "good" if fleet.passed else "middling" if good >= 0.9 * whole else "bad"
    return Section(
        anchor="verdict",
        title="Verdict",
        lead="",
        parts=(Prose(text=" ".join((_counted(fleet), _odd(found), _drifting(found))), tone=tone),),
    )


def _counted(fleet: Fleet) -> str:
    good, whole = fleet.counts.get(PASSED, 0), len(fleet.stages)
    if fleet.passed:
        return f"All {whole} stages passed."
    kinds = ((FAILED, "failed a verdict"), (REFUSED, "could not be used"), (CRASHED, "broke off"))
    rest = [f"{n} {word}" for state, word in kinds if (n := fleet.counts.get(state, 0))]
    return f"{good} of {whole} stages passed; {', '.join(rest)}."


def _odd(found: tuple[Distribution, ...]) -> str:
    if not found:
        return f"Fewer than {FEWEST} stages can be compared, so nothing is said of the spread."
    far = sorted(
        ((abs(float(one.away[k])), one.stages[k]) for one in found for k in one.outliers),
        reverse=True,
    )
    odd = list(dict.fromkeys(name for _, name in far))
    if not odd:
        return "No stage stands out from the others in anything that was compared."
    shown = ", ".join(odd[:3])
    more = f" most, and {len(odd) - 3} more" if len(odd) > 3 else ""
    return (
        f"{len(odd)} {'stands' if len(odd) == 1 else 'stand'} out from the others: {shown}{more}."
    )


def _drifting(found: tuple[Distribution, ...]) -> str:
    named = [f"{one.quantity.label} of axis {one.axis}" for one in found if one.drifts]
    if named:
        return f"Over the serial numbers {', '.join(named)} drifts."
    if any(one.trend is not None for one in found):
        return "Nothing drifts over the serial numbers."
    return "Too few stages carry a serial number in their name to speak of drift."


def failures(fleet: Fleet) -> Section:
    """Return every stage that did not pass, with the reason as it was given."""
    rows = list(islice((s for s in fleet.stages if s.state != PASSED), WORST))
    parts: tuple[Part, ...] = (Prose(text="Every stage passed.", tone="good"),)
    if rows:
        parts = (
            Table(
                caption="Stages that did not pass."
                + _beyond(len(fleet.stages) - fleet.counts.get(PASSED, 0)),
                columns=("stage", "what happened", "reason"),
                rows=tuple((s.name, s.state, s.reason) for s in rows),
                links=tuple(_link(s) for s in rows),
            ),
        )
    lead = "; ".join(f"{state}: {meaning}" for state, meaning in STATES.items())
    return Section(
        anchor="failures", title="Failures and their reasons", lead=f"{lead}.", parts=parts
    )


def outliers(found: tuple[Distribution, ...]) -> Section:
    """Return the stages that stand out, farthest first."""
    rows = sorted(
        ((one, k) for one in found for k in one.outliers),
        key=lambda pair: -abs(pair[0].away[pair[1]]),
    )
    limit = min((one.limit for one in found), default=0.0)
    lead = (
        f"At least {limit:.1f} robust standard deviations from the others, of the logarithm where "
        "a quantity has a long tail. What a value's own interval allows is counted in: a stage "
        "whose data hardly tell a number does not stand out by it. The limit knows how often was "
        "looked and how well the spread is known: in a batch where nothing is wrong, chance alone "
        f"names {FALSE_ALARMS:g} stages at most."
    )
    if not rows:
        return Section(
            anchor="outliers",
            title="Stages that stand out",
            lead=lead if found else "",
            parts=(Prose(text="None.", tone="good"),),
        )
    return Section(
        anchor="outliers",
        title="Stages that stand out",
        lead=lead,
        parts=(
            Table(
                caption="Measured against the middle of all stages, or against the drift."
                + _beyond(len(rows)),
                columns=("stage", "axis", "quantity", "value", "middle", "away", "may be"),
                rows=tuple(_odd_row(one, k) for one, k in rows[:WORST]),
                links=tuple(_place(one.stages[k]) for one, k in rows[:WORST]),
            ),
        ),
    )


def _odd_row(one: Distribution, k: int) -> tuple[str, ...]:
    return (
        one.stages[k],
        one.axis,
        one.quantity.label,
        _value(one, k),
        told(one.spread.median, one.quantity.unit),
        f"{significant(float(one.away[k]), 2)} sigma",
        one.quantity.means,
    )


def _value(one: Distribution, k: int) -> str:
    """Return a value with its own 95 % interval, where it is known."""
    if not one.errors[k] > 0.0:
        return told(float(one.values[k]), one.quantity.unit)
    return told_between(float(one.values[k]), HALF_95 * float(one.errors[k]), one.quantity.unit)


def stages(fleet: Fleet) -> Section:
    """Return all stages with what they were made from and became, or the worst of very many."""
    shown, title = fleet.stages, "All stages, and where their numbers come from"
    if len(shown) > WORST:
        shown = nsmallest(WORST, shown, key=_badness)
        title = f"The worst {WORST} stages, and where their numbers come from"
    return Section(
        anchor="stages",
        title=title,
        lead="The same inputs and the same version give the same files, byte for byte. A stage "
        "whose inputs have changed is not the one this page speaks of.",
        parts=(
            Table(
                caption="Digests of the model and of the parameter file of every stage."
                + _beyond(len(fleet.stages)),
                columns=("stage", "state", "held-out error", "model.json", "params.json"),
                rows=tuple(_row(stage) for stage in shown),
                digests=(3, 4),
                links=tuple(_link(stage) for stage in shown),
            ),
        ),
    )


def _beyond(rows: int) -> str:
    """Say where the rows are that a table does not show."""
    if rows <= WORST:
        return ""
    return f" Of {rows} rows {WORST} are shown; all stages stand in parameters.parquet."


def _badness(stage: FleetStage) -> tuple[bool, float, str]:
    """Order stages: those that did not pass, then by the largest error on rows left out."""
    errors = [axis.values.get("held_out_rms_percent", 0.0) for axis in stage.axes]
    return stage.state == PASSED, -max(errors, default=0.0), stage.name


def _row(stage: FleetStage) -> tuple[str, ...]:
    shares = [axis.values.get("held_out_rms_percent") for axis in stage.axes]
    errors = ", ".join(told(share, "%") for share in shares if share is not None)
    made = [stage.outputs.get(name, "") for name in ("model.json", "params.json")]
    return stage.name, stage.state, errors, *made


def _link(stage: FleetStage) -> str:
    return _place(stage.name) if stage.state in (PASSED, FAILED) else ""


def _place(name: str) -> str:
    """Return where a stage's report lies; a name can be no scheme and no other place."""
    return f"./{STAGES}/{quote(name)}/report.html"
