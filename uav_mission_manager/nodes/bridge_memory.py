"""What a bridge writes down, and how the next one goes on from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from uav_mission_manager.autopilot.bridge import VehicleBridge
from uav_mission_manager.nodes.failures import one_line
from uav_mission_manager.nodes.flight_plan import Plans
from uav_mission_manager.nodes.memory import moment, time_here
from uav_mission_manager.nodes.plan_offers import plan_after
from uav_mission_manager.onboard.journal import Journal


class BridgeMemory:
    """The journal of a bridge: its memory, and the plan with the goals requested in flight.

    Parameters
    ----------
    journal : Journal
    plans : Plans
        Whose latest one is written down; the next one is set where there was one before.
    log : callable
        Takes whether a line is a warning, and the line.
    """

    def __init__(self, journal: Journal, plans: Plans, log: Callable[[bool, str], None]) -> None:
        self._journal, self._plans, self._log = journal, plans, log
        self._written: dict[str, Any] = {}

    @property
    def error(self) -> str:
        """Why it cannot be written; '' while it can."""
        return self._journal.error

    def recall(self, bridge: VehicleBridge) -> None:
        """Let a bridge go on from the journal; what cannot be believed is not obeyed."""
        try:
            record = self._journal.read()
            if record is None:
                return
            state = record.state
            bridge.restore(state['memory'], time_here(state['written']))
        except (LookupError, TypeError, ValueError) as error:
            self._log(True, f'{error}; what was before is not known')
            bridge.distrust(f'what was before is not known: {error}')
            return
        self._recall_plan(str(state.get('plan', '')))
        of = '' if record.mission == self._journal.mission else ' of another mission'
        self._log(False, f'goes on from its journal{of}: {self._journal.path}')

    def _recall_plan(self, path: str) -> None:
        """Have the goals at hand that were requested in flight; unknown ones are not flown to."""
        if not path:
            return
        try:
            self._plans.next = plan_after(self._plans.present, path)
        except (ValueError, OSError, MemoryError) as error:
            self._log(True, f'the plan flown by before is not used: {one_line(error)}')

    def write(self, memory: dict[str, Any], now: float) -> None:
        """Write down a bridge's memory at `now` [s], and when it was last another one."""
        what = {'memory': memory, 'plan': self._plans.latest.source}
        if what != {key: self._written.get(key) for key in what}:
            self._written = {**what, 'written': moment(now)}
        self._journal.write(self._written)
