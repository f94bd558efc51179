"""Commands to an autopilot and its answers: one at a time, repeated, refused in its own words."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACK_TIMEOUT = 1.0
"""Time [s] to wait for the answer to a command: a choice."""

MAX_TRANSMISSIONS = 3
"""How often an unanswered command is sent at most: a choice."""

MAX_PROGRESS_TIME = 10.0
"""Time [s] that a command may be in progress, as its answers say: a choice. None of those sent
here takes longer than a mode change."""

WORDS_TIME = 1.0
"""Time [s] around a refusal in which the autopilot's texts explain it: a choice. ArduCopter sends
them just before or after the answer."""

MAX_WORDS = 4
"""Texts kept to explain a refusal, at most: a choice, as ArduCopter names a few checks at once."""

MAX_WHY_LENGTH = 200
"""Letters of a refusal with its explanation, at most: a choice, four texts of MAVLink's 50."""


def enum_name(enum: str, value: int) -> str:
    """Name of a MAVLink enum's value, the number where it has none."""
    entry = mavlink.enums[enum].get(value)
    return entry.name if entry else str(value)


def short_name(enum: str, value: int) -> str:
    """Name of a MAVLink enum's value without the enum's own: QUADROTOR for MAV_TYPE_QUADROTOR."""
    return enum_name(enum, value).removeprefix(f'{enum}_')


@dataclass(frozen=True)
class MavCommand:
    """A MAV_CMD: COMMAND_LONG, or COMMAND_INT where `frame` is given.

    `params` are param1 to param7; as COMMAND_INT params 5 and 6 are degrees. `component` of the
    vehicle is to do it.
    """

    number: int
    params: tuple[float, ...]
    frame: int | None = None
    component: int = mavlink.MAV_COMP_ID_AUTOPILOT1

    @property
    def name(self) -> str:
        """Name of the command in the MAVLink dialect, and of the message it asks for."""
        name = short_name('MAV_CMD', self.number)
        if self.number != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return name
        message = mavlink.mavlink_map.get(int(self.params[0]))
        return f'{name} {message.msgname if message else int(self.params[0])}'

    def message(self, system: int, confirmation: int) -> Any:
        """Return the MAVLink message to a system, sent for the n-th time again."""
        target = system, self.component
        if self.frame is None:
            return mavlink.MAVLink_command_long_message(
                *target, self.number, confirmation, *self.params
            )
        *params, latitude, longitude, z = self.params
        degrees = round(latitude * 1e7), round(longitude * 1e7)
        return mavlink.MAVLink_command_int_message(
            *target, self.frame, self.number, 0, 0, *params, *degrees, z
        )


@dataclass(frozen=True)
class Answer:
    """How a command ended: `why` it was not accepted, '' where it was."""

    command: MavCommand
    accepted: bool
    why: str


@dataclass(frozen=True)
class _Pending:
    """A command under way, and those to send after it."""

    commands: tuple[MavCommand, ...]
    sent_at: float
    transmissions: int = 1
    progress_since: float | None = None

    def waits_for(self, number: int, component: int | None = None) -> bool:
        command = self.commands[0]
        return command.number == number and component in (None, command.component)


@dataclass
class _Words:
    """What the autopilot said: a STATUSTEXT with the number that its chunks share."""

    time: float
    number: int
    text: str


@dataclass(frozen=True)
class _Refusal:
    """The last command that was answered, and not accepted."""

    time: float
    command: MavCommand
    result: str
    words: list[_Words]

    @property
    def why(self) -> str:
        said = '; '.join(words.text for words in self.words)
        return (f'{self.result}: {said}' if said else self.result)[:MAX_WHY_LENGTH]


