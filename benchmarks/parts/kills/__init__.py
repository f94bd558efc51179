"""The chain of processes, killed at random, a crew that uses it, and a watch from outside."""
