"""The Bouc-Wen benchmark: one mode with a hysteretic spring, identified from its record.

Start at ``record.py``. ``fit.py`` and ``mode.py`` do not import piezoid.
"""

from benchmarks.records.bouc_wen.record import FOLDER, NAME, report

__all__ = ["FOLDER", "NAME", "report"]
