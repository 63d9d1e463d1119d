"""What leaves the house: the parameter file, the C header made of it, the bundle around both.

parameter_file.py  the record, to sealed JSON and back
from_design.py     the record made of a model and a design; runtime_names.py exchanges letters
c_header.py        piezo_params.h
golden.py          inputs and the answers of the shipped source to them
bundle.py          the folder a firmware engineer copies
"""
