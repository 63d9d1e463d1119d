"""Numerical methods without physics: arrays, least squares, convex programs, filters, threads.

Start at arrays.py. Nothing here knows a unit or a piezo.
May import only ``errors``; a method that SciPy offers is called there, not written here.
"""
