from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import FlightTask, Phase, Settings
from uav_mission_manager.autopilot.telemetry import Position, Telemetry
from uav_mission_manager.autopilot.vehicle import Arm, FlightMode, Fly, SetMode, TakeOff

LATITUDE, LONGITUDE = -35.363262, 149.165237
PER_DEGREE = math.radians(6371000.0)
GROUND = 584.0
SETTINGS = Settings(allow_arming=True)
UP = GROUND + SETTINGS.flight_altitude
HEARD = dict.fromkeys(('HEARTBEAT', 'GLOBAL_POSITION_INT', 'EXTENDED_SYS_STATE'), 0.0)


def place(east: float = 0.0, north: float = 0.0) -> tuple[float, float]:
    per_longitude = PER_DEGREE * math.cos(math.radians(LATITUDE))
    return LATITUDE + north / PER_DEGREE, LONGITUDE + east / per_longitude


HOME = FlightTask('none normal', *place(), UP, UP, land=True)
HOVER = FlightTask('none agile', *place(), UP, UP, agile=True)
COMMIT = FlightTask('commit goal1 normal', *place(100.0), UP, UP, goal='goal1')
AGILE = replace(COMMIT, text='commit goal1 agile', agile=True)
OTHER = FlightTask('commit goal2 normal', *place(0.0, -100.0), UP, UP, goal='goal2')
RECHARGE = FlightTask('recharge', *place(50.0), UP, UP, land=True)
REPAIR = FlightTask('repair', *place(50.0), UP, UP, land=True, service=True)


class Flight:
    """A pilot, the vehicle it sees and the time; the manager repeats its command at 1 Hz."""

    def __init__(self, settings: Settings = SETTINGS, **telemetry) -> None:
        self.pilot = Pilot(settings, lambda latitude, longitude: GROUND)
        self.pilot.goals_wanted = True
        self.settings = settings
        self.now = 100.0
        self.task: FlightTask | None = None
        self.east = self.north = self.height = self.climb = self.speed = 0.0
        self.telemetry = replace(
            Telemetry(
                mode=FlightMode.STABILIZE,
                landed=True,
                ready=True,
                unhealthy=0,
                ekf_flags=831,
                received=HEARD,
            ),
            **telemetry,
        )
        self.position = True
        self.home = 0.0

    def at(self, east: float, north: float = 0.0, height: float = 20.0) -> Flight:
        self.east, self.north, self.height = east, north, height
        return self

    def airborne(self, east: float = 0.0, north: float = 0.0) -> Flight:
        """In command of the vehicle in the air."""
        self.at(east, north)
        self.set(mode=FlightMode.GUIDED, armed=True, landed=False)
        return self

    def set(self, **telemetry) -> Flight:
        self.telemetry = replace(self.telemetry, **telemetry)
        return self

    def order(self, task: FlightTask) -> Flight:
        self.task = task
        self.pilot.command(task, self.now)
        return self

    def step(self, seconds: float = 0.05):
        self.now += seconds
        if self.task is not None:
            self.pilot.command(self.task, self.now)
        return self.silent_step(0.0)

    def silent_step(self, seconds: float = 0.05):
        self.now += seconds
        position = Position(
            self.now,
            *place(self.east, self.north),
            GROUND + self.height,
            self.height - self.home,
            (0.0, self.speed, self.climb),
        )
        return self.pilot.update(
            replace(self.telemetry, position=position if self.position else None), self.now
        )

    def run(self, seconds: float):
        """All requests within so many seconds, and the last step."""
        requests, completed = [], []
        for _ in range(round(seconds / 0.05)):
            step = self.step()
            requests += step.requests
            completed += [step.completed] * bool(step.completed)
        return requests, completed, step


def fly_to(task: FlightTask, speed: float = SETTINGS.cruise_speed) -> Fly:
    return Fly(task.latitude, task.longitude, UP, speed)


# A flight, phase by phase


def test_nothing_is_done_on_the_ground_without_a_command():
    flight = Flight()
    assert flight.run(60.0)[0] == []
    requests, _, step = flight.set(mode=FlightMode.GUIDED, armed=True).run(60.0)
    assert (requests, step.phase) == ([], Phase.HOLDING)


def test_from_the_ground_guided_then_arm_then_take_off_then_go():
    flight = Flight().order(COMMIT)
    step = flight.step()
    assert (step.phase, step.requests) == (Phase.ARMING, (SetMode(FlightMode.GUIDED),))
    step = flight.set(mode=FlightMode.GUIDED).step()
    assert (step.phase, step.requests) == (Phase.ARMING, (Arm(),))
    step = flight.set(armed=True).step()
    assert step.phase is Phase.TAKE_OFF
    assert [request.height for request in step.requests] == [20.0]
    flight.set(landed=False).at(0.0, height=5.0)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.TAKE_OFF, [])
    step = flight.at(0.0, height=18.5).step()
    assert (step.phase, step.requests) == (Phase.EN_ROUTE, (fly_to(COMMIT),))


@pytest.mark.parametrize(
    'telemetry',
    [
        {'mode': FlightMode.STABILIZE},
        {'mode': FlightMode.GUIDED},
    ],
    ids=['mode', 'arm'],
)
def test_a_request_is_repeated_until_telemetry_shows_it_done(telemetry):
    flight = Flight(**telemetry).order(COMMIT)
    seconds, times = 0.0, []
    while len(times) < 7:
        seconds += 0.05
        requests, _, _ = flight.run(0.05)
        times += [seconds] * len(requests)
    pauses = [later - sooner for sooner, later in pairwise(times)]
    assert pauses == pytest.approx([2.0, 4.0, 8.0, 16.0, 30.0, 30.0], abs=0.2)


def test_refused_arming_is_repeated_and_never_skipped():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    requests, _, step = flight.run(30.0)
    assert set(requests) == {Arm()}
    assert step.phase is Phase.ARMING


