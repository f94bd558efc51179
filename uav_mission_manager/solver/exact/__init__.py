"""V* and Q on the mission's axes, in memory or out of core."""
