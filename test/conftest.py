"""What all tests share: beside this file lie `strategies` (missions) and `brute_force`.

Pytest puts the folder of a conftest on the path, so that every test can import both.
"""

from hypothesis import settings

# How long an example takes is up to the machine, and what else it does.
settings.register_profile('any machine', deadline=None)
settings.load_profile('any machine')
