"""Ground floor: arrays, small convex problems, filters. No piezo, no units. Start at arrays.py."""
