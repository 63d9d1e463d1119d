"""Recordings: what was measured, read from what laboratories write. Start at recording.py."""
