"""Hysteresis of an axis: plays, dead zones, envelope and lag, with their uncertainty.

    estimate_axis(recordings, axis, rig) -> AxisModel    all of it; estimate.py
    search(pieces, shape, settings) -> Fitted            one shape
    choose_shape(pieces, settings) -> Choice             the smallest shape that predicts as well
    pieces_of(recordings, axis, ...) -> Piece, ...       what a fit is given, scaled

Read coordinates.py first: what the numbers mean. May import extensions and the forward model.
"""
