"""One battery: policies that see range flags beside policies that see the charge.

    make bench SCRIPTS=benchmarks/charge.py

Writes charge.md. Some minutes on an idle processor.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from parts import pages
from parts.missions import case_study, random_mission, with_battery

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission, StateSpace, allowed_actions, dynamics
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.mdp.energy import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation import evaluate, simulate, start_state, tabulate
from uav_mission_manager.solver.evaluation.simulation import Transition, cost_horizon
from uav_mission_manager.solver.submdp import whole_mission

EMPTY_COSTS = (0.0, 20.0, 200.0)
"""Costs of an epoch of flight on an empty battery."""

FLIGHTS, TRUNCATION = 4000, 1e-4
"""Simulated flights of each policy; weight of the epochs after the last one."""

NORMAL_95 = 1.96
"""Half the width of a 95 % interval, in standard errors."""

SEEDS = (1, 2, 3, 4)
"""Of the missions that are drawn."""


@dataclass(frozen=True)
class Measured:
    """One policy in one mission with a charge.

    Attributes
    ----------
    cost : float
        Exact expected cost from base, charged, all goals of high priority.
    empty, recharges : (float, float)
        Discounted numbers of epochs flown empty, and of recharges, each with its 95 % interval.
    """

    cost: float
    empty: tuple[float, float]
    recharges: tuple[float, float]


def main() -> int:
    """Run the comparison."""
    parser = pages.parser(__doc__.splitlines()[0])
    options = parser.parse_args()
    named = [(f'case study, {k} goals', case_study(k)) for k in (2, 3, 5)]
    named += [(f'drawn, seed {seed}', random_mission(3, seed)) for seed in SEEDS]
    rows = [
        [name, f'{empty_cost:g}', *_row(flagged, empty_cost)]
        for name, flagged in named
        for empty_cost in EMPTY_COSTS
    ]
    sections = [INTRODUCTION, f'## What it is worth\n\n{pages.table(HEAD, rows)}', NOTES]
    sections.append(_possible())
    pages.publish(pages.folder(options) / 'charge.md', 'One battery', sections)
    return 0


def charged(flagged: Mission, empty_cost: float) -> Mission:
    """The mission with a battery that lasts as long as its range flags do in the mean.

    Range flags last for 1 / loss epochs of normal flight in the mean. At a speed of 1 m/s and 1 W
    that is as many metres as watt seconds.
    """
    loss = flagged.range.loss
    assert loss is not None
    energy = Energy(
        capacity=flagged.grid.cell_size / loss.normal / SECONDS_PER_HOUR,
        voltage=1.0,
        power=1.0,
        speed=1.0,
        wind=0.0,
        wind_penalty=0.0,
        payload=0.0,
        payload_penalty=0.0,
        agile_power=loss.agile / loss.normal,
    )
    mission = with_battery(dataclasses.replace(flagged, energy=energy))
    assert mission.range.charge is not None
    charge = dataclasses.replace(mission.range.charge, empty_cost=empty_cost)
    return dataclasses.replace(mission, range=dataclasses.replace(mission.range, charge=charge))


def by_flags(policy: Policy, mission: Mission) -> Callable[[IntArray], IntArray]:
    """The policy of a mission with range flags, flown in one with a charge.

    Where it recharges a full battery, for a goal that is out of range with that, it stays.
    """
    flags, space = RangeFlags(mission), StateSpace.of(mission)

    def act(states: IntArray) -> IntArray:
        s = space.split(states)
        columns = [s.f[:, None], flags(s), s.g, *(x[:, None] for x in (s.l, s.c, s.t, s.m))]
        actions = policy.act(np.hstack(columns))
        allowed = allowed_actions(mission, states)[np.arange(len(states)), actions - 1]
        return np.where(allowed, actions, 1)

    return act


def measured(mission: Mission, act: Callable[[IntArray], IntArray]) -> Measured:
    """What a policy costs, exactly, and what it does, by simulation."""
    sub, start = whole_mission(mission), start_state(mission)
    cost = float(evaluate(sub, tabulate(sub, act), 1e-6).state_values(start)[0])
    space, regimes = StateSpace.of(mission), dynamics.regimes(mission)
    empty, recharges, weight = np.zeros(FLIGHTS), np.zeros(FLIGHTS), 1.0

    def watch(epoch: Transition) -> None:
        nonlocal weight
        s = space.split(epoch.states)
        regime = regimes[epoch.actions - 1, s.l]
        empty[:] += weight * ((s.b[:, 0] == 0) & ~np.isin(regime, dynamics.ON_GROUND))
        recharges[:] += weight * (regime == dynamics.Regime.RECHARGED)
        weight *= mission.discount

    starts = np.repeat(start, FLIGHTS, axis=0)
    epochs = cost_horizon(mission, TRUNCATION)
    simulate(mission, act, starts, epochs, np.random.default_rng(0), watch=watch)
    return Measured(cost, _interval(empty), _interval(recharges))


def _interval(samples: FloatArray) -> tuple[float, float]:
    return float(samples.mean()), float(NORMAL_95 * samples.std(ddof=1) / math.sqrt(len(samples)))


def _row(flagged: Mission, empty_cost: float) -> list[str]:
    mission = charged(flagged, empty_cost)
    best = measured(mission, build_policy(mission, 'exact').act)
    other = measured(mission, by_flags(build_policy(flagged, 'exact'), mission))
    more = round(100 * (other.cost / best.cost - 1), 1) + 0.0
    row = [f'{best.cost:.4g}', f'{other.cost:.4g}', f'{more:.1f} %']
    for of in ('empty', 'recharges'):
        for policy in (best, other):
            mean, half = getattr(policy, of)
            row.append(f'{mean:.2g} ± {half:.1g}')
    return row


def _possible() -> str:
    rows = []
    for k in (3, 6, 10):
        mission = charged(case_study(k), 0.0)
        flags = RangeFlags(mission)
        states = np.zeros((mission.grid.q * 16, len(StateSpace.of(mission).shape)), np.int64)
        s = StateSpace.of(mission).split(states)
        s.f[:], s.l[:] = 1, np.repeat(np.arange(mission.grid.q), 16)
        s.b[:, 0] = np.tile(np.arange(16), mission.grid.q)
        pairs = {(cell, *r) for cell, r in zip(s.l.tolist(), flags(s).tolist())}
        every = mission.grid.q * 2**k
        rows.append([k, f'{every:,}', len(pairs), f'{100 * len(pairs) / every:.2g} %'])
    head = ['goals', 'cells times flag vectors', 'of these possible', '']
    return f"""## What range flags plan for

