"""How often the diagnosis names what a virtual laboratory has hidden.

Usage: python benchmarks/hidden_effects.py [CASES] [FIRST_SEED]

Single effects in turn, pairs, and nulls, each from seeds of its own; a cause counts as found where
it is among the findings, or where a finding says that it cannot be told from it.
"""

import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.write import write_campaign

NAMES = tuple(effect.name for effect in EFFECTS)
HIDDEN = tuple(name for name in NAMES if name != "asymmetry")  # the simulation has dead zones
CYCLE = len(HIDDEN) + 7 + 4  # singles, pairs, nulls


def hidden_in(case: int, seed: int) -> tuple[str, ...]:
    turn = case % CYCLE
    if turn < len(HIDDEN):
        return (HIDDEN[turn],)
    if turn < len(HIDDEN) + 7:
        chosen = np.random.default_rng([seed, 7]).choice(len(HIDDEN), 2, replace=False)
        return tuple(HIDDEN[int(k)] for k in chosen)
    return ()


def diagnosed(campaign: Campaign) -> tuple[Diagnosis, float]:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_campaign(campaign, place)
        lab = read_lab(place / "recordings/lab.toml")
        files = [place / f"recordings/{rows.run.name}.csv" for rows in campaign.recordings]
        recordings = ingest_all(files, lab)
    begun = time.process_time()
    return diagnose(recordings, lab=lab), time.process_time() - begun


def main(cases: int, first_seed: int) -> None:
    counts: Counter[str] = Counter()
    confusion: defaultdict[str, Counter[str]] = defaultdict(Counter)
    by_truth: defaultdict[str, Counter[str]] = defaultdict(Counter)
    times_s = []
    for case in range(cases):
        seed = first_seed + case
        hidden = hidden_in(case, seed)
        try:
            campaign = draw_campaign(seed, effects=hidden)
        except ValueError as error:
            print(f"{seed}: skipped, {error}")
            continue
        found, time_s = diagnosed(campaign)
        times_s.append(time_s)
        named = set(found.names)
        truth = campaign.answer.truth
        hits, false = set(hidden) & named, named - set(hidden)
        tally = {
            "hidden": len(hidden),
            "hits": len(hits),
            "named": len(named),
            "false": len(false),
            "cases with a cause": bool(hidden),
            "top": bool(hidden) and bool(named) and found.names[0] in hidden,
            "nulls": not hidden,
            "alarms": not hidden and bool(named),
        }
        for name, count in tally.items():
            counts[name] += int(count)
            by_truth[truth][name] += int(count)
        for name in hidden:
            confusion[name]["found" if name in named else "missed"] += 1
        for name in false:
            confusion["+".join(hidden) or "null"][f"+{name}"] += 1
        wrong = "" if hits == set(hidden) and not false else "  <<<"
        print(
            f"{seed} {truth}: {', '.join(hidden) or 'null'} -> "
            f"{', '.join(found.names) or 'none'} ({time_s:.1f} s){wrong}",
            flush=True,
        )
    for title, tally in (("all", counts), *by_truth.items()):
        print(
            f"{title}: recall {tally['hits']}/{tally['hidden']}, "
            f"precision {tally['hits']}/{tally['named']}, "
            f"top-1 {tally['top']}/{tally['cases with a cause']}, "
            f"alarms {tally['alarms']}/{tally['nulls']}"
        )
    for name, row in sorted(confusion.items()):
        print(f"  {name}: {dict(row)}")
    print(f"seconds: median {np.median(times_s):.1f}, longest {max(times_s):.1f}")


if __name__ == "__main__":
    main(*(int(a) for a in (*sys.argv[1:], *("60", "1000")[len(sys.argv) - 1 :])))
