"""Lines of a log, however fast they come."""

from __future__ import annotations

from uav_mission_manager.nodes.log_limit import BURST, LINE_PERIOD, LogLimit


class Lines:
    def __init__(self) -> None:
        self.now = 5.0
        self.limit = LogLimit(lambda: self.now)

    def flood(self, kind: str, seconds: float) -> list[str]:
        """Lines that pass, at 1 kHz."""
        passed = []
        for number in range(round(1000 * seconds)):
            self.now += 0.001
            passed.append(self.limit.passed(kind, f'line {number}'))
        return list(filter(None, passed))


def test_what_comes_slowly_passes_as_it_is():
    lines = Lines()
    for _ in range(10 * BURST):
        lines.now += LINE_PERIOD
        assert lines.limit.passed('phase', 'take-off') == 'take-off'


def test_a_flood_is_a_burst_and_then_a_line_now_and_then_with_a_count():
    lines = Lines()
    passed = lines.flood('autopilot', 60.0)
    assert BURST + 60.0 / LINE_PERIOD - 2 <= len(passed) <= BURST + 60.0 / LINE_PERIOD + 1
    assert passed[0] == 'line 0'
    assert passed[-1].endswith(f'({round(1000 * LINE_PERIOD) - 1:,} lines before it left out)')


def test_one_kind_does_not_silence_another():
    lines = Lines()
    lines.flood('autopilot', 10.0)
    assert lines.limit.passed('phase', 'landing') == 'landing'
