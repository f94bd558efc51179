"""Where the package's data files are."""

from __future__ import annotations

from pathlib import Path


def share_directory() -> Path:
    """Return the folder that holds `config`, `policies` and `launch`.

    That is the source tree when running from it, else `share/uav_mission_manager` in the
    prefix this package is installed in, be it by pip, colcon or apt.

    Raises
    ------
    FileNotFoundError
        The package was installed without its data files.
    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent, *(p / 'share' / package.name for p in package.parents)]
    for candidate in candidates:
        if (candidate / 'package.xml').is_file():
            return candidate
    raise FileNotFoundError(f'{package} has neither package.xml beside it nor a share folder')
