"""Work off the executor: the node goes on, the latest request wins."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from ros_helpers import Ros
from std_srvs.srv import Trigger

from uav_mission_manager.nodes.background import LatestOnly, SupersededError


class Requests:
    """Asks `latest` for work that ends when told to, through a service of the test's own node."""

    def __init__(self, ros: Ros) -> None:
        self.ros, self.outcomes, self.begun = ros, [], []
        self.go_on = threading.Event()
        self._latest = LatestOnly(ros.node)
        ros.node.create_service(
            Trigger, 'work', self._on_work, callback_group=ReentrantCallbackGroup()
        )
        self._client = ros.node.create_client(Trigger, 'work')
        ros.until(self._client.service_is_ready, 'the service')

    async def _on_work(self, _, response):
        number = len(self.outcomes)
        self.outcomes.append(None)
        try:
            self.outcomes[number] = await self._latest.run(partial(self._work, number))
        except (SupersededError, ValueError) as error:
            self.outcomes[number] = error
        return response

    def _work(self, number: int) -> int:
        self.begun.append(number)
        assert self.go_on.wait(60.0)
        if number == 9:
            raise ValueError('cannot be done')
        return number

    def ask(self) -> None:
        count = len(self.outcomes)
        self._client.call_async(Trigger.Request())
        self.ros.until(lambda: len(self.outcomes) > count, 'the request')


@pytest.fixture
def requests(ros: Ros) -> Iterator[Requests]:
    requests = Requests(ros)
    yield requests
    requests.go_on.set()


def test_callbacks_run_while_one_waits(ros: Ros, requests: Requests) -> None:
    ticks = []
    ros.node.create_timer(0.01, lambda: ticks.append(1))
    requests.ask()
    ros.until(lambda: len(ticks) > 20, 'a timer')
    assert requests.outcomes == [None]
    requests.go_on.set()
    ros.until(lambda: requests.outcomes == [0], 'the result')


def test_of_many_requests_the_first_runs_and_the_latest_counts(
    ros: Ros, requests: Requests
) -> None:
    for _ in range(9):
        requests.ask()
    ros.until(lambda: sum(o is not None for o in requests.outcomes) == 7, 'those in between')
    assert requests.begun == [0]
    requests.go_on.set()
    ros.until(lambda: requests.outcomes[8] == 8, 'the latest')
    ros.until(lambda: requests.outcomes[0] is not None, 'the first')
    assert requests.begun == [0, 8]
    assert all(isinstance(outcome, SupersededError) for outcome in requests.outcomes[:8])


def test_what_work_raises_is_the_asker_s(ros: Ros, requests: Requests) -> None:
    requests.go_on.set()
    for number in range(10):
        requests.ask()
        ros.until(lambda number=number: requests.outcomes[number] is not None, 'an outcome')
    assert requests.outcomes[:9] == list(range(9))
    assert isinstance(requests.outcomes[9], ValueError)
