"""The notebooks of the documentation run, cell by cell, in a plain interpreter."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / 'docs' / 'notebooks').glob('*.ipynb'))


def code_cells(path):
    """The code cells, which hold no command of Jupyter's own."""
    cells = json.loads(path.read_text(encoding='utf-8'))['cells']
    return [cell for cell in cells if cell['cell_type'] == 'code']


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs(path):
    code = '\n'.join(''.join(cell['source']) for cell in code_cells(path))
    environment = os.environ | {'MPLBACKEND': 'agg', 'PYTHONPATH': str(ROOT)}
    done = subprocess.run(
        [sys.executable, '-W', 'error', '-c', code],
        cwd=path.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_kept_without_results(path):
    assert {(cell['execution_count'], len(cell['outputs'])) for cell in code_cells(path)} == {
        (None, 0)
    }
    assert path.stat().st_size < 20_000
