"""Calibrate a stage: from its recordings to model, diagnoses, controllers and their files.

Start at calibrate.py; `piezoid calibrate` and `piezoid.calibrate` call it.
May import every part of the library except the verbs and sealed files. It starts no
processes: the command line distributes the jobs of calibrate.py and collects the results.
To add a step, add it to the jobs of one axis, or to ``finish`` in calibrate.py for a whole stage.
"""
