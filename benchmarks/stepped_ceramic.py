"""A Preisach ceramic of the virtual laboratory, whole and voltage by voltage: the same law."""

import math
from collections.abc import Callable

import numpy as np
from seed_paper_design import LATERAL_m_per_V

from piezoid.numerics.arrays import Array
from piezoid_datasets.virtual_lab.truths.return_point import Everett, preisach_memory
from piezoid_datasets.virtual_lab.truths.truth import FLOOR, Ceramic, ceramic_with_opening

VOLTS = 10.0  # field 1
STROKE_m = 2 * VOLTS * LATERAL_m_per_V
DEPOLED = np.array([(-0.97) ** n for n in range(150)])


class SteppedPreisach:
    """The laboratory's Preisach law one field at a time: the same stack of extrema."""

    def __init__(self, everett: Everett) -> None:
        self.terms = [
            (float(weight), *(float(v) for pair in zip(c, w, strict=True) for v in pair))
            for weight, c, w in zip(everett.weight, everett.centre.T, everett.width.T, strict=True)
        ]
        self.stack = [(FLOOR, 0.0)]
        self.field, self.value, self.sign = FLOOR, 0.0, 1.0

    def everett(self, high: float, low: float) -> float:
        """E of the laboratory for two numbers."""
        tanh = math.tanh
        total = 0.0
        for weight, c_p, w_p, c_q, w_q in self.terms:
            first = tanh((high - c_p) / w_p) - tanh((low - c_p) / w_p)
            second = tanh((high - c_q) / w_q) - tanh((low - c_q) / w_q)
            total += weight * first * second
        return float(total)

    def __call__(self, field: float) -> float:
        """Go to a field and return the output there."""
        field = round(field, 13)
        if field == self.field:
            return self.value
        sign = 1.0 if field > self.field else -1.0
        if sign != self.sign:
            self.stack.append((self.field, self.value))
            self.sign = sign
        while len(self.stack) > 1 and sign * field >= sign * self.stack[-2][0]:
            del self.stack[-2:]
        if not self.stack:
            self.stack.append((FLOOR, 0.0))
        root, base = self.stack[-1]
        self.value = base + sign * self.everett(max(field, root), min(field, root))
        self.field = field
        return self.value


def drawn(rng: np.random.Generator) -> tuple[Ceramic, Everett, float, Callable[[Array], Array]]:
    """Draw a ceramic as the laboratory does, keeping the parts it is made of."""
    everett = Everett(
        weight=rng.uniform(0.3, 1.0, 3),
        centre=rng.uniform(-0.6, 0.6, (2, 3)),
        width=rng.uniform(0.9, 2.2, (2, 3)),
    )
    bend, flex = float(rng.uniform(-0.06, 0.06)), float(rng.uniform(-0.05, 0.02))

    def reversible(field: Array) -> Array:
        return field + bend * field**2 + flex * field**3

    opening = float(rng.uniform(0.09, 0.15))
    ceramic = ceramic_with_opening(
        opening, reversible, lambda path: preisach_memory(everett, path)
    )
    return ceramic, everett, opening, reversible


def displacement_m(ceramic: Ceramic, voltage_V: Array) -> Array:
    """Return the displacement of a de-poled ceramic, 0 at the start's 0 V."""
    field = np.concatenate([[0.0], voltage_V / VOLTS])
    strain = np.add(*ceramic.respond(field, DEPOLED))
    return np.asarray(STROKE_m * (strain[1:] - strain[0]))


def stepped(
    ceramic: Ceramic, everett: Everett, reversible: Callable[[Array], Array], rest_V: float
) -> Callable[[float], float]:
    """Return the same ceramic, voltage by voltage, resting where its history left it."""
    law = SteppedPreisach(everett)
    probe = np.concatenate([DEPOLED, [0.0]])
    raw = np.array([law(float(f)) for f in probe])
    _, known = ceramic.respond(np.zeros(1), DEPOLED)
    _, other = ceramic.respond(np.ones(1), np.zeros(0))
    top = SteppedPreisach(everett)(1.0)
    scale = (float(other[0]) - float(known[0])) / (top - raw[-1])
    ends = reversible(np.array([-1.0, 0.0, 1.0]))
    start, rise = float(ends[1]), float(ends[2] - ends[0])
    share, held = 1.0 - ceramic.share, float(raw[-1])

    def respond(voltage_V: float) -> float:
        field = voltage_V / VOLTS
        straight = (float(reversible(np.float64(field))) - start) / rise
        return STROKE_m * (share * straight + scale * (law(field) - held))

    respond(rest_V)
    return respond
