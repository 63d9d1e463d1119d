"""Hysteresis operators and linear systems: arrays in, arrays out.

Start at play.py, then prandtl_ishlinskii.py. The inner loops are compiled from kernels.c, chain.c
and states.c.
May import numerics. The docstring of an operator states its equation, and its exact inverse if
there is one.
"""
