"""The manager without ROS: inputs in, decisions out, and a memory for the one started after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Mission, global_actions
from uav_mission_manager.mdp.placing import changed_goals
from uav_mission_manager.onboard.deciding import Refusal, decide
from uav_mission_manager.onboard.dwell import StandingCommand, dwell, stay
from uav_mission_manager.onboard.inputs import index_of
from uav_mission_manager.onboard.memory import (
    as_it_was,
    remembered,
    situation_memory,
    situation_now,
)
from uav_mission_manager.onboard.situation import Situation
from uav_mission_manager.policy import Decision, Policy


@dataclass(frozen=True)
class ManagerSettings:
    """How the manager takes its inputs.

    Attributes
    ----------
    input_timeout : float
        Age [s] above which battery, position or fault mode count as missing.
    range_hysteresis : float
        Extra range with which a lost range flag comes back, as a fraction.
    command_dwell : float
        Time [s] for which a command stays before a change that no danger asks for.
    settling_time : float
        Time [s] for which a danger counts after its end; 0 for none.
    threat_unknown : str
        Threat level that counts until one is heard.
    """

    input_timeout: float = 3.0
    range_hysteresis: float = 0.2
    command_dwell: float = 5.0
    settling_time: float = 5.0
    threat_unknown: str = THREAT_LEVELS[0]


class MissionManager:
    """Takes inputs and decides. Time is an argument, always of the same clock.

    Parameters
    ----------
    policy : Policy
    settings : ManagerSettings
    memory : mapping, optional
        What `memory` or `snapshot` said of a manager for the same goals and grid: this one goes
        on from there.

    Raises
    ------
    ValueError
        One line: the mission has no energy model, a setting is none, or the memory is of
        something else.

    Attributes
    ----------
    policy : Policy
    settings : ManagerSettings
    situation : Situation
    """

    def __init__(
        self,
        policy: Policy,
        settings: ManagerSettings = ManagerSettings(),
        memory: Mapping[str, Any] | None = None,
    ) -> None:
        self.policy = policy
        self.settings = settings
        index_of(settings.threat_unknown, THREAT_LEVELS, 'threat_unknown')
        self.situation = Situation(
            policy.mission,
            settings.range_hysteresis,
            settings.settling_time,
            settings.threat_unknown,
        )
        self._standing: StandingCommand | None = None
        if memory is not None:
            try:
                self.situation = remembered(self.situation, memory['situation'])
                if 'now' in memory:
                    self.situation = as_it_was(self.situation, memory['now'])
                self._standing = _remembered_command(policy.mission, memory['command'])
            except (LookupError, TypeError, ValueError, AttributeError) as error:
                raise ValueError(f'memory: {error!r}') from error
        self._told = self.situation.warnings

    def take(self, change: Callable[[Situation], Situation]) -> None:
        """Change the situation.

        Raises
        ------
        InputError
            As the change does; then nothing is changed.
        """
        self.situation = change(self.situation)

    def news(self) -> tuple[str, ...]:
        """Return the warnings that were not there when this was asked last, or at the start."""
        told, self._told = self._told, self.situation.warnings
        return tuple(text for text in self._told if text not in told)

    def step(self, now: float) -> Decision | Refusal:
        """Decide, and remember that."""
        self.situation = self.situation.settled(now)
        if 'goal_priorities' not in self.situation.known:
            return Refusal('no goal priorities yet')
        outcome = decide(self.policy, self.situation, now, self.settings.input_timeout)
        if isinstance(outcome, Refusal):
            return outcome
        if self.situation.off_grid:
            stays = (
                stay(outcome, self.situation, self._standing) if self.situation.strayed else None
            )
            return stays or Refusal(self.situation.off_grid)
        outcome, self._standing = dwell(
            outcome, self.situation, self._standing, self.settings.command_dwell, now
        )
        self.situation = self.situation.after(outcome.action)
        return outcome

    def foresee(self) -> None:
        """Decide for each threat level and fault mode from here, while there is time.

        The policy remembers it: when a danger comes, what to do then is at hand.
        """
        fault, *rest, threat, mode = self.situation.state
        for level in range(len(THREAT_LEVELS)):
            self.policy.decide((fault, *rest, level, mode))
        for number in range(1, len(FAULT_MODES) + 1):
            self.policy.decide((number, *rest, threat, mode))

    def adopt(self, policy: Policy, wanted: bool = True) -> tuple[str, ...]:
        """Fly on with another policy; the standing command stays, unless its goal is gone.

        Parameters
        ----------
        policy : Policy
        wanted : bool
            Whether goals that are new are wanted as they were requested, or not at all.

        Returns
        -------
        tuple of str
            The names of the goals that are new.

        Raises
        ------
        ValueError
            If it is for another grid or other goals, see `changed_goals`, or has no energy model.
        """
        others = changed_goals(self.policy.mission, policy.mission)
        self.situation = self.situation.with_mission(policy.mission, wanted)
        self.policy = policy
        if self._standing is not None:
            self._standing = _standing_in(policy.mission, self._standing, others)
        return tuple(policy.mission.goals[j].name for j in others)

    def adjust(self, settings: ManagerSettings) -> None:
        """Go on with other settings; the standing command stays as long as it was to."""
        self.settings = settings
        self.situation = replace(
            self.situation,
            hysteresis=settings.range_hysteresis,
            settling_time=settings.settling_time,
            threat_unknown=settings.threat_unknown,
        )

    def reset_goals(self) -> None:
        """Want no goal any more, and forget which were refused."""
        self.situation = self.situation.without_goals()

    @property
    def memory(self) -> dict[str, Any]:
        """What another one needs to go on from here, as JSON values."""
        command = self._standing and {
            'action': self._standing.action.number,
            'until': self._standing.until,
            'dangers': sorted(self._standing.dangers),
            'wanted': self._standing.wanted,
        }
        return {'situation': situation_memory(self.situation), 'command': command}

    @property
    def snapshot(self) -> dict[str, Any]:
        """What another one needs to decide from here on as this one does, as JSON values."""
        return {**self.memory, 'now': situation_now(self.situation)}


def _standing_in(
    mission: Mission, standing: StandingCommand, others: Sequence[int]
) -> StandingCommand | None:
    """Return a command as that of a mission which follows; None if its goal is gone."""
    was = standing.action
    if was.goal in others:
        return None
    same = (was.kind, was.goal, was.agile)
    actions = (a for a in global_actions(mission) if (a.kind, a.goal, a.agile) == same)
    return replace(standing, action=next(actions))


def _remembered_command(
    mission: Mission, memory: Mapping[str, Any] | None
) -> StandingCommand | None:
    if memory is None:
        return None
    actions = {action.number: action for action in global_actions(mission)}
    return StandingCommand(
        actions[memory['action']],
        float(memory['until']),
        frozenset(memory['dangers']),
        bool(memory['wanted']),
    )
