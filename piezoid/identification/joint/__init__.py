"""Joint refits of an axis model and extensions, for diagnosis.

    fit_extended(model, recordings, extensions, ...) -> Extended

Start at fit_extended.py; vector.py defines the parameter vector. May import hysteresis and
extensions.
"""
