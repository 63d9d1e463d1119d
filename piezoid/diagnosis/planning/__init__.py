"""Plan the next experiment: candidate drives, simulated responses, separability of effects.

``diagnosis.experiment`` selects with these modules.
May import the effects and what the diagnosis imports.
To add a candidate drive, add it to candidate_drives.py.
"""
