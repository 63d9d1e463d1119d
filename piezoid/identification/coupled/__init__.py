"""Stages whose drives act on several displacements at once: common modes, hysteresis, level."""
