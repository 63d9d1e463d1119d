"""Hysteresis of an axis: plays, dead zones, envelope and lag, with their uncertainty.

    estimate_axis(recordings, axis, rig) -> AxisModel    the complete estimate; estimate.py
    search(pieces, shape, settings) -> HysteresisFit     the fit of one shape
    choose_shape(pieces, settings) -> Choice             the smallest shape that predicts as well
    pieces_of(recordings, axis, ...) -> Piece, ...       scaled drive and displacement

Read coordinates.py first: it defines the parameter vector. May import extensions and the forward
model.
"""
