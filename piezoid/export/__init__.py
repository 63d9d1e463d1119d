"""Export controllers: parameter file, C header, firmware bundle.

Start at parameter_file.py (the record and its sealed JSON), then export_stage.py, which
fills it from a model and a design; bundle.py writes the folder that a firmware engineer copies.
May import design, identification, the runtime.
To add a format, write a function from a ``ParameterFile`` to the files of that format.
"""
