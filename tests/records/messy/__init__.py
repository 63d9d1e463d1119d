"""Files as laboratories leave them: each with what is wrong, and what must come of it."""
