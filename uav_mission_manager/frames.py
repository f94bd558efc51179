"""Coordinate frames of the messages, by the names of ROS (REP 105)."""

MAP_FRAME = 'map'
"""The mission's local tangent plane [m]: east, north and up from the centre of cell 0."""

BODY_FRAME = 'base_link'
"""The vehicle: forward, left and up. In a namespace the frame is called after it, see
`body_frame`."""


def vehicle_name(namespace: str) -> str:
    """Return what a vehicle is called: its namespace without the slashes around it."""
    return namespace.strip('/')


def body_frame(namespace: str) -> str:
    """Return the frame of the vehicle of a namespace, such as `uav1/base_link`."""
    return f'{vehicle_name(namespace)}/{BODY_FRAME}'.lstrip('/')
