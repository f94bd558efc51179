"""Quality of service by name; every topic's profile can be overridden by parameters."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

_RELIABLE, _VOLATILE = ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE
_PROFILES = {
    # For measurements, of which a lost one is soon replaced: ROS's profile for sensor data.
    'SENSOR': (ReliabilityPolicy.BEST_EFFORT, _VOLATILE, 5),
    # For states that are sent again and again, of which only the last one counts.
    'STATE_IN': (_RELIABLE, _VOLATILE, 1),
    # For what happens once and must not be lost; the depth is a choice.
    'EVENT': (_RELIABLE, _VOLATILE, 10),
    # For what those who come later shall also hear: the last one.
    'LATCHED': (_RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1),
    # For what is recorded, to its beginning: the depth is a choice, half a minute.
    'TRACE': (_RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1000),
    # For transforms: what tf2's own broadcasters have.
    'TRANSFORMS': (_RELIABLE, _VOLATILE, 100),
    # For diagnostics and markers, with ROS's default depth.
    'RELIABLE': (_RELIABLE, _VOLATILE, 10),
}


def __getattr__(name: str) -> QoSProfile:
    """Return a profile, each time a new one: rclpy writes a topic's overrides into it."""
    if name not in _PROFILES:
        raise AttributeError(name)
    reliability, durability, depth = _PROFILES[name]
    return QoSProfile(reliability=reliability, durability=durability, depth=depth)


OVERRIDABLE = QoSOverridingOptions(
    [
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    ]
)
"""Pass as `qos_overriding_options`: qos_overrides./topic.publisher.depth and so on."""
