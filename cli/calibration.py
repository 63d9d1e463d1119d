"""Calibrate one stage, its axes in parallel processes, and write its report."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration

Progress = Callable[[str], None]


def calibrate(
    files: Sequence[Path], lab: Path | None, progress: Progress, processes: int = 1
) -> "Calibration":
    """Fit, diagnose, design, export, verify and report one stage.

    processes  maximum number of processes, including this one; the results do not depend on it

    Raises the errors of reading and fitting. If no controller can be designed, the calibration
    has none.
    """
    progress("reading recordings")
    from piezoid_cli.workers import map_jobs, worker_pool

    # Workers load modules while this process reads. A single file has one axis: no worker.
    preload = partial(import_module, "piezoid.calibration.calibrate")
    with worker_pool(processes - 1 if len(files) > 1 else 0, preload) as pool:
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab

        declared = None if lab is None else read_lab(lab)
        collection = collect(files, declared)
        from piezoid.calibration.calibrate import estimated_cost, finish, jobs_of, run_job

        stage, jobs = jobs_of(collection, declared, processes, progress)
        results = map_jobs(run_job, jobs, progress, pool=pool, cost=estimated_cost)
    from piezoid_reports.render import with_report

    calibration = finish(stage, results, declared, progress, processes)
    progress("writing the report")
    return with_report(calibration, collection, declared)
