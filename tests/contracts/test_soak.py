"""The soak draws reproducible stages and names the command that reproduces a fault."""

from benchmarks.soak import Outcome, table, write_stage


def test_a_stage_of_the_soak_has_the_same_bytes_again(tmp_path):
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
    truths = [write_stage(3, 0, folder)[0] for folder in folders]
    assert truths[0] == truths[1]
    contents = [{p.name: p.read_bytes() for p in folder.iterdir()} for folder in folders]
    assert contents[0] == contents[1]
    assert "lab.toml" in contents[0]


def test_a_fault_comes_with_the_command_that_reproduces_it():
    clean = Outcome(number=4, stage="cedar 1, dahl", change="none", status=0, seconds=1.0)
    crash = Outcome(
        number=7, stage="cedar 2, dahl", change="copy", status=70, seconds=1.0, fault="exception"
    )
    assert "python -m benchmarks.soak --seed 9 --first 7 --stages 1" in table([clean, crash], 9)
    assert "--first 4" not in table([clean, crash], 9)
