"""Verify a controller: simulate the compiled source in closed loop with the identified stage.

Start at verify.py (all scenarios of a parameter file) and plant.py (the simulated axis between its
converters). criteria.py compares figures with limits, verification.py is the record.
May import export, design, identification, records, the runtime.
To add a scenario, add it to ``SCENARIOS`` in scenarios.py.
"""
