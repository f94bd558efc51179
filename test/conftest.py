"""What all tests share: beside this file lie `strategies` (missions) and `brute_force`.

Pytest puts the folder of a conftest on the path, so that every test can import both.
"""
