"""A network, a task and a rule in closed loop, its frames and its saves."""
