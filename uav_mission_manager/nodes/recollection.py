"""What a manager goes on from: the journal of the one before it, and the policy it flew by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uav_mission_manager.mdp.placing import changed_goals
from uav_mission_manager.onboard import ManagerSettings, MissionManager
from uav_mission_manager.onboard.journal import Journal, JournalError, goals_hash
from uav_mission_manager.policy import Policy, PolicyError, load_policy


@dataclass(frozen=True)
class PolicyInUse:
    """A policy, the path of its set, and the path that the parameter asked for."""

    policy: Policy
    path: str
    asked: str

    def as_record(self) -> dict[str, str]:
        """Return the JSON values by which another manager finds it again."""
        return {'path': self.path, 'asked': self.asked, 'digest': self.policy.digest}


@dataclass(frozen=True)
class Recollection:
    """What to begin with.

    Attributes
    ----------
    core : MissionManager
    used : PolicyInUse
    trouble : str
        Why it does not go on as before where it might be expected to; empty if it does.
    goes_on : bool
        Whether it knows what was before.
    """

    core: MissionManager
    used: PolicyInUse
    trouble: str = ''
    goes_on: bool = False


def recollect(journal: Journal, asked: PolicyInUse, settings: ManagerSettings) -> Recollection:
    """Go on from a journal; without one, or one that cannot be believed, begin anew.

    The policy taken over in flight is flown on with, if its set is still the same, and nobody
    has asked for another one by the parameter since.
    """
    fresh = MissionManager(asked.policy, settings)
    try:
        record = journal.read()
        if record is None:
            return Recollection(fresh, asked)
        used, trouble = _used_before(record.state['policy'], asked)
        if record.mission != goals_hash(used.policy.mission):
            other = 'the journal is of another mission: not used'
            return Recollection(fresh, asked, '; '.join(filter(None, (other, trouble))))
        core = MissionManager(used.policy, settings, record.state['memory'])
    except JournalError as error:
        return Recollection(fresh, asked, f'journal not believed: {error}')
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        return Recollection(fresh, asked, f'journal not understood: {error!r}')
    return Recollection(core, used, trouble, goes_on=True)


def _used_before(record: Mapping[str, Any], asked: PolicyInUse) -> tuple[PolicyInUse, str]:
    """Return what to fly by, and why it is not what was flown by."""
    path, digest = str(record['path']), record['digest']
    if record['asked'] != asked.asked or digest == asked.policy.digest:
        return asked, ''
    try:
        policy = load_policy(path)
        if policy.digest != digest:
            raise PolicyError(f'{path}: another one has taken its place')
        changed_goals(asked.policy.mission, policy.mission)
    except (ValueError, OSError, MemoryError) as error:
        return asked, f'policy set flown by before not found: {error}; now by {asked.path}'
    return PolicyInUse(policy, path, asked.asked), ''
