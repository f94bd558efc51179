"""Fleets: the paper's queues beside an optimal assignment of UAVs to goals.

    make bench SCRIPTS=benchmarks/fleet.py

Writes fleet.md. A minute or two on an idle processor.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Callable

import numpy as np
from parts import losses, pages
from parts.missions import case_study
from parts.rollouts import EPOCHS as ROLLOUT_EPOCHS
from parts.rollouts import SAMPLES, Rollouts

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.paths import share_directory
from uav_mission_manager.solver.evaluation.fleet_simulation import simulate_fleets
from uav_mission_manager.solver.evaluation.occupancy import starts_at_base
from uav_mission_manager.solver.recombination import FleetPlanner, FleetRules

GOALS, UAVS = (3, 6, 9, 12), (1, 2, 3, 4, 6, 8)
FLEETS, EPOCHS = 150, 100

DECISIONS = {
    'as printed': (FleetRules(threshold=math.inf), 'queue'),
    'queue': (FleetRules(), 'queue'),
    'queue, 0.5': (FleetRules(threshold=0.5), 'queue'),
    'optimal': (FleetRules(), 'optimal'),
}
"""How a fleet decides: rules and assignment."""

Costs = dict[str, FloatArray]


def main() -> int:
    """Run the comparison."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--goals', type=int, nargs='+', default=GOALS, help='12 at most')
    parser.add_argument('--uavs', type=int, nargs='+', default=UAVS)
    options = parser.parse_args()
    sections = [INTRODUCTION]
    for title, mission in (
        ('The case study, 2 x 4 cells', case_study),
        ('Its goals scattered over 6 x 8 cells', scattered),
    ):
        sizes = itertools.product(options.goals, options.uavs)
        found = {(k, n): compare(mission(k), n) for k, n in sizes}
        sections += [f'## {title}\n\n{_table(found)}', _summary(found)]
        if mission is case_study and (3, 1) in found:
            sections.append(_optimum(found[3, 1]))
    sections += [_losses(), _rollouts(), _times()]
    pages.publish(pages.folder(options) / 'fleet.md', 'Fleets', sections)
    return 0


def scattered(k: int) -> Mission:
    """Goals of the case study in cells of their own on a larger grid, drawn once."""
    mission = case_study(k)
    grid = dataclasses.replace(mission.grid, rows=6, cols=8)
    cells = np.random.default_rng(0).choice(grid.q, max(GOALS), replace=False)
    goals = [dataclasses.replace(g, cell=int(cell)) for g, cell in zip(mission.goals, cells)]
    return dataclasses.replace(mission, grid=grid, goals=tuple(goals))


def starts(mission: Mission, uavs: int) -> IntArray:
    """Fleets at the base, nominal and charged, priorities drawn evenly, (FLEETS, n, 2k+5)."""
    alone = starts_at_base(mission, FLEETS, np.random.default_rng(0))
    return np.repeat(alone[:, None], uavs, axis=1)


def compare(mission: Mission, uavs: int) -> Costs:
    """Discounted costs (FLEETS,) of each way to decide, all with the same random numbers."""
    states, known, costs = starts(mission, uavs), None, {}
    for name, (rules, assignment) in DECISIONS.items():
        planner = FleetPlanner(mission, states[0], rules, known)
        known = planner.known
        rng = np.random.default_rng(1)
        costs[name] = simulate_fleets(planner, states, EPOCHS, rng, assignment)
    return costs


def saved(costs: Costs) -> tuple[float, float]:
    """What the optimal assignment saves of the better queue's cost, and its 95 % interval [%]."""
    queue = min((costs['queue'], costs['queue, 0.5']), key=np.mean)
    difference, whole = queue - costs['optimal'], queue.mean() / 100
    error = difference.std(ddof=1) / math.sqrt(len(difference))
    return float(difference.mean() / whole), float(1.96 * error / whole)


INTRODUCTION = f"""\
Fleets of one to eight UAVs share the goals of a mission. They start at the base, nominal and
charged, with priorities drawn evenly. A goal is achieved by whichever UAV completes it. An epoch
costs

    sum over goals of eta_j g_j reached_j (1 - covered_j) + delta_j g_j (1 - reached_j)
    + sum over UAVs of h + phi(f) + p(t, m) + (beta/k) sum_j (1 - r_j).

reached_j = 1 where some UAV has goal j in range, and covered_j = 1 where one that has is committed
to it. For one UAV this is the mission's stage cost. The tables show the mean
discounted cost of {EPOCHS} epochs of {FLEETS} fleets.
All assignments are simulated with the same random numbers.

- *As printed*: the loops of the paper's Algorithm 2. All agents are in the queue of every goal,
  and no goal is ever complete (C_j^min = inf), so all UAVs fly to the goal of highest priority.
- *Queue*: E_j and C_j follow each agent that joins, with C_j^min = {FleetRules().threshold}. The
  next agent goes to the first goal of the ranked list that is still open. Beside it the same with
  C_j^min = 0.5: a distant UAV adds less to E_j, so more of them are sent.
- *Optimal*: which goals are open is decided as with the queue, but agents are matched to them by
  the largest sum of gains, by `scipy.optimize.linear_sum_assignment`. A gain is the cost of
  being idle for a goal less that of pursuing it.

*Saved* is what the optimal assignment saves of the cost of the better queue, with its 95 %
confidence interval."""


def _table(found: dict[tuple[int, int], Costs]) -> str:
    rows = []
    for (k, n), costs in found.items():
        share, interval = saved(costs)
        means = [f'{costs[name].mean():.1f}' for name in DECISIONS]
        rows.append([k, n, *means, f'{share:.1f} ± {interval:.1f} %'])
    return pages.table(['goals', 'UAVs', *DECISIONS, 'saved'], rows)


