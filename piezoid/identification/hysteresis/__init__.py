"""The hysteresis fit: a convex start, then Gauss-Newton on the forward output error.

Read coordinates.py (what is varied), rows.py (residual and tangents), then fit.py.
"""
