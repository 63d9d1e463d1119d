"""Linear dynamics of an axis: modes, lags, delay and their intervals, behind its hysteresis.

    with_dynamics(axis, recordings, response=...) -> AxisModel    complete fit; axis_dynamics.py
    estimate_response(PeriodicData) -> FrequencyResponse, ...     responses of periodic data
    fit_dynamics(FrequencyResponse, Structure, ...) -> LinearDynamics
    fit_response(FrequencyResponseRecord, ...)                    response from a file

Read first: frequency_response.py, then modal.py. May import hysteresis and what it imports.
"""
