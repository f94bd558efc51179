"""The live table: one row a decision, events between them."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table

LINES_BESIDES_ROWS = 6
"""Lines of a terminal that the live table needs besides its rows: title, head, borders."""


class View:
    """Rows of epoch, state, command, reason and position; live on a terminal, lines elsewhere."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.console = Console(markup=False, emoji=False)  # Goals may be called [b] or :b:.
        self.rows: list[tuple[str, ...]] = []
        self.epoch = 0
        live = self.console.is_terminal
        self._live = Live(console=self.console, auto_refresh=False) if live else None

    def __enter__(self) -> View:
        """Show the title."""
        if self._live:
            self._live.start()
        else:
            print(self.title, flush=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last rows standing."""
        if self._live:
            self._live.stop()

    def decision(self, state: tuple[int, ...], command: str, reason: str, where: str) -> None:
        """Add a row: the manager decided anew, so a new epoch begins."""
        self.epoch += 1
        self._add(str(self.epoch), ' '.join(map(str, state)), command, reason, where)

    def event(self, text: str) -> None:
        """Add a row for something that happened."""
        self._add('', '', '', f'* {text}', '')

    def _add(self, *row: str) -> None:
        self.rows.append(row)
        if self._live is None:
            epoch, state, command, reason, where = row
            print(
                f'{epoch:>4}  {state:<23}  {command:<20}  {reason:<70}  {where}'.rstrip(),
                flush=True,
            )
            return
        table = Table(title=self.title, expand=True)
        for heading in ('epoch', 'state [f r g l c t m]', 'command', 'reason', 'position'):
            # On a narrow terminal it is the reason that is cut.
            table.add_column(heading, no_wrap=True, ratio=1 if heading == 'reason' else None)
        for shown in self.rows[-max(self.console.height - LINES_BESIDES_ROWS, 1) :]:
            table.add_row(*shown)
        self._live.update(table, refresh=True)
