"""Hidden effects on every law of the zoo: how often the diagnosis names what is there."""
