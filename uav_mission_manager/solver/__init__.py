"""Solving the mission, room by room.

On the ground floor is what all rooms share: `submdp` (the mission seen through some of its
goals), `reduced` (its terms in factors, taken from `uav_mission_manager.mdp`), `axes` (steps of
an expectation), `span_bounds`, `greedy`, `progress`, `memory` and `threads`. The rooms are

- `exact`: V* and Q on the mission's axes, in memory or out of core;
- `decomposition`: Algorithm 1, candidates, measures, plan and phi;
- `recombination`: Algorithm 2, priorities, meta-policies, assignment and fleet;
- `expansion`: fitted value iteration and its one-epoch look-ahead;
- `bounds`: lower bounds by shared cost;
- `evaluation`: what a policy costs, exactly or by simulation.
"""
