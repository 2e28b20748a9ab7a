"""Runs of a checkout, from Python, of which `digests.py` takes digests."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from digest_files import arrays_of, command, files_of, stable
from digest_source import (
    Parts,
    block_of,
    change,
    find,
    first,
    fork_of,
    frame_of,
    in_lanes,
    keyframes_of,
    learner_of,
    load,
    recorder_of,
    reset,
    rows_of,
    run_of,
    save,
    state_of,
    task_of,
)


def told(learner: Any, steps: int = 800) -> Parts:
    """A learner through all that can be done to it."""
    task, steps_again = learner.task, steps // 4
    learner.probe([0, learner.topology.synapses - 1])
    learner.skip(steps)
    parts: Parts = {"start": frame_of(learner)}
    parts["closely"] = block_of(learner.advance(steps // 2, closely=True))
    learner.set_beta(0.7)
    learner.set_gamma(3.0 * learner.gamma)
    learner.give_reward(1.5)
    parts["changed"] = block_of(learner.advance(steps // 4))
    learner.freeze(True)
    learner.skip(steps // 8)
    learner.freeze(False)
    learner.set_fall(1000.0)
    for control in task.controls:
        learner.press(control.name)
        learner.advance(3)
    learner.look_at(learner.lanes - 1)
    learner.skip(steps // 4)
    learner.advance(7)
    parts["frame"] = frame_of(learner)
    parts["state"] = state_of(learner)
    moment = learner.keyframe()
    parts["on"] = block_of(learner.advance(steps_again))
    learner.restore(moment)
    parts["on again"] = block_of(learner.advance(steps_again))
    parts["seen"] = [np.array(task.read(learner.world.T)), *task.poses(learner.world.T)]
    parts["end"] = state_of(learner)
    return parts


def plain(task: str, preset: str | None = None, *, steps: int = 800, **options: Any) -> Parts:
    return told(learner_of(task_of(task, preset), seed=7, **options), steps)


def compiled_twin(preset: str, **options: Any) -> Parts:
    """The pendulum as figures and sweeps step it."""
    return told(learner_of(in_lanes(task_of("pendulum", preset)), seed=7, **options))


def topology(kind: str, **options: Any) -> Parts:
    """Networks that no preset has, with eight inputs and two outputs, as the pendulum has them."""
    group, projection, whole = find("Group"), find("Projection"), find("Topology")
    networks = {
        "recurrent": (
            (group("in", 8, is_input=True), group("a", 5), group("out", 2)),
            ("in-a", "a-a", "a-out", "out-a", "in-out"), (-1.0, 1.0),
        ),
        "binary": (
            (group("a", 3), group("in", 8, is_input=True), group("out", 2)),
            ("out-a", "in-out", "a-out", "in-a"), (0.0, 1.0),
        ),
        "two-inputs": (
            (group("x", 5, is_input=True), group("y", 3, is_input=True), group("out", 2)),
            ("x-out", "y-out", "out-out"), (-1.0, 1.0),
        ),
    }  # fmt: skip
    groups, ends, activity = networks[kind]
    made = whole(groups, tuple(projection(*e.split("-")) for e in ends), "out", activity)
    return told(learner_of(in_lanes(task_of("pendulum", "raw")), topology=made, **options))


def clamped(lanes: int, dtype: str) -> Parts:
    """A task in which some neurons are made to fire or to be silent, now and then."""
    base, given, output, preset = (find(n) for n in ("Task", "Input", "Output", "Preset"))

    def clamps(_: Any, state: Any) -> Any:
        forced = np.full(4, np.nan)
        if state[0] % 3 == 0:
            forced[:2] = 1.0, 0.0
        if state[0] % 5 == 0:
            forced[3] = 1.0
        return forced

    about = {
        "name": "clamped", "inputs": (given("a"), given("b")), "outputs": (output("c", "x", "y"),),
        "hidden": (3,), "presets": {"only": preset(0.8, 0.02, "not in the paper")},
        "restart": lambda _, draws: np.array([0.0, draws(1)[0]]),
        "transition": lambda _, state, action, draws: np.array(
            [state[0] + 1.0 + (action[0] > 0.0), draws(2)[1]]
        ),
        "observation": lambda _, state: np.array([state[0] % 2, state[1]]),
        "reward": lambda _, state: float(state[1] > 0.5),
        "ended": lambda _, state: bool(state[0] > 40),
        "clamps": clamps,
    }  # fmt: skip
    return told(learner_of(type("Clamped", (base,), about)(), lanes=lanes, dtype=dtype), 200)


def evaluation(task: str, lanes: int) -> Parts:
    """Of a frozen copy, and the task's own figures."""
    learner = learner_of(in_lanes(task_of(task)), lanes=lanes, seed=2)
    tallies = learner.skip_tallied(1000)
    results = learner.task.results(learner, tallies[0])
    scores = [learner.task.measure.figures(learner.task.score(t)) for t in tallies]
    return {"evaluate": learner.task.evaluate(learner), "results": results, "scores": scores}


