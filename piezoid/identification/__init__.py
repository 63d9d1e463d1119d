"""Identify a stage: recordings in, an ``ActuatorModel`` out.

Start at model.py (one axis) and forward.py (from the drive to the reading), then fit.py.
May import records, operators, numerics.
To add a component of the model, add a file to ``extensions`` and its line in ``EXTENSIONS``.
"""
