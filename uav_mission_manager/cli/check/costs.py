"""Costs that drown all others, or that nothing is weighed by."""

from __future__ import annotations

from collections.abc import Iterator

from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import LIMITS
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.cost import PRIORITIES
from uav_mission_manager.mdp.routes import diameter


def cost_findings(mission: Mission) -> Iterator[Finding]:
    """Warn of costs out of scale, and of those that make a choice pointless."""
    for j, goal in enumerate(mission.goals):
        if goal.eta == goal.delta == 0:
            text = 'costs nothing while it is open, so it is never worth a flight: give a worth'
            yield Finding(f'goals.{j}.eta (worth)', 0.0, text)
    if not sum(_terms(mission).values()):
        yield Finding('costs', 0.0, 'all are 0, so there is nothing to decide: give some')
    else:
        yield from _scale(mission)
        yield from _agile(mission)


def _scale(mission: Mission) -> Iterator[Finding]:
    """Warn of the one cost, or of the goals together, that all others are nothing to."""
    terms, limit = _terms(mission), LIMITS['cost ratio']
    total = sum(terms.values())
    goals = sum(cost for field, cost in terms.items() if field.startswith('goals'))
    for field, cost in {**terms, 'goals[].eta, .delta (worth)': goals}.items():
        if cost > limit.high * (total - cost):
            text = (
                f'costs up to {cost:.3g} an epoch, all else together {total - cost:.3g}: it alone '
                f'decides ({limit.reason}); bring the costs into one scale'
            )
            yield Finding(field, cost, text)
            return


def _terms(mission: Mission) -> dict[str, float]:
    """The most that each cost may be in an epoch, by its field."""
    faults, service = mission.faults, mission.service_cost
    found = {
        f'goals.{j}.eta, .delta (worth)': float(PRIORITIES.max()) * max(goal.eta, goal.delta)
        for j, goal in enumerate(mission.goals)
    }
    return found | {
        'faults.cost': max(faults.cost),
        'range.cost': mission.range.cost,
        'threat.cost': max(map(max, mission.threat.cost)),
        'distance_weight': mission.distance_weight * diameter(mission.grid),
        'service_cost.recharge': service.recharge,
        'service_cost.repair': service.repair,
    }


def _agile(mission: Mission) -> Iterator[Finding]:
    """Warn where agile flight spares nothing under any threat."""
    rows = mission.threat.cost
    if any(row != (0.0, 0.0) for row in rows) and all(row[1] >= row[0] for row in rows):
        text = 'agile flight costs no less than normal flight under any threat, so it is pointless'
        yield Finding('threat.cost', rows[2], f'{text}: lower the second of each row')
