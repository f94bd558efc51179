"""Learning from flights: how often intervals hold the truth, and what the new policy is worth.

    make bench SCRIPTS=benchmarks/learn.py

Writes learn.md. Some minutes on an idle processor.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import yaml
from parts import pages
from parts.missions import random_mission

from uav_mission_manager import build_policy
from uav_mission_manager.learning import (
    DEFAULT_WEIGHT,
    LEVEL_TEXT,
    Counts,
    FlownEpochs,
    LearnedNumber,
    count,
    joined,
    simulated_epochs,
    with_counts,
)
from uav_mission_manager.learning.estimates import estimates
from uav_mission_manager.learning.mission_edit import Edit, edited
from uav_mission_manager.mdp import Mission, mission_from_dict
from uav_mission_manager.mdp.mission_file import mission_file_text
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation import (
    evaluate,
    simulate,
    start_state,
    starts_at_base,
    tabulate,
)
from uav_mission_manager.solver.submdp import whole_mission

WRONG = {
    ('priority_transition',): [[0.8, 0.1, 0.1], [0.05, 0.9, 0.05], [0.05, 0.2, 0.75]],
    ('faults', 'rate'): {'sensor': 0.002, 'actuator': 0.004, 'camera': 0.03},
    ('faults', 'repair_success'): 0.6,
    ('faults', 'completion'): [1.0, 0.3, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0],
    ('range', 'loss'): {'normal': 0.1, 'agile': 0.2},
    ('threat', 'onset'): 0.15,
    ('threat', 'zones'): {0: 0.0, 1: 0.0, 2: 0.05, 6: 0.05},
    ('threat', 'high_share'): 0.7,
    ('threat', 'from_low'): [0.2, 0.6, 0.2],
    ('threat', 'from_high'): [0.1, 0.2, 0.7],
}
"""What the wrong file says in place of the case study's numbers: off by factors of 2 to 5."""

DRAWN = (1, 2)
"""Seeds of missions that are drawn."""

FACTOR, LARGEST = 3.0, 0.9
"""Largest factor by which their files are off, and the largest probability in them."""

FLIGHT_EPOCHS, FLIGHTS = 120, (1, 3, 15)
"""Epochs of a flight, 20 minutes of 10 s, and numbers of flights that are learned from."""

WEIGHTS = (1.0, 3.0, 10.0, 30.0)
"""Events that the file is worth."""

SEEDS, POLICY_SEEDS = 100, 8
"""Simulations of which intervals are looked at, and of those for which policies are built."""

SPREAD = (0.9 * 0.1 / SEEDS) ** 0.5
"""Standard deviation of the share of so many intervals that hold, if it is 90 % in truth."""

TOLERANCE = 1e-5
"""Largest error of a cost."""


@dataclass(frozen=True)
class Case:
    """A mission file that is the prior, and the mission that is flown in truth."""

    text: str
    truth: str

    @cached_property
    def data(self) -> Any:
        """The file that is the prior, as it is read."""
        return read_yaml(self.text)

    @cached_property
    def prior(self) -> Mission:
        """What the file says."""
        return mission_of(self.text)

    @cached_property
    def mission(self) -> Mission:
        """What is true."""
        return mission_of(self.truth)

    @cached_property
    def numbers(self) -> Any:
        """The file of the truth, as it is read."""
        return read_yaml(self.truth)


def mission_of(text: str) -> Mission:
    """Return the mission of a file's text."""
    return mission_from_dict(read_yaml(text), 'benchmark')


def cases() -> dict[str, Case]:
    """Return files that are wrong, and the right one, with what is true."""
    text = mission_file_text(share_directory() / 'config' / 'case_study.yaml')
    wrong = edited(text, 'wrong', [Edit(path, value, 'wrong') for path, value in WRONG.items()])
    found = {'case study, wrong': Case(wrong, text), 'case study, right': Case(text, text)}
    for seed in DRAWN:
        truth = random_mission(3, seed).to_dict()
        prior = distorted(truth, np.random.default_rng(seed))
        found[f'drawn, seed {seed}, wrong'] = Case(yaml.safe_dump(prior), yaml.safe_dump(truth))
    return found


