"""Lower bounds on V* by shared cost."""

from uav_mission_manager.solver.bounds.clusters import bound_bytes, covering
from uav_mission_manager.solver.bounds.lower_bound import LowerBound, lower_bound

__all__ = ['LowerBound', 'bound_bytes', 'covering', 'lower_bound']
