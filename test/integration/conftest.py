"""A ROS domain of its own for every test; the longest flights first."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_helpers import Ros, ros_domain

LONGEST = (
    'test_the_policy_recharges_before_any_goal_is_out_of_range',
    'test_both_missions_end_with_every_goal_achieved_and_the_vehicle_home',
)
"""Flights that take more than a minute: begun last, all others would have to wait for them."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest, each beside a short one: processes get two tests at a time."""

    long = sorted((i for i in items if i.name in LONGEST), key=lambda i: LONGEST.index(i.name))
    short = [item for item in items if item.name not in LONGEST]
    pairs = [item for pair in zip(long, short) for item in pair]
    items[:] = [*pairs, *long[len(short) :], *short[len(long) :]]


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    """Return the test's side of a fresh ROS domain; ends what it started."""
    with ros_domain() as domain:
        peer = Ros(domain, tmp_path)
        try:
            yield peer
        finally:
            peer.close()
