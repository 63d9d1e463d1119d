"""Reports: one self-contained HTML page from the records of a stage.

Start at render.py; page.py holds the records behind a page.
May import the library, never the command line.
To add a section, add a file to ``sections`` and its line in ``SECTIONS``.
"""