def test_an_autopilot_that_is_not_ready_is_not_asked_to_arm():
    flight = Flight(mode=FlightMode.GUIDED, ready=False).order(COMMIT)
    requests, _, step = flight.run(10.0)
    assert requests == []
    assert 'not ready' in step.status
    assert flight.set(ready=True).step().requests == (Arm(),)


@pytest.mark.parametrize('task', [COMMIT, RECHARGE, REPAIR])
def test_without_allow_arming_it_says_so_and_waits(task):
    flight = Flight(Settings()).order(task)
    requests, _, step = flight.run(10.0)
    assert requests == []
    assert 'allow_arming' in step.status
    flight.set(mode=FlightMode.GUIDED, armed=True)
    requests, _, step = flight.run(10.0)
    assert requests == []
    assert 'allow_arming' in step.status


def test_without_allow_arming_a_vehicle_in_the_air_is_flown():
    flight = Flight(Settings()).order(COMMIT).airborne()
    assert flight.step().requests == (fly_to(COMMIT),)


def test_no_position_no_arming():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.position = False
    requests, _, step = flight.run(5.0)
    assert requests == []
    assert 'position' in step.status


MISSION = replace(SETTINGS, reach=300.0)


@pytest.mark.parametrize('task', [COMMIT, HOVER, HOME, REPAIR])
def test_far_from_its_destination_it_stays_on_the_ground_and_doubts_the_mission(task):
    flight = Flight(MISSION, mode=FlightMode.GUIDED).at(9100.0, height=0.0).order(task)
    requests, _, step = flight.run(30.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])
    assert 'km away; is it the right mission file?' in step.status
    assert flight.at(200.0, height=0.0).step().phase is not Phase.HOLDING


def test_far_from_its_destination_it_orders_nothing_in_the_air():
    flight = Flight(MISSION).order(COMMIT).airborne(9100.0)
    requests, _, step = flight.run(20.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])
    assert step.status.startswith(
        'commit goal1 normal: 9.0 km away; is it the right mission file?; no position to hold'
    )


def test_commit_dwells_and_completes_once():
    flight = Flight().order(COMMIT).airborne(50.0)
    assert flight.step().phase is Phase.EN_ROUTE
    flight.at(98.0)
    _, completed, step = flight.run(SETTINGS.goal_dwell - 0.1)
    assert (step.phase, completed) == (Phase.ON_SITE, [])
    assert flight.run(9.0)[1] == ['goal1']


def test_a_goal_is_not_completed_from_below():
    flight = Flight().order(COMMIT).airborne().at(100.0, height=3.0)
    requests, completed, step = flight.run(20.0)
    assert (step.phase, completed, set(requests)) == (Phase.EN_ROUTE, [], {fly_to(COMMIT)})


def test_only_time_on_site_counts():
    flight = Flight().order(COMMIT).airborne(100.0)
    flight.run(1.5)
    assert flight.at(90.0).run(20.0)[1] == []
    assert flight.at(100.0).run(0.4)[1] == []
    assert flight.run(0.3)[1] == ['goal1']


def test_agile_on_the_spot_keeps_the_dwell():
    flight = Flight().order(COMMIT).airborne(100.0)
    flight.run(1.5)
    assert flight.order(AGILE).run(1.0)[1] == ['goal1']


def test_a_goal_ordered_again_is_completed_again():
    flight = Flight().order(COMMIT).airborne(100.0)
    assert flight.run(3.0)[1] == ['goal1']
    flight.order(HOVER).run(1.0)
    assert flight.order(COMMIT).run(3.0)[1] == ['goal1']
    assert flight.run(12.0)[1] == ['goal1'], 'the manager never reacted'


def test_agile_changes_the_speed_at_once():
    flight = Flight().order(COMMIT).airborne()
    assert flight.step().requests == (fly_to(COMMIT),)
    assert flight.order(AGILE).step().requests == (fly_to(AGILE, SETTINGS.agile_speed),)


def test_a_new_command_retargets_at_once():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.run(1.0)
    step = flight.order(OTHER).step()
    assert (step.phase, step.requests) == (Phase.EN_ROUTE, (fly_to(OTHER),))


def test_no_commitment_flies_home_and_lands():
    flight = Flight().order(HOME).airborne(100.0)
    assert flight.step().requests == (fly_to(HOME),)
    step = flight.at(1.0).step()
    assert (step.phase, step.requests) == (Phase.LANDING, (SetMode(FlightMode.LAND),))
    flight.set(mode=FlightMode.LAND).at(1.0, height=8.0)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.LANDING, [])
    flight.set(armed=False, landed=True).at(1.0, height=0.0)
    requests, _, step = flight.run(30.0)
    assert (step.phase, requests) == (Phase.GROUND, [])


def test_landing_is_broken_off_for_a_new_destination():
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=FlightMode.LAND).at(0.0, height=8.0).step()
    assert flight.order(COMMIT).step().requests == (SetMode(FlightMode.GUIDED),)
    step = flight.set(mode=FlightMode.GUIDED).step()
    climb = Fly(*place(), UP, SETTINGS.cruise_speed)
    assert (step.phase, step.requests) == (Phase.CLIMBING, (climb,))
    flight.at(0.4, height=18.5).step()
    assert flight.step().phase is Phase.CLIMBING
    step = flight.at(0.4, height=19.5).step()
    assert (step.phase, step.requests) == (Phase.EN_ROUTE, (fly_to(COMMIT),))
    flight.order(HOME).step()
    flight.set(mode=FlightMode.LAND).step()
    assert flight.order(RECHARGE).step().requests == (SetMode(FlightMode.GUIDED),)
    flight.order(COMMIT).set(mode=FlightMode.GUIDED)
    assert flight.step().requests == (fly_to(COMMIT),), 'GUIDED anew has forgotten its target'


