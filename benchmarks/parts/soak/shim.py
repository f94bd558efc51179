"""Temporary: today's manager behind the interface of the one to come."""
from uav_mission_manager.onboard import Refusal, Situation, decide, dwell

class ManagerSettings:
    pass

class MissionManager:
    def __init__(self, policy, settings=None, memory=None):
        self.policy, self.situation = policy, Situation(policy.mission)
        self._standing = None

    def take(self, change):
        before = self.situation.warnings
        self.situation = change(self.situation)
        return tuple(w for w in self.situation.warnings if w not in before)

    def step(self, now):
        outcome = decide(self.policy, self.situation, now, 3.0)
        if isinstance(outcome, Refusal):
            self._standing = None
            return outcome
        outcome, self._standing = dwell(outcome, self.situation, self._standing, 5.0, now)
        self.situation = self.situation.after(outcome.action)
        return outcome

    def adopt(self, policy):
        self.policy, self.situation = policy, self.situation.with_mission(policy.mission)
