"""Polynomials of measurements, against NumPy's own and a fit without each; files and mistakes."""

from __future__ import annotations

import math
import re
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import scipy
import yaml

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.cli.fault_calibrate import main
from uav_mission_manager.learning.calibration import Measurement, fit_polynomial
from uav_mission_manager.learning.measurements import read_measurements
from uav_mission_manager.mdp.strict_yaml import read_yaml

ROOT = Path(__file__).parents[2]
EXAMPLE, CASE_STUDY = ROOT / 'config' / 'effectiveness.csv', ROOT / 'config' / 'case_study.yaml'
HEAD = 'part,effectiveness,quantity,value\n'


def measured(values: dict[float, list[float]]) -> list[Measurement]:
    return [
        Measurement('actuator', at, 'completion', value)
        for at, several in values.items()
        for value in several
    ]


LEVELS = {100.0: [1.0, 0.97], 80.0: [0.9, 0.93], 60.0: [0.75, 0.72, 0.74], 40.0: [0.5, 0.55]}


def polyfit(rows: list[Measurement], degree: int) -> np.ndarray:
    return np.polyfit([m.effectiveness / 100 for m in rows], [m.value for m in rows], degree)


@pytest.mark.parametrize('degree', [0, 1, 2, 3])
def test_a_fit_and_its_errors_are_those_of_least_squares(degree):
    rows = measured(LEVELS)
    fit = fit_polynomial(rows, degree)
    at, values = (np.array(x) for x in zip(*((m.effectiveness / 100, m.value) for m in rows)))
    expected, covariance = np.polyfit(at, values, degree, cov=True)
    assert fit.coefficients[::-1] == pytest.approx(expected)
    free = len(rows) - degree - 1
    residuals = values - np.polyval(expected, at)
    assert fit.residual == pytest.approx(math.sqrt((residuals**2).sum() / free))
    left_out = [
        m.value - np.polyval(polyfit(rows[:n] + rows[n + 1 :], degree), m.effectiveness / 100)
        for n, m in enumerate(rows)
    ]
    assert fit.leave_one_out == pytest.approx(math.sqrt(np.mean(np.square(left_out))))
    powers = 0.5 ** np.arange(degree, -1, -1)
    reach = scipy.stats.t.ppf(0.95, free) * math.sqrt(powers @ covariance @ powers)
    value, low, high = fit(50.0)
    assert (value - low, high - value) == pytest.approx((reach, reach))


def test_without_repetition_no_error_is_told():
    fit = fit_polynomial(measured({80.0: [0.9], 60.0: [0.7], 40.0: [0.4]}), 2)
    assert math.isnan(fit.residual)
    assert math.isnan(fit.leave_one_out)
    assert math.isnan(fit(60.0).low)
    assert fit(60.0).value == pytest.approx(0.7)
    assert fit.extrapolates(100.0)
    assert not fit.extrapolates(40.0)


def test_from_measurements_to_a_policy(tmp_path, capsys):
    out, plot = tmp_path / 'new.yaml', tmp_path / 'fits.png'
    command = [str(EXAMPLE), '--mission', str(CASE_STUDY), '--out', str(out), '--plot', str(plot)]
    assert main(command) == 0
    rows = read_measurements(EXAMPLE)

    def fitted(part: str, quantity: str, at: float) -> float:
        return np.polyval(polyfit([m for m in rows if (m[0], m[2]) == (part, quantity)], 2), at)

    new = load_mission(out)
    parts = 'sensor', 'actuator', 'camera'
    whole = np.mean([fitted(part, 'completion', 1.0) for part in parts])
    one = [fitted(part, 'completion', 0.4) for part in parts]
    cost = [fitted(part, 'cost', 0.4) for part in parts]
    for f in range(8):
        failed = [bit for bit in range(3) if f >> bit & 1]
        expected = whole * math.prod(one[bit] / whole for bit in failed)
        assert new.faults.completion[f] == pytest.approx(expected, rel=1e-5)
        assert new.faults.cost[f] == pytest.approx(sum(cost[bit] for bit in failed), rel=1e-5)
    rate = fitted('actuator', 'failures_per_hour', 1.0)
    assert new.faults.rate.actuator == pytest.approx(1 - math.exp(-rate * 10 / 3600), rel=1e-5)
    assert new.faults.rate.sensor == load_mission(CASE_STUDY).faults.rate.sensor
    comment = f'; from effectiveness.csv, {date.today().isoformat()}, degree 2'
    assert out.read_text().count(comment) == 8 + 1 + 7
    assert 'residual' in capsys.readouterr().out
    assert plot.read_bytes().startswith(b'\x89PNG')
    assert build_policy(new, 'exact', 1e-3).act([[1, 1, 1, 1, 2, 0, 0, 0, 0, 0, 0]]) == [2]


def written(tmp_path, lines: str) -> str:
    path = tmp_path / 'bench.csv'
    path.write_text(HEAD + lines)
    return str(path)


