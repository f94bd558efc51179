# PYTHON_ARGCOMPLETE_OK
"""`mission_new`: make a mission file from a plan, a KML or GeoJSON file, or from positions."""

from __future__ import annotations

from importlib.util import find_spec

from uav_mission_manager.cli.errors import one_line_errors
from uav_mission_manager.cli.mission_new.options import options_parser

NEEDED = ('shapely', 'defusedxml')
"""What the extra `plan` brings."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_new'):
        options = options_parser().parse_args(args)
        if missing := [name for name in NEEDED if find_spec(name) is None]:
            raise ValueError(f'needs {" and ".join(missing)}: pip install {" ".join(missing)}')
        from uav_mission_manager.cli.mission_new import making

        making.make(options)
        return 0
