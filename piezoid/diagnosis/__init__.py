"""Diagnose a stage: which effects explain the error of the model, and how certain that is.

Start at effect.py (what an effect provides) and diagnose.py (the sequence of the search).
May import identification, records, operators, numerics.
To add an effect, add a file to ``effects`` and a line to its ``EFFECTS``.
"""
