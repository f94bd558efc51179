"""Coordinate frames of the messages, by the names of ROS (REP 105)."""

MAP_FRAME = 'map'
"""The mission's local tangent plane [m]: east, north and up from the centre of cell 0."""

BODY_FRAME = 'base_link'
"""The vehicle: forward, left and up."""
