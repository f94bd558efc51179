"""How to read the report of a flight: each term that it uses, said once."""

from __future__ import annotations

from collections.abc import Iterator

from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.cli.mission_report.account import Account
from uav_mission_manager.mdp import Mission
from uav_mission_manager.onboard import ManagerSettings


def how_to_read(mission: Mission | None, account: Account | None, speedup: float) -> str:
    """Return the legend."""
    return f'<h2>How to read this</h2>{page.facts(_entries(mission, account, speedup))}'


def _entries(
    mission: Mission | None, account: Account | None, speedup: float
) -> Iterator[tuple[str, str]]:
    yield 'command', 'Numbered. In italics: what had changed since the command before.'
    yield 'EVADING, EVADE, agile', 'Dearer to fly, safer under a threat.'
    weight = (
        f', each later epoch weighing {mission.discount:g} of the one before' if mission else ''
    )
    yield (
        'cost',
        'Expected from there on, of goals open or out of range, distance, services, faults and '
        f'threats{weight}. More: than that of the command.',
    )
    if account is not None:
        yield 'epoch', f'A step of the model, the way through a cell: {account.seconds:.3g} s.'
    seconds = ManagerSettings().settling_time
    longer = (
        f" of the manager's clock, which are {seconds * speedup:g} s here"
        if speedup != 1.0
        else ''
    )
    yield (
        'counts later',
        'The end of a danger, and a request soon after another, count once they have lasted; a '
        f'change of mind waits after the last one: {seconds:g} s{longer}, unless set otherwise.',
    )
