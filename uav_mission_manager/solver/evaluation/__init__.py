"""What a policy costs: exactly, or by simulation."""
