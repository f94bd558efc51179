"""The demo flies five goals on one battery, and recharges before anything is out of range."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_helpers import ROOT
from test_demo import assert_replays, started

from uav_mission_manager.cli.mission_report import main as mission_report
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.mdp.range_model import flight_range, required_ranges

SPEEDUP = '16'
MISSION = load_mission(ROOT / 'config' / 'survey.yaml')
POLICY = ROOT / 'policies' / 'survey'


def recorded_decisions(bag: Path) -> list[dict[str, str]]:
    """Values of each decision, in order."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kind = 'diagnostic_msgs/msg/DiagnosticArray'
    with rosbag2.Reader(bag) as reader:
        [decisions] = (c for c in reader.connections if c.topic.endswith('/manager/decision'))
        told = [store.deserialize_cdr(m, kind) for _, _, m in reader.messages([decisions])]
    values = [{pair.key: pair.value for pair in each.status[0].values} for each in told]
    return [each for each in values if 'state' in each]


def reached(decision: dict[str, str]) -> list[bool]:
    """Whether the charge less the reserve reaches each goal, from the cell of a decision."""
    energy, charge = MISSION.energy, MISSION.range.charge
    cell, level = (int(decision[key].split()[0].strip(',')) for key in ('cell', 'charge level'))
    left = flight_range(energy, level / charge.levels - charge.reserve)
    needed = required_ranges(MISSION, MISSION.grid.position(cell))
    return [left >= distance for distance in needed]


def test_the_policy_recharges_before_any_goal_is_out_of_range(tmp_path):
    with started(tmp_path, 'survey', '--no-page', '--speedup', SPEEDUP) as demo:
        assert demo.finish() == 0, demo.text
    assert 'Five goals on one battery: 5 of 5 goals achieved' in demo.text
    bag = demo.logs / 'bags' / 'survey'
    decisions = recorded_decisions(bag)
    recharge = next(n for n, each in enumerate(decisions) if each['command'] == 'recharge')
    for decision in decisions[: recharge + 1]:
        assert {decision[f'{goal.name} in range'] for goal in MISSION.goals} == {'yes'}
        assert all(reached(decision)), decision
    assert any(map(int, decisions[recharge]['state'].split()[2:7]))  # There is more to do.
    assert not _drains_otherwise(demo.logs)
    assert_replays(demo.logs, 'survey', {'recharge'}, POLICY)
    out = tmp_path / 'report.html'
    assert mission_report([str(bag), '--policy', str(POLICY), '--out', str(out)]) == 0
    assert 'RECHARGE' in out.read_text()


def _drains_otherwise(logs: Path) -> bool:
    """Whether the bridge found another power than the mission's."""
    return 'set energy.' in (logs / 'survey' / 'mavlink_bridge.log').read_text()
