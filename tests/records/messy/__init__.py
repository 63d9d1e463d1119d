"""Real-world files with faults, and the expected results of reading them."""
