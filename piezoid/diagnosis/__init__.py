"""What the simulation gets wrong, and why: causes named only where the data can tell them.

Read effect.py (what one effect provides), tracks.py and nuisance.py (what everything is compared
with), then diagnose.py.
"""
