"""The tunnelling junction from data: barrier from sweeps, plant from loop records.

Read barrier_fit.py for sweeps of the current over the height, closed_loop.py for records under
the 20 kHz controller, model.py for what leaves this folder.
"""
