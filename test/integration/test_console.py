"""The console's page in a browser: each topic reaches it, and each control its topic."""

from __future__ import annotations

import itertools
import math
import signal
from dataclasses import replace

import pytest
from console_crew import POLICY, START, PlayedVehicle, Screen, browser, start_console
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ros_helpers import ROOT
from std_msgs.msg import String

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import action_name
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.reporting import status
from uav_mission_manager.onboard.heard_input import HeardInput
from uav_mission_manager.onboard.mission_manager import ManagerSettings, MissionManager
from uav_mission_manager.onboard.trace import TraceWriter

SERVED = '--serve', '--port', '0'


@pytest.fixture
def chromium():
    with browser() as found:
        yield found


@pytest.fixture
def crew(ros, chromium):
    """A vehicle, the console, and a screen with its page."""
    vehicle = PlayedVehicle(ros)
    _, address = start_console(ros)
    screen = Screen(ros, chromium.new_page(viewport={'width': 1366, 'height': 768}), address)
    screen.until('.vehicle', '/uav1')
    yield vehicle, screen
    assert screen.troubles == []
    assert screen.elsewhere == set()


def test_every_topic_reaches_the_page(ros, crew):
    vehicle, screen = crew
    decision = POLICY.decide(START)
    screen.until('.now .headline', 'GO TO goal')
    screen.until('.now .note', action_name(POLICY.mission, decision.action))
    screen.until('.now .second', action_name(POLICY.mission, decision.runner_up))
    screen.until('.fact:has-text("battery")', '80%')
    screen.until('.authority .word', 'MANAGER')
    vehicle.work = POLICY.mission.goals[decision.action.goal].name
    screen.until('.now .headline', f'AT WORK AT {vehicle.work}')
    vehicle.charge, vehicle.fault, vehicle.asked = 0.31, 'sensor_camera', (0, 2, 2)
    vehicle.status, vehicle.phase = 'LOITER was not ordered from here', 'pilot in command'
    vehicle.state = (*START[:-2], 2, 1)
    vehicle.threat = 'high'
    screen.until('.fact:has-text("battery")', '31%')
    screen.until('.fact:has-text("fault")', 'sensor, camera')
    screen.until('.fact:has-text("threat")', 'high')
    screen.until('.authority .word', 'PILOT')
    screen.until('.authority .note', 'LOITER was not ordered from here')
    screen.until('.log', 'asked for: priorities 0 2 2')
    vehicle.say('goal_completed', 'goal2')
    screen.until('.log', 'completed: goal2')
    vehicle.say('goal_refused', 'goal3')
    screen.until('.log', 'out of reach: goal3')
    vehicle.say('goal_active', 'goal1')
    screen.until('.log', 'another program works at: goal1')
    vehicle.say('goal_failed', 'goal1: no jar left')
    screen.until('.log .warning', 'task failed: goal1: no jar left')
    vehicle.say('policy_set', '/a/new/set')
    screen.until('.log', 'new policy set: /a/new/set')
    vehicle.place = (100.0, -50.0, 33.0)
    screen.until('.area-map', '33 m')
    assert 'translate(100.0 50.0)' in screen.page.locator('.craft').get_attribute('transform')
    vehicle.refusal = 'link lost: odom'
    screen.until('.now .headline', 'NO COMMAND')
    screen.until('.now .reason', 'link lost: odom')


def test_values_bars_timeline_and_forecast_are_the_policys(ros, crew):
    _, screen = crew
    decision = POLICY.decide(START)
    screen.until('.bar.choice', action_name(POLICY.mission, decision.action))
    least = min(decision.values)
    screen.until('.bar.choice .amount', f'{least:.4g}')
    screen.until('.bar.second .amount', f'+{decision.margin:.3g}')
    screen.until('.now .close', 'the best possible, proved')
    assert screen.page.locator('.timeline .g-2').count() == 1
    screen.until('.forecast', 'simulated flights')
    assert '%' in screen.text('.forecast tr:has-text("goal2")')
    assert screen.text('.forecast tr:has-text("goal3")') == ''


