"""What `mission_check` finds out about a mission, and how it shows it."""
