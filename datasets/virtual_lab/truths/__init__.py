"""The kinds of ceramic the laboratory owns; none of them is a sum of plays."""

from piezoid_datasets.virtual_lab.truths import bouc_wen, preisach, wall_pinning
from piezoid_datasets.virtual_lab.truths.truth import Truth

TRUTHS: tuple[Truth, ...] = (preisach.TRUTH, bouc_wen.TRUTH, wall_pinning.TRUTH)
