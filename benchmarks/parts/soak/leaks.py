"""Whether anything grows that should not: Python objects, the process, journals."""

from __future__ import annotations

import gc
import os
from dataclasses import dataclass
from pathlib import Path

from parts.soak.whereabouts import Violated

SAMPLE_PERIOD = 3600.0
"""Simulated time [s] between two looks: a choice. The first is the measure for all others."""

MAX_OBJECTS_GROWTH = 0.1
"""Share by which the number of objects may grow after an hour: a choice. Two policies remember a
thousand decisions each, some 6 %; what is left is a tenth of an object for each command."""

MAX_PROCESS_GROWTH = 16 << 20
"""Bytes by which the process may be larger after hours than after one: a choice, above what its
allocator keeps at hand, and well below a byte a step and hour."""

MAX_JOURNAL = 128 << 10
"""Bytes of a journal, at most: twice what it is cut at, as that is done in a thread."""


@dataclass(frozen=True)
class Sample:
    """How much there is: objects, bytes of the process, bytes of the largest journal."""

    time: float
    objects: int
    process: int
    journal: int


class Leaks:
    """Takes a sample every hour, and compares it with the first.

    Parameters
    ----------
    folder : Path
        Where the journals are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.samples: list[Sample] = []
        self._due = SAMPLE_PERIOD

    def look(self, now: float) -> bool:
        """Return whether it was time to; raise `Violated` if anything has grown."""
        if now < self._due:
            return False
        self._due += SAMPLE_PERIOD
        gc.collect()
        journals = [file.stat().st_size for file in self._folder.iterdir()]
        sample = Sample(now, len(gc.get_objects()), _resident(), max(journals, default=0))
        self.samples.append(sample)
        first = self.samples[0]
        growths = (
            ('objects', sample.objects, first.objects * (1.0 + MAX_OBJECTS_GROWTH)),
            ('bytes of the process', sample.process, first.process + MAX_PROCESS_GROWTH),
            ('bytes of a journal', sample.journal, MAX_JOURNAL),
        )
        for what, found, limit in growths:
            if found > limit:
                raise Violated(f'no leak: {found:,} {what}, more than {limit:,.0f}')
        return True


def _resident() -> int:
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE')
