"""What must hold at every moment, seen from outside: on the wires, and in the simulator's truth.

What the code under test says of itself counts only where the invariant is that it says so; and as
an excuse, for what takes longer while it holds, or waits.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from parts.soak.whereabouts import Whereabouts, fail
from parts.soak.wishes import GRACE, Wishes
from uav_mission_manager.autopilot.exchange import short_name
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode

if TYPE_CHECKING:
    from parts.soak.day import Day

ORDERS = {
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_DO_CHANGE_SPEED,
}
"""Commands that move the vehicle."""

TO_FLY = {mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF}
"""Commands that make it leave the ground."""

PICTURE = mavlink.MAV_CMD_IMAGE_START_CAPTURE

NEEDED = {'HEARTBEAT', 'GLOBAL_POSITION_INT', 'EXTENDED_SYS_STATE'}
"""What is to be heard before an order: mode, position, landed state."""

LINK_TIMEOUT = 3.0
"""Time [s] without HEARTBEAT after which the link is lost: the nodes' default."""

SLACK = 0.2
"""Time [s] for which it may not have been noticed yet: four steps."""

STALL = 1.0
"""Time [s] for which a bridge may stand still without forgetting what it has heard."""

HOMEWARD_TIME = 240.0
"""Time [s] after which a vehicle without a wanted goal, and with nothing wrong, is on the ground:
a choice, four times as long as the longest way home and down."""

MAX_CHANGES, CHANGES_TIME = 12, 60.0
"""Changed commands in so many seconds, at most."""

RESERVE_TIME = 4.0
"""Time [s] for which a commitment may stand that the charge no longer reaches: until it is
measured, told and decided on."""

GAUGE_ERROR = 0.03
"""How much more [of 1] than is true the manager may take the charge for: rounding and noise."""


