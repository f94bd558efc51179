"""Algorithm 1: candidates, measures, plan, phi."""
