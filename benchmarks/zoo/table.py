"""Summary of a run of the zoo: rows for all laws and kinds, with binomial intervals."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import beta, kstest

from benchmarks.zoo.score import UNNAMED, Case, ScoredFinding

LEVELS = (0.05, 1e-3, 1e-6)  # of the p-values of healthy stages


def summary_line(case: Case) -> str:
    """Return one stage in one line; ``<<<`` marks missed effects and false names."""
    head = f"{case.law} {case.kind} {case.seed}: {', '.join(case.hidden) or 'nothing'}"
    if case.failed:
        return f"{head} -> refused: {case.failed[:160]}"
    findings = "; ".join(map(_finding, case.findings)) or "nothing"
    if case.past_percent is not None:
        findings += f"; initial states change {case.past_percent:.3f} %"
    is_wrong = set(case.hidden) != set(case.names) or (not case.hidden and case.findings)
    return (
        f"{head} -> {findings} (residual {case.times_noise:.1f} times the noise, "
        f"{case.time_s:.0f} s){'  <<<' if is_wrong else ''}"
    )


def _finding(finding: ScoredFinding) -> str:
    text = f"{finding.name} p {finding.p_value:.1g}, {finding.value:.4g} {finding.unit}"
    if finding.truth is None:
        return text
    low, high = finding.ci95
    return f"{text} [{low:.4g}, {high:.4g}], true {finding.truth:.4g}"


def share(hits: int, total: int) -> str:
    """Return ``hits/total`` with the 95 % interval of Clopper and Pearson in percent."""
    if not total:
        return "-"
    low = beta.ppf(0.025, hits, total - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, total - hits) if hits < total else 1.0
    return f"{hits}/{total} ({100 * low:.0f}-{100 * high:.0f} %)"


def table(cases: Sequence[Case], kinds: Sequence[str]) -> str:
    """Return a row for each law and for all, then a row for each kind of stage."""
    diagnosed = [case for case in cases if not case.failed]
    laws = list(dict.fromkeys(case.law for case in cases))
    lines = [
        "| law | effects named | names right | something else | healthy accused | "
        "of these, only of a true initial state | "
        "intervals that hold | residual/noise of healthy stages, worst |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_row(law, [case for case in diagnosed if case.law == law]) for law in laws),
        _row("all", diagnosed),
        "",
        "| kind | effects named | names right |",
        "| --- | --- | --- |",
    ]
    for kind in kinds:
        stages = [case for case in diagnosed if case.kind == kind]
        if kind != "healthy" and stages:
            lines.append(f"| {kind} | {_named_share(stages)} | {_right_share(stages)} |")
    refused = len(cases) - len(diagnosed)
    return "\n".join([*lines, "", _uniformity(diagnosed), f"refused or not made: {refused}"])


def confusion(cases: Sequence[Case]) -> str:
    """Return for each hidden effect, and for healthy stages, the names that the diagnosis gave."""
    rows: dict[str, Counter[str]] = {}
    for case in cases:
        if case.failed:
            continue
        for name in case.hidden:
            rows.setdefault(name, Counter())["named" if name in case.names else "missed"] += 1
        false_names = [finding.name for finding in case.wrong]
        if not case.hidden:
            false_names += [f.name for f in case.findings if f.name == UNNAMED]
        for name in false_names:
            rows.setdefault("+".join(case.hidden) or "healthy", Counter())[f"said {name}"] += 1
    return "\n".join(
        f"  {name}: {', '.join(f'{outcome} {n}' for outcome, n in row.items())}"
        for name, row in sorted(rows.items())
    )


def _named_share(cases: Sequence[Case]) -> str:
    hits = sum(len(set(case.hidden) & set(case.names)) for case in cases)
    return share(hits, sum(len(case.hidden) for case in cases))


def _right_share(cases: Sequence[Case]) -> str:
    names = sum(len(case.names) for case in cases if case.hidden)
    return share(names - sum(len(case.wrong) for case in cases if case.hidden), names)


def _row(law: str, cases: Sequence[Case]) -> str:
    faulty = [case for case in cases if case.hidden]
    healthy = [case for case in cases if case.kind == "healthy"]
    coverage = [f.is_covered for case in cases for f in case.findings if f.is_covered is not None]
    unnamed = sum(UNNAMED in [f.name for f in case.findings] for case in faulty)
    worst = max((case.times_noise for case in healthy), default=0.0)
    return (
        f"| {law} | {_named_share(faulty)} | {_right_share(faulty)} | {unnamed}/{len(faulty)} | "
        f"{share(sum(bool(case.findings) for case in healthy), len(healthy))} | "
        f"{sum(case.is_only_initial_state for case in healthy)} | "
        f"{share(sum(coverage), len(coverage))} | {worst:.1f} |"
    )


def _uniformity(cases: Sequence[Case]) -> str:
    """Compare the p-values of healthy stages with a uniform distribution.

    Findings state p-values only below the level of the diagnosis, so the smallest of each stage
    is counted below LEVELS. Every stage has a p-value of its remaining structure, which the test
    of Kolmogorov and Smirnov compares.
    """
    healthy = [case for case in cases if case.kind == "healthy"]
    if not healthy:
        return "no healthy stage"
    smallest = np.array([min([1.0, *(f.p_value for f in case.findings)]) for case in healthy])
    counts = ", ".join(
        f"p <= {level:g} in {share(int(np.sum(smallest <= level)), len(smallest))}"
        for level in LEVELS
    )
    p_values = np.array([case.unexplained for case in healthy if case.unexplained is not None])
    text = f"healthy stages, smallest p of any finding: {counts}"
    if len(p_values) < 5:
        return text
    counts = ", ".join(str(n) for n in np.histogram(p_values, bins=10, range=(0.0, 1.0))[0])
    return (
        f"{text}\nhealthy stages, p of remaining structure: histogram of ten bins {counts}; "
        f"uniform with p {kstest(p_values, 'uniform').pvalue:.2g}"
    )
