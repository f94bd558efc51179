"""Commands for people."""

import signal
import sys
import threading
from types import FrameType, TracebackType

_excepthook = sys.excepthook
_come: list[int] = []  # signals of Ctrl-C


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise what Python does by itself, and note it: NumPy makes an ImportError of it."""
    _come.append(number)
    signal.default_int_handler(number, frame)


def _quietly(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show an error; of Ctrl-C while a command still imports its modules, only that."""
    if issubclass(kind, KeyboardInterrupt) or (_come and issubclass(kind, ImportError)):
        print('interrupted', file=sys.stderr)
    else:
        _excepthook(kind, error, trace)


sys.excepthook = _quietly
if (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
    and threading.current_thread() is threading.main_thread()
):
    signal.signal(signal.SIGINT, _interrupt)
