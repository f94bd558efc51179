"""Fleets: the paper's queues beside an optimal assignment of UAVs to goals.

make bench                      writes docs/fleet.md; a minute or two
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from parts.missions import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission
from uav_mission_manager.solver.evaluation.fleet_simulation import simulate_fleets
from uav_mission_manager.solver.recombination.assignment import FleetRules
from uav_mission_manager.solver.recombination.fleet import FleetPlanner

DOCS = Path(__file__).resolve().parents[1] / 'docs'
GOALS, UAVS = (3, 6, 9, 12), (1, 2, 3, 4, 6, 8)
FLEETS, EPOCHS = 150, 100

WAYS = {
    'as printed': (FleetRules(threshold=math.inf), 'queue'),
    'queue': (FleetRules(), 'queue'),
    'queue, 0.5': (FleetRules(threshold=0.5), 'queue'),
    'optimal': (FleetRules(), 'optimal'),
}
"""Rules and assignment."""

Costs = dict[str, np.ndarray]


def main() -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_known_args()  # `make bench` passes one set of arguments to every script.
    sections = [_introduction()]
    for title, mission in (
        ('The case study, 2 x 4 cells', case_study),
        ('Its goals scattered over 6 x 8 cells', scattered),
    ):
        found = {(k, n): compare(mission(k), n) for k, n in itertools.product(GOALS, UAVS)}
        sections += [f'## {title}\n\n{_table(found)}', _summary(found)]
        if mission is case_study:
            sections.append(_optimum(found[3, 1]))
    sections.append(_times())
    (DOCS / 'fleet.md').write_text('\n\n'.join(sections) + '\n', encoding='utf-8')
    return 0


def scattered(k: int) -> Mission:
    """Goals of the case study in cells of their own on a larger grid, drawn once."""
    mission = case_study(k)
    grid = dataclasses.replace(mission.grid, rows=6, cols=8)
    cells = np.random.default_rng(0).choice(grid.q, max(GOALS), replace=False)
    goals = [dataclasses.replace(g, cell=int(cell)) for g, cell in zip(mission.goals, cells)]
    return dataclasses.replace(mission, grid=grid, goals=tuple(goals))


def starts(mission: Mission, uavs: int) -> np.ndarray:
    """Fleets at the base, nominal and charged, priorities drawn evenly, (FLEETS, n, 2k+5)."""
    k = mission.k
    states = np.zeros((FLEETS, uavs, 2 * k + 5), np.int64)
    states[..., : 1 + k] = 1
    drawn = np.random.default_rng(0).integers(0, 3, (FLEETS, 1, k))
    states[..., 1 + k : 1 + 2 * k] = drawn
    states[..., -4] = mission.grid.base
    return states


def compare(mission: Mission, uavs: int) -> Costs:
    """Discounted costs (FLEETS,) of each way, all with the same random numbers."""
    states, known, costs = starts(mission, uavs), None, {}
    for name, (rules, assignment) in WAYS.items():
        planner = FleetPlanner(mission, states[0], rules, known)
        known = planner.known
        rng = np.random.default_rng(1)
        costs[name] = simulate_fleets(planner, states, EPOCHS, rng, assignment)
    return costs


def saved(costs: Costs) -> tuple[float, float]:
    """What the optimal assignment saves of the better queue's cost, and its 95 % interval [%]."""
    queue = min((costs['queue'], costs['queue, 0.5']), key=np.mean)
    difference, whole = queue - costs['optimal'], queue.mean() / 100
    error = difference.std(ddof=1) / math.sqrt(FLEETS)
    return float(difference.mean() / whole), float(1.96 * error / whole)


def _introduction() -> str:
    return f"""# Fleets

Written by `make bench` (`benchmarks/fleet.py`). Fleets of one to eight UAVs share the goals of a
mission; they start at the base, nominal and charged, with priorities drawn evenly. A goal is
achieved by whichever UAV completes it. An epoch costs

    sum over goals of eta_j g_j R_j (1 - C_j) + delta_j g_j (1 - R_j)
    + sum over UAVs of h + phi(f) + p(t, m) + (beta/k) sum_j (1 - r_j),

R_j = 1 where some UAV has goal j in range, C_j = 1 where one that has is committed to it: for
one UAV, the mission's stage cost. The tables show the mean discounted cost of {EPOCHS} epochs of
{FLEETS} fleets; every way meets with the same random numbers.

- *As printed*: the loops of the paper's Algorithm 2, all agents in the queue of every goal, none
  ever complete (C_j^min = inf). All UAVs then fly to the goal of highest priority.
- *Queue*: E_j and C_j follow each agent that joins, C_j^min = {FleetRules().threshold}; the
  next one goes to the first goal of the ranked list that is still open. Beside it the same with
  C_j^min = 0.5, better where ways are short: distant UAVs count for less, so more are sent.
- *Optimal*: the same goals open or complete, but agents are matched to them by the largest sum
  of gains, `scipy.optimize.linear_sum_assignment` on the value of pursuing a goal less that of
  being idle for it.

*Saved* is what the optimal assignment saves of the cost of the better of both queues, with its
95 % confidence interval."""


def _table(found: dict[tuple[int, int], Costs]) -> str:
    lines = [
        f'| goals | UAVs | {" | ".join(WAYS)} | saved |',
        f'| {" | ".join(["---:"] * (len(WAYS) + 3))} |',
    ]
    for (k, n), costs in found.items():
        means = ' | '.join(f'{costs[name].mean():.1f}' for name in WAYS)
        share, interval = saved(costs)
        lines.append(f'| {k} | {n} | {means} | {share:.1f} ± {interval:.1f} % |')
    return '\n'.join(lines)


def _summary(found: dict[tuple[int, int], Costs]) -> str:
    shares = [saved(costs) for costs in found.values()]
    better = sum(share > interval for share, interval in shares)
    worse = sum(share < -interval for share, interval in shares)
    mean = np.mean([share for share, _ in shares])
    return f"""The optimal assignment is better than either queue in {better} of {len(shares)}
rows, worse in {worse}, by more than the interval; it saves {mean:.1f} % on average."""


def _optimum(costs: Costs) -> str:
    mission = case_study(3)
    values = build_policy(mission).part_values(starts(mission, 1)[:, 0])
    rest = mission.discount**EPOCHS
    return f"""The optimal policy of one UAV with three goals costs {values.mean():.1f} from these
starts, with the future beyond the epochs simulated (discounted by {rest:.1g})."""


def _times() -> str:
    mission = case_study(12)
    states = starts(mission, 8)
    begin = time.perf_counter()
    planner = FleetPlanner(mission, states[0])
    built = time.perf_counter() - begin
    goals = (dataclasses.replace(mission.goals[0], eta=1.0), *mission.goals[1:])
    changed = dataclasses.replace(mission, goals=goals)
    replanned = _median(lambda: planner.replan(changed, states[0]))
    queue, optimal = (
        _median(lambda a=way: planner.plan(states[:1], assignment=a))
        for way in ('queue', 'optimal')
    )
    return f"""## Times

Eight UAVs, twelve goals: all sub-MDPs are solved in {1e3 * built:.0f} ms; after a change of one
goal's weight its own alone, in {1e3 * replanned:.1f} ms. A decision of the whole fleet takes
{1e3 * queue:.1f} ms with the queue and {1e3 * optimal:.1f} ms with the optimal assignment, and
after new faults or priorities it is all there is to do."""


def _median(work: Callable[[], object]) -> float:
    times = []
    for _ in range(15):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


if __name__ == '__main__':
    raise SystemExit(main())
