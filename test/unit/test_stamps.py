"""Whether a message is believed, by its own stamp."""

from __future__ import annotations

import math

import pytest

from uav_mission_manager.onboard import InputError
from uav_mission_manager.onboard.stamps import stamp_age

CLOCK, TIMEOUT = 1_700_000_000.0, 3.0


@pytest.mark.parametrize(
    ('stamp', 'age'),
    [(None, 0.0), (0.0, 0.0), (CLOCK, 0.0), (CLOCK - 3.0, 3.0), (CLOCK + 3.0, 0.0)],
)
def test_a_message_of_now_has_an_age_and_one_without_stamp_none(stamp, age):
    assert stamp_age('odom', stamp, CLOCK, TIMEOUT) == age


@pytest.mark.parametrize(
    ('stamp', 'words'),
    [
        (CLOCK - 3600.0, 'odom: stamped 3600.0 s ago, more than 3.0 s'),
        (CLOCK + 60.0, 'odom: stamped 60.0 s ahead of the clock here'),
        (math.nan, 'odom: stamped nan s ahead'),
        (1.0, 'odom: stamped 1699999999.0 s ago'),
    ],
)
def test_a_clock_ahead_is_as_suspect_as_one_behind(stamp, words):
    with pytest.raises(InputError) as error:
        stamp_age('odom', stamp, CLOCK, TIMEOUT)
    assert str(error.value).startswith(words)
