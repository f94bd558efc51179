"""Quality of service by name; every topic's profile can be overridden by parameters."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions


def _profile(
    reliability: ReliabilityPolicy,
    durability: DurabilityPolicy,
    depth: int,
) -> QoSProfile:
    return QoSProfile(reliability=reliability, durability=durability, depth=depth)


SENSOR = _profile(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE, 5)
"""For measurements, of which a lost one is soon replaced: ROS's profile for sensor data."""

STATE_IN = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 1)
"""For states that are sent again and again, of which only the last one counts."""

EVENT = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10)
"""For what happens once and must not be lost; the depth is a choice."""

LATCHED = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1)
"""For what those who come later shall also hear: the last one."""

RELIABLE = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10)
"""For diagnostics and markers, with ROS's default depth."""

OVERRIDABLE = QoSOverridingOptions(
    [
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    ]
)
"""Pass as `qos_overriding_options`: qos_overrides./topic.publisher.depth and so on."""
