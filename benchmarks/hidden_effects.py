"""How often the diagnosis names what a virtual laboratory has hidden.

Usage: python benchmarks/hidden_effects.py [CASES] [FIRST_SEED] [PROCESSES]

Single effects in turn, pairs, and nulls, each from seeds of its own. An effect that the laboratory
could not put in (less than a tenth of the size it asked for) is not counted as hidden. Counted
strictly: an effect is found where it is among the findings. Beside it stands how many more a
finding says it cannot be told from, and how often the 95 % intervals of sizes hold the
laboratory's own numbers.
"""

import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from multiprocessing import Pool
from pathlib import Path

import numpy as np

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.write import write_campaign

NAMES = tuple(effect.name for effect in EFFECTS)
HIDDEN = tuple(name for name in NAMES if name != "asymmetry")  # the simulation has dead zones
PAIRS, NULLS = 7, 4
PUT_IN = 0.1
CYCLE = len(HIDDEN) + PAIRS + NULLS
Numbers = Mapping[str, float | str]


def cut_off_percent(numbers: Numbers, rig: Rig) -> float:
    """Return the larger part of the drive's range, which every sweep covers, beyond a limit."""
    low_V, high_V = (rig.amplifier_gain_V_per_V * v for v in (rig.drive_min_V, rig.drive_max_V))
    above_V = high_V - float(numbers.get("high_V", high_V))
    below_V = float(numbers.get("low_V", low_V)) - low_V
    return 100.0 * max(above_V, below_V) / (high_V - low_V)


# what the laboratory calls the size that a finding gives, in the finding's unit
TRUE_SIZE: dict[str, Callable[[Numbers, Rig], float]] = {
    "creep": lambda n, _: 100.0 * float(n["creep_per_decade"]),
    "delay": lambda n, rig: 1e6 * float(n.get("delay_s", float(n.get("rows", 0)) / rig.clock_Hz)),
    "lag": lambda n, _: 1e6 * float(n["time_constant_s"]),
    "resonance": lambda n, _: float(n["frequency_Hz"]),
    "slew_limit": lambda n, rig: float(n["slew_V_per_s"]) / rig.amplifier_gain_V_per_V,
    "gain_change": lambda n, _: 100.0 * float(n["relative_change"]),
    "amplifier_saturation": cut_off_percent,
}


@dataclass(frozen=True, kw_only=True)
class Told:
    value: float
    ci95: tuple[float, float]
    truth: float

    @property
    def held(self) -> bool:
        return bool(self.ci95[0] <= self.truth <= self.ci95[1])


@dataclass(frozen=True, kw_only=True)
class Case:
    seed: int
    hidden: tuple[str, ...]
    truth: str = ""
    named: tuple[str, ...] = ()
    alike: tuple[str, ...] = ()
    sizes: Mapping[str, "Told"] = field(default_factory=dict)
    time_s: float = 0.0
    skipped: str = ""


def hidden_in(case: int, seed: int) -> tuple[str, ...]:
    turn = case % CYCLE
    if turn < len(HIDDEN):
        return (HIDDEN[turn],)
    if turn < len(HIDDEN) + PAIRS:
        chosen = np.random.default_rng([seed, 7]).choice(len(HIDDEN), 2, replace=False)
        return tuple(HIDDEN[int(k)] for k in chosen)
    return ()


