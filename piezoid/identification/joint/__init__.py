"""Refits of a fitted axis together with extensions, as a diagnosis needs them.

    fit_extended(model, recordings, extensions, ...) -> Extended

Start at fit_extended.py; vector.py orders the numbers. May import hysteresis and extensions.
"""
