"""Many stages on one page: what they have in common, which stand out, which failed and why."""