With one battery, the range flags in a cell are told by one number. Of all that a mission with
range flags has a decision for, little can occur:

{pages.table(head, rows)}"""


HEAD = (
    'mission',
    'cost of flying empty',
    'cost, charge',
    'cost, flags',
    'more',
    'flown empty, charge',
    'flown empty, flags',
    'recharges, charge',
    'recharges, flags',
)

INTRODUCTION = f"""\
In the paper's model each goal falls out of range by a chance of its own. A vehicle has one
battery: with [`range.charge`](mission_file.md#one-battery) its state of charge is a variable of
the model, from which the range flags follow; [the mathematics](model.md#one-battery) says how.

Here both kinds of policies, solved exactly, fly in the mission with a charge: *charge* is its
optimal policy; *flags* is the optimal policy of the same mission with range flags, which sees the
flags that the charge gives in each cell. The battery has 16 levels, a reserve of 0.1 and a noise
of 0.2, and lasts for 1 / `loss` epochs of flight, as range flags do in the mean.

*Cost* is the exact expected cost from base, charged, with all goals of high priority. *Flown
empty* and *recharges* are discounted numbers of epochs, by {FLIGHTS:,} simulated flights, with
95 % intervals."""

NOTES = """\
The policy by flags may recharge only while some goal is out of range, and does not know how much
is left beyond what reaches all goals, nor how long that lasts."""


if __name__ == '__main__':
    raise SystemExit(main())
