"""What the arguments of every command have in common: its version, and completion in a shell."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from argparse import ArgumentParser

from uav_mission_manager.paths import share_directory


def version() -> str:
    """Return the version of this package, which package.xml says."""
    return ElementTree.parse(share_directory() / 'package.xml').findtext('version', '')


def version_line() -> str:
    """Return what `--version` prints."""
    return f'uav_mission_manager {version()}'


def complete(parser: ArgumentParser) -> None:
    """Where a shell asks how the arguments could go on, answer and end; call before parsing."""
    if '_ARGCOMPLETE' in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
