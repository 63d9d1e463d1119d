"""Hysteresis operators and linear systems: arrays in, arrays out.

Start at play.py, then prandtl_ishlinskii.py. The Python code is the readable reference, the hot
loops are compiled from kernels.c, chain.c and states.c.
May import numerics. A new operator states its equation and has an exact inverse or says why not.
"""
