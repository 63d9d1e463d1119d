"""The paper face: records in, one self-contained HTML page out. Start at render.py."""
