"""The joint fit of an axis model and its extensions, with its error on rows left out."""
