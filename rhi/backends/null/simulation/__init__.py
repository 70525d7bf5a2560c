"""A GPU on a simulated clock: the cost of commands, when they finish, and which accesses conflict."""
