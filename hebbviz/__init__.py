"""Spiking neurons that learn by themselves: Bartlett and Baxter's rule, exact and compiled.

`topology` says who is connected to whom, `engine.kernel` is the paper's rule, `learner` closes the
loop with a `task`, `reference` is the paper's equations in plain NumPy, `learner.saves` saves and
loads.
"""

__version__ = "0.1.0"
