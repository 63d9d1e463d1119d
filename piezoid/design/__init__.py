"""Design controllers from a model and a specification.

Start at lateral.py for axes and junction_task.py for the tunnelling junction. design.py holds the
resulting record, specification.py the requirements that a user may set.
May import identification, records, operators, numerics.
To add a method, return R, S and T (rst.py); margins (sensitivity.py) and the bound with
hysteresis in the loop (certificate.py) are computed from these polynomials alone.
"""
