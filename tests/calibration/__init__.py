"""Tests of piezoid.calibration."""
