"""Experiments: many independent lanes of a task, on all cores or over a Dask cluster.

`plan` says what is run, `work_unit` is the piece of it that a worker does, `workers` who does it,
`store` keeps what was done on disk, and `run` brings it to its end: interrupted at any moment, it
goes on from there. What comes of it are `Curves`.
"""

from hebbviz.sims.experiments.plan import Curves, Plan, figures_of, options_of
from hebbviz.sims.experiments.run import Done, Interrupted, finish, run, run_all
from hebbviz.sims.experiments.workers import LostWorkers, Workers, open_workers

__all__ = [
    "Curves",
    "Done",
    "Interrupted",
    "LostWorkers",
    "Plan",
    "Workers",
    "figures_of",
    "finish",
    "open_workers",
    "options_of",
    "run",
    "run_all",
]
