"""The hysteresis fit: a convex start, then Gauss-Newton on the forward output error.

Read coordinates.py (what is varied), rows.py (residual and tangents), lag_search.py and start.py
(where it begins), then search.py.
"""
