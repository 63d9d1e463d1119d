"""What goes wrong in the laboratory: one file per effect, its physics in the docstring."""

from piezoid_datasets.virtual_lab.effects import creep
from piezoid_datasets.virtual_lab.effects.effect import Effect

EFFECTS: tuple[Effect, ...] = (creep.EFFECT,)
