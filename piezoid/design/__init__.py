"""Model and specification in, a Design out. Start at specification.py, then design.py.

plant.py            what is controlled: a nominal plant and its family
specification.py    what is asked
observer.py         disturbance observer; tuning.py chooses its poles, kalman.py its noise
rst.py              pole placement; shaping.py (band-stops) and youla.py (convex) shape it
sensitivity.py      what a loop does, from R, S, T and a plant alone
certificate.py      what is guaranteed with hysteresis in the loop
"""