def test_a_landing_in_a_failsafe_is_broken_off_by_resume_only():
    flight = Flight().order(HOME).airborne().set(failsafe=True)
    assert flight.step().requests == (SetMode(FlightMode.LAND),)
    flight.set(mode=FlightMode.LAND).step()
    requests, _, step = flight.order(COMMIT).run(10.0)
    assert (step.phase, requests) == (Phase.LANDING, [])
    assert 'failsafe' in step.status
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)


def test_landed_at_the_service_cell_it_takes_off_for_home():
    flight = Flight(mode=FlightMode.GUIDED).at(50.0, height=0.0).order(HOME)
    assert flight.step().requests == (Arm(),)


def test_evasion_hovers_over_the_base_and_stays_on_the_ground():
    flight = Flight().order(HOVER).airborne(100.0)
    assert flight.step().requests == (fly_to(HOVER, SETTINGS.agile_speed),)
    requests, completed, step = flight.at(0.0).run(30.0)
    assert step.phase is Phase.ON_SITE
    assert completed == []
    assert set(requests) <= {fly_to(HOVER, SETTINGS.agile_speed)}
    flight = Flight().at(50.0, height=0.0).order(HOVER)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.GROUND, [])


def test_repair_needs_standing_disarmed_on_the_service_cell():
    flight = Flight(mode=FlightMode.GUIDED).order(REPAIR).airborne(50.0)
    flight.step()
    flight.set(mode=FlightMode.LAND)
    for _ in range(200):
        assert not flight.step().serviced
    flight.set(armed=False, landed=True).at(51.0, height=0.0)
    start = flight.now
    while not flight.step().serviced:
        assert flight.now - start < 10.0
    assert flight.now - start == pytest.approx(SETTINGS.service_time, abs=0.2)


@pytest.mark.parametrize(('task', 'east'), [(RECHARGE, 50.0), (HOME, 0.0), (REPAIR, 200.0)])
def test_no_service_by_another_command_or_elsewhere(task, east):
    flight = Flight(Settings()).order(task).at(east, height=0.0)
    assert not any(flight.step().serviced for _ in range(200))


def test_repair_given_up_midway_starts_anew():
    flight = Flight().at(50.0, height=0.0).order(REPAIR)
    flight.run(4.0)
    flight.order(RECHARGE).run(0.1)
    flight.order(REPAIR)
    assert not any(flight.step().serviced for _ in range(80))


# Who is in command


@pytest.mark.parametrize(
    'mode', [FlightMode.LOITER, FlightMode.STABILIZE, FlightMode.LAND, FlightMode.RTL]
)
def test_a_mode_not_ordered_here_ends_the_commanding_until_resume(mode):
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.set(mode=mode)
    requests, completed, step = flight.at(100.0).run(60.0)
    assert (step.phase, requests, completed) == (Phase.PILOT, [], [])
    flight.set(mode=FlightMode.GUIDED)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, []), 'back in GUIDED is no resume'
    flight.set(mode=mode)
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)
    assert flight.set(mode=FlightMode.GUIDED).step().requests == (fly_to(COMMIT),)


def test_a_landing_not_ordered_any_more_is_someone_elses():
    flight = Flight().order(HOME).airborne()
    assert flight.step().requests == (SetMode(FlightMode.LAND),)
    flight.order(COMMIT).run(6.0)
    requests, _, step = flight.set(mode=FlightMode.LAND).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def test_a_landing_that_comes_late_is_still_ours():
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.order(COMMIT).run(2.0)
    assert flight.set(mode=FlightMode.LAND).step().requests == (SetMode(FlightMode.GUIDED),)


def test_a_pilot_who_stops_an_arming_is_not_overruled():
    flight = Flight().order(COMMIT)
    flight.step()
    flight.set(mode=FlightMode.GUIDED).step()
    requests, _, step = flight.set(mode=FlightMode.STABILIZE).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def test_a_pilot_who_disarms_is_not_overruled():
    flight = Flight().order(COMMIT)
    flight.step()
    flight.set(mode=FlightMode.GUIDED).step()
    flight.set(armed=True).step()
    requests, _, step = flight.set(armed=False).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def landing_when_ordered_away(height: float) -> Flight:
    """A vehicle in LAND, by an order from here, that is just ordered to fly on."""
    flight = Flight().order(HOME).airborne()
    assert flight.step().requests == (SetMode(FlightMode.LAND),)
    flight.at(0.0, height=height).set(mode=FlightMode.LAND).step()
    assert flight.order(COMMIT).step().requests == (SetMode(FlightMode.GUIDED),)
    return flight


def test_a_landing_may_end_just_when_the_next_flight_is_ordered():
    """Motors that stopped in LAND are heard of in GUIDED."""
    flight = landing_when_ordered_away(height=0.1)
    step = flight.set(mode=FlightMode.GUIDED, armed=False, landed=True).step()
    assert (step.phase, step.requests) == (Phase.ARMING, (Arm(),))


def test_motors_stopped_just_then_in_the_air_are_not_started_again():
    flight = landing_when_ordered_away(height=8.0)
    requests, _, step = flight.set(mode=FlightMode.GUIDED, armed=False, landed=True).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def test_motors_stopped_once_it_flies_on_are_not_started_again():
    flight = landing_when_ordered_away(height=0.1)
    flight.set(mode=FlightMode.GUIDED).step()
    requests, _, step = flight.set(armed=False, landed=True).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


@pytest.mark.parametrize('settings', [SETTINGS, Settings()])
def test_motors_stopped_in_flight_are_not_started_again(settings):
    """Whoever armed it: a crew that found it flying away, say."""
    flight = Flight(settings).order(COMMIT).airborne(50.0)
    flight.step()
    requests, _, step = flight.set(armed=False, landed=True).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    assert 'disarmed, but not from here' in step.status


