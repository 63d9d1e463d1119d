"""Write settings for existing controllers and simulators from what the export ships.

Start at targets.py, which lists the targets and the files of each.
May import export, design, identification, records.
To add a target, add a file and its line in ``TARGETS``.
"""
