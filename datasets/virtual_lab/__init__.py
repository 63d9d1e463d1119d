"""Simulated test stages with known effects.

Start at ``campaign.draw_campaign``; ``stage.record`` simulates one recording, ``truths`` contains
the hysteresis laws and ``effects`` the faults and dynamics added to them.
Imports nothing of the library. To add a law or an effect, add a file and its line in the tuple.
"""
