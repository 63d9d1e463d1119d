"""The controller that ships: one C source, simulated here and copied into the bundle.

Start at piezoid_runtime.h: the equations of the loop, every parameter and the cost of each call.
schema.py is the only table of parameters; controller.py steps the compiled source from Python.
May import numerics; it shares no code with the operators, so that each can test the other.
To add a parameter, add it to the header, to schema.py and to the check of the source.
"""