def _summary(found: dict[tuple[int, int], Costs]) -> str:
    shares = [saved(costs) for costs in found.values()]
    better = sum(share > interval for share, interval in shares)
    worse = sum(share < -interval for share, interval in shares)
    mean = np.mean([share for share, _ in shares])
    return f"""\
The optimal assignment is better than both queues in {better} of {len(shares)} rows, and worse than
one of them in {worse}, by more than the interval. On average it saves {mean:.1f} %."""


def _optimum(costs: Costs) -> str:
    mission = case_study(3)
    values = build_policy(mission, 'exact').part_values(starts(mission, 1)[:, 0])
    rest = mission.discount**EPOCHS
    return f"""\
The optimal policy of one UAV with three goals costs {values.mean():.1f} from these starts. That
counts the future after the simulated epochs too, which is discounted by {rest:.1g}."""


def _losses() -> str:
    """The node's mission, with a UAV lost and without."""
    mission, rows = load_mission(share_directory() / 'config' / 'fleet.yaml'), []
    known, told = FleetPlanner(mission).known, []
    for uavs, lost in itertools.product((2, 3, 4), (False, True)):
        flown = {}
        for name, (rules, assignment) in DECISIONS.items():
            planner = FleetPlanner(mission, None, rules, known)
            who = losses.one_lost(uavs) if lost else None
            flown[name] = losses.fly(planner, uavs, assignment, who)
            rows.append([uavs, 'one' if lost else 'none', name, *flown[name].words()])
        share, error = saved({name: outcome.costs for name, outcome in flown.items()})
        told.append(f'{share:.1f} ± {error:.1f} % with {uavs} UAVs and {int(lost)} lost')
    table = pages.table(['UAVs', 'lost', 'decision', 'cost', 'epochs until all are done'], rows)
    return f"""## Nine goals, with losses and recharges

The mission of `config/fleet.yaml` without its rules, every goal asked for at once,
{losses.SEEDS} seeds of {losses.EPOCHS} epochs, with 95 % confidence intervals. Ranges are lost,
and UAVs fail, are recharged and repaired, as the mission says. One UAV is lost for good in an
epoch from {losses.FIRST_LOSS} to {losses.LAST_LOSS - 1}; for an epoch it still counts as acting
for its goal, as with `lost_after` of the node `fleet`, whose assignment by default is *optimal*. A
lost UAV counts as out of range of all goals, which costs the same whoever decides.

{table}

The optimal assignment saves of the better queue's cost, seed by seed:
{'; '.join(told)}."""


def rolled(mission: Mission, uavs: int) -> tuple[losses.Outcome, losses.Outcome, float]:
    """All goals flown by the optimal assignment and by rollouts; time of a decision [s]."""
    planner = FleetPlanner(mission)
    best = losses.fly(planner, uavs, 'optimal')
    begin = time.perf_counter()
    other = losses.fly(planner, uavs, decide=Rollouts(planner))
    return best, other, (time.perf_counter() - begin) / losses.EPOCHS / losses.SEEDS


def _rollouts() -> str:
    """The optimal assignment beside the best of a few by rollouts."""
    near, rows, shares = load_mission(share_directory() / 'config' / 'fleet.yaml'), [], []
    for mission, uavs in (near, 2), (near, 3), (scattered(9), 2), (scattered(9), 3):
        best, other, seconds = rolled(mission, uavs)
        saving, whole = best.costs - other.costs, best.costs.mean() / 100
        shares.append((saving.mean() / whole, losses.interval(saving) / whole))
        size = f'nine goals, {mission.grid.rows} x {mission.grid.cols} cells'
        costs = best.words()[0], other.words()[0]
        saved = '{:.1f} ± {:.1f} %'.format(*shares[-1])
        rows.append([size, uavs, *costs, saved, f'{1e3 * seconds:.0f} ms'])
    better = sum(share > interval for share, interval in shares)
    worse = sum(share < -interval for share, interval in shares)
    head = ['mission', 'UAVs', 'optimal', 'rollouts', 'saved', 'a decision']
    return f"""## A meta-policy by rollouts

Rollouts look at the joint future, which no sum of gains does: of the optimal assignment, the
queue, and the optimal assignments without one UAV's goal, the one is taken whose {SAMPLES}
rollouts of {ROLLOUT_EPOCHS} epochs cost least. In a rollout each UAV pursues its goal to the end,
then what the queue gives it; what is left then costs, for each goal, V_j of the UAV that suits it
best. {losses.SEEDS} seeds, nobody lost, the first mission with its rules. It decides anew in every
epoch.

{pages.table(head, rows)}

Rollouts are better in {better} of {len(rows)} rows, and worse in {worse}, by more than the
interval: the node `fleet` has none."""


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
        _median(lambda a=assignment: planner.plan(states[:1], assignment=a))
        for assignment in ('queue', 'optimal')
    )
    return f"""## Times

Eight UAVs, twelve goals. All sub-MDPs are solved in {1e3 * built:.0f} ms. When one goal's weight
changes, its sub-MDP alone is solved again, in {1e3 * replanned:.1f} ms. A decision of the whole
fleet takes {1e3 * queue:.1f} ms with the queue and {1e3 * optimal:.1f} ms with the optimal
assignment. After new faults or priorities a new decision is all that is needed."""


def _median(work: Callable[[], object]) -> float:
    times = []
    for _ in range(15):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


if __name__ == '__main__':
    raise SystemExit(main())
