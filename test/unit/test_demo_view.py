"""The demo's lines fit a terminal and lose nothing."""

from __future__ import annotations

import pytest

from uav_mission_manager.cli.demo.view import LEGEND, View
from uav_mission_manager.mdp import StateSpace

REASON = 'goal2 has high priority, threat high; expected cost 153.2, 14 below commit goal1 agile'
WHERE = 'cell 15 (150, -150, 20) m'


@pytest.mark.parametrize('width', [80, 100])
def test_every_word_is_shown_in_lines_of_a_terminals_width(width, monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', str(width))
    monkeypatch.setenv('FORCE_COLOR', '1')
    view = View('Three goals', StateSpace(3, 8).names)
    view.start()
    view.decision((1, 1, 1, 1, 0, 2, 0, 15, 2, 2, 1), 'commit goal2 normal', REASON, WHERE)
    view.event(f'bridge: {REASON}')
    out, _ = capsys.readouterr()
    lines = out.splitlines()
    assert max(map(len, lines)) <= width
    assert '\x1b' not in out
    assert ' '.join(out.split()).count(REASON) == 2
    assert ' '.join(LEGEND.split()) in ' '.join(out.split())
    row = next(line for line in lines if WHERE in line)
    assert ' '.join(row.split()[:12]) == '1 1 1 1 1 0 2 0 15 2 2 1'
    head = next(line for line in lines if 'position' in line)
    assert head.index('command') == row.index('commit')
    assert head.split()[1:12] == list('frrrggglctm')


def test_elsewhere_each_happening_is_a_line(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '80')
    monkeypatch.delenv('FORCE_COLOR', raising=False)
    view = View('Case I', StateSpace(1, 8).names)
    view.decision((1, 1, 2, 5, 1, 0, 0), 'commit goal1 normal', REASON, WHERE)
    view.event(REASON)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert lines[0].split() == ['1', *'1125100', 'commit', 'goal1', 'normal', *WHERE.split()]
    assert [line.strip() for line in lines[1:]] == [REASON, f'* {REASON}']
