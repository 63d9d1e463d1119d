"""From the parameter file to a verdict: what ships is run against what was identified.

plant.py         an axis between its converters: amplifier, response, mechanics, sensor
uncertainty.py   other plants the recordings allow as well
closed_loop.py   the plant and the compiled runtime, sample by sample
trajectories.py  spirals, rasters, steps;  scenarios.py  the tuple SCENARIOS of what is run
surface.py       what is under the tip;  over_surface.py  the tip's loop while the stage moves it
tracking.py      records to numbers;       criteria.py   numbers to verdicts with limits
trace.py         a few runs, place by place, for pictures;  limits.py  limits from a file
verify.py        all of it, stage.py for a model;   verification.py  the record that leaves
rebuild.py       the same bits from the bundle compiled here and on an emulated Cortex-M4F
"""