def test_each_button_is_confirmed_and_calls_its_service(ros, crew):
    vehicle, screen = crew
    screen.press('Controls')
    for kind, service in (
        ('hold', 'mavlink_bridge/hold'),
        ('resume', 'mavlink_bridge/resume'),
        ('reload', 'manager/reload_policy'),
    ):
        before = len(vehicle.ordered)
        screen.press(kind.capitalize())
        screen.press('Cancel')
        ros.until(lambda: screen.page.locator('.q-dialog').count() == 0, 'no question')
        assert len(vehicle.ordered) == before
        screen.confirm(kind.capitalize())
        screen.until('.q-notifications', f'{kind} /uav1: {service} done')
        assert vehicle.ordered[before:] == [service]


def test_priorities_and_threat_level_are_set(ros, crew):
    vehicle, screen = crew
    screen.press('Controls')
    rows = screen.page.locator('.priorities .q-btn-group')
    ros.until(lambda: rows.count() == 3, 'a choice for each goal')
    screen.until('.priorities .q-btn[aria-pressed=true]:has-text("high")', 'high')
    rows.nth(0).get_by_text('none').click()
    rows.nth(2).get_by_text('high').click()
    screen.confirm('Ask for these')
    screen.until('.q-notifications', 'asked for')
    assert vehicle.ordered == [('priorities', 0, 2, 2)]
    screen.page.locator('.threat-choice').get_by_text('low').click()
    screen.confirm('Tell the manager')
    ros.until(lambda: ('threat', 'low') in vehicle.ordered, 'the threat level')


def test_of_a_stale_link_the_page_is_grey_and_its_controls_say_why(ros, crew):
    vehicle, screen = crew
    screen.until('.authority .word', 'MANAGER')
    screen.until('.fact:has-text("battery")', '80%')
    screen.until('.fact:has-text("fault")', 'none')
    screen.page.keyboard.press('c')
    vehicle.state = vehicle.place = vehicle.charge = vehicle.fault = vehicle.phase = None
    screen.until('.authority .word', 'UNKNOWN')
    screen.until('.obstacle', 'the link is stale')
    screen.until('.fact:has-text("battery")', 's old')
    for part in ('.authority', '.now', '.fact:has-text("fault")', '.fact:has-text("battery")'):
        ros.until(lambda part=part: 'stale' in screen.classes(part), f'{part} in grey')
    for name in ('Hold', 'Resume', 'Reload', 'Ask for these', 'Tell the manager'):
        ros.until(screen.page.get_by_role('button', name=name).is_disabled, f'no {name}')
    screen.page.keyboard.press('h')
    screen.until('.q-notifications', 'hold: the link is stale')
    assert vehicle.ordered == []


def test_keys_hold_and_resume_and_change_to_dark(ros, crew):
    vehicle, screen = crew
    screen.until('.authority .word', 'MANAGER')
    screen.press('Controls')
    for _ in range(3):  # One question at a time, and one order of it.
        screen.page.keyboard.press('h')
        ros.spin(0.3)
    screen.press('Yes')
    ros.until(lambda: vehicle.ordered == ['mavlink_bridge/hold'], 'the order')
    before = screen.page.evaluate('getComputedStyle(document.body).backgroundColor')
    screen.page.keyboard.press('d')
    after = 'getComputedStyle(document.body).backgroundColor'
    ros.until(lambda: screen.page.evaluate(after) != before, 'another colour')


def test_two_vehicles_are_side_by_side_and_a_click_chooses(ros, crew):
    _, screen = crew
    second = PlayedVehicle(ros, '/uav2')
    second.charge, second.place = 0.42, (100.0, 0.0, 11.0)
    screen.until('.area-tiles', '42%')
    ros.until(lambda: screen.page.locator('.tile').count() == 2, 'two tiles')
    screen.until('.other', '/uav2')
    screen.page.locator('.tile:has-text("/uav2")').click()
    screen.until('.vehicle', '/uav2')
    screen.until('.fact:has-text("battery")', '42%')
    screen.page.keyboard.press('1')
    screen.until('.vehicle', '/uav1')


