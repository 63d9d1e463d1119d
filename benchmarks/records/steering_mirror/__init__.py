"""The fine steering mirror: one nonlinear model for two levels of the drive.

Start at ``record.py``; ``distortion.py`` adds nonlinear terms to ``piezoid.fit_coupled``.
"""

from benchmarks.records.steering_mirror.record import FOLDER, NAME, report

__all__ = ["FOLDER", "NAME", "report"]
