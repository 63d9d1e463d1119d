"""Recordings: measured data, read from the files that laboratories write.

Start at recording.py (the record) and ingest.py (the path to it): ``readers`` turn any format into
a ``RawTable``, columns.py finds quantity, axis and SI unit of every column, clock.py the sampling
rate, invalid_samples.py readings that are none; ``checks`` state what is odd, and change nothing.
May import numerics and operators; nothing here imports identification or any part above it.
To add a format or a check, add a file to its folder and its line in the folder's list.
"""
