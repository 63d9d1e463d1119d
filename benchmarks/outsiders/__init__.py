"""Simulators by third parties who never saw piezoid, and the shipped controller on their plants.

The authors received `FORMATS.md` only. A simulator is frozen after its first run. The changes of
piezoid that its stages caused are in docs/outsiders.md, with their seeds.
"""
