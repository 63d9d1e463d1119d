"""Public records, identified here in one run with rivals, beside figures published elsewhere.

A module a record: NAME, FOLDER (inside the folder of all records), and ``report(folder)``, which
returns the lines to print. The data stay where they are.
"""
