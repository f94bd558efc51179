"""Algorithm 2: priorities, meta-policies, assignment, fleet."""
