"""Design controllers: a model and a specification in, a ``Design`` out.

Start at lateral.py for axes and junction_task.py for the tunnelling junction; design.py is the
record that they fill, specification.py is what a user may ask for.
May import identification, records, operators, numerics.
To add a method, return R, S and T (rst.py); margins (sensitivity.py) and the bound with
hysteresis in the loop (certificate.py) are computed from these polynomials alone.
"""
