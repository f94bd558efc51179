"""Lower bounds on V* by shared cost."""
