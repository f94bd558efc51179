"""`mission_learn`: a recorded flight, read here by other means, and flights made up in detail."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from uav_mission_manager import load_mission
from uav_mission_manager.cli.mission_learn import command, main
from uav_mission_manager.cli.mission_learn.certificates import compared
from uav_mission_manager.cli.mission_learn.flown_bag import flown_epochs, measured
from uav_mission_manager.cli.mission_report.flight_record import AirTime, Decided, FlightRecord
from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.console.words import InCommand
from uav_mission_manager.learning import count
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.policy.certificate import Certificate

ROOT = Path(__file__).parents[2]
BAG, MISSION = str(ROOT / 'test' / 'bags' / 'case_study'), str(ROOT / 'config' / 'case_study.yaml')
SPEEDUP = 8.0
LENGTH = 10.0


def said(topic: str) -> list[tuple[float, Any]]:
    """Seconds of the flight, and messages of a topic of the recorded flight."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(BAG) as reader:
        found = [each for each in reader.connections if each.topic.endswith(topic)]
        return [
            ((time - reader.start_time) * 1e-9 * SPEEDUP, store.deserialize_cdr(m, c.msgtype))
            for c, time, m in reader.messages(found)
        ]


def table(text: str) -> dict[str, list[str]]:
    """The rows of the page's table, by number."""
    rows = [line.strip('| ').split(' | ') for line in text.splitlines() if line.startswith('|')]
    return {row[0]: row[1:] for row in rows}


def test_a_recorded_flight_says_what_happened_in_it(tmp_path, capsys):
    out, page = tmp_path / 'new.yaml', tmp_path / 'page.html'
    arguments = [BAG, '--mission', MISSION, '--out', str(out), '--report', str(page)]
    assert main([*arguments, '--speedup', str(SPEEDUP)]) == 0
    text = capsys.readouterr().out
    rows = table(text)
    done = {message.data for _, message in said('goal_completed')} - {''}
    assert done == {'goal1', 'goal2', 'goal3'}
    # goal1 was asked for twice, and done twice.
    assert rows['faults.completion[0]'][3:5] == ['4', '4']
    faults = [message.data for _, message in said('fault_mode')]
    assert {'nominal', 'actuator'} == set(faults)
    assert rows['faults.rate.actuator'][3] == '1'
    assert [rows[f'faults.rate.{part}'][3] for part in ('sensor', 'camera')] == ['0', '0']
    heights = [(at, message.pose.pose.position.z) for at, message in said('odom')]
    up = sum(b[0] - a[0] for a, b in pairwise(heights) if a[1] > heights[0][1] + 0.5)
    assert float(rows['faults.rate.sensor'][4]) * LENGTH == pytest.approx(up, abs=2 * LENGTH)
    new, old = load_mission(out), load_mission(MISSION)
    assert new.faults.rate.sensor < old.faults.rate.sensor < 0.05
    assert old.faults.rate.actuator < new.faults.rate.actuator
    assert new.geography() == old.geography()
    assert '# learned repair_success' in out.read_text()
    html = page.read_text()
    assert 'faults.repair_success' in html
    assert 'Exact expected cost in the new model' in html
    assert '<script' not in html


def test_a_page_in_markdown_is_what_is_printed(tmp_path, capsys):
    out, page = tmp_path / 'new.yaml', tmp_path / 'page.md'
    options = ['--mission', MISSION, '--out', str(out), '--report', str(page), '--speedup', '8']
    assert main([BAG, BAG, *options, '--weight', '30']) == 0
    assert page.read_text() in capsys.readouterr().out
    assert 'of 2 bags' in page.read_text()


