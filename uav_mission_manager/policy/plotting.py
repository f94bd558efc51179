"""The map of a policy: what it does in each cell, in one picture.

Colours are told apart by the colour-blind (Okabe and Ito 2008), and in print by the words in the
cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import FAULT_MODES, Action, ActionKind, global_actions
from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.policy.policy import Policy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KIND_COLOURS = {
    ActionKind.NONE: '#dddddd',
    ActionKind.RECHARGE: '#f0e442',
    ActionKind.REPAIR: '#d55e00',
}
"""Of cells in which no goal is committed to."""

GOAL_COLOURS = ('#56b4e9', '#e69f00', '#009e73', '#cc79a7')
"""Of the goals committed to, over and over again."""

HATCH, HATCH_COLOUR = '///', '0.45'
"""Where the action is flown in agile mode."""

CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0), (0, 0))
"""Of a cell, around it, in rows and columns from its first one."""

MOST_LETTERED = 12
"""Cells a side of a grid up to which each says in words what is done there: a choice."""

LONGEST_GOAL_NAME = 20
"""Characters of a goal's name in the legend, at most."""


def plot_policy(
    policy: Policy,
    *,
    fault: str = FAULT_MODES[0],
    threat: str = 'none',
    ranges: Sequence[int] | None = None,
    priorities: Sequence[int] | None = None,
    charge: int | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw what a policy does in each cell; needs the extra `plot`.

    A colour for each goal committed to, for recharge, repair and none of these; hatched where the
    mode is agile. B and S are base and service cell, (1), (2).. the goals. A policy that looks at
    commitment or mode, as `best_value` does, is asked uncommitted and in normal mode.

    Parameters
    ----------
    policy : Policy
    fault : str
        Name of the fault mode f, such as `nominal`.
    threat : str
        Name of the threat level t, such as `none`.
    ranges : sequence of k int, optional
        Range flag of each goal, 0 or 1; by default all are in range. Not where the mission has a
        charge, which tells them.
    priorities : sequence of k int, optional
        Priority of each goal, 0 to 2; by default all are high.
    charge : int, optional
        Level b of the charge, where the mission has one; by default it is full.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default on a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        East and north [m] from the centre of cell 0.

    Raises
    ------
    ImportError
        If Matplotlib is missing.
    ValueError
        If there is no such fault mode, threat level, flag, priority or charge.
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise ImportError('plot_policy needs Matplotlib: pip install matplotlib') from error
    mission = policy.mission
    columns = range_columns(policy, ranges, charge)
    states = map_states(policy, fault, threat, columns, priorities)
    actions = [global_actions(mission)[number - 1] for number in policy.act(states)]
    if axes is None:
        axes = pyplot.figure(layout='constrained').add_subplot()
    lettered = max(mission.grid.rows, mission.grid.cols) <= MOST_LETTERED
    _fill(axes, mission, actions, edges='white' if lettered else 'none')
    if lettered:
        _letter(axes, mission, actions)
    _mark(axes, mission, 0.3 if lettered else 0.0)
    axes.set(xlabel='east [m]', ylabel='north [m]', aspect='equal')
    axes.set_title(f'fault {fault}, threat {threat}', fontsize='medium')
    _explain(axes, mission, actions)
    return axes


def map_states(
    policy: Policy,
    fault: str,
    threat: str,
    ranges: IntArray,
    priorities: Sequence[int] | None,
) -> IntArray:
    """One state for each cell, shape (q, 2k+5); arguments as of `plot_policy`.

    The variables that tell range are those of `range_columns`.
    """
    mission = policy.mission
    states = np.zeros((mission.grid.q, len(policy.space.shape)), np.int64)
    s = policy.space.split(states)
    s.f[:] = _position('fault', fault, FAULT_MODES) + 1
    s.t[:] = _position('threat', threat, mission.threat.levels)
    states[:, 1 : 1 + len(ranges)] = ranges
    s.g[:] = _each_goal('priorities', priorities, 2, mission)
    s.l[:] = np.arange(mission.grid.q)
    return policy.space.check(states)


def range_columns(policy: Policy, ranges: Sequence[int] | None, charge: int | None) -> IntArray:
    """The variables that tell range in states; arguments as of `plot_policy`."""
    mission, full = policy.mission, np.array(policy.space.charged, np.int64)
    if mission.range.charge is None:
        if charge is not None:
            raise ValueError(f'charge: {quoted(charge)}: mission {mission.name} has range flags')
        return full * _each_goal('ranges', ranges, 1, mission)
    if ranges is not None:
        raise ValueError(f'ranges: {quoted(ranges)}: the charge tells what is in range')
    return full if charge is None else np.array([charge])


def _position(what: str, name: str, names: Sequence[str]) -> int:
    if name not in names:
        raise ValueError(f'{what}: {quoted(name)} is none of {", ".join(names)}')
    return names.index(name)


def _each_goal(
    what: str, values: Sequence[int] | None, default: int, mission: Mission
) -> int | IntArray:
    if values is None:
        return default
    numbers = np.asarray(values)
    if numbers.shape != (mission.k,) or not np.issubdtype(numbers.dtype, np.integer):
        goals = f'each of {mission.k} goals'
        raise ValueError(f'{what}: {quoted(values)} is not a whole number for {goals}')
    return numbers


def _fill(axes: Axes, mission: Mission, actions: Sequence[Action], edges: str) -> None:
    """Colour the cells, hatch those of agile actions."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    grid = mission.grid
    corners = np.array(
        [
            [grid.at(col - 0.5, row - 0.5) for col in range(grid.cols + 1)]
            for row in range(grid.rows + 1)
        ]
    )
    colours = np.array([to_rgb(action_colour(action)) for action in actions])
    cells = colours.reshape(grid.rows, grid.cols, 3)
    axes.pcolormesh(corners[..., 0], corners[..., 1], cells, edgecolors=edges)
    agile = [divmod(cell, grid.cols) for cell, action in enumerate(actions) if action.agile]
    if agile:
        rows, cols = np.array(agile).T
        ring = [corners[rows + down, cols + right] for down, right in CORNERS]
        outline = Path.make_compound_path_from_polys(np.stack(ring, axis=1))
        axes.add_patch(PathPatch(outline, fill=False, ec=HATCH_COLOUR, lw=0, hatch=HATCH))


def _letter(axes: Axes, mission: Mission, actions: Sequence[Action]) -> None:
    """Say in words in the cells what is done there."""
    for cell, action in enumerate(actions):
        text = axes.text(
            *mission.grid.position(cell), action_word(action), ha='center', va='center'
        )
        text.set(fontsize='small', clip_on=True)


def action_colour(action: Action) -> str:
    """Return the colour of a cell in which this is done."""
    if action.goal is None:
        return KIND_COLOURS[action.kind]
    return GOAL_COLOURS[action.goal % len(GOAL_COLOURS)]


def action_word(action: Action) -> str:
    """What a cell says of an action; goals are counted from 1."""
    if action.kind in (ActionKind.RECHARGE, ActionKind.REPAIR):
        return action.kind.value
    what = 'base' if action.goal is None else f'goal {action.goal + 1}'
    return f'{what}\nagile' if action.agile else what


def _mark(axes: Axes, mission: Mission, rise: float) -> None:
    """Draw base, service cell and goals, so many cell widths above the middle of their cells."""
    grid, signs = mission.grid, dict[int, list[str]]()
    for cell, sign in ((grid.base, 'B'), (grid.service, 'S')):
        signs.setdefault(cell, []).append(sign)
    for number, goal in enumerate(mission.goals, 1):
        signs.setdefault(goal.cell, []).append(f'({number})')
    for cell, here in signs.items():
        east, north = grid.position(cell)
        place = east, north + rise * grid.cell_size
        axes.text(*place, ' '.join(here), ha='center', va='center', weight='bold')


def _explain(axes: Axes, mission: Mission, actions: Sequence[Action]) -> None:
    """Draw a legend of the colours that there are."""
    from matplotlib.patches import Patch

    names: dict[str, list[str]] = {}
    for action in sorted(set(actions), key=lambda action: action.number):
        name = 'base' if action.kind is ActionKind.NONE else action.kind.value
        if action.goal is not None:
            goal = shown(mission.goals[action.goal].name, LONGEST_GOAL_NAME)
            name = f'({action.goal + 1}) {goal}'
        found = names.setdefault(action_colour(action), [])
        if name not in found:
            found.append(name)
    patches = [Patch(facecolor=colour, label=', '.join(here)) for colour, here in names.items()]
    if any(action.agile for action in actions):
        patches.append(Patch(fill=False, ec=HATCH_COLOUR, lw=0, hatch=HATCH, label='agile'))
    legend = axes.legend(
        handles=patches, loc='upper left', bbox_to_anchor=(1, 1), frameon=False, fontsize='small'
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
