"""Identification of public records, compared with other methods and with published figures.

Each record is a package with NAME, FOLDER (inside the folder of all records), and
``report(folder)``, which yields the lines to print. The data are not part of the repository.
"""
