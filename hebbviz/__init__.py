"""Spiking neurons that learn by themselves: Bartlett and Baxter's rule, exact and compiled.

`topology` says who is connected to whom, `rule` is the paper's rule, `learner` closes the loop
with a `task`, `reference` is the paper's equations in plain NumPy, `files` saves and loads.
"""

__version__ = "0.1.0"
