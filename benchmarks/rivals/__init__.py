"""Comparison of the hysteresis model with other classes."""
