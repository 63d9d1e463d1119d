"""The whole way of one stage, its axes side by side, with the page that shows it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration

Told = Callable[[str], None]


def calibrate(
    files: Sequence[Path], lab: Path | None, told: Told, processes: int = 1
) -> "Calibration":
    """Fit, diagnose, design, export, verify and report one stage.

    processes  at most so many do the axes, this one among them; the files are the same bytes

    Raises what reading and fitting raise; a stage for which no controller can be designed is a
    calibration without one.
    """
    told("reading recordings")
    from piezoid.calibration.stage_jobs import jobs_of, ready, run_job, weight_of
    from piezoid_cli.aside import with_trials_aside
    from piezoid_cli.other_process import others
    from piezoid_cli.side_by_side import side_by_side

    # One more begins to load before it is known what there is to do: a single file is one axis.
    with others(int(processes > 1 and len(files) > 1), ready) as begun:
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab

        declared = None if lab is None else read_lab(lab)
        held = collect(files, declared)
        blank, ways = jobs_of(held, declared, processes, told)
        jobs = with_trials_aside(ways, begun)
        found = side_by_side(
            run_job, jobs, told, processes=processes, weight=weight_of, begun=begun
        )
    from piezoid.calibration.calibrate import finished, stage_of
    from piezoid_reports.render import with_report

    done = finished(stage_of(blank, found), declared, told, processes)
    told("writing the report")
    return with_report(done, held, declared)