@pytest.mark.parametrize(
    ('options', 'problem'),
    [
        (['--mission', 'config/case_one.yaml'], r'at \d+\.\d+ s: decided in another mission'),
        (['--weight', '0'], "'0' is not a number above 0"),
        (['--weight', 'nan'], "'nan' is not a number above 0"),
        (['--report', 'page.pdf'], '--report: page.pdf ends in none of .html, .md'),
        (['--out', 'nowhere/new.yaml'], '--out: there is no folder nowhere'),
        (['--out', MISSION], '--out: is the file of --mission, which is the prior'),
        (['--mission', 'missing.yaml'], 'missing.yaml: cannot be read'),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(
    options, problem, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    arguments = [BAG, '--mission', MISSION, '--out', 'new.yaml', '--speedup', '8', *options]
    with pytest.raises(SystemExit) as end:
        main(arguments)
    said_of_it = f'{end.value.code}\n{capsys.readouterr().err}'
    assert re.search(problem, said_of_it)
    assert [path.name for path in tmp_path.iterdir()] == ['config']


def test_a_file_without_a_speed_has_no_epochs(tmp_path):
    data = read_yaml(Path(MISSION).read_text())
    del data['energy']
    file = tmp_path / 'slow.yaml'
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(SystemExit, match=r'slow\.yaml: .*energy'):
        main([BAG, '--mission', str(file), '--out', str(tmp_path / 'new.yaml')])
    assert not (tmp_path / 'new.yaml').exists()


CASE = load_mission(MISSION)


def state(cell=0, f=1, g=(2, 0, 0), t=0):
    return (f, 1, 1, 1, *g, cell, 0, t, 0)


def flight(*decided, end, command='commit goal1 normal', **known) -> FlightRecord:
    """A flight of decisions, each a time and a state, in the air all the time unless told."""
    record = FlightRecord('/uav1', 0.0, 1.0, end=end)
    for at, told, *other in decided:
        decision = HeardDecision('', state=told, command=other[0] if other else command)
        record.decided.append(Decided(at, decision))
    record.legs.append(AirTime(0.0, end))
    record.charges.append((0.0, 1.0))
    for name, value in known.items():
        setattr(record, name, value)
    return record


def who(word: str) -> InCommand:
    return InCommand(word, '', '', '')


def cells(epochs) -> list[int]:
    return epochs.states[:, 7].tolist()


def test_epochs_are_as_long_as_the_models_and_the_cell_is_half_an_epoch_late():
    record = flight((0.0, state(0)), (15.0, state(1)), (24.0, state(5)), end=64.0)
    epochs = flown_epochs(record, CASE, LENGTH)
    # At 0, 10, .. 50 s the vehicle is where it was at 0, 5, 15, .. 45 s; 4 s at the end are none.
    assert cells(epochs) == [0, 0, 1, 5, 5, 5]
    assert epochs.after[:, 7].tolist() == [0, 1, 5, 5, 5, 5]
    assert epochs.actions.tolist() == [2] * 6
    assert len(flown_epochs(flight((0.0, state(0)), end=66.0), CASE, LENGTH).states) == 7


def test_only_epochs_in_which_the_manager_decided_and_was_in_command_count():
    record = flight(
        (0.0, ()), (5.0, state(0)), (47.0, ()), (60.0, state(1)), end=100.0,
        in_command=[(0.0, who('MANAGER')), (75.0, who('PILOT')), (85.0, who('MANAGER'))],
    )  # fmt: skip
    # 5..47 s: four; 60..75 s: two, the last of half an epoch; 85..100 s: two.
    assert cells(flown_epochs(record, CASE, LENGTH)) == [0, 0, 0, 0, 1, 1, 1, 1]


def test_on_the_ground_nothing_can_fail():
    record = flight((0.0, state(0)), (25.0, state(0, f=3)), end=60.0, legs=[AirTime(24.0, 60.0)])
    counts = count(CASE, flown_epochs(record, CASE, LENGTH))
    assert counts.failure.sum(axis=0).tolist() == [[0, 4], [1, 0], [0, 4]]


def test_a_completion_counts_once_however_often_it_is_said():
    record = flight(
        (0.0, state(5)), (27.0, state(5, g=(0, 0, 0))), end=60.0,
        completed=[(26.0, 'goal1'), (28.0, 'goal1'), (33.0, 'goal1'), (40.0, 'nobody')],
    )  # fmt: skip
    counts = count(CASE, flown_epochs(record, CASE, LENGTH))
    # On site for 26 s: three epochs, of which one completed it. After that it is not wanted.
    assert counts.completion[0, 0, 0] == 1
    assert counts.priority[0, 2].tolist() == [0, 0, 2]


def test_a_gauge_that_wavers_drains_nothing_twice():
    drains = {'charge': {'levels': 16, 'empty_cost': 1.0}, 'cost': 3.0}
    mission = mission_from_dict({**CASE.to_dict(), 'range': drains}, 'charge')
    levels = (15, 14, 15, 14, 13, 14)
    record = flight(
        *((LENGTH * n, (1, b, 2, 0, 0, 0, 0, 0, 0)) for n, b in enumerate(levels)), end=60.0
    )
    drained = count(mission, flown_epochs(record, mission, LENGTH)).drain[0]
    assert drained @ np.arange(16) == 2


def test_power_is_what_the_charge_lost_in_the_air():
    charges = [(0.0, 1.0), (10.0, 0.99), (20.0, 0.97), (30.0, 1.0), (40.0, 0.98)]
    record = flight((0.0, state(0)), end=40.0, charges=charges)
    found = measured([record], CASE, LENGTH)
    full = 5.0 * 14.8 * 3600
    # From 20 to 30 s the battery was changed.
    assert found.power == pytest.approx([full * 0.01 / 10, full * 0.02 / 10, full * 0.02 / 10])
    assert found.agile_power.size == 0


def certificate(gap: float | None, flown: float) -> Certificate:
    return Certificate(None, 0.0, 1.0, 1.0, gap, 0.0, flown, 0.0, None)


def test_a_certificate_that_gets_worse_is_a_warning():
    lines = compared(certificate(0.05, 0.02), certificate(0.04, 0.03))
    warnings = [line for line in lines if line.startswith('WARNING')]
    assert len(warnings) == 1
    assert 'flown is certified worse, 3.00% for 2.00%' in warnings[0]
    rounding = compared(certificate(0.05, 0.02), certificate(0.05 + 1e-9, 0.02))
    assert not any(line.startswith('WARNING') for line in rounding)
    assert any('certified worse, not known' in line for line in
               compared(certificate(0.05, 0.02), certificate(None, 0.02)))  # fmt: skip


def test_a_mission_that_is_too_large_is_not_compared(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, 'obstacle_to_solving', lambda mission: 'it would take a year')
    out = str(tmp_path / 'new.yaml')
    assert main([BAG, '--mission', MISSION, '--out', out, '--speedup', '8']) == 0
    assert 'Not compared: it would take a year.' in capsys.readouterr().out
    assert math.isfinite(load_mission(out).faults.repair_success)