# A run: its log, keyframes, undo, forks


def changed_run(task: str = "pendulum", lanes: int = 1, *, until: int = 900) -> Any:
    """A run with changes, keyframes and an undo in it."""
    return _driven(run_of(learner_of(task_of(task), seed=3, lanes=lanes), task), until)


def _driven(run: Any, until: int) -> Any:
    """Move a run on, a frame every 40 steps, a keyframe every 200."""
    changes = {
        300: change("SetBeta", 0.9), 410: change("GiveReward", 2.5), 411: change("Freeze", True),
        500: change("Freeze", False), 501: change("SetGamma", 3e-3), 620: change("SetFall", 1e4),
        640: change("SetRule", "baseline:time=50"),
    }  # fmt: skip
    while (step := run.learner.step) < until:
        if step in changes:
            run.change(changes[step])
        ahead = [*changes, 40 * (step // 40 + 1), until]
        run.advance(min(s for s in ahead if s > step) - step)
        if run.learner.step % 40 == 0:
            run.frame()
        if run.learner.step % 200 == 0:
            run.keep()
    return run


def run_parts(run: Any) -> Parts:
    edges = [(t.steps, t.reward, t.broadcast, t.ended) for t in _edges(run)]
    log = [(logged.step, str(logged.change)) for logged in run.log]
    return {"state": state_of(run.learner), "log": log, "edges": edges}


def _edges(run: Any) -> Any:
    """The totals at the edges of the learning curve's windows, of the watched lane."""
    lane = run.learner.watch
    return [t.lane(lane) if hasattr(t, "lane") else t for t in run.history.edges()]


def history(task: str, lanes: int) -> Parts:
    """Keyframes: any step is made again from the one before; then the run is taken over there."""
    run = changed_run(task, lanes)
    parts: Parts = {"whole": run_parts(run)}
    for step in (150, 333, 505, 899):
        replay = run.replay(keyframes_of(run).before(step))
        replay.go_to(step)
        parts[f"at {step}"] = state_of(replay.learner)
    replay = run.replay(keyframes_of(run).before(450))
    replay.go_to(450)
    run.take_over(replay)
    run.change(change("SetBeta", 0.5))
    run.advance(1)
    run.undo()
    run.advance(30)
    parts["taken over"] = run_parts(run)
    run.undo()
    run.undo()
    parts["undone"] = run_parts(run)
    reset(run, 11)
    run.advance(50)
    parts["reset"] = run_parts(run)
    return parts


def fork(kind: str, value: float | None, lanes: int) -> Parts:
    run = changed_run("prediction", lanes, until=600)
    other = fork_of(run, kind, value)
    for _ in range(5):
        run.advance(50)
        other.follow(run.learner.step)
    shared = change("Freeze", True)
    run.change(shared)
    other.change(shared)
    run.advance(20)
    other.follow(run.learner.step)
    return {"run": run_parts(run), "other": state_of(other.learner)}


def saved(task: str, dtype: str, rule: str | None, lanes: int) -> Parts:
    """A save and what goes on from it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.npz"
        learner = learner_of(task_of(task), dtype=dtype, rule=rule, lanes=lanes, first_lane=2)
        learner.skip(500)
        save(learner, path)
        again = load(path)
        parts = {"file": arrays_of(path), "loaded": state_of(again)}
    again.advance(200)
    return parts | {"on": state_of(again)}


def recorded(task: str, lanes: int) -> Parts:
    """A recording: its tables, what is exported, and any step made again."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = run_of(learner_of(task_of(task), seed=3, lanes=lanes), task)
        run.learner.look_at(lanes - 1)
        recorder = recorder_of(run, folder / "a.rrd")
        _driven(run, 900)
        recorder.close(run)
        tables = {n: {"step": s, **c} for n, s, c in rows_of(folder / "a.rrd")}
        command(folder, "export", "a.rrd", "--out", "timelines")
        command(folder, "export", "a.rrd", "--out", "steps", "--every-step", "250:700")
        said = command(folder, "inspect", "a.rrd", "--json")
        return {
            "tables": tables,
            "inspect": stable(json.loads(said)),
            "timelines": files_of(folder / "timelines"),
            "every step": files_of(folder / "steps"),
        }


# The theory


def theory() -> Parts:
    world, policy = find("three_state_chain")()
    theta = np.array([0.5, -0.3, 0.2, 0.7])
    gradients = [find("gpomdp")(world, policy, theta, beta=b, steps=200, runs=4, seed=1)
                 for b in (0.0, 0.8)]  # fmt: skip
    network, weights = find("small_example")()
    chains = {"three states": world.under(policy, theta), "network": network.at(weights),
              "lazy": world.lazy(0.5).under(policy, theta)}  # fmt: skip
    return {"gpomdp": gradients} | {name: _exact(chain) for name, chain in chains.items()}


def _exact(chain: Any) -> Parts:
    names = ("stationary", "average_reward", "gradient", "relaxation_time", "mixing_time")
    betas = (0.0, 0.5, 0.9, 0.999)
    return {
        **{name: first(chain, name) for name in names},
        "biased": [chain.biased_gradient(b) for b in betas],
        "noise": [chain.noise(b) for b in betas],
        "delays": chain.gradient_by_delay(5),
        "cosines": [chain.expected_cosine(b, steps=1e4) for b in betas],
        "best beta": chain.best_beta(steps=1e4),
    }


def truth(task: str) -> Parts:
    """The exact gradient that a task tells of its network."""
    made = task_of(task)
    learner = learner_of(made, seed=5, hidden=(2,))
    weights = learner.weights[:, 0]
    found = [first(made, "truth", "exact_gradient")(weights, learner.topology, b)
             for b in (0.0, 0.8)]  # fmt: skip
    names = ("gradient", "biased", "noise", "average_reward", "best_reward", "bias_angle")
    return {name: [first(f, name) for f in found] for name in names}


def reference(kind: str) -> Parts:
    """The readable text, stepped by itself."""
    hidden = {"none": (), "one": (4,), "two": (3, 2)}[kind]
    network = find("feedforward")(5, hidden, 2)
    rng = np.random.default_rng(4)
    weights = [rng.uniform(-1, 1, network.shape(p)) for p in network.projections]
    net = find("Reference")(network, weights, beta=0.9, gamma=0.02, seed=3, lane=2)
    fired = []
    for _ in range(200):
        net.observe(rng.uniform(-1, 1, 5))
        net.respond()
        net.reinforce(rng.normal())
        fired.append(net.fired.copy())
    return {"fired": np.array(fired), "weights": net.weights, "traces": net.traces}
