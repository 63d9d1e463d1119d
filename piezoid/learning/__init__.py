"""Learn the feedforward of a periodic motion, from the model and from recorded periods.

Start at learn.py. contraction.py designs the filter so that the iteration converges on every plant
of the family; files.py writes the table.
May import targets, verification, export, design, identification, records.
"""
