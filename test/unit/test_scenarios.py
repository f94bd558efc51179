"""Every scenario with the simulated autopilot, in simulated time."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenarios import SCENARIOS
from simulated_chain import SimulatedChain

from uav_mission_manager.autopilot.simulator.frames import MOTOR_FRAMES
from uav_mission_manager.policy import load_policy

ROOT = Path(__file__).parents[2]
POLICY = load_policy(ROOT / 'policies' / 'case_study')


@pytest.mark.parametrize('frame', ['quad', 'hexa'])
@pytest.mark.parametrize('scenario', SCENARIOS, ids=lambda scenario: scenario.__name__)
def test_scenario(scenario, frame):
    chain = SimulatedChain(POLICY, frame=MOTOR_FRAMES[frame])
    scenario(chain)