class CommandExchange:
    """Sends commands and hears their answers.

    Parameters
    ----------
    transmit : callable
        Sends a command; the second argument counts its repetitions.

    Attributes
    ----------
    refused : dict of str to str
        Why, by the command's name, until the same command is accepted, or given up.
    """

    def __init__(self, transmit: Callable[[MavCommand, int], None]) -> None:
        self._transmit = transmit
        self.refused: dict[str, str] = {}
        self._pending: dict[int, _Pending] = {}  # By the number of a sequence's first command.
        self._answers: list[Answer] = []
        self._words: deque[_Words] = deque(maxlen=MAX_WORDS)
        self._refusal: _Refusal | None = None

    def send(self, commands: Sequence[MavCommand], now: float) -> None:
        """Send the first command, and each other once the one before it was accepted.

        The same commands under way go on. Other sequences that this one's first command is a part
        of are given up.
        """
        first = commands[0]
        under_way = self._pending.get(first.number)
        if under_way is not None and under_way.commands == tuple(commands):
            return
        self._pending = {
            number: pending
            for number, pending in self._pending.items()
            if number != first.number and all(c.number != first.number for c in pending.commands)
        }
        self._pending[first.number] = _Pending(tuple(commands), now)
        self._transmit(first, 0)

    def waits_for(self, number: int) -> bool:
        """Whether the answer to a command of this number is still to come."""
        return any(pending.waits_for(number) for pending in self._pending.values())

    def take_answers(self) -> list[Answer]:
        """Return the commands that ended since the last call."""
        answers, self._answers = self._answers, []
        return answers

    def cancel(self) -> None:
        """Forget what is under way and what was refused, except for requests of messages."""
        kept = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        self._pending = {n: pending for n, pending in self._pending.items() if n == kept}
        streams = short_name('MAV_CMD', kept)
        self.refused = {n: why for n, why in self.refused.items() if n.startswith(streams)}

    def clear(self) -> None:
        """Forget what is under way and what was refused: the link was lost."""
        self._pending.clear()
        self.refused.clear()
        self._words.clear()
        self._refusal = None

    def acknowledge(self, ack: Any, now: float) -> None:
        """Take note of a COMMAND_ACK of the component that was to do it."""
        component = ack.get_srcComponent()
        waiting = (n for n, p in self._pending.items() if p.waits_for(ack.command, component))
        first = next(waiting, None)
        if first is None:
            return
        pending = self._pending[first]
        if ack.result == mavlink.MAV_RESULT_IN_PROGRESS:
            since = now if pending.progress_since is None else pending.progress_since
            self._pending[first] = replace(pending, progress_since=since)
        elif ack.result == mavlink.MAV_RESULT_ACCEPTED:
            command, *others = self._pending.pop(first).commands
            self.refused.pop(command.name, None)
            self._answers.append(Answer(command, True, ''))
            if others:  # Sent by `repeat`: what else has come with the answer may cancel them.
                self._pending[first] = _Pending(tuple(others), -math.inf, transmissions=0)
        else:
            result = short_name('MAV_RESULT', ack.result).replace('_', ' ')
            self._refuse(first, result, now, explained=True)

    def hear(self, text: Any, now: float) -> None:
        """Take note of a STATUSTEXT, in the chunks of which it may come."""
        if text.severity > mavlink.MAV_SEVERITY_WARNING:
            return
        said = ''.join(filter(str.isprintable, text.text))
        recent = self._recent(now)
        late = self._refusal if self._explains_late(now) else None
        if text.chunk_seq and recent and recent[-1].number == text.id:
            recent[-1].text = f'{recent[-1].text}{said}'[:MAX_WHY_LENGTH]
        elif said and said not in [words.text for words in recent]:
            self._words.append(_Words(now, text.id, said))
            if late and len(late.words) < MAX_WORDS:
                late.words.append(self._words[-1])
        if late:
            self.refused[late.command.name] = late.why

    def repeat(self, now: float) -> None:
        """Send what is next, or not answered; give up what was not answered in time."""
        for first, pending in list(self._pending.items()):
            if pending.progress_since is not None:
                if now - pending.progress_since > MAX_PROGRESS_TIME:
                    self._refuse(first, f'still in progress after {MAX_PROGRESS_TIME:.0f} s', now)
            elif now - pending.sent_at < ACK_TIMEOUT:
                continue
            elif pending.transmissions < MAX_TRANSMISSIONS:
                self._transmit(pending.commands[0], pending.transmissions)
                self._pending[first] = replace(
                    pending, sent_at=now, transmissions=pending.transmissions + 1
                )
            else:
                self._refuse(first, 'no answer', now)

    def _refuse(self, first: int, result: str, now: float, *, explained: bool = False) -> None:
        command = self._pending.pop(first).commands[0]
        why = result
        if explained and command.number != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._refusal = _Refusal(now, command, result, self._recent(now))
            why = self._refusal.why
        self.refused[command.name] = why
        self._answers.append(Answer(command, False, why))

    def _recent(self, now: float) -> list[_Words]:
        return [words for words in self._words if now - words.time <= WORDS_TIME]

    def _explains_late(self, now: float) -> bool:
        """Whether a text may still explain the last refusal."""
        last = self._refusal
        return bool(last and now - last.time <= WORDS_TIME and last.command.name in self.refused)
