"""Stages whose drives act on several displacements at once.

    identify_coupled(recordings, lab) -> CoupledStage    from recordings of a stage
    fit_coupled(levels) -> CoupledStage                  from periodic data, one record per level
    decoupled(recordings, coupled)                       recordings in decoupled coordinates

Start at coupled_stage.py. May import dynamics and what it imports.
"""
