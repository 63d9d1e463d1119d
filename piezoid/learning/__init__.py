"""Learn the feedforward of a periodic motion, from the model and from recorded periods.

Start at learn.py; contraction.py proves that the iteration converges on every plant.
May import export, design, identification, records. The table is written by files.py.
"""