def disarmed(flight: Flight, height: float, climb: float):
    flight.at(0.0, height=height).climb = climb
    return flight.set(armed=False, landed=True).step()


@pytest.mark.parametrize(
    ('mode', 'height', 'climb', 'phase'),
    [
        (FlightMode.LAND, 18.0, -4.0, Phase.PILOT),
        (FlightMode.LAND, 18.0, 0.0, Phase.GROUND),
        (FlightMode.LAND, 0.0, -0.6, Phase.GROUND),
    ],
    ids=['falling', 'landed on a hill', 'landed'],
)
def test_a_landing_ends_at_rest(mode, height, climb, phase):
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=mode).step()
    assert disarmed(flight, height, climb).phase is phase


@pytest.mark.parametrize('first', ['the fall', 'the news'], ids=lambda first: f'{first} first')
def test_motors_stopped_just_above_the_ground_are_not_started_again(first):
    """A heartbeat may take a second; by then it lies on the ground."""
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=FlightMode.LAND).at(0.0, height=3.0).step()
    if first == 'the news':
        flight.set(armed=False, landed=True).step()
    flight.at(0.0, height=1.0).climb = -5.0
    flight.step()
    flight.at(0.0, height=0.0).climb = 0.0
    flight.step()
    flight.set(armed=False, landed=True)
    requests, _, step = flight.order(COMMIT).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    assert 'stopped in the air' in step.status
    flight.pilot.resume(flight.now)
    assert flight.step().phase is Phase.ARMING


def test_motors_stopped_by_hand_in_flight_by_hand_are_not_started_again():
    flight = Flight().order(COMMIT).airborne().set(mode=FlightMode.LOITER)
    flight.step()
    step = disarmed(flight, 18.0, 0.0)
    assert (step.phase, step.requests) == (Phase.PILOT, ())
    assert step.status.startswith('disarmed 18 m above home')


def hand_armed_after_resume() -> Flight:
    flight = Flight().order(HOVER)
    flight.pilot.resume(flight.now)
    flight.step()
    return flight


def hand_armed_after_an_order() -> Flight:
    flight = Flight().order(COMMIT)
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)
    return flight


@pytest.mark.parametrize('ready', [hand_armed_after_resume, hand_armed_after_an_order])
def test_armed_by_hand_it_is_flown_by_hand_until_guided(ready):
    flight = ready().set(armed=True)
    requests, _, step = flight.order(COMMIT).run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    flight.set(landed=False).at(0.0)
    assert flight.set(mode=FlightMode.GUIDED).step().requests == (fly_to(COMMIT),)


def test_a_failsafe_is_not_overruled():
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=FlightMode.LAND).step()
    flight.set(failsafe=True).order(COMMIT)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    assert 'failsafe' in step.status


def test_in_a_failsafe_it_does_not_arm():
    requests, _, step = Flight(mode=FlightMode.GUIDED, failsafe=True).order(COMMIT).run(10.0)
    assert requests == []
    assert 'failsafe' in step.status


def test_flown_by_hand_from_the_start_guided_gives_command():
    flight = Flight().order(COMMIT).airborne().set(mode=FlightMode.LOITER)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    assert flight.set(mode=FlightMode.GUIDED).step().requests == (fly_to(COMMIT),)
    assert flight.set(mode=FlightMode.LOITER).step().phase is Phase.PILOT
    assert flight.set(mode=FlightMode.GUIDED).run(5.0)[0] == []


def test_after_a_lost_link_a_changed_mode_is_someone_elses():
    flight = Flight().order(COMMIT).airborne()
    flight.step()
    assert flight.pilot.update(None, flight.now).phase is Phase.NO_LINK
    requests, _, step = flight.set(mode=FlightMode.RTL).run(5.0)
    assert (step.phase, requests) == (Phase.PILOT, [])
    assert flight.set(mode=FlightMode.GUIDED).run(5.0)[0] == []


def test_on_the_ground_the_autopilot_may_reboot():
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=FlightMode.LAND).step()
    flight.set(armed=False, landed=True).at(0.0, height=0.0).step()
    flight.pilot.update(None, flight.now)
    assert flight.set(mode=FlightMode.STABILIZE).step().phase is Phase.GROUND
    assert flight.order(COMMIT).step().requests == (SetMode(FlightMode.GUIDED),)


def test_a_lost_link_gives_no_command_back():
    flight = Flight().order(COMMIT).airborne()
    flight.step()
    flight.set(mode=FlightMode.LOITER).step()
    flight.set(armed=False, landed=True).step()
    flight.pilot.update(None, flight.now)
    assert flight.set(mode=FlightMode.STABILIZE).step().phase is Phase.PILOT


def test_a_lost_link_interrupts_the_dwell():
    flight = Flight().order(COMMIT).airborne(100.0)
    flight.run(1.5)
    for _ in range(100):
        flight.now += 0.05
        flight.pilot.update(None, flight.now)
    assert flight.run(0.4)[1] == []
    assert flight.run(0.3)[1] == ['goal1']


def test_hold_stays_where_it_was_called_until_resume():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.pilot.hold()
    here = Fly(*place(50.0), UP, SETTINGS.cruise_speed)
    step = flight.step()
    assert (step.phase, step.requests) == (Phase.HOLDING, (here,))
    requests, _, step = flight.at(55.0).order(OTHER).run(30.0)
    assert (step.phase, set(requests)) == (Phase.HOLDING, {here})
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (fly_to(OTHER),)
    flight.pilot.hold()
    assert flight.step().requests == (Fly(*place(55.0), UP, SETTINGS.cruise_speed),)


def test_a_hold_interrupts_the_dwell():
    flight = Flight().order(COMMIT).airborne(100.0)
    flight.run(1.5)
    flight.pilot.hold()
    assert flight.run(20.0)[1] == []
    flight.pilot.resume(flight.now)
    assert flight.run(0.4)[1] == []
    assert flight.run(0.3)[1] == ['goal1']


