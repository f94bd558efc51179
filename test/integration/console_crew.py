"""A vehicle as the console sees it, played by a test, and a browser that looks at the page."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from playwright.sync_api import Browser, Error, Page, sync_playwright
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from ros_helpers import LIMIT, ROOT, NodeProcess, Ros
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray
from std_srvs.srv import Trigger

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.reporting import decision_status
from uav_mission_manager.nodes.topics import TOPICS
from uav_mission_manager.onboard import Refusal, Situation
from uav_mission_manager.policy import load_policy

POLICY = load_policy(ROOT / 'policies' / 'case_study')
START = (1, 1, 1, 1, 1, 2, 0, 0, 0, 0, 0)
CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')


class PlayedVehicle:
    """Manager, bridge and base station of one vehicle, as messages that a test chooses.

    What is set is published ten times a second; None is not published at all.
    """

    def __init__(self, ros: Ros, name: str = '/uav1') -> None:
        self._ros, self.name = ros, name
        self.state: tuple[int, ...] | None = START
        self.refusal = ''
        self.place: tuple[float, float, float] | None = (0.0, 0.0, 20.0)
        self.charge: float | None = 0.8
        self.fault: str | None = 'nominal'
        self.threat: str | None = 'none'
        self.asked: tuple[int, ...] | None = (1, 2, 0)
        self.phase: str | None = 'en route'
        self.status, self.link, self.work = 'en route: as commanded', 'up', ''
        self.ordered: list[Any] = []
        every_decision = qos.LATCHED
        every_decision.depth = 100  # A test may decide faster than they travel.
        self._publishers = {
            topic: ros.node.create_publisher(TOPICS[topic], f'{name}/{topic}', profile)
            for topic, profile in (
                ('manager/decision', every_decision),
                ('odom', qos.SENSOR),
                ('battery_state', qos.SENSOR),
                ('fault_mode', qos.STATE_IN),
                ('threat_level', qos.STATE_IN),
                ('goal_priorities', qos.STATE_IN),
                ('goal_active', qos.LATCHED),
                ('goal_completed', qos.EVENT),
                ('goal_failed', qos.EVENT),
                ('goal_refused', qos.EVENT),
                ('policy_set', qos.LATCHED),
            )
        }
        self._diagnostics = ros.node.create_publisher(
            DiagnosticArray, '/diagnostics', qos.RELIABLE
        )
        for service in ('mavlink_bridge/hold', 'mavlink_bridge/resume', 'manager/reload_policy'):
            ros.node.create_service(Trigger, f'{name}/{service}', self._serve(service))
        ros.node.create_service(
            SetParameters, f'{name}/base_station/set_parameters', self._on_parameters
        )
        ros.node.create_subscription(String, f'{name}/threat_level', self._on_threat, qos.STATE_IN)
        ros.node.create_timer(0.1, self.publish)

    def say(self, topic: str, text: str) -> None:
        """Publish a word once."""
        self._publishers[topic].publish(String(data=text))

    def publish(self) -> None:
        """Publish all that is to be said now."""
        if self.state is not None:
            self.decide()
        if self.place is not None:
            message = Odometry()
            message.header.frame_id, message.header.stamp = 'map', self._now()
            place = message.pose.pose.position
            place.x, place.y, place.z = self.place
            message.pose.pose.orientation.w = 1.0
            self._publishers['odom'].publish(message)
        if self.charge is not None:
            message = BatteryState(percentage=self.charge, location='id0')
            message.header.stamp = self._now()
            self._publishers['battery_state'].publish(message)
        for topic, word in (('fault_mode', self.fault), ('threat_level', self.threat)):
            if word is not None:
                self.say(topic, word)
        if self.asked is not None:
            self._publishers['goal_priorities'].publish(UInt8MultiArray(data=self.asked))
        if self.phase is not None:
            self._publish_bridge(self.phase)

    def decide(self) -> None:
        """Publish what the policy says of the state."""
        outcome = Refusal(self.refusal) if self.refusal else POLICY.decide(self.state)
        status = decision_status(
            'manager: decision', outcome, Situation(POLICY.mission), 0.0, POLICY.digest
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._now()
        self._publishers['manager/decision'].publish(message)

    def _publish_bridge(self, phase: str) -> None:
        facts = {
            **{'phase': phase, 'link': self.link, 'mode': 'GUIDED', 'armed': 'True'},
            'goal_at_work': self.work,
        }
        status = DiagnosticStatus(
            name=f'{self.name}/mavlink_bridge: autopilot',
            message=self.status,
            values=[KeyValue(key=key, value=value) for key, value in facts.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._now()
        self._diagnostics.publish(message)

    def _now(self) -> Any:
        return self._ros.node.get_clock().now().to_msg()

    def _serve(self, service: str) -> Any:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self.ordered.append(service)
            response.success, response.message = True, f'{service} done'
            return response

        return answer

    def _on_parameters(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        for parameter in request.parameters:
            self.ordered.append((parameter.name, *parameter.value.integer_array_value))
        response.results = [SetParametersResult(successful=True)] * len(request.parameters)
        return response

    def _on_threat(self, message: String) -> None:
        if message.data != self.threat:
            self.ordered.append(('threat', message.data))


class Screen:
    """A page in a browser, and what went wrong in it."""

    def __init__(self, ros: Ros, page: Page, address: str) -> None:
        self._ros, self.page, self.troubles = ros, page, []
        self.elsewhere: set[str] = set()
        page.on('console', self._on_console)
        page.on('pageerror', lambda error: self.troubles.append(str(error)))
        page.on('request', lambda request: self._on_request(request.url))
        page.goto(address)

    def _on_console(self, message: Any) -> None:
        if message.type in ('error', 'warning'):
            self.troubles.append(message.text)

    def _on_request(self, url: str) -> None:
        if not re.match(r'(https?|wss?)://127\.0\.0\.1[:/]|data:|blob:', url):
            self.elsewhere.add(url)

    def text(self, selector: str) -> str:
        """What can be read in a part of the page; empty without it, or while the page loads."""
        try:
            found = self.page.locator(selector).all_text_contents()
        except Error:
            return ''
        return found[0] if found else ''

    def until(self, selector: str, text: str) -> None:
        """Wait until a part of the page says so."""
        what = f'{text!r} in {selector}'
        try:
            self._ros.until(lambda: text in self.text(selector), what)
        except AssertionError as error:
            raise AssertionError(f'{error}\n{self.text("body")}\n{self.troubles}') from None

    def classes(self, selector: str) -> set[str]:
        """Classes of a part of the page."""
        return set((self.page.locator(selector).first.get_attribute('class') or '').split())

    def press(self, name: str) -> None:
        """Press a button once it can be; the vehicle goes on meanwhile."""
        button = self.page.get_by_role('button', name=name, disabled=False)
        self._ros.until(button.count, f'button {name}')
        button.click(timeout=1000 * LIMIT)

    def confirm(self, button: str) -> None:
        """Press a button of the drawer, and say yes."""
        self.press(button)
        self.press('Yes')


@contextmanager
def browser() -> Iterator[Browser]:
    """Start a browser without a screen; without one on the machine the test is left out."""
    if CHROMIUM is None:
        pytest.skip('there is no chromium: apt install chromium')
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield found
        found.close()


def start_console(ros: Ros, *parameters: str, port: int = 0) -> tuple[NodeProcess, str]:
    """Start the node and return it with the page's address."""
    words = [f'port:={port}', *parameters]
    arguments = [word for parameter in words for word in ('-p', parameter)]
    process = ros.start('nodes.console', '--ros-args', *arguments)

    def address() -> str:
        lines = process.lines('page: http')
        return lines[0].partition('page: ')[2] if lines else ''

    return process, ros.until(address, 'the address of the page')
