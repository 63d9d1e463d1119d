"""Workers write what a batch makes, wherever that is; the client is told a kilobyte a stage."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from uuid import uuid4

import fsspec
import pytest
from distributed import Client, LocalCluster

from piezoid.digests import digest_of_bytes, unseal
from piezoid_cli.batch import done_by, write_summary
from piezoid_cli.batch_cluster import bundle_size, stages_of
from piezoid_cli.stage_task import SPELL_s, StageTask, work_off
from piezoid_reports.fleet.records import (
    CRASHED,
    PASSED,
    STAGE_SCHEMA,
    Fleet,
    FleetStage,
    StagesOnDisk,
)

COUNT, MANY = 9, 40
BAD = "unit-4"


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """Two workers in threads of this process, which see its memory."""
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster) as here,
    ):
        yield here


@pytest.fixture
def night(tmp_path: Path) -> Path:
    return written(tmp_path / "night", COUNT)


@pytest.fixture
def long_night(tmp_path: Path) -> Path:
    """So many stages that two workers are given several of them at once."""
    assert bundle_size(MANY, 2) > 1
    return written(tmp_path / "night", MANY)


def written(folder: Path, count: int) -> Path:
    for number in range(count):
        place = folder / f"unit-{number}"
        place.mkdir(parents=True)
        (place / "lab.toml").write_text(f"# {number}\n")
        (place / "sweep.csv").write_text("1,2\n")
    return folder


@pytest.fixture(params=["folder", "memory"])
def results(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return f"memory://{uuid4()}" if request.param == "memory" else str(tmp_path / "results")


def named(
    task: StageTask, inputs: Mapping[str, str], *, log: Path | None = None
) -> tuple[FleetStage, Mapping[str, bytes]]:
    """What stands for a calibration: a file of the inputs' digests."""
    if log:  # another process may do it
        with log.open("a") as stream:
            stream.write(f"{task.name}\n")
    stage = FleetStage(name=task.name, state=PASSED, version=task.version, inputs=inputs)
    return stage, {"sub/model.json": "".join(inputs.values()).encode()}


def run(
    client: Client,
    tasks: Sequence[StageTask],
    work: Callable[..., object],
    *,
    force: bool = False,
    spell_s: float = SPELL_s,
) -> tuple[int, dict[str, str]]:
    """Return how many were finished before, and how every stage ended."""
    with StagesOnDisk() as stages:
        doing = partial(work_off, run=work, spell_s=spell_s)  # type: ignore[arg-type]
        before = done_by(client, tasks, stages, 1, force=force, work=doing)
        return before, {stage.name: stage.state for stage in stages}


def test_workers_write_every_stage_and_a_second_start_does_what_lost_its_record(
    client: Client, night: Path, results: str, tmp_path: Path
) -> None:
    tasks, log = stages_of(night, results), tmp_path / "log"
    work = partial(named, log=log)
    assert run(client, tasks, work) == (0, {f"unit-{k}": PASSED for k in range(COUNT)})
    files, root = fsspec.core.url_to_fs(results)
    for number in range(COUNT):
        place = f"{root}/stages/unit-{number}"
        digests = digest_of_bytes(f"# {number}\n".encode()) + digest_of_bytes(b"1,2\n")
        assert files.cat_file(f"{place}/sub/model.json") == digests.encode()
        record = unseal(files.cat_file(f"{place}/batch.json"), STAGE_SCHEMA, place)
        assert record["inputs"].keys() == {"lab.toml", "sweep.csv"}
    assert sorted(log.read_text().split()) == sorted(task.name for task in tasks)
    files.rm_file(f"{root}/stages/{BAD}/batch.json")
    log.write_text("")
    assert run(client, tasks, work)[0] == COUNT - 1
    assert log.read_text() == f"{BAD}\n"


def test_what_would_be_replaced_is_refused_before_anything_is_done(
    client: Client, night: Path, results: str, tmp_path: Path
) -> None:
    tasks, log = stages_of(night, results), tmp_path / "log"
    work = partial(named, log=log)
    run(client, tasks, work)
    (night / BAD / "sweep.csv").write_text("1,3\n")
    log.write_text("")
    with pytest.raises(Exception, match=f"1 stages were done from other files.*{BAD}"):
        run(client, tasks, work)
    assert not log.read_text()
    assert run(client, tasks, work, force=True)[0] == COUNT - 1
    assert log.read_text() == f"{BAD}\n"


def test_of_stages_given_together_only_the_one_that_fails_again_breaks_off(
    client: Client, long_night: Path, results: str
) -> None:
    def failing(task: StageTask, inputs: Mapping[str, str]) -> object:
        if task == third:
            raise OSError("the disk is away")
        return named(task, inputs)

    tasks = stages_of(long_night, results)
    third = tasks[2]  # of the first bundle
    _, ended = run(client, tasks, failing)
    assert ended.pop(third.name) == CRASHED
    assert set(ended.values()) == {PASSED}
    assert len(ended) == MANY - 1


def test_what_takes_long_is_handed_back_and_done_all_the_same(
    client: Client, long_night: Path, results: str
) -> None:
    tasks = stages_of(long_night, results)
    _, ended = run(client, tasks, named, spell_s=-1.0)
    assert len(ended) == MANY
    assert len(work_off(tasks[:3], named, spell_s=-1.0)) == 1


def test_a_worker_that_does_not_see_the_results_says_so(tmp_path: Path, night: Path) -> None:
    (task, *_) = stages_of(night, str(tmp_path / "elsewhere"))
    with pytest.raises(OSError, match=r"does not see .*elsewhere.*s3://"):
        work_off([task], named)


def test_the_summary_is_the_same_bytes_in_whatever_order_stages_end(
    night: Path, results: str
) -> None:
    files, root = fsspec.core.url_to_fs(results)
    made = []
    for order in (1, -1):
        with StagesOnDisk() as stages:
            for task in stages_of(night, results)[::order]:
                stage, _ = named(task, {})
                stages.add(stage.name, stage.packed())
            write_summary(results, Fleet(name="night", stages=stages))
        names = ("summary.html", "parameters.parquet", "batch.json")
        made.append([files.cat_file(f"{root}/{name}") for name in names])
    assert made[0] == made[1]
    record = unseal(made[0][-1], "piezoid.batch/1", "batch.json")
    assert [stage["name"] for stage in record["stages"]] == [f"unit-{k}" for k in range(COUNT)]
