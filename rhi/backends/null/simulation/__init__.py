"""A GPU on a simulated clock: what commands cost, when they finish, and which accesses collide."""
