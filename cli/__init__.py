"""The command line: one file per verb, registered in main.py.

A verb parses arguments, calls one function of the library and prints the result; it makes no
decisions about data. Heavy packages are imported inside the verb, so that help is immediate.
May import everything. To add a verb, add a file and its line in main.py.
"""
