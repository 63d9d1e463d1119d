"""Memory operators, the readable reference: plays, dead zones, their sums and exact inverses.

Arrays in, arrays out; hot loops in kernels.c, chain.c and states.c. Read play.py first, then
prandtl_ishlinskii.py.
"""
