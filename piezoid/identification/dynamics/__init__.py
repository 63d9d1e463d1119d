"""Linear dynamics of an axis: modes, lags, delay and their intervals, behind its hysteresis.

    with_dynamics(axis, recordings, response=...) -> AxisModel    all of it; axis_dynamics.py
    estimate_response(PeriodicData) -> FrequencyResponse          what is measured
    fit_dynamics(FrequencyResponse, Structure, ...) -> LinearDynamics
    fit_response(FrequencyResponseRecord, ...)                    a response measured elsewhere
    distortion_of(recordings, axis)                               lines that were not driven

Read first: frequency_response.py, then modal.py. May import hysteresis and what it imports.
"""
