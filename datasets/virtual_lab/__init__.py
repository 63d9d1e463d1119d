"""Simulated test stages: recordings whose effects are known.

Start at ``campaign.draw_campaign``; ``stage.record`` runs one stage, ``truths`` holds the
hysteresis laws and ``effects`` the faults and dynamics added to them.
May import none of the library. To add a law or an effect, add a file and its line in the tuple.
"""
