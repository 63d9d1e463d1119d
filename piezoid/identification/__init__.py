"""Recordings in, an ActuatorModel out. Start at model.py, then hysteresis.py."""
