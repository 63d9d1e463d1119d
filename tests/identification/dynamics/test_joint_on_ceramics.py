"""The joint fit on a ceramic that is no sum of plays: nobody is given away for another."""

from benchmarks.dynamics_coverage import coverage, draw, fit_stage


def test_a_slow_sweep_is_not_given_away_for_the_many_lines_of_a_chirp() -> None:
    # Counted line by line, the chirp had bought its last nanometres with 2223 nm of this sweep.
    stage, truth = draw(3010)
    axis = fit_stage(stage)
    assert axis.joint is not None
    assert axis.dynamics is not None
    assert axis.joint.recordings == ("sweep", "chirp")
    separate_m, joint_m = axis.joint.separate_rms_m[0], axis.joint.joint_rms_m[0]
    assert joint_m < 2.0 * separate_m
    # Nor are mode, damping and delay: their intervals hold the truth.
    assert all(holds for holds, _ in coverage(axis.dynamics, truth))
