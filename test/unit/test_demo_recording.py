"""Where the demo records its flights."""

from __future__ import annotations

from pathlib import Path

import pytest

from uav_mission_manager.cli.demo import runner
from uav_mission_manager.cli.recording_options import place_of_bags
from uav_mission_manager.onboard import recording

LOGS = Path('/logs')


def place(*arguments: str) -> Path | None:
    return place_of_bags(runner._parser().parse_args(arguments), LOGS / 'bags')


def test_it_records_by_default_where_it_is_told_or_not_at_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recording, 'find_spec', lambda name: name)
    assert place() == LOGS / 'bags'
    assert place('--record', '/there') == Path('/there')
    assert place('--no-record') is None


def test_both_at_once_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        place('--record', '/there', '--no-record')
    assert end.value.code == 2
    assert 'not allowed with argument' in capsys.readouterr().err


def test_without_the_library_it_flies_all_the_same_unless_told_to_record(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(recording, 'find_spec', lambda name: None)
    assert place() is None
    assert capsys.readouterr().out == 'not recorded: needs rosbags: pip install rosbags\n'
    with pytest.raises(ValueError, match=r'^--record: needs rosbags'):
        place('--record', '/there')
    assert place('--no-record') is None
    assert capsys.readouterr().out == ''
