"""A ROS domain of its own for every test; the longest flights first."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_helpers import Ros, ros_domain

LONGEST = 'test_survey_flight.py', 'test_demo.py', 'test_fleet.py', 'test_plan_flight.py'
"""Files whose tests take minutes: begun last, all others would have to wait for them."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    """Return the test's side of a fresh ROS domain; ends what it started."""
    with ros_domain() as domain:
        peer = Ros(domain, tmp_path)
        try:
            yield peer
        finally:
            peer.close()
