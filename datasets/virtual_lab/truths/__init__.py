"""Hysteresis laws of the simulated stages; none of them is a sum of plays.

A campaign draws from ``TRUTHS`` by default. ``TRUTHS`` must not change, so that every seed gives
the same bytes; ``ZOO`` has all laws. To add a law, add a file and its line.
"""

from piezoid_datasets.virtual_lab.truths import (
    bouc_wen,
    coleman_hodgdon,
    dahl,
    duhem,
    generalised_bouc_wen,
    jiles_atherton,
    krasnoselskii_pokrovskii,
    lugre,
    maxwell_slip,
    preisach,
    preisach_lorentzian,
    takacs,
    wall_pinning,
)
from piezoid_datasets.virtual_lab.truths.truth import Truth

TRUTHS: tuple[Truth, ...] = (preisach.TRUTH, bouc_wen.TRUTH, wall_pinning.TRUTH)
ZOO: tuple[Truth, ...] = (
    *TRUTHS,
    preisach_lorentzian.TRUTH,
    krasnoselskii_pokrovskii.TRUTH,
    takacs.TRUTH,
    maxwell_slip.TRUTH,
    dahl.TRUTH,
    lugre.TRUTH,
    generalised_bouc_wen.TRUTH,
    duhem.TRUTH,
    coleman_hodgdon.TRUTH,
    jiles_atherton.TRUTH,
)
