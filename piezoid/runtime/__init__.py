"""The shipped controller: one C source, simulated here and copied into the bundle.

Start at piezoid_runtime.h: the loop's equations, what every parameter means, what each call costs.
schema.py is the one table of parameters, controller.py steps the compiled source from Python.
"""
