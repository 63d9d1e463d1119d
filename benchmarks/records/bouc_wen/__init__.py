"""The Bouc-Wen benchmark: one mode whose spring is hysteretic, identified from its record.

Start at ``record.py``; ``fit.py`` and ``mode.py`` need nothing of piezoid.
"""

from benchmarks.records.bouc_wen.record import FOLDER, NAME, report

__all__ = ["FOLDER", "NAME", "report"]