def test_what_a_mission_cannot_have_is_clipped_and_said(tmp_path, capsys):
    lines = ''.join(
        f'actuator,{at},{quantity},{value}\n'
        for quantity, values in (
            ('completion', (0.9, 0.5, 0.1)),  # A line: 1.3 at 100 %, -0.3 at 20 %.
            ('failures_per_hour', (1.0, 3.0, 5.0)),  # -1 at 100 %.
            ('cost', (6.0, 3.0, 0.0)),  # Less than nothing at 20 %.
        )
        for at, value in zip((80, 60, 40), values)
    )
    out = tmp_path / 'new.yaml'
    options = ['--mission', str(CASE_STUDY), '--out', str(out), '--degree', '1']
    assert main([written(tmp_path, lines), *options, '--failed-at', '20']) == 0
    told = capsys.readouterr().out
    new = load_mission(out)
    assert new.faults.completion[:4] == (1.0, 0.8, 0.0, 0.0)
    assert (new.faults.rate.actuator, new.faults.cost[2]) == (0.0, 0.0)
    for field, limit in (('completion[0]', '1'), ('completion[2]', '0'), ('rate.actuator', '0')):
        line = next(line for line in told.splitlines() if f'faults.{field}:' in line)
        assert f'brought to {limit}' in line
        assert 'beyond what was measured' in line
    assert 'brought to' in out.read_text()


def test_numbers_come_in_the_units_of_the_file(tmp_path):
    data = read_yaml(CASE_STUDY.read_text())
    faults = data['faults']
    del faults['rate'], faults['completion']
    faults |= {'mtbf': dict.fromkeys(('sensor', 'actuator', 'camera'), 50.0)}
    faults |= {'done_in': [10.0, 20.0, 30.0, 40.0, *['never'] * 4]}
    (tmp_path / 'mission.yaml').write_text(yaml.safe_dump(data))
    lines = [f'actuator,{at},completion,{value}' for at, value in ((100, 0.8), (40, 0.4))]
    lines += [f'actuator,{at},failures_per_hour,{value}' for at, value in ((100, 0.02), (40, 0.1))]
    options = ['--mission', str(tmp_path / 'mission.yaml'), '--out', str(tmp_path / 'new.yaml')]
    assert main([written(tmp_path, '\n'.join(lines)), *options, '--degree', '1']) == 0
    new = read_yaml((tmp_path / 'new.yaml').read_text())['faults']
    assert new['mtbf'] == {'sensor': 50.0, 'actuator': 50.0, 'camera': 50.0}
    # A failed sensor stays at the file's half of what there is without a fault.
    assert new['done_in'] == [12.5, 20.0, 25.0, 50.0, 'never', 'never', 'never', 'never']


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('part,efectiveness,quantity,value\n', "line 1: column 'efectiveness' is unknown; the "
         'nearest is effectiveness'),
        ('part,quantity,value\n', 'line 1: column effectiveness is missing'),
        (f'{HEAD.strip()},part\n', 'line 1: column part is there twice'),
        (f'{HEAD}\n# a comment\nmotor,80,cost,1\n', "line 4: part: 'motor' is none of sensor,"),
        (f'{HEAD}sensor,80,costs,1\n', "line 2: quantity: 'costs' is none of completion,"),
        (f'{HEAD}sensor,180,cost,1\n', r'line 2: effectiveness: 180.0 is outside 0..100'),
        (f'{HEAD}sensor,80,completion,1.5\n', r'line 2: value: 1.5 is outside 0..1'),
        (f'{HEAD}sensor,80,cost,-1\n', 'line 2: value: -1.0 is negative'),
        (f'{HEAD}sensor,80,cost,nan\n', 'line 2: value: nan is not finite'),
        (f'{HEAD}sensor,80,cost,much\n', "line 2: value: 'much' is not a number"),
        (f'{HEAD}sensor,80,cost\n', 'line 2: 3 values, not 4'),
        (f'{HEAD}sensor,"80,cost,1\n', 'no CSV: '),
        (HEAD, 'no measurements in it'),
        ('', 'no measurements in it'),
        (f'{HEAD}sensor,80,cost,1\nsensor,60,cost,2\n', 'sensor: cost: 2 levels of effectiveness '
         'carry no polynomial of degree 2'),
    ],
)  # fmt: skip
def test_a_mistake_is_named_by_line_column_and_value(text, problem, tmp_path):
    path = tmp_path / 'bench.csv'
    path.write_text(text)
    out = tmp_path / 'new.yaml'
    with pytest.raises(SystemExit) as end:
        main([str(path), '--mission', str(CASE_STUDY), '--out', str(out)])
    assert re.search(f'bench.csv: {re.escape(problem)}', str(end.value.code))
    assert not out.exists()


@pytest.mark.parametrize(
    ('options', 'problem'),
    [
        (['--out', 'new.yaml'], '--out: needs --mission'),
        (['--mission', str(CASE_STUDY), '--out', 'no/new.yaml'], 'there is no folder no'),
        (['--plot', 'fits.txt'], '--plot: fits.txt ends in none of'),
        (['--degree', '-1'], "'-1' is no whole number from 0 to 9"),
        (['--failed-at', '101'], "'101' is not a number from 0 to 100"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, problem, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main([str(EXAMPLE), *options])
    assert problem in f'{end.value.code}{capsys.readouterr().err}'
    assert list(tmp_path.iterdir()) == []