def climbing() -> Flight:
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True).step()
    assert flight.set(landed=False).at(0.0, height=5.0).step().phase is Phase.TAKE_OFF
    return flight


def test_a_climb_ended_by_a_hold_is_not_waited_for():
    flight = climbing()
    flight.pilot.hold()
    flight.run(1.0)
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (Fly(*place(), UP, SETTINGS.cruise_speed),)


def test_a_climb_ended_by_a_pilot_is_not_waited_for():
    flight = climbing()
    flight.set(mode=FlightMode.LOITER).step()
    flight.pilot.resume(flight.now)
    flight.step()
    step = flight.set(mode=FlightMode.GUIDED).step()
    assert step.requests == (Fly(*place(), UP, SETTINGS.cruise_speed),)


def test_hold_ends_a_return_to_launch():
    flight = Flight().order(COMMIT).airborne(50.0)
    silence(flight, 14.0)
    flight.set(mode=FlightMode.RTL).step()
    flight.pilot.hold()
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)
    assert flight.set(mode=FlightMode.GUIDED).step().phase is Phase.HOLDING


def test_hold_breaks_off_a_landing_at_a_safe_height():
    flight = Flight().order(HOME).airborne()
    flight.step()
    flight.set(mode=FlightMode.LAND).at(0.0, height=1.0).step()
    flight.pilot.hold()
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)
    assert flight.set(mode=FlightMode.GUIDED).step().requests == (
        Fly(*place(), GROUND + 3.0, SETTINGS.cruise_speed),
    )


def test_without_position_a_hold_asks_for_nothing_and_says_so():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.pilot.hold()
    flight.step()
    flight.position = False
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])
    assert 'no position to hold' in step.status


def test_hold_on_the_ground_does_not_arm():
    flight = Flight().order(COMMIT)
    flight.pilot.hold()
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])


def test_motors_started_for_nothing_are_stopped_by_landing():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True).order(HOME)
    assert flight.step().requests == (SetMode(FlightMode.LAND),)
    step = flight.set(mode=FlightMode.LAND, armed=False).step()
    assert (step.phase, step.requests) == (Phase.GROUND, ())


def test_motors_that_a_human_started_are_left_alone():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.order(HOVER).run(6.0)
    flight.set(armed=True)
    requests, _, step = flight.run(5.0)
    assert (step.phase, requests) == (Phase.GROUND, [])
    assert 'disarmed, but not from here' in flight.set(armed=False).step().status


# A silent manager


def silence(flight: Flight, seconds: float):
    requests = []
    for _ in range(round(seconds / 0.05)):
        step = flight.silent_step()
        requests += step.requests
    return requests, step


def test_silence_holds_then_returns_to_launch_and_flies_it_to_the_end():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    requests, step = silence(flight, 2.9)
    assert (step.phase, requests) == (Phase.EN_ROUTE, [])
    requests, step = silence(flight, 9.9)
    assert step.phase is Phase.HOLDING
    assert set(requests) == {Fly(*place(50.0), UP, SETTINGS.cruise_speed)}
    requests, step = silence(flight, 1.0)
    assert (step.phase, requests) == (Phase.RETURNING, [SetMode(FlightMode.RTL)])
    flight.set(mode=FlightMode.RTL)
    requests, _, step = flight.run(30.0)
    assert (step.phase, requests) == (Phase.RETURNING, []), 'the manager is back too late'
    flight.set(armed=False, landed=True).at(0.0, height=0.0)
    requests, _, step = flight.run(30.0)
    assert (step.phase, requests) == (Phase.HOLDING, []), 'nobody expects a take-off now'
    assert step.status == (
        'on the ground until ~/resume; returned to launch: the manager is silent'
    )
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)
    flight.set(mode=FlightMode.GUIDED).step()
    assert isinstance(flight.set(armed=True).step().requests[0], TakeOff)


def test_a_manager_that_comes_back_before_the_return_continues():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    silence(flight, 8.0)
    step = flight.step()
    assert (step.phase, step.requests) == (Phase.EN_ROUTE, (fly_to(COMMIT),))


def test_found_flying_without_a_manager_it_holds_then_returns():
    flight = Flight().airborne(50.0)
    requests, step = silence(flight, 12.9)
    assert (step.phase, requests[0]) == (
        Phase.HOLDING,
        Fly(*place(50.0), UP, SETTINGS.cruise_speed),
    )
    requests, step = silence(flight, 0.3)
    assert (step.phase, requests) == (Phase.RETURNING, [SetMode(FlightMode.RTL)])


def test_a_manager_silent_since_the_link_was_lost_is_awaited_anew():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    for _ in range(1000):
        flight.now += 0.05
        flight.pilot.update(None, flight.now)
    requests, step = silence(flight, 12.9)
    assert step.phase is Phase.HOLDING
    assert SetMode(FlightMode.RTL) not in requests
    assert flight.step().requests == (fly_to(COMMIT),)


def test_a_resume_is_not_kept_for_after_a_lost_link():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.pilot.update(None, flight.now)
    flight.pilot.resume(flight.now)
    flight.pilot.update(None, flight.now)
    requests, _, step = flight.set(mode=FlightMode.LOITER).run(5.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def test_a_resumed_vehicle_holds_where_it_is_until_the_manager_is_heard():
    flight = Flight().order(COMMIT).airborne(50.0)
    silence(flight, 8.0)
    silence(flight.set(mode=FlightMode.LOITER).at(80.0), 5.0)
    flight.pilot.resume(flight.now)
    silence(flight, 0.1)
    requests, _ = silence(flight.set(mode=FlightMode.GUIDED), 0.1)
    assert requests == [Fly(*place(80.0), UP, SETTINGS.cruise_speed)]


def test_silence_lets_motors_that_a_human_started_idle_on_the_ground():
    flight = Flight(mode=FlightMode.GUIDED).order(HOVER)
    flight.step()
    requests, step = silence(flight.set(armed=True), 60.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])


