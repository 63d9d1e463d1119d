"""Rivals of the hysteresis model, measured in one run."""
