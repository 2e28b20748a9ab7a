"""The same network, task and rule in Brian2: sonar, 60-8-1, the paper's β and γ, 1 000 steps a
pattern, reward 1 where the output is right.

The fastest way found to say it in Brian2: three NeuronGroups and two Synapses, so that a step is
seven short loops: potentials summed over the synapses of each, hidden and output neurons, the
reward sent to the hidden ones, traces and weights of each. No spike is propagated, no monitor runs
while time is taken, and inputs are written where the pattern changes and at no other step. Every
synapse is updated at every step, as anyone would write it; hebbviz's closed form for held input is
its own.

    python tests/benchmarks/brian.py check DEVICE FOLDER    # cpp_standalone or runtime
    python tests/benchmarks/brian.py build FOLDER STEPS     # then FOLDER/main runs them
    python tests/benchmarks/brian.py time STEPS             # Cython runtime, ns a step

`check` gives Brian2 hebbviz's random numbers and compares every spike, and the weights at the end,
with the NumPy reference; the others draw with Brian2's own rand(). Each prints a line of JSON.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import brian2 as b2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import SPIKES, uniforms
from hebbviz.reference import Reference
from hebbviz.sims.worlds.sonar import ENERGIES, HOLD, PATTERNS, TRAINING, Sonar, load

Array = NDArray[np.float64]

HIDDEN = 8
INPUTS, NEURONS = ENERGIES, HIDDEN + 1
STEP = 1 * b2.ms
CHECKED = 2_500
"""Steps compared with the reference: two changes of the pattern are among them."""

NEURON = """
u : 1
before : 1
v : 1
surprise : 1
reward : 1
"""
RESPOND = """
before = u
p = 1 / (1 + exp(-v))
fired = int({draw} < p)
surprise = fired - p
u = 2 * fired - 1
"""
JUDGE = "\nreward = int(u == label(t))"
SYNAPSE = "w : 1\nz : 1\nv_post = w * u_pre : 1 (summed)"
LEARN = """
z = beta * z + surprise_post * before_pre
w += gamma * reward_post * z
"""


class Brian:
    """The network in Brian2, to start as lane 0 of seed 0 does in hebbviz.

    `draws` (steps, neurons) are the random numbers; without them Brian2 draws its own. As in
    `limit.py` every epoch has the order of the first.
    """

    def __init__(self, steps: int, draws: Array | None = None) -> None:
        learner = Learner(Sonar("paper"), seed=0)
        shown = load()[np.resize(first_epoch(learner), steps // HOLD + 1)]
        self.names: dict[str, Any] = {
            "beta": learner.beta, "gamma": learner.gamma,
            "pattern": b2.TimedArray(shown[:, :ENERGIES].copy(), dt=HOLD * STEP),
            "label": b2.TimedArray(shown[:, ENERGIES].copy(), dt=HOLD * STEP),
        }  # fmt: skip
        hidden_draw = output_draw = "rand()"
        if draws is not None:
            self.names["draws"] = b2.TimedArray(draws, dt=STEP)
            hidden_draw, output_draw = "draws(t, i)", f"draws(t, {HIDDEN})"
        b2.defaultclock.dt = STEP
        inputs = b2.NeuronGroup(INPUTS, "u : 1\nbefore : 1")
        hidden = b2.NeuronGroup(HIDDEN, NEURON + "right : 1 (linked)")
        output = b2.NeuronGroup(1, NEURON)
        hidden.right = b2.linked_var(output, "reward")
        hidden.u = output.u = -1.0
        inputs.run_regularly("u = pattern(t, i)\nbefore = u", dt=HOLD * STEP, when="start")
        hidden.run_regularly(RESPOND.format(draw=hidden_draw), when="thresholds")
        output.run_regularly(RESPOND.format(draw=output_draw) + JUDGE, when="thresholds")
        hidden.run_regularly("reward = right", when="synapses")
        self.first = b2.Synapses(inputs, hidden, SYNAPSE)
        self.second = b2.Synapses(hidden, output, SYNAPSE)
        for synapses in (self.first, self.second):
            synapses.connect()
            synapses.run_regularly(LEARN, when="resets")
        w = learner.weights[:, 0]
        self.first.w = w[:-HIDDEN].reshape(HIDDEN, INPUTS).T.ravel()  # Brian2: by input, then post
        self.second.w = w[-HIDDEN:]
        self.neurons = hidden, output
        self.network = b2.Network(inputs, hidden, output, self.first, self.second)

    def run(self, steps: int) -> None:
        """Run `steps` steps, or write the program that does."""
        self.network.run(steps * STEP, namespace=self.names)

    @property
    def weights(self) -> Array:
        """w of every synapse, (synapses,), in hebbviz's order."""
        first = np.array(self.first.w).reshape(INPUTS, HIDDEN).T.ravel()
        return np.concatenate((first, np.array(self.second.w)))


