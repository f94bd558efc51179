"""The map of a policy shows what the policy does."""

from __future__ import annotations

import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from strategies import case_study

from uav_mission_manager import build_policy, load_policy, plot_policy
from uav_mission_manager.mdp import action_name, mission_from_dict
from uav_mission_manager.paths import share_directory

mpl.use('agg')
from matplotlib import pyplot


@pytest.fixture(scope='module')
def policy():
    return load_policy(share_directory() / 'policies' / 'case_study')


@pytest.fixture(autouse=True)
def closing():
    yield
    pyplot.close('all')


def words(name):
    """What a cell says, of an action's name: `commit goal2 agile` is `goal 2`, `agile`."""
    kind, *rest = name.split()
    what = {'commit': f'goal {rest[0][-1]}' if rest else '', 'none': 'base'}.get(kind, kind)
    return f'{what}\nagile' if rest[-1:] == ['agile'] else what


def texts(axes):
    """Text of the map by its place [m]."""
    return {tuple(text.get_position()): text.get_text() for text in axes.texts}


@pytest.mark.parametrize(
    ('f', 't', 'how'),
    [
        (1, 0, {}),
        (2, 2, {'fault': 'sensor', 'threat': 'high', 'ranges': [1, 0, 1]}),
        (5, 1, {'fault': 'camera', 'threat': 'low', 'ranges': [0, 0, 0]}),
        (1, 2, {'threat': 'high', 'priorities': (0, 0, 1)}),
    ],
)
def test_every_cell_says_its_action(policy, f, t, how):
    r, g = how.get('ranges', [1, 1, 1]), how.get('priorities', [2, 2, 2])
    shown = texts(plot_policy(policy, **how))
    for cell in range(8):
        decision = policy.decide([f, *r, *g, cell, 0, t, 0])
        place = 50.0 * (cell % 4), -50.0 * (cell // 4)
        assert shown[place] == words(action_name(policy.mission, decision.action))


def test_colours_and_hatches_tell_the_actions_apart(policy):
    axes = plot_policy(policy, threat='high')
    names = np.array([texts(axes)[50.0 * (c % 4), -50.0 * (c // 4)] for c in range(8)])
    goals = [name.split('\n')[0] for name in names]
    [mesh], [hatching] = axes.collections, axes.patches
    assert (*axes.get_xlim(), *axes.get_ylim()) == (-25.0, 175.0, -75.0, 25.0)
    colours = list(map(tuple, mesh.get_array().reshape(8, 3).tolist()))
    assert len(set(zip(goals, colours))) == len(set(goals)) == len(set(colours)) > 1
    for cell, name in enumerate(names):
        place = 50.0 * (cell % 4), -50.0 * (cell // 4)
        assert hatching.get_path().contains_point(place) == name.endswith('agile')
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ['(1) goal1', '(2) goal2', '(3) goal3', 'agile']


def test_places_are_marked(policy):
    signs = [text for text in texts(plot_policy(policy)).items() if text[0][1] % 50]
    assert signs == [
        ((0.0, 15.0), 'B'),
        ((50.0, 15.0), 'S'),
        ((50.0, -35.0), '(1)'),
        ((150.0, 15.0), '(2)'),
        ((100.0, -35.0), '(3)'),
    ]


def test_it_draws_where_it_is_told(policy):
    _, panels = pyplot.subplots(1, 2)
    for axes, threat in zip(panels, ('none', 'high')):
        assert plot_policy(policy, threat=threat, axes=axes) is axes
        assert axes.get_title() == f'fault nominal, threat {threat}'
        assert (axes.get_xlabel(), axes.get_ylabel()) == ('east [m]', 'north [m]')


def test_a_turned_grid_is_drawn_turned(policy):
    grid = replace(policy.mission.grid, bearing=90.0)  # Rows run west, columns south.
    turned = build_policy(replace(policy.mission, grid=grid), 'exact')
    axes = plot_policy(turned, threat='high')
    said = {tuple(np.round(place, 6)): text for place, text in texts(axes).items()}
    [mesh], [hatching] = axes.collections, axes.patches
    corners = mesh.get_coordinates()
    for cell in range(8):
        row, col = divmod(cell, 4)
        place = -50.0 * row, -50.0 * col
        action = turned.decide([1, 1, 1, 1, 2, 2, 2, cell, 0, 2, 0]).action
        assert said[place] == words(action_name(turned.mission, action))
        middle = corners[row : row + 2, col : col + 2].mean(axis=(0, 1))
        np.testing.assert_allclose(middle, place, atol=1e-9)
        assert hatching.get_path().contains_point(place) == action.agile


def test_a_large_grid_is_not_lettered():
    mission = mission_from_dict(case_study(1), 'test')
    goals = (replace(mission.goals[0], name='$x', cell=389),)
    grid = replace(mission.grid, rows=13, cols=30, base=0, service=389)
    axes = plot_policy(build_policy(replace(mission, grid=grid, goals=goals)))
    assert texts(axes) == {(0.0, 0.0): 'B', (29 * 50.0, -12 * 50.0): 'S (1)'}
    axes.figure.canvas.draw()


@pytest.mark.parametrize(
    ('how', 'problem'),
    [
        ({'fault': 'engine'}, r"fault: 'engine' is none of nominal, sensor, .*, all"),
        ({'threat': 'extreme'}, "threat: 'extreme' is none of none, low, high"),
        ({'ranges': [1, 1]}, r'ranges: \[1, 1\] is not a whole number for each of 3 goals'),
        ({'ranges': [0.5, 1, 1]}, 'ranges: .* is not a whole number for each of 3 goals'),
        ({'priorities': [0, 1, 2, 0]}, 'priorities: .* is not a whole number for each'),
        ({'ranges': [1, 2, 0]}, r'r2 = 2 is outside 0\.\.1'),
        ({'priorities': [0, 1, 3]}, r'g3 = 3 is outside 0\.\.2'),
    ],
)
def test_what_there_is_not(policy, how, problem):
    with pytest.raises(ValueError, match=problem):
        plot_policy(policy, **how)
    assert pyplot.get_fignums() == []


def test_without_matplotlib_it_says_what_it_needs(policy, monkeypatch):
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(ImportError, match='plot_policy needs Matplotlib: pip install matplotlib'):
        plot_policy(policy)
