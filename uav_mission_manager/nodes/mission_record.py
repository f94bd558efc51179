"""The recorder: what is said on a vehicle's topics, into a bag."""

from __future__ import annotations

import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.failures import FatalError, one_line
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.nodes.topics import TOPICS
from uav_mission_manager.nodes.vehicle_inputs import NO_EVENTS
from uav_mission_manager.onboard.recording import Recording, new_folder, require_rosbags

PARAMETERS = (
    NodeParameter(
        'bag',
        '',
        'Folder to make; where one has the name, it is FOLDER-2 and so on; empty is '
        'mission_DATE_TIME in the folder where it is started',
        path=True,
    ),
)

DISCOVERY_PERIOD = 0.2
"""Time [s] between two looks for who publishes: a choice."""

SAVE_PERIOD = 0.9
"""Time [s] between two saves: with the time that one takes, what is lost is less than a second."""

DEPTH = 1000
"""Messages of a topic that wait for the recorder, at most: a choice, all that a trace keeps."""

REMEMBERED = 2 * DEPTH
"""Messages of a topic by which one that comes in two ways is known again: as many as can wait."""

Way = tuple[ReliabilityPolicy, DurabilityPolicy]
"""How a topic is subscribed to."""


class MissionRecord(Node):
    """Records a vehicle's topics into a rosbag2 folder, for `mission_replay` and ROS's own tools.

    The bag is whole at any moment: a recorder that is killed loses its last second.
    """

    def __init__(self) -> None:
        super().__init__('mission_record')
        settings = declare(self, PARAMETERS)
        require_rosbags()
        path = settings.bag or time.strftime('mission_%Y-%m-%d_%H-%M-%S')
        folder = new_folder(Path.cwd() / path)
        self._recording = Recording(folder)
        self._ways: dict[str, set[Way]] = {}
        self._recent: dict[str, dict[tuple[int, int], None]] = {}
        # Bags are in order of the system's time, which may be set: from here on, it is not asked.
        self._epoch = time.time_ns() - time.monotonic_ns()
        self._trouble = ''
        self._ended = threading.Event()
        self._saving = threading.Thread(target=self._save_often, daemon=True)
        self._saving.start()
        self.create_timer(DISCOVERY_PERIOD, self._look, clock=safety_clock())
        self._look()
        self.get_logger().info(f'records into {folder}')

    def destroy_node(self) -> None:
        """Save what is left."""
        self._ended.set()
        self._saving.join()
        super().destroy_node()

    def _look(self) -> None:
        """Subscribe to what is published, in a way that suits all who do."""
        if self._trouble:
            raise FatalError(f'recording ended: {self._trouble}')
        for topic, kind in TOPICS.items():
            name = self.resolve_topic_name(topic)
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
            if offered and name not in self._ways:
                self._recording.add_topic(name, type_name(kind), recorded_profiles(offered))
                self._ways[name], self._recent[name] = set(), {}
            for way in ways_to_hear(offered) - self._ways.get(name, set()):
                self._subscribe(name, kind, way)

    def _subscribe(self, topic: str, kind: Any, way: Way) -> None:
        """Hear a topic in one more way; the others stay, for what they wait for may yet come."""
        self._ways[topic].add(way)
        reliability, durability = way
        self.create_subscription(
            kind,
            topic,
            partial(self._take, topic),
            QoSProfile(reliability=reliability, durability=durability, depth=DEPTH),
            event_callbacks=NO_EVENTS,
            raw=True,
        )

    def _take(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        """Record a message, once if it comes in two ways."""
        sent = info['source_timestamp'], info['publication_sequence_number']
        recent = self._recent[topic]
        if sent in recent:
            return
        recent[sent] = None
        if len(recent) > REMEMBERED:
            del recent[next(iter(recent))]
        self._recording.add(topic, self._epoch + time.monotonic_ns(), data)

    def _save_often(self) -> None:
        """Save in a thread of its own, as a disk may be slow."""
        ended = False
        while not (ended or self._trouble):
            ended = self._ended.wait(SAVE_PERIOD)
            try:
                self._recording.save()
            except Exception as error:  # Whatever it is, it must not stay unheard in a thread.
                self._trouble = one_line(error)


def type_name(kind: Any) -> str:
    """Return the name of a message class, such as `std_msgs/msg/String`."""
    return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'


def ways_to_hear(offered: list[QoSProfile]) -> set[Way]:
    """Return the ways in which all is heard that is offered in different ones.

    A subscription for what is latched hears nobody who does not latch, and one that hears all
    gets nothing of what was latched before. Where both are offered, there are two.
    """
    latched = [each for each in offered if each.durability == DurabilityPolicy.TRANSIENT_LOCAL]
    return {suiting(group) for group in (offered, latched) if group}


def suiting(offered: list[QoSProfile]) -> Way:
    """Return a way to hear all who offer so, as far as one is enough."""
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
    latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def recorded_profiles(offered: list[QoSProfile]) -> list[Any]:
    """Return the same as a bag has it, for who plays the bag to offer it again."""
    from rosbags import interfaces

    def lasting(duration: Duration) -> Any:
        return interfaces.QosTime(*divmod(duration.nanoseconds, 10**9))

    return [
        interfaces.Qos(
            interfaces.QosHistory(each.history.value),
            each.depth,
            interfaces.QosReliability(each.reliability.value),
            interfaces.QosDurability(each.durability.value),
            lasting(each.deadline),
            lasting(each.lifespan),
            interfaces.QosLiveliness(each.liveliness.value),
            lasting(each.liveliness_lease_duration),
            each.avoid_ros_namespace_conventions,
        )
        for each in offered
    ]


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MissionRecord, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
