"""Missions as pictures: shapes in metres, and what all maps have in common."""
