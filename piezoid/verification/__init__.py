"""Verify a controller: the compiled source runs against the identified stage.

Start at verify.py (all scenarios of a parameter file) and plant.py (the simulated axis between its
converters); criteria.py turns figures into verdicts, verification.py is the record.
May import export, design, identification, records, the runtime.
To add a scenario, add it to ``SCENARIOS`` in scenarios.py.
"""
