"""What compiled sweeps gain: a sweep by numba's kernels and by elementwise steps."""

from __future__ import annotations

import os
import tempfile
import time
from typing import Any

import numpy as np

from parts.machine import best
from parts.missions import case_study, with_battery
from uav_mission_manager.mdp import Mission
from uav_mission_manager.solver.exact import AxisModel, Sweeper, sweep
from uav_mission_manager.solver.submdp import whole_mission
from uav_mission_manager.solver.threads import processors


def compiled(k: int, battery: bool, dtype: str) -> dict[str, Any]:
    """Seconds of a sweep in both ways, and of compiling, and whether the bits agree."""
    with tempfile.TemporaryDirectory() as nothing_kept:
        os.environ['NUMBA_CACHE_DIR'] = nothing_kept
        return _compiled(case_study(k), battery, dtype)


def _compiled(mission: Mission, battery: bool, dtype: str) -> dict[str, Any]:
    model = AxisModel(whole_mission(with_battery(mission) if battery else mission), dtype)
    sweepers = []
    for least in (0, model.sub.entries + 1):
        sweep.MIN_COMPILED_ENTRIES = least
        sweepers.append(Sweeper(model, model.zero(), processors()))
    fast, slow = sweepers
    if fast.compiled is None:
        raise SystemExit('numba is missing')
    start = time.perf_counter()
    changes = fast.backup()
    first = time.perf_counter() - start
    same = changes == slow.backup() and np.array_equal(fast.values, slow.values)
    seconds = best(fast.backup, 3)
    return {
        'compiling': first - seconds,
        'compiled': seconds,
        'ours': best(slow.backup, 3),
        'same bits': bool(same),
    }
