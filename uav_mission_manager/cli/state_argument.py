"""A state as an argument of a command."""

from __future__ import annotations

from uav_mission_manager.echo import quoted

STATE_FORM = (
    'f, r and g of each goal, l, c, t, m; for three goals "1,1,0,1,0,2,1,1,0,2,1"; one '
    'b for all r where the mission has a charge'
)
"""How a state is written, for the help of a command."""


def parse_state(option: str, text: str) -> list[int]:
    """Return the variables of a state that is written with commas or blanks.

    Raises
    ------
    ValueError
        If they are not whole numbers; the message names the option and the text.
    """
    try:
        return [int(part) for part in text.replace(',', ' ').split()]
    except ValueError:
        raise ValueError(f'{option}: {quoted(text)} is not a list of whole numbers') from None
