"""Workers of a batch write the files of every stage, in a folder or an object store."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from uuid import uuid4

import fsspec
import pytest
from distributed import Client, LocalCluster

from piezoid.digests import digest_of_bytes, unseal
from piezoid_cli.batch import calibrate_stages, write_summary
from piezoid_cli.batch_cluster import find_stages
from piezoid_cli.batch_stage import StageTask, run_task
from piezoid_reports.fleet.records import (
    CRASHED,
    PASSED,
    STAGE_SCHEMA,
    Fleet,
    FleetStage,
    StagesOnDisk,
)

COUNT = 9
BAD = "unit-4"


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """Two workers in threads of this process, which share its memory."""
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster) as connected,
    ):
        yield connected


@pytest.fixture
def night(tmp_path: Path) -> Path:
    for number in range(COUNT):
        folder = tmp_path / "night" / f"unit-{number}"
        folder.mkdir(parents=True)
        (folder / "lab.toml").write_text(f"# {number}\n")
        (folder / "sweep.csv").write_text("1,2\n")
    return tmp_path / "night"


@pytest.fixture(params=["folder", "memory"])
def results(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return f"memory://{uuid4()}" if request.param == "memory" else str(tmp_path / "results")


def write_digests(
    task: StageTask, inputs: Mapping[str, str], *, log: Path | None = None
) -> tuple[FleetStage, Mapping[str, bytes]]:
    """Write the digests of the inputs instead of a calibration."""
    if log:
        with log.open("a") as stream:
            stream.write(f"{task.name}\n")
    stage = FleetStage(name=task.name, state=PASSED, version=task.version, inputs=inputs)
    return stage, {"sub/model.json": "".join(inputs.values()).encode()}


def run(
    client: Client, tasks: Sequence[StageTask], work: Callable[..., object]
) -> tuple[int, dict[str, str]]:
    """Return the number of stages with an earlier result, and the state of every stage."""
    with StagesOnDisk() as stages:
        task_runner = partial(run_task, calibrate=work)  # type: ignore[arg-type]
        earlier = calibrate_stages(client, tasks, stages, 1, work=task_runner)
        return earlier, {stage.name: stage.state for stage in stages}


def test_a_second_start_calibrates_only_stages_without_a_record(client, night, results, tmp_path):
    tasks, log = find_stages(night, results), tmp_path / "log"
    work = partial(write_digests, log=log)
    assert run(client, tasks, work) == (0, {f"unit-{k}": PASSED for k in range(COUNT)})
    files, root = fsspec.core.url_to_fs(results)
    for number in range(COUNT):
        folder = f"{root}/stages/unit-{number}"
        digests = digest_of_bytes(f"# {number}\n".encode()) + digest_of_bytes(b"1,2\n")
        assert files.cat_file(f"{folder}/sub/model.json") == digests.encode()
        record = unseal(files.cat_file(f"{folder}/batch.json"), STAGE_SCHEMA, folder)
        assert record["inputs"].keys() == {"lab.toml", "sweep.csv"}
    assert sorted(log.read_text().split()) == sorted(task.name for task in tasks)
    files.rm_file(f"{root}/stages/{BAD}/batch.json")
    log.write_text("")
    assert run(client, tasks, work)[0] == COUNT - 1
    assert log.read_text() == f"{BAD}\n"


def test_a_removed_result_among_the_stages_is_computed_again(client, night):
    results = night / "results"
    names = [f"unit-{k}" for k in range(COUNT)]
    assert run(client, find_stages(night, str(results)), write_digests)[0] == 0
    (results / f"stages/{BAD}/lab.toml").touch()
    (results / f"stages/{BAD}/sub/model.json").unlink()
    tasks = find_stages(night, str(results))
    assert [task.name for task in tasks] == names
    assert run(client, tasks, write_digests)[0] == COUNT - 1
    assert (results / f"stages/{BAD}/sub/model.json").exists()


def test_changed_inputs_are_refused_before_any_calibration(client, night, results, tmp_path):
    tasks, log = find_stages(night, results), tmp_path / "log"
    work = partial(write_digests, log=log)
    run(client, tasks, work)
    (night / BAD / "sweep.csv").write_text("1,3\n")
    log.write_text("")
    with pytest.raises(Exception, match=f"1 stages were calibrated from other files.*{BAD}"):
        run(client, tasks, work)
    assert not log.read_text()
    forced = find_stages(night, results, force=True)
    assert run(client, forced, work)[0] == COUNT - 1
    assert log.read_text() == f"{BAD}\n"


def test_a_failing_stage_does_not_stop_the_others(client, night, results):
    def fail_at_bad_stage(task: StageTask, inputs: Mapping[str, str]) -> object:
        if task.name == BAD:
            raise OSError("the disk is away")
        return write_digests(task, inputs)

    _, states = run(client, find_stages(night, results), fail_at_bad_stage)
    assert states.pop(BAD) == CRASHED
    assert set(states.values()) == {PASSED}
    assert len(states) == COUNT - 1


def test_a_worker_without_access_to_the_results_is_reported(tmp_path, night):
    (task, *_) = find_stages(night, str(tmp_path / "elsewhere"))
    with pytest.raises(OSError, match=r"does not see .*elsewhere.*s3://"):
        run_task(task, write_digests)


def test_the_summary_does_not_depend_on_the_order_of_the_stages(night, results):
    files, root = fsspec.core.url_to_fs(results)
    contents = []
    for order in (1, -1):
        with StagesOnDisk() as stages:
            for task in find_stages(night, results)[::order]:
                stage, _ = write_digests(task, {})
                stages.add(stage.name, stage.packed())
            write_summary(results, Fleet(name="night", stages=stages))
        names = ("summary.html", "parameters.parquet", "batch.json")
        contents.append([files.cat_file(f"{root}/{name}") for name in names])
    assert contents[0] == contents[1]
    record = unseal(contents[0][-1], "piezoid.batch/1", "batch.json")
    assert [stage["name"] for stage in record["stages"]] == [f"unit-{k}" for k in range(COUNT)]
