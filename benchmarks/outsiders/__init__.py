"""Simulators whose authors never saw piezoid, and the shipped controller on their plants.

`FORMATS.md` is all that their authors were given. A simulator is never changed after its first
run; what piezoid was changed for is told with the seeds it was seen on (docs/outsiders.md).
"""
