"""Algorithm 1: candidates, measures, plan and phi."""

from uav_mission_manager.solver.decomposition.decompose import decompose
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.decomposition.plan import Part, Plan

__all__ = ['Measures', 'Part', 'Plan', 'decompose']
