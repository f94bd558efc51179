"""`mission_report` of a policy set: what the other commands say, and what it does."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from strategies import case_study, with_charge
from test_mission_report import Page, report

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.cli import mission_check, mission_simulate
from uav_mission_manager.cli.mission_report import beside_optimum, policy_page
from uav_mission_manager.cli.mission_report.policy_maps import MapRow, maps_table
from uav_mission_manager.mdp import FAULT_MODES, action_name, mission_from_dict

ROOT = Path(__file__).parents[2]
CASE_STUDY = str(ROOT / 'policies' / 'case_study')
LETTERS = 'B123B123CR'
"""What stands in a cell for each action of a mission of three goals."""


@pytest.fixture(scope='module')
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    return report(tmp_path_factory.mktemp('report') / 'report.html', CASE_STUDY)


@pytest.fixture(scope='module')
def page(text: str) -> Page:
    return Page(text)


def maps(text: str) -> dict[str, str]:
    """The small maps by their labels."""
    found = re.findall(
        r'<svg viewBox="[^"]*" role="img" aria-label="([^"]*, threat \w+)".*?</svg>', text
    )
    pictures = re.findall(
        r'<svg viewBox="[^"]*" role="img" aria-label="[^"]*, threat \w+".*?</svg>', text
    )
    return dict(zip(found, pictures, strict=True))


@pytest.mark.parametrize('threat', ['none', 'low', 'high'])
@pytest.mark.parametrize('fault', FAULT_MODES)
def test_each_cell_of_a_map_is_what_the_policy_does_there(
    text: str, fault: str, threat: str
) -> None:
    f, t = FAULT_MODES.index(fault) + 1, ('none', 'low', 'high').index(threat)
    states = np.array([[f, 1, 1, 1, 2, 2, 2, cell, 0, t, 0] for cell in range(8)])
    best = load_policy(CASE_STUDY).q_values(states).argmin(axis=1)
    picture = maps(text)[f'{fault.replace("_", ", ")}, threat {threat}']
    assert ''.join(re.findall(r'>(\w)<title>cell', picture)) == ''.join(LETTERS[a] for a in best)
    agile = [a in (4, 5, 6, 7) for a in best]
    assert ('class="agile"' in picture) == any(agile)


def test_priorities_have_maps(text: str) -> None:
    alone = maps(text)['goal2 high alone, threat none']
    assert set(re.findall(r'>(\w)<title>cell', alone)) == {'2'}
    assert set(re.findall(r'>(\w)<title>cell', maps(text)['no goal wanted, threat none'])) == {'B'}
    assert 'C' in re.findall(
        r'>(\w)<title>cell', maps(text)['all high, none in range, threat none']
    )


def test_sensitivities_are_those_of_mission_check(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mission_check.main([str(ROOT / 'config' / 'case_study.yaml'), '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    rows = page.table('field', 'V* changes by')
    expected = [(s['name'], f'{s["relative"]:+.2%}') for s in answer['sensitivities'][:10]]
    assert [(row[0], row[3]) for row in rows] == expected
    assert f'V* from the start is {answer["value_at_start"]:.4f}' in ''.join(page.words)


def test_the_forecast_is_that_of_mission_simulate(
    page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mission_simulate.main([CASE_STUDY, '--episodes', '2000', '--json']) == 0
    found = json.loads(capsys.readouterr().out)['policies'][0]['forecast']
    goals = page.table('goal', 'median [min]')
    for row, goal in zip(goals, found['goals'], strict=True):
        assert row[0] == goal['name']
        assert float(row[1].split()[0]) == pytest.approx(
            100 * goal['done_within']['5']['value'], abs=0.06
        )
        assert float(row[4].split()[0]) == pytest.approx(goal['median_minutes']['value'], abs=0.06)
    rows = {row[0]: row[1] for row in page.table('estimate')}
    for name, key in (('recharges', 'recharges'), ('energy [Wh]', 'energy_wh')):
        assert float(rows[name]) == pytest.approx(found['means'][key]['value'], abs=0.06)


def test_cost_and_bounds_are_the_policy_s(page: Page) -> None:
    policy, start = load_policy(CASE_STUDY), [[1, 1, 1, 1, 2, 2, 2, 0, 0, 0, 0]]
    words = ''.join(page.words)
    assert f'{policy.q_values(start).min():.6g}' in words
    assert policy.digest in words
    assert 'the best possible, proved' in words


def test_it_is_one_file_without_scripts_or_network(text: str, page: Page) -> None:
    assert not {'script', 'link', 'img', 'iframe', 'object', 'use'} & set(page.tags)
    assert not {name for name, _ in page.attributes} & {'src', 'href', 'onload', 'onclick'}
    for svg in re.findall(r'<svg.*?</svg>', text, re.S):
        ElementTree.fromstring(svg)


def test_what_comes_from_the_mission_is_escaped(tmp_path: Path) -> None:
    document = case_study(1, 2, name='</title><script>x</script>')
    for number, goal in enumerate(document['goals']):
        goal['name'] = f'<script>{number}</script>'
    build_policy(mission_from_dict(document, 'test')).save(tmp_path / 'policy')
    text = report(tmp_path / 'r.html', tmp_path / 'policy')
    assert 'script' not in Page(text).tags
    assert text.count('&lt;script&gt;') > 10


@pytest.mark.parametrize('method', ['split', 'highest_priority', 'expansion'])
def test_a_decomposed_policy_shows_its_parts_and_certificate(tmp_path: Path, method: str) -> None:
    mission = mission_from_dict(case_study(1, 2), 'test')
    policy = build_policy(mission, method, certificate=True)
    policy.save(tmp_path / 'policy')
    words = ''.join(Page(report(tmp_path / 'r.html', tmp_path / 'policy')).words)
    assert 'share of each sub-MDP in the cost' in words
    assert f'{policy.certificate.gap:.2%}' in words


def test_large_grids_have_no_letters_and_few_shapes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(policy_page, 'MOST_SOLVE_SECONDS', 0.0)  # Maps are looked at alone.
    places = {'rows': 40, 'cols': 40, 'base': 0, 'service': 1, 'cell_size': 50.0}
    document = case_study(grid=places)
    document['goals'] = document['goals'][:1]
    document['threat']['zones'] = {}
    build_policy(mission_from_dict(document, 'test'), tolerance=1.0).save(tmp_path / 'policy')
    text = report(tmp_path / 'r.html', tmp_path / 'policy')
    assert '<title>cell 0: ' not in text
    assert len(text) < 5_000_000


def test_a_policy_with_a_charge_is_drawn_full_and_empty() -> None:
    mission = mission_from_dict(with_charge(case_study(), levels=4), 'test')
    policy = build_policy(mission)
    row = MapRow('all', 'nominal', (1, 1, 1), (2, 2, 2))
    full, empty = (maps_table(policy, [replace(row, ranges=(r,) * 3)]) for r in (1, 0))
    assert full != empty
    assert 'commit goal' in full
    assert 'commit goal' not in empty


def test_agreement_with_the_optimal_policy_is_counted(tmp_path: Path) -> None:
    mission = mission_from_dict(case_study(1, 2), 'test')
    policies = {
        method: build_policy(mission, method)
        for method in ('best_value', 'exact', 'split', 'highest_priority')
    }
    policies['best_value'].save(tmp_path / 'policy')
    text = report(tmp_path / 'r.html', tmp_path / 'policy')
    rows = Page(text).table('policy', 'same action')
    states = policies['exact'].space.states()
    best = policies['exact'].q_values(states)
    for row, policy in zip(rows, policies.values(), strict=True):
        assert row[0].startswith(policy.method)
        chosen = policy.act(states) - 1
        same = int((chosen == best.argmin(axis=1)).sum())
        assert row[1:3] == [f'{same:,}', f'{len(states) - same:,}']
        cost = best[np.arange(len(states)), chosen]
        near = (cost <= 1.001 * best.min(axis=1)).mean()
        assert row[3:] == [f'{same / len(states):.1%}', f'{near:.1%}']
    assert rows[1][1] == f'{len(states):,}'
    assert [row[2] for row in rows].count('0') == 1
    assert len(text) < 5_000_000


def test_of_very_many_states_some_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside_optimum, 'MOST_COMPARED', 1000)
    mission = mission_from_dict(case_study(), 'test')
    exact, other = (build_policy(mission, method) for method in ('exact', 'best_value'))
    page = Page(''.join(beside_optimum.beside_optimum(other, exact)))
    found = float(page.table('policy', 'same action')[0][3].rstrip('%'))
    states = exact.space.states()
    assert found == pytest.approx(100 * (exact.act(states) == other.act(states)).mean(), abs=2.0)
    assert f'Of 10,000 states, drawn evenly from {len(states):,}.' in ''.join(page.words)
    assert 'as good' not in ''.join(page.words)


def test_sub_mdps_and_the_likeliest_next_states_are_shown(tmp_path: Path) -> None:
    policy = build_policy(mission_from_dict(case_study(1, 2), 'test'), 'best_value')
    policy.save(tmp_path / 'policy')
    page = Page(report(tmp_path / 'r.html', tmp_path / 'policy'))
    words = ''.join(page.words)
    start = [1, 1, 1, 2, 2, 0, 0, 0, 0]
    for value in policy.part_values([start])[0]:
        assert f'{value:.4g}' in words
    names = ['f', 'r1', 'r2', 'g1', 'g2', 'l', 'c', 't', 'm']
    for level in (0, 2):
        state = [*start[:-2], level, 0]
        rows = [table[1:] for table in page.tables if table[0][1:-1] == ['does', *names]][
            level // 2
        ]
        assert list(map(int, rows[0][2:-1])) == state
        action = policy.decide(state).action
        assert rows[1][1] == action_name(policy.mission, action)
        assert int(rows[1][-2]) == int(action.agile)
        assert int(rows[1][names.index('c') + 2]) == action.commitment


def test_a_mission_too_large_to_solve_is_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policy_page, 'MOST_SOLVE_SECONDS', 0.0)
    words = ''.join(Page(policy_page.policy_page(load_policy(CASE_STUDY), 'here')).words)
    assert words.count('Left out: the exact solution would take about') == 2
    assert 'built anew' not in words
