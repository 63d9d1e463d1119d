"""Feedforward for periodic motion: computed from the model, refined from recorded periods."""