class Invariants:
    """Checks a day.

    Attributes
    ----------
    checked : Counter
        How often each was looked at.
    """

    def __init__(self, day: Day) -> None:
        self.day = day
        self.wishes = Wishes(day.mission)
        self.checked: Counter[str] = Counter()
        self.command = ''
        self._goals = {goal.name: goal.cell for goal in day.mission.goals}
        self._photographed = day.mission.goals[0].name  # as `with_work` has it
        self._where = Whereabouts(day, self.checked)
        self._changes: deque[float] = deque(maxlen=MAX_CHANGES + 1)
        self._heard: set[str] = set()
        self._beat_at = -math.inf
        self._boot_time = 0
        self._yields = self._sees = False  # the bridge has seen someone else in command; just now
        self._ordered_mode: float | None = None
        self._own_mode: float | None = None  # as it takes it, until it is known to have left it
        self._held = self._guided_gives = False
        self._short_since: float | None = None
        self._troubled_at = -math.inf
        self._order_at: dict[int, tuple[float, str]] = {}
        self._refusals: list[tuple[float, str, str]] = []
        self._cancelled_at = -math.inf

    # What people do

    def asked(self, priorities: tuple[int, ...]) -> None:
        """Take note of a request."""
        self.wishes.ask(priorities)

    def bridge_started(self, doubt: str) -> None:
        """Without a journal to believe, it is held until ~/resume; GUIDED gives command to it."""
        self._held = self._held or bool(doubt)
        self._guided_gives = bool(doubt)

    def held(self, taken: bool) -> None:
        """Take note of ~/hold, and whether it was taken."""
        self._held = self._held or taken
        self.day.vehicle.piloted = self.day.vehicle.piloted or taken
        self._cancelled_at = self.day.now

    def resumed(self) -> tuple[Any, ...]:
        """Take note of ~/resume; return what to take back if it is not taken."""
        before = self._held, self._yields or self._sees, self.day.vehicle.foreign
        self._own_mode, self.day.vehicle.foreign = self.day.vehicle.foreign, None
        self._held = self._yields = self._sees = self._guided_gives = False
        self._cancelled_at = self.day.now
        return before

    def not_resumed(self, before: tuple[Any, ...]) -> None:
        """Take it back."""
        self._held, self._yields, self.day.vehicle.foreign = before

    def rebooted(self) -> None:
        """Take note of it that the autopilot begins anew."""
        self._cancelled_at = self.day.now

    # On the wire

    def bridge_died(self) -> None:
        """What it has heard is gone."""
        self._heard.clear()
        self._refusals.clear()
        self._sees = False
        self._beat_at = -math.inf

    def heard(self, message: Any) -> None:
        """Take note of what the bridge has read."""
        kind = message.get_type()
        now = self.day.now
        bridge = self.day.bridge
        if now - bridge.worked_at > STALL:  # What has waited is out of date.
            return
        if kind == 'HEARTBEAT':
            self._beat_at = now
        if not bridge.works:
            return
        if self._is_reboot(kind, message):
            self._heard.clear()
            self._cancelled_at = now
        if kind == 'HEARTBEAT':
            self._see_mode(message)
        elif kind == 'COMMAND_ACK':
            self._see_answer(message, now)
        self._heard.add(kind)

    def _is_reboot(self, kind: str, message: Any) -> bool:
        """Whether time has gone back, and nothing has said before that it would."""
        if kind == 'HEARTBEAT' and message.system_status == mavlink.MAV_STATE_BOOT:
            self._boot_time = 0
        if kind == 'GLOBAL_POSITION_INT':
            last, self._boot_time = self._boot_time, message.time_boot_ms
            return bool(message.time_boot_ms < last - 1000)
        return False

    def _see_mode(self, message: Any) -> None:
        """Whoever else has command is seen by the mode, and in it nothing is ordered any more."""
        foreign = self.day.vehicle.foreign
        if message.custom_mode != self._own_mode:
            self._own_mode = None
        if foreign is None or foreign != message.custom_mode:
            return
        if foreign == SimulatedMode.GUIDED and self._guided_gives:
            self._yields = False
        if foreign == self._ordered_mode:
            self._own_mode = foreign
        if foreign in (SimulatedMode.GUIDED, self._own_mode):
            return  # In a mode of the bridge's own, or not known to be left, nobody can tell.
        if message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
            self._sees = True
            self._cancelled_at = self.day.now

    def _see_answer(self, message: Any, now: float) -> None:
        """A refusal of what was sent lately has to be said."""
        fine = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS
        sent_at, phase = self._order_at.pop(message.command, (-math.inf, ''))
        if message.command == mavlink.MAV_CMD_DO_SET_MODE and message.result in fine:
            self._own_mode = None
        if message.result not in fine and now - sent_at < 1.0:
            self._refusals.append((now, short_name('MAV_CMD', message.command), phase))

    def sent(self, message: Any) -> None:
        """Check what the bridge asks of the vehicle."""
        if message.get_type() not in ('COMMAND_LONG', 'COMMAND_INT'):
            return
        if message.command == PICTURE:
            self.check_work('a picture', self._photographed)
        if message.command not in ORDERS:
            return
        self.checked['orders'] += 1
        now, order = self.day.now, short_name('MAV_CMD', message.command)
        order += f' {message.param2:.0f}' if message.command == 176 else ''
        self._order_at[message.command] = now, self.day.phase
        if message.command == mavlink.MAV_CMD_DO_SET_MODE:
            self._ordered_mode = message.param2
        if self._yields or self._sees:
            fail('never against a pilot', f'{order}, and someone else is in command')
        if missing := NEEDED - self._heard:
            fail('hears before it orders', f'{order} without {", ".join(sorted(missing))}')
        if message.command in TO_FLY:
            if self._held:
                fail('held', f'{order} before ~/resume')
            if self.wishes.none_for > GRACE:
                fail('flies only for a goal', f'{order}, and none is wanted')

    def check_work(self, what: str, goal: str) -> None:
        """Check work at a goal: it is done there, and not while someone else is in command."""
        self.checked['work'] += 1
        if not self._where.at(goal):
            distance = self.day.vehicle.distance(self.day.mission.grid, self._goals[goal])
            fail('done where it is', f'{what}, {distance:.1f} m from {goal}')
        if self._yields or self._sees or self._held:
            fail('never against a pilot', what)

    # Between the processes

    def commanded(self, text: str) -> None:
        """Check what the manager commands."""
        self.checked['commands'] += 1
        now = self.day.now
        if text != self.command:
            self.command = text
            self._short_since = None
            self._changes.append(now)
            if len(self._changes) > MAX_CHANGES and now - self._changes[0] < CHANGES_TIME:
                fail('few commands', f'{len(self._changes)} in {CHANGES_TIME:.0f} s')
        goal = self._committed
        if goal and self.wishes.unwanted_for[goal] > GRACE and not self._where.at(goal):
            done = self.wishes.done.get(goal)
            why = 'nobody wants' if done is None else f'was done at {done:.1f} s'
            fail('nothing is done twice', f'{text}, which {why}')

    def manager_died(self) -> None:
        """Its successor may change its mind."""
        self._changes.clear()
        self._short_since = None

    def completed(self, goal: str, heard: bool) -> None:
        """Check a completion: was it there? `heard`, whether there was anyone to hear of it."""
        self.checked['completions'] += 1
        if not self._where.at(goal):
            distance = self.day.vehicle.distance(self.day.mission.grid, self._goals[goal])
            height = self.day.vehicle.flight.body.altitude
            fail('done where it is', f'{goal}, {distance:.1f} m off, {height:.1f} m high')
        if goal in self.wishes.done and self._where.away[goal]:
            done = self.wishes.done[goal]
            fail('nothing is done twice', f'{goal}, done before at {done:.1f} s')
        self._where.away[goal] = False
        if heard:
            self.wishes.complete(goal, self.day.now)

    # At every step

    def check(self, dt: float) -> None:
        """Check what is true now."""
        day = self.day
        self.checked['steps'] += 1
        self._yields, self._sees = self._yields or self._sees, False
        silent = day.now - self._beat_at > LINK_TIMEOUT + SLACK
        if silent or day.now - day.bridge.worked_at > STALL + SLACK:
            self._heard.clear()
        self.wishes.pass_time(dt, all_work=day.all_work)
        self._where.check()
        self._check_reserve()
        self._check_homeward()
        self._check_refusals()
        for text in day.vehicle_texts:
            if 'Crash' in text and not self._where.drained:
                fail('no crash', text)

    def _check_reserve(self) -> None:
        """A commitment is within reach by the mission's own energy model, and the true charge."""
        goal, day = self._committed, self.day
        if not goal or not day.manager.works or not day.vehicle.airborne:
            self._short_since = None
            return
        mission = day.mission
        energy, cell = mission.energy, self._goals[goal]
        charge = day.vehicle.flight.body.battery.charge + GAUGE_ERROR
        seconds = charge * energy.capacity * energy.voltage / energy.power * 3600.0
        reach = energy.speed * seconds
        reach -= energy.wind_penalty * energy.wind + energy.payload_penalty * energy.payload
        here, goal_place = day.vehicle.place, mission.grid.position(cell)
        way = math.dist(here, goal_place)
        way += math.dist(goal_place, mission.grid.position(mission.grid.service))
        if reach >= way or not day.told:
            self._short_since = None
        elif self._short_since is None:
            self._short_since = day.now
        elif day.now - self._short_since > RESERVE_TIME:
            fail('reserve', f'{self.command}: {way:.0f} m to fly, reach {reach:.0f} m')

    def _check_homeward(self) -> None:
        """Without a wanted goal, and with nothing wrong, it is on its way home, and arrives."""
        day = self.day
        if day.troubled or not day.vehicle.airborne or self.wishes.none_for < GRACE:
            self._troubled_at = day.now
        if day.now - self._troubled_at > HOMEWARD_TIME:
            fail('flies only for a goal', f'in the air for {HOMEWARD_TIME:.0f} s for none')

    def _check_refusals(self) -> None:
        """What was refused two steps ago is in the diagnostics, or is no longer asked for."""
        day = self.day
        for refusal in [r for r in self._refusals if day.now - r[0] > SLACK]:
            self._refusals.remove(refusal)
            at, name, phase = refusal
            # After a change of phase it is something else that is asked for.
            if at - self._cancelled_at < 3.0 or phase != day.phase or not day.bridge.works:
                continue
            self.checked['refusals'] += 1
            if not any(name in text for text in day.said):
                fail('refusals are said', f'{name} was refused at {at:.2f} s')

    @property
    def _committed(self) -> str:
        words = self.command.split()
        return words[1] if words[:1] == ['commit'] else ''
