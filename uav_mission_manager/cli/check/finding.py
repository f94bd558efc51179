"""A line of what is wrong with a mission."""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.echo import shown


@dataclass(frozen=True)
class Finding:
    """A field that a mission is implausible in, or that is worth a note.

    Attributes
    ----------
    field : str
        As in the mission file; where there is one in physical units too, both.
    value : object
        What it is.
    text : str
        Why that is odd, and what to do.
    note : bool
        Whether the mission may well be meant so.
    """

    field: str
    value: object
    text: str
    note: bool = False

    def __str__(self) -> str:
        """Say it in one line."""
        value = f'{self.value:.6g}' if isinstance(self.value, float) else shown(self.value, 40)
        return f'{self.field}: {value}: {self.text}'