def distorted(data: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a mission in which each probability is off by a factor of up to three."""

    def off(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: off(entry) for key, entry in value.items()}
        return min(value * FACTOR ** float(rng.uniform(-1, 1)), LARGEST)

    def row(probabilities: Sequence[float]) -> list[float]:
        weights = np.array([off(p) for p in probabilities])
        return [float(weight) for weight in weights / weights.sum()]

    new = copy.deepcopy(data)
    faults, threat = new['faults'], new['threat']
    faults['rate'], new['range']['loss'] = off(faults['rate']), off(new['range']['loss'])
    faults['repair_success'] = off(faults['repair_success'])
    faults['completion'] = [off(p) for p in faults['completion']]
    for key in ('onset', 'zones', 'high_share'):
        threat[key] = off(threat[key])
    for key in ('from_low', 'from_high'):
        threat[key] = row(threat[key])
    for goal in new['goals']:
        goal['priority_transition'] = [row(level) for level in goal['priority_transition']]
    return new


@cache
def policy_of(mission: Mission) -> Policy:
    """Return the optimal policy of a mission."""
    return build_policy(mission, 'exact', TOLERANCE)


def flown(case: Case, flights: int, seed: int) -> Counts:
    """Count in flights of the truth by the policy of the file."""
    mission, rng = case.mission, np.random.default_rng([flights, seed])
    rows: list[FlownEpochs] = []
    simulate(
        mission,
        policy_of(case.prior).act,
        starts_at_base(mission, flights, rng),
        FLIGHT_EPOCHS,
        rng,
        watch=lambda epoch: rows.append(simulated_epochs(mission, epoch)),
    )
    return count(mission, joined(rows))


def true_value(case: Case, estimate: LearnedNumber) -> float:
    """Return what the truth has for a field."""
    found = case.numbers
    for part in estimate.path:
        found = found[part]
    return float(found)


def cost(mission: Mission, policy: Policy) -> float:
    """Exact expected cost of a policy from the start."""
    sub = whole_mission(mission)
    values = evaluate(sub, tabulate(sub, policy.act), TOLERANCE)
    return float(values.state_values(start_state(mission))[0])


def held(case: Case, flights: int) -> dict[str, float]:
    """Return how often the intervals of each number hold the truth; under '' of all."""
    hits, tries = Counter[str](), Counter[str]()
    for seed in range(SEEDS):
        counts = flown(case, flights, seed)
        for learned in estimates(case.data, case.prior, counts, DEFAULT_WEIGHT):
            low, high = learned.posterior[1:]
            for name in ('', learned.field):
                hits[name] += low <= true_value(case, learned) <= high
                tries[name] += 1
    # Of what is seen in a few simulations the share is chance.
    return {name: hits[name] / tried for name, tried in tries.items() if tried >= SEEDS / 2}


def costs(case: Case, flights: int, weight: float) -> Iterator[float]:
    """Yield the exact cost in truth of the policy that was learned, by seed."""
    for seed in range(POLICY_SEEDS):
        new = with_counts(case.text, 'prior', flown(case, flights, seed), weight).mission
        yield cost(case.mission, build_policy(new, 'exact', TOLERANCE))


def main() -> int:
    """Run the comparison."""
    options = pages.parser(__doc__.splitlines()[0]).parse_args()
    every = cases()
    sections = [
        INTRODUCTION,
        f'## Do the intervals hold?\n\n{HOLD}\n\n{_held_table(every)}',
        f'## What is the new policy worth?\n\n{WORTH}\n\n{_worth_table(every)}',
    ]
    pages.publish(pages.folder(options) / 'learn.md', 'Learning from flights, measured', sections)
    return 0


def _hours(flights: int) -> str:
    return f'{flights * FLIGHT_EPOCHS * 10 / 3600:.3g} h'


def _held_table(every: dict[str, Case]) -> str:
    rows = []
    for name, case in every.items():
        for flights in FLIGHTS:
            shares = held(case, flights)
            total = shares.pop('')
            least = min(shares, key=lambda field: shares[field])
            worst = f'{least}: {100 * shares[least]:.0f} %'
            rows.append([name, _hours(flights), f'{100 * total:.1f} %', worst])
    return pages.table(['file', 'flown', 'hold', 'least, by number'], rows)


def _worth_table(every: dict[str, Case]) -> str:
    rows = []
    for name, case in every.items():
        before, best = (
            cost(case.mission, policy_of(mission)) for mission in (case.prior, case.mission)
        )
        for flights in FLIGHTS:
            for weight in WEIGHTS if flights == FLIGHTS[0] else (DEFAULT_WEIGHT,):
                after = list(costs(case, flights, weight))
                row = [name, f'{100 * (before / best - 1):.2f} %', _hours(flights), f'{weight:g}']
                lost = [each / best - 1 for each in after]
                row += [f'{100 * share:.2f} %' for share in (np.mean(lost), max(lost))]
                if before > best + TOLERANCE:
                    won = (before - np.mean(after)) / (before - best)
                    row.append(f'{100 * won:.1f} %')
                else:
                    row.append('')
                rows.append(row)
    head = ['file', 'its policy', 'flown', 'weight', 'new policy', 'at most', 'won back']
    return pages.table(head, rows)


INTRODUCTION = f"""\
Flights are simulated by the policy of a mission file in a mission with other probabilities, and
counted by the same function that counts recorded flights; [`mission_learn`](learning.md) makes a
new file of the counts. The file of the case study is *wrong* by factors of two to five in both
directions, or *right*; the others are missions drawn at random, of which the file has each
probability wrong by a factor of up to {FACTOR:g}. A flight is {FLIGHT_EPOCHS} epochs of 10 s
long."""

HOLD = f"""\
How many of the {LEVEL_TEXT} intervals hold the true number, over {SEEDS} simulations. The
intervals are of the count alone, so a wrong file does not take them along, whatever its weight.
They are exact ones of discrete counts, which hold more often than they say. The last column is the
number whose intervals hold least often: the least of up to 45 shares, each of {SEEDS} simulations
and so itself uncertain by {100 * SPREAD:.0f} %."""

WORTH = f"""\
How much more than the best policy the one of the file costs, exactly, from base with all goals of
high priority, and the one of the file that was learned: the mean of {POLICY_SEEDS} simulations,
and the most of them. *Won back* is the share of the file's loss that is not lost any more, in the
mean. With the right file there is nothing to win. Where a file costs little, little is won back by
a short flight, or less than nothing. The weight of the file is {DEFAULT_WEIGHT:g} events by
default."""


if __name__ == '__main__':
    raise SystemExit(main())
