"""One mode with a hysteretic restoring force: its start, its fit, and whether it is one."""
