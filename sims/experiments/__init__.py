"""Experiments: many independent lanes of a task, on all cores or on a Dask cluster.

`plan` describes the runs, `work_unit` is one worker's part, `workers` provides threads, processes
or a cluster, `store` saves completed work on disk, and `run` completes a plan, also one that was
interrupted. The results are `Curves`.
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
