"""A ROS domain of its own for every test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_helpers import Ros, ros_domain


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    """Return the test's side of a fresh ROS domain; ends what it started."""
    with ros_domain() as domain:
        peer = Ros(domain, tmp_path)
        try:
            yield peer
        finally:
            peer.close()
