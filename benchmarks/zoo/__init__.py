"""Effects hidden in stages of every law of the zoo, and the names that the diagnosis gives."""
