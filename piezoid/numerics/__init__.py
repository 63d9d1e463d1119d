"""Numerical methods without physics: arrays, least squares, convex programs, filters, threads.

Start at arrays.py. The methods do not depend on units or on piezo stages.
May import only ``errors``; methods that SciPy offers are not implemented here.
"""