def read_back(campaign: Campaign) -> tuple[list[Recording], Lab]:
    """Write a campaign as a laboratory hands it over, and read it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_campaign(campaign, place)
        lab = read_lab(place / "recordings/lab.toml")
        files = [place / f"recordings/{rows.run.name}.csv" for rows in campaign.recordings]
        return list(ingest_all(files, lab)), lab


def diagnosed(campaign: Campaign) -> tuple[Diagnosis, float]:
    recordings, lab = read_back(campaign)
    begun = time.process_time()
    return diagnose(recordings, lab=lab), time.process_time() - begun


def case_of(numbered: tuple[int, int]) -> Case:
    case, seed = numbered
    hidden = hidden_in(case, seed)
    try:
        campaign = draw_campaign(seed, effects=hidden)
    except ValueError as error:
        return Case(seed=seed, hidden=hidden, skipped=str(error))
    real = {
        effect.name
        for effect in campaign.answer.effects
        if effect.measured_percent > PUT_IN * effect.asked_percent
    }
    hidden = tuple(name for name in hidden if name in real)
    found, time_s = diagnosed(campaign)
    return Case(
        seed=seed,
        hidden=hidden,
        truth=campaign.answer.truth,
        named=found.names,
        alike=tuple(name for f in found.findings for name in f.not_separable_from),
        sizes={f.effect: _told(f, campaign) for f in found.findings if _sized(f, hidden)},
        time_s=time_s,
    )


def _sized(finding: Finding, hidden: tuple[str, ...]) -> bool:
    return finding.effect in hidden and finding.effect in TRUE_SIZE


def _told(finding: Finding, campaign: Campaign) -> Told:
    numbers = next(e.numbers for e in campaign.answer.effects if e.name == finding.effect)
    truth = TRUE_SIZE[finding.effect](numbers, campaign.rig)
    return Told(value=finding.size.value, ci95=finding.size.ci95, truth=truth)


def told(case: Case) -> str:
    if case.skipped:
        return f"{case.seed}: skipped, {case.skipped}"
    wrong = "" if set(case.named) == set(case.hidden) else "  <<<"
    alike = f" (or {', '.join(case.alike)})" if case.alike else ""
    sizes = "".join(
        f"; {name} {told.value:.4g} [{told.ci95[0]:.4g}, {told.ci95[1]:.4g}] is {told.truth:.4g}"
        for name, told in case.sizes.items()
    )
    return (
        f"{case.seed} {case.truth}: {', '.join(case.hidden) or 'null'} -> "
        f"{', '.join(case.named) or 'none'}{alike} ({case.time_s:.1f} s){sizes}{wrong}"
    )


def tally(case: Case) -> dict[str, int]:
    hidden, named = set(case.hidden), set(case.named)
    return {
        "hidden": len(hidden),
        "hits": len(hidden & named),
        "alike": len((hidden - named) & set(case.alike)),
        "named": len(named),
        "cases with a cause": int(bool(hidden)),
        "top": int(bool(named) and case.named[0] in hidden),
        "nulls": int(not hidden),
        "alarms": int(not hidden and bool(named)),
    }


def main(cases: int, first_seed: int, processes: int) -> None:
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    confusion: defaultdict[str, Counter[str]] = defaultdict(Counter)
    intervals: defaultdict[str, list[bool]] = defaultdict(list)
    times_s = []
    with Pool(processes) as pool:
        for case in pool.imap_unordered(case_of, [(k, first_seed + k) for k in range(cases)]):
            print(told(case), flush=True)
            if case.skipped:
                continue
            times_s.append(case.time_s)
            for title in ("all", case.truth):
                counts[title].update(tally(case))
            for name in case.hidden:
                confusion[name]["found" if name in case.named else "missed"] += 1
            for name in set(case.named) - set(case.hidden):
                confusion["+".join(case.hidden) or "null"][f"+{name}"] += 1
            for name, size in case.sizes.items():
                intervals[name].append(size.held)
    for title, count in counts.items():
        print(
            f"{title}: recall {count['hits']}/{count['hidden']} (and {count['alike']} said to be "
            f"inseparable), precision {count['hits']}/{count['named']}, "
            f"top-1 {count['top']}/{count['cases with a cause']}, "
            f"alarms {count['alarms']}/{count['nulls']}"
        )
    for name, row in sorted(confusion.items()):
        print(f"  {name}: {dict(row)}")
    for name, held in sorted(intervals.items()):
        print(f"  interval of {name} holds in {sum(held)}/{len(held)}")
    print(f"seconds of processor: median {np.median(times_s):.1f}, longest {max(times_s):.1f}")


if __name__ == "__main__":
    main(*(int(a) for a in (*sys.argv[1:], *("60", "1000", "2")[len(sys.argv) - 1 :])))
