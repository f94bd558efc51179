"""What all tests share: beside this file lie `strategies` (missions) and `brute_force`.

Pytest puts the folder of a conftest on the path, so that every test can import both.
"""

import signal
from importlib.util import find_spec

from hypothesis import settings

# How long an example takes is up to the machine, and what else it does.
settings.register_profile('any machine', deadline=None)
settings.load_profile('any machine')

# Of what was started in the background a shell ignores Ctrl-C, and so would all that tests start.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, signal.SIG_DFL)

# Of the extra `record`, which `make` installs, and no package of ROS's brings.
WITH_BAGS = [
    'unit/test_recording.py',
    'unit/test_cli_replay.py',
    'integration/test_mission_record.py',
]
collect_ignore = [] if find_spec('rosbags') else WITH_BAGS
