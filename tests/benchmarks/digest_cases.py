"""The runs, files and figures of which `digests.py` takes digests, by name."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

from digest_files import figured, train_recorded, trained
from digest_runs import (
    clamped,
    compiled_twin,
    evaluation,
    fork,
    history,
    plain,
    recorded,
    reference,
    saved,
    theory,
    topology,
    truth,
)
from digest_source import Parts

TASKS = {
    "synapse": ("hand", "script"),
    "pendulum": ("baseline", "quick", "raw", "paper", "literal", "best"),
    "sonar": ("quick", "paper", "best"),
    "gradient": ("still", "learning"),
    "prediction": ("quick",),
    "filtering": ("quick",),
}
"""With their presets."""
RULES = {"paper": "paper", "baseline": "baseline:time=50", "yoked": "yoked"}
DTYPES = ("float64", "float32")
LANES = (1, 5, 64)


def cases() -> dict[str, Callable[[], Parts]]:
    """Every case, by its name."""
    found: dict[str, Callable[[], Parts]] = {}
    grid = list(itertools.product(DTYPES, LANES))
    for task, presets in TASKS.items():
        for preset, (dtype, lanes) in itertools.product(presets, grid):
            found[f"run/{task}/{preset}/{dtype}/{lanes}"] = partial(
                plain, task, preset, dtype=dtype, lanes=lanes, steps=400 if lanes > 5 else 1600
            )
        for (rule, spec), (dtype, lanes) in itertools.product(RULES.items(), grid):
            found[f"rule/{rule}/{task}/{dtype}/{max(2, lanes)}"] = partial(
                plain, task, rule=spec, dtype=dtype, lanes=max(2, lanes), steps=320
            )
        found[f"evaluate/{task}"] = partial(evaluation, task, 3)
    for dtype, lanes in grid:
        at = f"{dtype}/{lanes}"
        of = {"dtype": dtype, "lanes": lanes}
        found |= {f"twin/{p}/{at}": partial(compiled_twin, p, **of) for p in TASKS["pendulum"]}
        for kind in ("recurrent", "binary", "two-inputs"):
            found[f"topology/{kind}/{at}"] = partial(topology, kind, **of)
        for hidden in ((), (3, 2)):
            said = ",".join(map(str, hidden)) or "none"
            found[f"hidden/{said}/{at}"] = partial(plain, "prediction", hidden=hidden, **of)
        for switch in ("centred=no", "scaled=no", "constant=no"):
            found[f"switch/{switch}/{at}"] = partial(plain, "sonar", f"best:{switch}", **of)
        found[f"clamps/{at}"] = partial(clamped, lanes, dtype)
        found[f"fall/{at}"] = partial(plain, "gradient", fall=300.0, gamma=0.1, beta=0.5, **of)
        for rule in ("paper", "baseline:time=50"):
            found[f"save/{rule}/{at}"] = partial(saved, "pendulum", dtype, rule, lanes)
    for dtype in DTYPES:
        found[f"lanes/many/{dtype}"] = partial(
            plain, "sonar", "best", lanes=70, first_lane=9, dtype=dtype
        )
        found[f"unrolled/{dtype}"] = partial(
            plain, "gradient", "learning", lanes=64, dtype=dtype, written_out=True
        )
    return found | _files() | _theories()


def _files() -> dict[str, Callable[[], Parts]]:
    """Of runs that are kept, and of the command line."""
    found: dict[str, Callable[[], Parts]] = {}
    for task, lanes in (("pendulum", 1), ("sonar", 1), ("synapse", 1), ("prediction", 3)):
        found[f"keyframes/{task}/{lanes}"] = partial(history, task, lanes)
        found[f"record/{task}/{lanes}"] = partial(recorded, task, lanes)
    kinds = (("another β", 0.4), ("another γ", 0.1), ("β = 0", None), ("no reward", None),
             ("reward of another run", None))  # fmt: skip
    for (kind, value), lanes in itertools.product(kinds, (1, 3)):
        found[f"fork/{kind.replace(' ', '-')}/{lanes}"] = partial(fork, kind, value, lanes)
    for task in TASKS:
        found[f"train/{task}"] = partial(trained, "--task", task, "--seed", "4")
    found["train/yoked"] = partial(trained, "--task", "gradient", "--rule", "yoked")
    found["train/hidden"] = partial(
        trained, "--task", "sonar", "--preset", "best:scaled=no", "--hidden", "5,3"
    )
    for task in ("pendulum", "filtering"):
        found[f"train-record/{task}"] = partial(train_recorded, "--task", task)
    short = ("--task", "prediction", "--steps", "5000", "--lanes", "4", "--seed", "3")
    figures = {
        **{name: (name, "--quick") for name in ("synapse", "gradient", "sonar", "pendulum")},
        "sonar-best": ("sonar", "--preset", "best", "--epochs", "2", "--lanes", "4"),
        "learning": ("learning", *short),
        "learning-yoked": ("learning", *short, "--rule", "yoked", "--beta", "0.5"),
        "learning-pendulum": ("learning", "--task", "pendulum", "--steps", "5000", "--lanes", "3"),
    }
    for name, words in figures.items():
        found[f"figure/{name}"] = partial(figured, "figure", *words)
    for task in ("gradient", "pendulum", "sonar"):
        found[f"sweep/{task}"] = partial(
            figured, "sweep", "--task", task, "--beta", "0.5,0.9", "--gamma", "1e-3:1e-1:2",
            "--lanes", "3", "--steps", "5000",
        )  # fmt: skip
    return found


def _theories() -> dict[str, Callable[[], Parts]]:
    return {
        "theory/chains": theory,
        **{f"theory/{t}": partial(truth, t) for t in ("gradient", "prediction")},
        **{f"reference/{k}": partial(reference, k) for k in ("none", "one", "two")},
    }
