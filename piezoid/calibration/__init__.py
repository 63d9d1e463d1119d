"""The whole way of one stage: recordings in, model, diagnoses, controllers and their files out.

The command line and ``piezoid.calibrate`` go this way and no other. Nothing here starts processes:
whoever has them runs the jobs of ``stage_jobs`` side by side and puts them together.
"""