def test_a_return_that_is_not_flown_is_asked_for_again():
    flight = Flight().order(COMMIT).airborne(50.0)
    requests, _ = silence(flight, 21.0)
    assert requests.count(SetMode(FlightMode.RTL)) == 3


def test_held_in_the_air_after_a_return_it_says_until_when():
    flight = Flight().order(COMMIT).airborne(50.0)
    silence(flight, 20.0)
    flight.set(mode=FlightMode.RTL).step()
    flight.set(armed=False, landed=True).at(0.0, height=0.0).step()
    flight.set(mode=FlightMode.LOITER, armed=True).step()
    step = flight.airborne().step()
    assert step.phase is Phase.HOLDING
    assert step.status == 'until ~/resume; returned to launch: the manager is silent'


def test_resume_ends_a_return_and_waits_for_the_manager_anew():
    flight = Flight().order(COMMIT).airborne(50.0)
    silence(flight, 14.0)
    silence(flight.set(mode=FlightMode.RTL), 5.0)
    flight.pilot.resume(flight.now)
    assert flight.silent_step().requests == (SetMode(FlightMode.GUIDED),)
    _, step = silence(flight.set(mode=FlightMode.GUIDED), 5.0)
    assert step.phase is Phase.HOLDING
    _, step = silence(flight, 10.0)
    assert step.phase is Phase.RETURNING


def test_a_pilot_takes_over_from_a_return():
    flight = Flight().order(COMMIT).airborne(50.0)
    silence(flight, 14.0)
    silence(flight.set(mode=FlightMode.RTL), 1.0)
    requests, step = silence(flight.set(mode=FlightMode.LOITER), 30.0)
    assert (step.phase, requests) == (Phase.PILOT, [])


def test_silence_lets_a_landing_finish():
    flight = Flight().order(HOME).airborne()
    flight.step()
    requests, step = silence(flight.set(mode=FlightMode.LAND), 60.0)
    assert (step.phase, requests) == (Phase.LANDING, [])


def test_silence_on_the_ground_does_nothing():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    silence(flight, 3.0)
    requests, step = silence(flight, 60.0)
    assert (step.phase, requests) == (Phase.GROUND, [])


def test_a_hold_outlasts_a_silent_manager():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.pilot.hold()
    requests, step = silence(flight, 60.0)
    assert step.phase is Phase.HOLDING
    assert all(isinstance(request, Fly) for request in requests)


# On the ground, a reason to fly


@pytest.mark.parametrize('task', [COMMIT, HOME, RECHARGE, REPAIR])
@pytest.mark.parametrize('telemetry', [{}, {'mode': FlightMode.GUIDED}], ids=['by hand', 'guided'])
def test_without_a_wanted_goal_it_stays_on_the_ground(task, telemetry):
    flight = Flight(**telemetry).at(-60.0, height=0.0).order(task)
    flight.pilot.goals_wanted = False
    requests, _, step = flight.run(60.0)
    assert (step.phase, requests) == (Phase.GROUND, [])
    assert step.status == f'{task.text}: stays on the ground, for no goal is wanted'
    flight.pilot.goals_wanted = True
    assert flight.step().requests


def test_after_a_service_it_stays_if_no_goal_is_wanted():
    flight = Flight(mode=FlightMode.LAND).at(50.0, height=0.0).order(REPAIR)
    flight.pilot.goals_wanted = False
    _, _, step = flight.run(SETTINGS.service_time - 0.1)
    serviced = [flight.step().serviced for _ in range(10)]
    assert any(serviced)
    requests, _, step = flight.order(HOME).run(60.0)
    assert (step.phase, requests) == (Phase.GROUND, [])


def test_motors_started_here_are_stopped_when_no_goal_is_wanted_any_more():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True)
    flight.pilot.goals_wanted = False
    assert flight.step().requests == (SetMode(FlightMode.LAND),)


def test_motors_that_are_being_stopped_are_left_to_it():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True).step()
    flight.order(RECHARGE).pilot.goals_wanted = False
    assert flight.step().requests == (SetMode(FlightMode.LAND),)
    requests, _, step = flight.set(mode=FlightMode.LAND).run(20.0)
    assert (step.phase, requests) == (Phase.GROUND, [])


@pytest.mark.parametrize(('task', 'flies'), [(COMMIT, True), (REPAIR, False), (HOME, False)])
def test_where_nobody_says_what_is_wanted_a_commitment_says_it(task, flies):
    flight = Flight(mode=FlightMode.GUIDED).at(-60.0, height=0.0).order(task)
    flight.pilot.goals_wanted = None
    assert bool(flight.step().requests) is flies


# What is not known


@pytest.mark.parametrize('kind', HEARD)
def test_nothing_is_ordered_before_all_is_heard(kind):
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.pilot.update(None, flight.now)
    flight.set(received={heard: 0.0 for heard in HEARD if heard != kind})
    requests, _, step = flight.run(60.0)
    assert (step.phase, requests) == (Phase.WAITING, [])
    assert step.status.startswith('not heard yet: ')
    assert flight.set(received=HEARD).step().requests == (fly_to(COMMIT),)


def test_a_manager_silent_while_the_vehicle_is_heard_anew_is_awaited_anew():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.set(received={})
    silence(flight, 60.0)
    flight.set(received=HEARD)
    requests, step = silence(flight, 12.0)
    assert step.phase is Phase.HOLDING
    assert SetMode(FlightMode.RTL) not in requests


