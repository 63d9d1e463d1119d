"""Joint refits of an axis model and extensions, for diagnosis.

    fit_extended(model, recordings, extensions, ...) -> Extended

Start at fit_extended.py; vector.py selects rows and blocks, and defines the start. The search is
that of the hysteresis fit. May import hysteresis and extensions.
"""
