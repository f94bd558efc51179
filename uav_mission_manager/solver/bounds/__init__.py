"""Lower bounds on V* by shared cost."""

from uav_mission_manager.solver.bounds.lower_bound import LowerBound, covering, lower_bound

__all__ = ['LowerBound', 'covering', 'lower_bound']
