"""Hysteresis laws of the simulated stages; none of them is a sum of plays.

A campaign draws from ``TRUTHS`` by default. ``TRUTHS`` must not change, so that every seed gives
the same bytes; ``ZOO`` has all laws. To add a law, add a function that draws it, with the physics
in its docstring, and its line.
"""

from piezoid_datasets.virtual_lab.truths.closed_form import BOUC_WEN, DAHL, DUHEM, WALL_PINNING
from piezoid_datasets.virtual_lab.truths.differential import (
    COLEMAN_HODGDON,
    GENERALISED_BOUC_WEN,
    JILES_ATHERTON,
    LUGRE,
)
from piezoid_datasets.virtual_lab.truths.return_point import (
    KRASNOSELSKII_POKROVSKII,
    MAXWELL_SLIP,
    PREISACH,
    PREISACH_LORENTZIAN,
    TAKACS,
)
from piezoid_datasets.virtual_lab.truths.truth import Truth

TRUTHS: tuple[Truth, ...] = (PREISACH, BOUC_WEN, WALL_PINNING)
ZOO: tuple[Truth, ...] = (
    *TRUTHS,
    PREISACH_LORENTZIAN,
    KRASNOSELSKII_POKROVSKII,
    TAKACS,
    MAXWELL_SLIP,
    DAHL,
    LUGRE,
    GENERALISED_BOUC_WEN,
    DUHEM,
    COLEMAN_HODGDON,
    JILES_ATHERTON,
)
