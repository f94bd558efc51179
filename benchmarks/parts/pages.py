"""The benchmarks' pages: where they are written, who wrote them, and what has changed in them.

Pages go to build/bench/, beside those of docs/, which stay as they are; with `--update` they
replace these. Either way the differences are printed.
"""

from __future__ import annotations

import argparse
import difflib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from parts.machine import machine

ROOT = Path(__file__).resolve().parents[2]
DOCS, BESIDE = ROOT / 'docs', ROOT / 'build' / 'bench'
UPDATE = '--update'


def parser(description: str) -> argparse.ArgumentParser:
    """Return a parser of what all benchmarks understand."""
    found = argparse.ArgumentParser(description=description)
    found.add_argument(UPDATE, action='store_true', help='write into docs/, not build/bench/')
    return found


def folder(options: argparse.Namespace) -> Path:
    """Where pages and pictures go."""
    chosen = DOCS if options.update else BESIDE
    chosen.mkdir(parents=True, exist_ok=True)
    return chosen


def publish(file: Path, title: str, sections: Sequence[str]) -> None:
    """Write a page and print how it differs from the one of that name in docs/."""
    text = '\n\n'.join([f'# {title}', written_by(), *sections]) + '\n'
    known = DOCS / file.name
    before = known.read_text(encoding='utf-8') if known.exists() else ''
    file.write_text(text, encoding='utf-8')
    lines = before.splitlines(), text.splitlines()
    names = f'docs/{file.name} before', str(file.relative_to(ROOT))
    print(*difflib.unified_diff(*lines, *names, n=0, lineterm=''), sep='\n')
    print(f'wrote {names[1]}')


def written_by() -> str:
    """Say which command writes the page, and on which machine this one was made."""
    script = Path(sys.argv[0]).name
    arguments = shlex.join(argument for argument in sys.argv[1:] if argument != UPDATE)
    given = f" ARGS='{arguments}'" if arguments else ''
    return f'Written by `make bench SCRIPTS=benchmarks/{script}{given}` on\n{machine()}.'


def table(head: Sequence[Any], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table; all columns but the first are aligned to the right."""
    lines = [head, ['---'] + ['---:'] * (len(head) - 1), *rows]
    return '\n'.join(f'| {" | ".join(map(str, line))} |' for line in lines)
