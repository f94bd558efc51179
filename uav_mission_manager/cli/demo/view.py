"""What happens in the demo, as lines: a decision and why it was made, events between them."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

from rich.console import Console

from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS

LEGEND = (
    f'state: f fault mode, {", ".join(f"{n} {name}" for n, name in enumerate(FAULT_MODES, 1))}; '
    'r of each goal, 1 in range, or b, level of the charge; '
    'g of each goal, its priority 0 to 2; l cell; '
    'c goal committed to, 0 none; '
    f't threat, {", ".join(f"{n} {name}" for n, name in enumerate(THREAT_LEVELS))}; '
    'm mode, 0 normal, 1 agile'
)
"""What the numbers of a state say."""

ROW = '{:>5}  {:<22}  {:<20}  {}'
"""Epoch, state, command, position: at most 77 characters for three goals on a small grid."""

INDENT = ' ' * 7
"""Reasons and events stand below the state."""


class View:
    """Lines of epoch, state, command, position and reason; wrapped where a terminal is narrow.

    Parameters
    ----------
    title : str
    names : sequence of str
        Of the variables of a state.
    """

    def __init__(self, title: str, names: Sequence[str]) -> None:
        self.title, self.names = title, names
        self.epoch = 0
        self._console = Console()  # It knows whether this is a terminal, and how wide now.

    def start(self) -> None:
        """Show title, legend and headings."""
        self._show(self.title)
        self._show(LEGEND)
        state = ' '.join(name[0] for name in self.names)
        self._show(ROW.format('epoch', state, 'command', 'position'))

    def decision(self, state: tuple[int, ...], command: str, reason: str, where: str) -> None:
        """Show that the manager decided anew, so a new epoch begins."""
        self.epoch += 1
        self._show(ROW.format(self.epoch, ' '.join(map(str, state)), command, where))
        self._show(f'{INDENT}{reason}')

    def event(self, text: str) -> None:
        """Show something that happened."""
        self._show(f'{INDENT}* {text}')

    def _show(self, text: str) -> None:
        """Print a text; on a terminal in lines of its width."""
        if self._console.is_terminal and len(text) > self._console.width:
            text = '\n'.join(wrap(text, self._console.width, subsequent_indent=INDENT))
        print(text, flush=True)
