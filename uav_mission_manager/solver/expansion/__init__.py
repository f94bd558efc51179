"""Goal expansion: fitted value iteration and its one-epoch look-ahead."""

from uav_mission_manager.solver.expansion.basis import Basis, Clusters, Group, cluster_states
from uav_mission_manager.solver.expansion.fit import Expansion, fit_bytes, fit_expansion
from uav_mission_manager.solver.expansion.look_ahead import ExpansionLookAhead

__all__ = [
    'Basis',
    'Clusters',
    'Expansion',
    'ExpansionLookAhead',
    'Group',
    'cluster_states',
    'fit_bytes',
    'fit_expansion',
]
