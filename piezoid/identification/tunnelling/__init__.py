"""The tunnelling junction from data: barrier from sweeps, plant from closed loops.

    fit_junction(sweeps, recordings, lab) -> TunnellingModel    the complete fit; junction.py
    read_z_spectroscopy(table) -> ApproachCurve, ...            sweeps of current over height
    fit_barrier(curves) -> BarrierFit                           sweeps of one direction
    identify_closed_loop(record, ...) -> ClosedLoopFit          one record under its controller
    measure_loop_noise(record, plant, rig) -> LoopNoise         motion of the gap and its sources

Start at junction.py. May import records, operators, numerics; nothing else of identification.
"""
