"""Tests of what `import piezoid` offers."""