@pytest.mark.parametrize('gap', [None, {}])
def test_a_dead_manager_is_not_awaited_for_ever_on_a_link_with_gaps(gap):
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    for _ in range(2):
        _, step = silence(flight, 6.0)
        assert step.phase is Phase.HOLDING
        for _ in range(100):
            flight.now += 0.05
            telemetry = None if gap is None else replace(flight.telemetry, received=gap)
            flight.pilot.update(telemetry, flight.now)
    requests, step = silence(flight, 2.0)
    assert (step.phase, requests[-1]) == (Phase.RETURNING, SetMode(FlightMode.RTL))


def test_in_the_air_unknown_is_not_on_the_ground():
    flight = Flight().order(HOME).airborne(50.0)
    flight.step()
    flight.position = False
    requests, _, step = flight.set(landed=None).run(10.0)
    assert (step.phase, requests) == (Phase.WAITING, [])
    flight.pilot.hold()
    assert flight.run(10.0)[0] == []


def test_below_home_unknown_is_not_on_the_ground():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True).step()
    flight.airborne(50.0).order(HOME).pilot.goals_wanted = False
    flight.home = 30.0
    requests, _, step = flight.set(landed=None).run(10.0)
    assert SetMode(FlightMode.LAND) not in requests
    assert step.phase is Phase.EN_ROUTE


# Failsafes


def test_a_failsafe_that_leaves_the_mode_is_no_takeover():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.set(failsafe=True)
    assert flight.run(10.0)[2].phase is Phase.EN_ROUTE
    assert flight.order(RECHARGE).step().phase is Phase.LANDING
    flight.set(mode=FlightMode.LAND).run(10.0)
    assert flight.set(failsafe=False).run(10.0)[2].phase is Phase.LANDING


# How it flies


@pytest.mark.parametrize('height', [1.7, 4.4, 17.9])
def test_it_climbs_before_it_moves_sideways(height):
    flight = Flight().order(COMMIT).airborne().at(3.5, height=height)
    step = flight.step()
    climb = Fly(*place(3.5), UP, SETTINGS.cruise_speed)
    assert (step.phase, step.requests) == (Phase.CLIMBING, (climb,))
    flight.at(5.0, height=18.9).run(3.0)
    requests, _, step = flight.run(6.0)
    assert (step.phase, set(requests)) == (Phase.CLIMBING, {climb}), 'where it began to climb'
    assert flight.at(5.0, height=19.1).step().requests == (fly_to(COMMIT),)


def test_a_goal_counts_at_its_height():
    flight = Flight().order(COMMIT).airborne().at(100.0, height=39.0)
    requests, completed, step = flight.run(20.0)
    assert (step.phase, completed) == (Phase.EN_ROUTE, [])
    assert set(requests) == {fly_to(COMMIT)}
    assert flight.at(100.0, height=21.9).run(3.0)[1] == ['goal1']


def test_on_hilly_ground_it_travels_high_and_completes_low():
    flight = Flight().order(replace(COMMIT, altitude=UP, cruise_altitude=UP + 30.0)).airborne()
    assert flight.at(0.0, height=20.0).step().phase is Phase.CLIMBING
    step = flight.at(0.0, height=50.0).step()
    assert step.requests == (replace(fly_to(COMMIT), altitude=UP + 30.0),)
    step = flight.at(100.0, height=50.0).step()
    assert (step.requests, step.completed) == ((fly_to(COMMIT),), '')
    assert flight.at(100.0, height=20.0).run(3.0)[1] == ['goal1']


@pytest.mark.parametrize(('error', 'word'), [(15.0, 'above'), (-15.0, 'below')])
def test_where_it_stands_must_agree_with_the_mission_file(error, word):
    flight = Flight(mode=FlightMode.GUIDED).at(0.0, height=error).order(COMMIT)
    requests, _, step = flight.run(10.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])
    assert f'the vehicle is 15 m {word} the mission' in step.status
    assert flight.at(0.0, height=math.copysign(9.0, error)).step().requests == (Arm(),)


def test_a_trembling_altitude_of_home_is_no_reason_to_take_off_again():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.set(armed=True).step()
    requests = []
    for millimetres in range(30):
        flight.home = millimetres % 3 * 1e-3
        requests += flight.step().requests
    assert requests == []


def test_home_must_agree_with_the_mission_file_and_take_off_ends_at_its_altitude():
    def take_off(home: float):
        flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
        flight.step()
        flight.home = home
        return flight.set(armed=True).step()

    assert [request.height for request in take_off(3.0).requests] == [17.0]
    step = take_off(-20.0)
    assert (step.phase, step.requests) == (Phase.HOLDING, (SetMode(FlightMode.LAND),))
    assert 'home is 20 m below the mission' in step.status


def held_on_the_ground(flight: Flight, why: str) -> None:
    step = flight.step()
    assert (step.phase, step.requests) == (Phase.HOLDING, (SetMode(FlightMode.LAND),))
    assert flight.set(mode=FlightMode.LAND).run(5.0)[0] == []
    requests, _, step = flight.set(armed=False).run(60.0)
    assert (step.phase, requests) == (Phase.HOLDING, [])
    assert why in step.status
    assert '~/resume' in step.status
    flight.pilot.resume(flight.now)
    assert flight.step().requests == (SetMode(FlightMode.GUIDED),)


def test_for_a_wrong_home_motors_are_not_started_again_and_again():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    flight.home = -20.0
    held_on_the_ground(flight.set(armed=True), 'home is 20 m below the mission')


def test_a_take_off_that_leads_nowhere_is_given_up():
    flight = Flight(mode=FlightMode.GUIDED).order(COMMIT)
    flight.step()
    requests, _, step = flight.set(armed=True).run(SETTINGS.progress_timeout - 1.0)
    assert step.phase is Phase.TAKE_OFF
    assert [type(request) for request in requests] == 4 * [TakeOff]
    flight.pilot.answered(TakeOff, False, 'FAILED: too heavy', flight.now)
    flight.now += 2.0
    held_on_the_ground(flight, 'no take-off in 30 s: FAILED: too heavy')


