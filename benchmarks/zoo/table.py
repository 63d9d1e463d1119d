"""What a run of the zoo comes to: a row for each law, with binomial intervals."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from benchmarks.zoo.score import ELSE, Case

LEVELS = (0.05, 1e-3, 1e-6)  # at which stated p-values of healthy stages are counted


def told(case: Case) -> str:
    """Return one stage in one line; ``<<<`` marks what is missed or wrong."""
    head = f"{case.law} {case.kind} {case.seed}: {', '.join(case.hidden) or 'nothing'}"
    if case.failed:
        return f"{head} -> refused: {case.failed[:160]}"
    said = "; ".join(
        f"{s.name} p {s.p_value:.1g}, {s.value:.4g} {s.unit}" + _interval(s) for s in case.said
    )
    if case.past_percent is not None:
        said = f"{said or 'nothing'}; its past moves {case.past_percent:.3f} %"
    mark = (
        "  <<<" if set(case.hidden) != set(case.names) or (not case.hidden and case.said) else ""
    )
    return (
        f"{head} -> {said or 'nothing'} ({case.times_noise:.1f} of the noise, "
        f"{case.time_s:.0f} s){mark}"
    )


def _interval(said) -> str:
    if said.truth is None:
        return ""
    return f" [{said.ci95[0]:.4g}, {said.ci95[1]:.4g}] is {said.truth:.4g}"


def share(hits: int, of: int) -> str:
    """Return ``hits/of`` with Clopper and Pearson's 95 % interval in percent."""
    from scipy.stats import beta

    if not of:
        return "-"
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return f"{hits}/{of} ({100 * low:.0f}-{100 * high:.0f} %)"


def table(cases: Sequence[Case], kinds: Sequence[str]) -> str:
    """Return rows for laws and for all, then one for each size and number of effects."""
    judged = [case for case in cases if not case.failed]
    laws = list(dict.fromkeys(case.law for case in cases))
    lines = [
        "| law | effects named | names right | something else beside | healthy accused | "
        "of these, only of a past that is there | "
        "intervals that hold | noise left in healthy stages, worst |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_row(law, [case for case in judged if case.law == law]) for law in laws),
        _row("all", judged),
        "",
        "| kind | effects named | names right |",
        "| --- | --- | --- |",
    ]
    for kind in kinds:
        of_kind = [case for case in judged if case.kind == kind]
        if kind != "healthy" and of_kind:
            lines.append(f"| {kind} | {_named(of_kind)} | {_right(of_kind)} |")
    refused = len(cases) - len(judged)
    return "\n".join([*lines, "", _uniformity(judged), f"refused or not made: {refused}"])


def confusion(cases: Sequence[Case]) -> str:
    """Return what each effect was taken for, and of what healthy stages were accused."""
    rows: dict[str, Counter[str]] = {}
    for case in cases:
        if case.failed:
            continue
        for name in case.hidden:
            rows.setdefault(name, Counter())["named" if name in case.names else "missed"] += 1
        blamed = [s.name for s in case.wrong]
        if not case.hidden:
            blamed += [s.name for s in case.said if s.name == ELSE]
        for name in blamed:
            rows.setdefault("+".join(case.hidden) or "healthy", Counter())[f"said {name}"] += 1
    return "\n".join(
        f"  {name}: {', '.join(f'{what} {n}' for what, n in row.items())}"
        for name, row in sorted(rows.items())
    )


def _named(cases: Sequence[Case]) -> str:
    hits = sum(len(set(case.hidden) & set(case.names)) for case in cases)
    return share(hits, sum(len(case.hidden) for case in cases))


def _right(cases: Sequence[Case]) -> str:
    names = sum(len(case.names) for case in cases if case.hidden)
    return share(names - sum(len(case.wrong) for case in cases if case.hidden), names)


def _row(law: str, cases: Sequence[Case]) -> str:
    sick = [case for case in cases if case.hidden]
    healthy = [case for case in cases if case.kind == "healthy"]
    held = [s.held for case in cases for s in case.said if s.held is not None]
    elses = sum(ELSE in [s.name for s in case.said] for case in sick)
    worst = max((case.times_noise for case in healthy), default=0.0)
    return (
        f"| {law} | {_named(sick)} | {_right(sick)} | {elses}/{len(sick)} | "
        f"{share(sum(bool(case.said) for case in healthy), len(healthy))} | "
        f"{sum(case.fair for case in healthy)} | {share(sum(held), len(held))} | {worst:.1f} |"
    )


def _uniformity(cases: Sequence[Case]) -> str:
    """Return whether p-values stated of healthy stages are probabilities.

    A stage's p is the smallest of its findings', which is stated only below the level of the
    engine; so it is counted below levels. What is left has a p always: it is held against the
    uniform distribution [Kolmogorov and Smirnov].
    """
    from scipy.stats import kstest

    healthy = [case for case in cases if case.kind == "healthy"]
    if not healthy:
        return "no healthy stage"
    least = np.array([min([1.0, *(s.p_value for s in case.said)]) for case in healthy])
    counted = ", ".join(
        f"p <= {level:g} in {share(int(np.sum(least <= level)), len(least))}" for level in LEVELS
    )
    left = np.array([case.unexplained for case in healthy if case.unexplained is not None])
    text = f"healthy stages, smallest p of any finding: {counted}"
    if len(left) < 5:
        return text
    tenths = ", ".join(str(n) for n in np.histogram(left, bins=10, range=(0.0, 1.0))[0])
    return (
        f"{text}\nhealthy stages, p of what is left: tenths hold {tenths}; "
        f"uniform with p {kstest(left, 'uniform').pvalue:.2g}"
    )
