"""Bundled recordings with their manifest, and the laboratory that made them."""