def test_too_fast_it_is_told_its_speed_again():
    flight = Flight().order(COMMIT).airborne(20.0)
    flight.step()
    flight.speed = 5.4
    assert flight.run(4.5)[0] == []
    flight.step(1.0)
    flight.speed = 5.6
    assert flight.run(3.5)[0] == [fly_to(COMMIT)]


def test_a_bad_position_is_not_held():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.pilot.hold()
    flight.step()
    flight.position = False
    flight.run(1.0)
    flight.position = True
    requests, _, _ = flight.at(86.0).run(10.0)
    assert set(requests) == {Fly(*place(86.0), UP, SETTINGS.cruise_speed)}


# What is refused


def refuse(flight: Flight, times: int):
    for _ in range(times):
        flight.pilot.answered(Fly, False, 'FAILED: outside the fence', flight.now)


def test_a_refused_flight_makes_its_goal_out_of_reach():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    refuse(flight, 1)
    step = flight.step()
    assert (step.phase, step.refused) == (Phase.EN_ROUTE, '')
    refuse(flight, 1)
    step = flight.step()
    assert (step.phase, step.refused, step.losing_ground) == (Phase.BLOCKED, 'goal1', False)
    assert step.status == 'commit goal1 normal: FAILED: outside the fence'
    assert flight.step().refused == '', 'said once'
    step = flight.order(OTHER).step()
    assert (step.phase, step.requests) == (Phase.EN_ROUTE, (fly_to(OTHER),))


def test_a_refused_flight_is_asked_for_with_growing_pauses():
    flight = Flight(replace(SETTINGS, progress_timeout=1000.0)).order(COMMIT).airborne(50.0)
    pauses, seconds = [], 0.0
    flight.step()
    while len(pauses) < 6:
        refuse(flight, 1)
        while not flight.step().requests:
            seconds += 0.05
        pauses, seconds = [*pauses, seconds + 0.05], 0.0
    assert pauses == pytest.approx([2.0, 4.0, 8.0, 16.0, 30.0, 30.0], abs=0.2)


def test_an_accepted_flight_takes_the_refusals_back():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    refuse(flight, 2)
    assert flight.step().phase is Phase.BLOCKED
    flight.pilot.answered(Fly, True, '', flight.now)
    assert flight.step().phase is Phase.EN_ROUTE


def test_no_progress_makes_a_goal_out_of_reach_and_in_the_end_it_returns():
    flight = Flight().order(COMMIT).airborne(50.0)
    for step in range(200):  # It swings in the wind.
        flight.at(50.0 + step % 2 * 0.9).run(0.1)
    flight.run(9.0)
    assert flight.step().phase is Phase.EN_ROUTE
    outputs = [flight.step() for _ in range(60)]
    assert [output.refused for output in outputs if output.refused] == ['goal1']
    assert outputs[-1].phase is Phase.BLOCKED
    assert outputs[-1].status == 'commit goal1 normal: no nearer for 30 s'
    requests, _, step = flight.run(31.0)
    assert step.phase is Phase.RETURNING
    assert requests[-1] == SetMode(FlightMode.RTL)


def test_carried_away_no_goal_is_within_reach():
    flight = Flight().order(COMMIT).airborne(50.0)
    flight.step()
    flight.at(20.0)
    outputs = [flight.step() for _ in range(700)]
    assert [output.losing_ground for output in outputs if output.refused] == [True]


def test_slow_progress_is_progress():
    flight = Flight().order(COMMIT).airborne(0.0)
    for metre in range(80):
        assert flight.at(metre * 1.1).run(20.0)[2].phase is Phase.EN_ROUTE


def test_climbing_again_and_again_is_no_progress():
    flight = Flight().order(COMMIT).airborne(50.0)
    phases = set()
    for step in range(200):  # A downdraft.
        output = flight.at(50.0, height=17.0 + step % 2 * 3.0).run(0.2)[2]
        phases.add(output.phase)
    assert phases == {Phase.CLIMBING, Phase.EN_ROUTE, Phase.BLOCKED}


# Settings changed in flight


def test_another_speed_is_ordered_at_once_and_the_leg_goes_on():
    flight = Flight().order(COMMIT).airborne()
    assert flight.step().requests == (fly_to(COMMIT),)
    flight.run(20.0)
    flight.pilot.site.settings = replace(SETTINGS, cruise_speed=3.0)
    assert flight.step().requests == (fly_to(COMMIT, 3.0),)
    assert flight.step().requests == ()
    # It is no new leg: no progress since its beginning still counts.
    assert flight.run(SETTINGS.progress_timeout - 19.0)[2].phase is Phase.BLOCKED


@pytest.mark.parametrize(
    ('name', 'task', 'before', 'after'),
    [
        ('progress_timeout', COMMIT, Phase.EN_ROUTE, Phase.BLOCKED),
        ('manager_timeout', None, Phase.EN_ROUTE, Phase.HOLDING),
    ],
)
def test_a_shorter_time_counts_from_when_it_began(name, task, before, after):
    flight = Flight().order(COMMIT).airborne()
    flight.step()
    flight.task = task
    for _ in range(50):
        step = flight.step()
    assert step.phase is before
    flight.pilot.site.settings = replace(SETTINGS, **{name: 2.0})
    assert flight.step().phase is after


def test_another_dwell_begins_anew():
    flight = Flight(replace(SETTINGS, goal_dwell=100.0)).order(COMMIT)
    flight.airborne(100.0)
    assert flight.run(10.0)[1] == []
    flight.pilot.site.settings = replace(SETTINGS, goal_dwell=5.0)
    assert flight.run(4.9)[1] == []
    assert flight.run(0.3)[1] == ['goal1']
