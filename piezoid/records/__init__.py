"""Recordings: what was measured, read from what laboratories write. Start at recording.py.

In come files and lab.toml; out go `Recording`s. The way: readers/ make a
`RawTable` of any format, meaning.py and assignment.py say which column is what, conversion.py
puts it into SI units, clock.py and faults.py say what is odd about it, ingest.py makes the
recording, inspection.py shows all of it.
"""
