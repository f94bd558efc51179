"""What a soak's manager says and decides on, as a bag for `mission_replay`."""

from __future__ import annotations

from pathlib import Path

from uav_mission_manager.onboard.recording import Recording, new_folder

SAVE_PERIOD = 60.0
"""Simulated time [s] between two saves: a choice, for speed."""

TEXT = 'std_msgs/msg/String'


class SoakBag:
    """A bag of texts in simulated time; call it with topic, text and time [s]."""

    def __init__(self, folder: Path) -> None:
        self._recording = Recording(new_folder(folder))
        from rosbags.typesys import Stores, get_typestore  # Of an extra.

        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._saved_at = 0.0
        for topic in 'manager/trace', 'mission_command':
            self._recording.add_topic(f'/{topic}', TEXT)

    def __call__(self, topic: str, text: str, now: float) -> None:
        """Take a text."""
        data = self._store.serialize_cdr(self._store.types[TEXT](text), TEXT)
        self._recording.add(f'/{topic}', round(now * 1e9), bytes(data))
        if now - self._saved_at >= SAVE_PERIOD:
            self.save(now)

    def save(self, now: float) -> None:
        """Write what was taken."""
        self._saved_at = now
        self._recording.save()
