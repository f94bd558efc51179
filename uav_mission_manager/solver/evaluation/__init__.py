"""What a policy costs, exactly or by simulation, and what happens when it is flown."""

from uav_mission_manager.solver.evaluation.fleet_simulation import simulate_fleets
from uav_mission_manager.solver.evaluation.occupancy import (
    flown_states,
    start_state,
    starts_at_base,
)
from uav_mission_manager.solver.evaluation.policy_evaluation import (
    Evaluation,
    evaluate,
    representatives,
    tabulate,
)
from uav_mission_manager.solver.evaluation.simulation import (
    ControlVariate,
    Estimate,
    Simulator,
    estimate,
    simulate,
)

__all__ = [
    'ControlVariate',
    'Estimate',
    'Evaluation',
    'Simulator',
    'estimate',
    'evaluate',
    'flown_states',
    'representatives',
    'simulate',
    'simulate_fleets',
    'start_state',
    'starts_at_base',
    'tabulate',
]
