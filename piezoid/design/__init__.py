"""Model and specification in, a Design out. Start at specification.py, then lateral.py.

chain.py, plant.py   what is controlled: physical sections, a nominal plant and its family
specification.py     what is asked
lateral.py           X and Y: observer.py, its poles by tuning.py or its noise by kalman.py
vertical.py          Z: rst.py, shaped by shaping.py (band-stops) or youla.py (convex: cones.py)
sensitivity.py       what a loop does, from R, S, T and a plant alone
certificate.py       what is guaranteed with hysteresis in the loop
from_model.py        families and defaults from an identified axis; stage.py: all axes
design.py            the record that leaves this floor
"""