def first_epoch(learner: Learner) -> NDArray[np.int64]:
    """The patterns of the training set, in the order in which a learner at its start sees them."""
    return learner.world[-PATTERNS:, 0][:TRAINING].astype(np.int64)


def reference_run(steps: int) -> tuple[Array, Array]:
    """The same by the NumPy reference: activities (neurons, steps), and weights at the end."""
    learner = Learner(Sonar("paper"), seed=0)
    w = learner.weights[:, 0]
    network = Reference(
        learner.topology, [w[:-HIDDEN].reshape(HIDDEN, INPUTS), w[-HIDDEN:].reshape(1, HIDDEN)],
        beta=learner.beta, gamma=learner.gamma, seed=0,
    )  # fmt: skip
    order = first_epoch(learner)
    activities = np.empty((NEURONS, steps))
    for step in range(steps):
        pattern = load()[order[step // HOLD]]
        network.observe(pattern[:ENERGIES])
        answer = network.respond()
        network.reinforce(float(answer[0] == pattern[ENERGIES]))
        activities[:, step] = 2.0 * network.fired - 1.0
    return activities, np.concatenate([w.ravel() for w in network.weights])


def check(device: str, folder: str) -> dict[str, Any]:
    """How a short run with the same random numbers departs from the reference."""
    if device == "cpp_standalone":
        b2.set_device(device, directory=folder)
    draws = np.stack([uniforms(NEURONS, seed=0, purpose=SPIKES, step=t) for t in range(CHECKED)])
    brian = Brian(CHECKED, draws)
    monitors = [b2.StateMonitor(group, "u", record=True, when="end") for group in brian.neurons]
    brian.network.add(*monitors)
    brian.run(CHECKED)
    seen = np.concatenate([np.array(monitor.u) for monitor in monitors])
    activities, weights = reference_run(CHECKED)
    return {
        "steps": CHECKED,
        "spikes": int((activities > 0.0).sum()),
        "spikes_that_differ": int((seen != activities).sum()),
        "largest_difference_of_a_weight": float(np.abs(brian.weights - weights).max()),
    }


def build(folder: str, steps: str) -> dict[str, Any]:
    """Write and compile the C++ program of a run with Brian2's own random numbers."""
    b2.set_device("cpp_standalone", build_on_run=False)
    Brian(int(steps)).run(int(steps))
    b2.device.build(directory=folder, run=False)
    return {"built": folder}


def cython_time(steps: str) -> dict[str, Any]:
    """Time of a step in the Cython runtime, in ns; what each call of run() costs is taken away."""
    b2.prefs.codegen.target = "cython"
    n = int(steps)
    brian = Brian(4 * n)
    brian.run(1)  # compiles
    times = []
    for length in (n, 2 * n):
        began = time.perf_counter()
        brian.run(length)
        times.append(time.perf_counter() - began)
    return {"ns_per_step": 1e9 * (times[1] - times[0]) / n}


if __name__ == "__main__":
    done = {"check": check, "build": build, "time": cython_time}[sys.argv[1]](*sys.argv[2:])
    sys.stdout.write(f"{json.dumps(done)}\n")
