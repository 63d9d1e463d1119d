"""Calibrate a whole stage: recordings in; model, diagnoses, controllers and their files out.

Start at calibrate.py; `piezoid calibrate` and `piezoid.calibrate` both call it.
May import every part of the library except the verbs and sealed files. It starts no
processes: the command line distributes the jobs of ``axis_jobs`` and collects the results.
To add a step, add it to the jobs of one axis or to what is done once all axes are known.
"""
