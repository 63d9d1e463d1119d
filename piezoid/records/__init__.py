"""Recordings: measured data, read from the files that laboratories write.

Start at recording.py (the record) and ingest.py (the path to it): ``readers`` turn any format into
a ``RawTable``, columns.py finds quantity, axis and SI unit of every column, clock.py the sampling
rate, invalid_samples.py the invalid readings; ``checks`` report problems and change nothing.
May import numerics and operators, but not identification or any room above it.
To add a format or a check, add a file to its folder and its line in the folder's list.
"""