def test_what_the_fleet_s_base_station_gives_a_vehicle_is_told(ros, crew):
    _, screen = crew
    words = {'/uav1': 'to goal3: it is nearest', '/uav2': 'has no goal: lost', 'goal1': 'left'}
    report = status(DiagnosticStatus.OK, '/fleet: decision', 'uav1 to goal3', **words)
    publisher = ros.node.create_publisher(DiagnosticArray, '/fleet/decision', qos.LATCHED)
    publisher.publish(DiagnosticArray(status=[report]))
    screen.until('.share', 'fleet: to goal3: it is nearest')
    PlayedVehicle(ros, '/uav2')
    screen.until('.area-tiles', '/uav2')
    screen.page.keyboard.press('2')
    screen.until('.share', 'fleet: has no goal: lost')


def test_a_thousand_epochs_are_on_the_timeline(ros, crew):
    vehicle, screen = crew
    screen.until('.now .headline', 'GO TO')
    heads = screen.page.locator('svg.timeline .head')
    numbers = itertools.count()

    def more_epochs():
        """Decide for another while; what comes too fast may be missed."""
        for number in itertools.islice(numbers, 100):
            vehicle.state = (*START[:-4], number % 8, number // 8 % 4, 0, 0)
            vehicle.decide()
            ros.executor.spin_once(timeout_sec=0.01)
        return heads.count() == 1000 and int(heads.last.text_content()) > 1000

    ros.until(more_epochs, 'a thousand epochs, and more before them')
    vehicle.state = None
    ros.until(
        lambda: int(heads.last.text_content()) - int(heads.first.text_content()) == 999,
        'the last thousand',
    )
    screen.until('.area-map', 'goal1')


def test_the_page_goes_on_after_a_restart_and_a_reload(ros, chromium):
    vehicle = PlayedVehicle(ros)
    process, address = start_console(ros)
    screen = Screen(ros, chromium.new_page(), address)
    screen.until('.fact:has-text("battery")', '80%')
    assert process.stop(signal.SIGINT) == 0
    assert 'Traceback' not in process.output
    vehicle.charge = 0.55
    port = int(address.rpartition(':')[2].strip('/'))
    start_console(ros, port=port)
    screen.until('.fact:has-text("battery")', '55%')
    screen.page.reload()
    screen.until('.fact:has-text("battery")', '55%')


def traced_decision():
    """An entry of a trace: what is heard of a vehicle in `START`, and that it was decided."""
    core = MissionManager(POLICY, ManagerSettings())
    trace = TraceWriter(core, 0.0)
    battery = dict.fromkeys(('voltage', 'current', 'capacity'), math.nan)
    for topic, values in (
        ('battery_state', {'percentage': 0.8, 'healthy': True, 'battery': 'id0', **battery}),
        ('odom', {'east': 0.0, 'north': 0.0}),
        ('fault_mode', {'name': 'nominal'}),
        ('threat_level', {'name': 'none'}),
        ('goal_priorities', {'values': START[4:7], 'request': 'a'}),
    ):
        heard = HeardInput(topic, 0.0, values)
        core.take(heard)
        trace.hear(heard)
    outcome = core.step(0.0)
    assert outcome.state == START
    trace.step(0.0, outcome)
    return trace.entry()


@pytest.fixture
def bag(ros, tmp_path):
    """A recording in which the charge falls from 80 % to 31 %."""
    rosbag2, typesys = (
        pytest.importorskip('rosbags.rosbag2'),
        pytest.importorskip('rosbags.typesys'),
    )
    vehicle, folder = PlayedVehicle(ros), tmp_path / 'bag'
    trace = ros.node.create_publisher(String, '/uav1/manager/trace', qos.LATCHED)
    trace.publish(String(data=traced_decision()))
    bag = f'bag:={folder}'
    recorder = ros.start('nodes.mission_record', '--ros-args', '-r', '__ns:=/uav1', '-p', bag)

    def recorded(charge):
        if not (folder / 'metadata.yaml').exists():
            return False
        store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        with rosbag2.Reader(folder) as reader:
            messages = [
                store.deserialize_cdr(data, each.msgtype)
                for each, _, data in reader.messages()
                if each.msgtype.endswith('BatteryState')
            ]
        # Twice, for the last of them is at the very end, where no click on the scrubber leads.
        return sum(each.percentage == pytest.approx(charge) for each in messages) >= 2

    for charge in (0.8, 0.31):
        vehicle.charge = charge
        ros.until(lambda charge=charge: recorded(charge), f'{charge} in the bag')
    assert recorder.stop() == 0
    vehicle.state = vehicle.place = vehicle.charge = vehicle.phase = None
    return folder


def go_to(ros, screen, share):
    """Click on the scrubber."""
    slider = screen.page.locator('.playback .q-slider')
    ros.until(slider.count, 'a scrubber')
    box = slider.bounding_box()
    screen.page.mouse.click(box['x'] + share * box['width'], box['y'] + box['height'] / 2)


def test_a_recorded_flight_is_played(ros, chromium, bag):
    policy = '--policy', str(ROOT / 'policies' / 'case_study')
    command = ros.start('cli.mission_replay', str(bag), *policy, *SERVED)
    ros.until(lambda: command.lines('page: http'), 'the address of the page')
    screen = Screen(ros, chromium.new_page(), command.lines('page: http')[0].split()[1])
    go_to(ros, screen, 0.999)
    screen.until('.fact:has-text("battery")', '31%')
    screen.until('.now .headline', 'GO TO goal')
    screen.until('.area-map', '20 m')
    screen.until('.other .headline', 'the same')
    assert screen.page.locator('.differences rect').count() == 0
    go_to(ros, screen, 0.4)
    screen.until('.fact:has-text("battery")', '80%')
    screen.press('Play or pause')
    screen.until('.fact:has-text("battery")', '31%')
    screen.page.keyboard.press('h')
    screen.until('.q-notifications', 'hold: this is a recording')
    assert screen.troubles == []
    assert screen.elsewhere == set()
    assert command.stop(signal.SIGINT) == 130
    assert 'Traceback' not in command.output


def test_another_policy_s_decisions_are_shown_beside_those_flown(ros, chromium, bag, tmp_path):
    mission = replace(POLICY.mission, distance_weight=1000.0)
    other = build_policy(mission)
    other.save(tmp_path / 'other')
    assert other.decide(START).action.goal is None
    command = ros.start(
        'cli.mission_replay', str(bag), '--policy', str(tmp_path / 'other'), *SERVED
    )
    ros.until(lambda: command.lines('page: http'), 'the address of the page')
    screen = Screen(ros, chromium.new_page(), command.lines('page: http')[0].split()[1])
    ros.until(screen.page.locator('.differences rect').count, 'a mark on the scrubber')
    go_to(ros, screen, 0.999)
    screen.until('.now .headline', 'GO TO goal')
    screen.until('.other.differs .headline', 'TO BASE')
    screen.until('.other .reason', other.decide(START).reason)
    screen.until('.other h2', 'by other (exact)')
    screen.until('.other .note', 'by its values, what was flown costs')
    screen.until('.timeline-names', 'other policy')
    assert screen.page.locator('.timeline .d-1').count() == 1
    screen.until('.area-map', 'goal2')
    screen.press('Next difference')  # There is one, at the beginning.
    screen.until('.playback .time', '0:00 of')
    assert screen.troubles == []
    assert command.stop(signal.SIGINT) == 130


def test_without_the_token_there_is_no_page(ros, chromium):
    PlayedVehicle(ros)
    _, address = start_console(ros, 'token:=secret')
    screen = Screen(ros, chromium.new_page(), address)
    assert screen.text('body') == 'add ?token=TOKEN to the address'
    screen.page.goto(f'{address}?token=secret')
    screen.until('.vehicle', '/uav1')
    assert 'secret' not in screen.page.url


@pytest.mark.parametrize(
    ('parameter', 'complaint'),
    [
        ('host:=0.0.0.0', 'parameter token: not given; host 0.0.0.0 can be reached by others'),
        (
            'token:=a;b',
            'other characters than letters, digits, - and _',
        ),
        ('policy:=/nowhere', '/nowhere'),
        ('port:=70000', 'parameter port'),
    ],
)
def test_what_cannot_be_is_told_in_one_line(ros, parameter, complaint):
    process = ros.start(
        'nodes.console', '--ros-args', '-p', 'policy:=policies/case_study', '-p', parameter
    )
    assert process.wait() == 1
    assert len(process.output.strip().splitlines()) == 1
    assert complaint in process.output
