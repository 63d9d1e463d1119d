"""The joint fit of a ceramic that is not a sum of plays."""

from benchmarks.dynamics_coverage import coverage, draw, fit_stage


def test_a_chirp_of_many_lines_does_not_outweigh_a_slow_sweep():
    # Weighted line by line, the last nanometres of the chirp cost 2223 nm of this sweep.
    stage, truth = draw(3010)
    axis = fit_stage(stage)
    assert axis.dynamics is not None
    assert axis.joint.recordings == ("sweep", "chirp")
    separate_m, joint_m = axis.joint.separate_rms_m[0], axis.joint.joint_rms_m[0]
    assert joint_m < 2.0 * separate_m
    # The intervals of mode, damping and delay contain the truth.
    assert all(holds for holds, _ in coverage(axis.dynamics, truth))
