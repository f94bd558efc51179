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
STATE_IN = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 1)
EVENT = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10)
LATCHED = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1)
RELIABLE = _profile(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10)

# Pass as `qos_overriding_options`: qos_overrides./topic.publisher.depth and so on.
OVERRIDABLE = QoSOverridingOptions(
    [
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    ]
)
