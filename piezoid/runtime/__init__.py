"""The shipped controller: one C source, simulated and shipped. Start at piezoid_runtime.h."""
