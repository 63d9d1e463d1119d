"""The tunnelling junction from data: barrier from sweeps, plant from closed loops.

    fit_junction(sweeps, recordings, lab) -> TunnellingModel    all of a tip; junction.py
    read_z_spectroscopy(table) -> ApproachCurve, ...            one sweep of current over height
    fit_barrier(curves) -> BarrierFit                           sweeps of one direction
    identify_closed_loop(record, ...) -> ClosedLoopFit          one record under its controller
    measure_loop_noise(record, plant, rig) -> LoopNoise         what moves the gap

Start at junction.py. May import records, operators, numerics; nothing else of identification.
"""
