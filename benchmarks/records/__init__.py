"""Public records: identified here, beside figures published elsewhere."""
