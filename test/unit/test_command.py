"""The command grammar both ways."""

from __future__ import annotations

from pathlib import Path

import pytest

from uav_mission_manager.mdp import global_actions, load_mission
from uav_mission_manager.onboard import format_command, parse_command

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')


def test_every_action_has_its_words() -> None:
    assert [format_command(MISSION, action) for action in global_actions(MISSION)] == [
        'none normal',
        'commit goal1 normal',
        'commit goal2 normal',
        'commit goal3 normal',
        'none agile',
        'commit goal1 agile',
        'commit goal2 agile',
        'commit goal3 agile',
        'recharge',
        'repair',
    ]


def test_parse_inverts_format() -> None:
    for action in global_actions(MISSION):
        assert parse_command(MISSION, format_command(MISSION, action)) == action
    assert parse_command(MISSION, '  commit   goal2 agile\n').number == 7


@pytest.mark.parametrize(
    'text',
    [
        '',
        'none',
        'commit goal4 normal',
        'commit goal1',
        'goal1 normal',
        'recharge agile',
        'Repair',
    ],
)
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ValueError, match='is not one of: none normal') as error:
        parse_command(MISSION, text)
    assert str(error.value).startswith(f'mission_command: {text!r} ')
    assert '\n' not in str(error.value)
