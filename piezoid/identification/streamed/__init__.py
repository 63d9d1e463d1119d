"""The fit of recordings larger than memory: play states and triangular factors are all it carries.

Start at fit_streamed.py.
"""
