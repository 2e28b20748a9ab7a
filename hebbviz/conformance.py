"""Checks that a task or a rule keeps its contract. In a test of your own task:

from hebbviz.conformance import check_task
from mine import MyTask

def test_my_task():
    check_task(MyTask)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import FIRST_EPISODE, NEXT_EPISODE, Draws
from hebbviz.rules.base import Rule, make_rule
from hebbviz.task.base import CompiledTask, Input, Output, Task
from hebbviz.task.presets import Preset
from hebbviz.task.scene import Pose

Array = NDArray[np.float64]
MakeTask = Callable[[], Task]

STEPS = 1200
"""Longer than a sonar pattern is shown, and than some twenty falls of the pendulum."""


def check_task(make_task: MakeTask) -> None:
    """Raise AssertionError unless the task keeps to the contract of `hebbviz.task.Task`."""
    for check in CHECKS:
        check(make_task)


class Walk:
    """A task under random actions: its states, and each transition's state, action and step."""

    def __init__(self, task: Task, *, steps: int = STEPS, seed: int = 7) -> None:
        coins = np.random.default_rng(seed)
        state = task.restart(Draws(seed, 0, 0, FIRST_EPISODE))
        self.seed, self.moves, self.ends = seed, [], []
        self.states = [state]
        for step in range(steps):
            action = coins.choice(task.activity, len(task.outputs))
            self.moves.append((state, action, step))
            state = task.transition(state.copy(), action.copy(), self.draws(step))
            self.states.append(state)
            self.ends.append(task.ended(state))
            if self.ends[-1]:
                state = task.restart(self.draws(step, NEXT_EPISODE))
                self.states.append(state)

    def draws(self, step: int, purpose: int | None = None) -> Draws:
        return Draws(self.seed, 0, step) if purpose is None else Draws(self.seed, 0, step, purpose)


def check_attributes(make_task: MakeTask) -> None:
    task = make_task()
    assert isinstance(task.name, str)
    assert task.name
    assert isinstance(task.summary, str)
    assert all(isinstance(i, Input) and i.name for i in task.inputs)
    assert task.outputs
    assert all(isinstance(o, Output) and o.name and o.fires and o.silent for o in task.outputs)
    for names in ([i.name for i in task.inputs], [o.name for o in task.outputs]):
        assert len(set(names)) == len(names), "names of inputs and of outputs must differ"
    assert task.dt is None or task.dt > 0
    assert task.weight_range >= 0
    assert task.measure.name
    assert task.measure.key.isidentifier()
    if isinstance(task, CompiledTask):
        assert type(task).clamps is Task.clamps, "a compiled task has no clamps"
    topology = task.topology()
    assert topology.inputs == len(task.inputs)
    assert topology.group(topology.output).size == len(task.outputs)
    weights = task.initial_weights(np.full(topology.synapses, 0.25))
    assert weights.shape == (topology.synapses,)
    assert np.isfinite(weights).all()


def check_presets(make_task: MakeTask) -> None:
    task = make_task()
    assert task.presets
    assert task.preset_name in task.presets
    for name, preset in task.presets.items():
        assert isinstance(preset, Preset)
        assert preset.note
        made = type(task)(name)
        assert made.preset is preset
        learner = Learner(made)
        assert (learner.beta, learner.gamma) == (preset.beta, preset.gamma)
        learner.advance(3)
        for switch, on in made.settings.items():
            other = type(task)(made.switched(switch, not on))
            assert other.settings == made.settings | {switch: not on}
            Learner(other).advance(3)


def check_shapes(make_task: MakeTask) -> None:
    """States, observations, rewards, ends, clamps: of one shape and finite all the way."""
    task = make_task()
    walk, neurons = Walk(task), task.topology().neurons
    for state in walk.states:
        assert state.dtype == np.float64, "a state is float64"
        assert state.shape == walk.states[0].shape, "a state keeps its shape"
        assert state.ndim == 1, "a state has one axis"
        seen = np.asarray(task.observation(state))
        assert seen.shape == (len(task.inputs),), "an observation has a number for each input"
        assert np.isfinite(seen).all()
        assert np.isfinite(float(task.reward(state)))
        assert task.ended(state) in (True, False)
        clamps = task.clamps(state)
        if clamps is not None:
            assert clamps.shape == (neurons,), "clamps has a number for each neuron"
            assert all(c in (0.0, 1.0) or np.isnan(c) for c in clamps)


def check_purity(make_task: MakeTask) -> None:
    """The same answer whatever came in between, of this instance or of another."""
    task, other = make_task(), make_task()
    walk = Walk(task, steps=200)
    assert _same(walk.states, Walk(other, steps=200).states), "two instances differ"
    Walk(task, steps=50, seed=8)
    for state, action, step in reversed(walk.moves):
        first = task.transition(state.copy(), action.copy(), walk.draws(step))
        again = task.transition(state.copy(), action.copy(), walk.draws(step))
        fresh = other.transition(state.copy(), action.copy(), walk.draws(step))
        assert _same(first, again), "transition is not a function of state, action and draws"
        assert _same(first, fresh), "transition depends on what else the task was used for"
    assert _same(walk.states, Walk(task, steps=200).states), "a walk is not the same again"


def check_nothing_is_modified(make_task: MakeTask) -> None:
    """Functions of the state leave it alone, and what they return is not changed later."""
    task = make_task()
    for state in Walk(task, steps=200).states:
        before = state.copy()
        for function in (task.observation, task.reward, task.ended, task.clamps, task.pose):
            function(state)
            assert _same(state, before), f"{function.__name__} changes the state"
        kept = np.array(task.observation(state))
        task.observation(state)
        assert _same(kept, np.asarray(task.observation(state))), "observation is not repeatable"


def check_draws(make_task: MakeTask) -> None:
    """A restart follows from its draws alone."""
    task = make_task()
    first = task.restart(Draws(1, 0, 0, FIRST_EPISODE))
    Walk(task, steps=50)
    assert _same(first, task.restart(Draws(1, 0, 0, FIRST_EPISODE)))
    assert _same(first, make_task().restart(Draws(1, 0, 0, FIRST_EPISODE)))


def check_pose(make_task: MakeTask) -> None:
    task = make_task()
    count = len(task.props)
    for state in Walk(task, steps=200).states:
        pose = task.pose(state)
        assert isinstance(pose, Pose)
        assert pose.position.shape == (count, 3)
        assert pose.rotation.shape == (count, 4)
        assert pose.scale.shape == (count, 3)
        assert all(np.isfinite(a).all() for a in (pose.position, pose.rotation, pose.scale))
        assert np.allclose(np.linalg.norm(pose.rotation, axis=1), 1.0), "rotations are of unit size"
        assert (pose.scale >= 0.0).all()
        assert "\n" not in pose.words
    assert len({p.name for p in task.props}) == count
    assert {p.shape for p in task.props} <= {"box", "sphere", "cylinder"}


def check_many_states(make_task: MakeTask) -> None:
    """Methods that take many states at once agree with those that take one."""
    task = make_task()
    states = np.array(Walk(task, steps=200).states)
    poses = [task.pose(state) for state in states]
    for together, name in zip(task.poses(states), ("position", "rotation", "scale"), strict=True):
        assert np.allclose(together, [getattr(p, name) for p in poses], rtol=0, atol=1e-12)
    readings = task.read(states)
    assert readings.shape == (len(states), len(task.readings))
    assert np.isfinite(readings).all()
    assert np.array_equal(readings, [task.read(s[None])[0] for s in states])
    assert len({r.name for r in task.readings}) == len(task.readings)


def check_controls(make_task: MakeTask) -> None:
    task = make_task()
    names = [c.name for c in task.controls]
    assert len(set(names)) == len(names)
    keys = [c.key for c in task.controls if c.key]
    assert len(set(keys)) == len(keys)
    for state in Walk(task, steps=20).states:
        for name in names:
            before = state.copy()
            after = task.press(state.copy(), name)
            assert after.shape == before.shape
            assert _same(after, task.press(before.copy(), name)), f"{name} is not repeatable"
    learner = Learner(make_task(), lanes=2)
    for name in names:
        learner.press(name)
        learner.advance(5)


def check_runs_repeat(make_task: MakeTask) -> None:
    """One run whatever the cuts, and what is kept of a moment makes the rest of it again."""
    whole, cut = Learner(make_task(), seed=3), Learner(make_task(), seed=3)
    whole.advance(STEPS)
    for steps in (1, 0, 7, STEPS // 2, 100):
        cut.advance(steps)
        cut.frame()
    moment = cut.keyframe()
    cut.advance(STEPS - cut.step)
    assert same_learner(whole, cut), "a run depends on how it was cut"
    other = Learner(make_task(), seed=3)
    other.set_beta(0.1)
    other.advance(20)
    other.restore(moment)
    other.advance(STEPS - other.step)
    assert same_learner(whole, other), "a run goes on differently from a keyframe"


def check_lanes(make_task: MakeTask) -> None:
    """A lane is the same run whatever is beside it."""
    together = Learner(make_task(), seed=3, lanes=3)
    together.advance(STEPS)
    for lane in range(3):
        alone = Learner(make_task(), seed=3, first_lane=lane)
        alone.advance(STEPS)
        assert np.array_equal(alone.network[:, 0], together.network[:, lane], equal_nan=True)
        assert np.array_equal(alone.world[:, 0], together.world[:, lane], equal_nan=True)


def check_rows(make_task: MakeTask) -> None:
    """Each step is seen with the state that its reward was given for, an episode's last too."""
    task = make_task()
    learner = Learner(task, seed=5, lanes=2)
    learner.look_at(1)
    block = learner.advance(STEPS, closely=True)
    assert np.array_equal(block.reward, [task.reward(state) for state in block.world])
    assert np.array_equal(block.ended, [task.ended(state) for state in block.world])


def check_measures(make_task: MakeTask) -> None:
    task = make_task()
    learner = Learner(task)
    start = learner.tally()
    scored = task.measure.figures(task.score(start - start))
    assert _are_told(task, scored), "no steps have a score too"
    learner.advance(STEPS)
    assert _are_told(task, task.measure.figures(task.score(learner.tally() - start)))
    results = task.results(learner, learner.tally())
    assert results
    assert all(isinstance(k, str) for k in results)
    assert _are_told(task, results)


def check_evaluation(make_task: MakeTask) -> None:
    """A frozen copy is judged lane by lane, and the learner left as it is."""
    task = make_task()
    learner = Learner(task)
    learner.advance(STEPS)
    before = learner.keyframe()
    figures = task.evaluate(learner)
    assert figures
    assert all(isinstance(k, str) for k in figures)
    assert all(v.shape == (learner.lanes,) for v in figures.values())
    assert _are_told(task, figures)
    after = learner.keyframe()
    assert _same([before.network, before.world], [after.network, after.world])
    assert learner.step == before.step


def _are_told(task: Task, figures: Mapping[str, ArrayLike]) -> bool:
    """Whether all are finite, but for the time to an event that was not seen, which is infinite."""
    measure = task.measure
    unseen = (measure.key, measure.ends[1]) if measure.event else ()
    return all(
        np.all(np.isfinite(v) | ((np.asarray(v) == np.inf) & (key in unseen)))
        for key, v in figures.items()
    )


def check_compiled(make_task: MakeTask) -> None:
    """A compiled answer is, to the bit, what the methods say."""
    task = make_task()
    if not isinstance(task, CompiledTask):
        return
    steps = 3 * STEPS
    compiled, plain = (Learner(t, seed=5, lanes=3) for t in (make_task(), Interpreted(task)))
    blocks = [learner.advance(steps, closely=True) for learner in (compiled, plain)]
    assert same_learner(compiled, plain)
    assert np.array_equal(blocks[0].world, blocks[1].world, equal_nan=True)
    assert np.array_equal(blocks[0].fired, blocks[1].fired)
    assert np.array_equal(blocks[0].reward, blocks[1].reward)
    assert np.array_equal(blocks[0].ended, blocks[1].ended)


def check_rule(rule: Rule, make_task: MakeTask) -> None:
    """Raise AssertionError unless a rule keeps the contract of `hebbviz.rules` in a task.

    `make_task` is called without arguments: the class of a task will do.
    """
    lanes, steps = max(2, rule.least_lanes), 600
    whole, cut = (Learner(make_task(), rule=rule, lanes=lanes, seed=3) for _ in range(2))
    block = whole.advance(steps)
    assert np.isfinite(block.broadcast).all()
    assert np.isfinite(whole.memory).all()
    assert whole.memory.shape == (len(rule.memory), lanes)
    cut.advance(steps // 3)
    cut.frame()
    moment = cut.keyframe()
    cut.advance(steps - cut.step)
    assert same_learner(whole, cut), "a run depends on how it was cut"
    other = Learner(make_task(), lanes=lanes, seed=3)
    other.restore(moment)
    assert other.rule == rule, "a moment brings its rule"
    other.skip(steps - other.step)
    assert same_learner(whole, other), "a run goes on differently from a keyframe"
    if not rule.lanes_touch:
        alone = Learner(make_task(), rule=rule, seed=3, first_lane=1)
        alone.advance(steps)
        assert np.array_equal(alone.network[:, 0], whole.network[:, 1], equal_nan=True)
        assert np.array_equal(alone.memory[:, 0], whole.memory[:, 1])
    assert make_rule(str(rule)) == rule, "its text makes it again"
    assert whole.frame().memory.shape == (len(rule.memory),)


class Interpreted(Task):
    """A compiled task with its methods alone."""

    def __init__(self, task: CompiledTask) -> None:
        for name in ("name", "outputs", "inputs", "presets", "switches", "activity"):
            setattr(self, name, getattr(task, name))
        super().__init__(task.preset_name)
        for name in (
            "restart",
            "transition",
            "observation",
            "reward",
            "ended",
            "topology",
            "initial_weights",
        ):
            setattr(self, name, getattr(task, name))


CHECKS: tuple[Callable[[MakeTask], None], ...] = (
    check_attributes,
    check_presets,
    check_shapes,
    check_purity,
    check_nothing_is_modified,
    check_draws,
    check_pose,
    check_many_states,
    check_controls,
    check_runs_repeat,
    check_lanes,
    check_rows,
    check_measures,
    check_evaluation,
    check_compiled,
)


def same_learner(a: Learner, b: Learner) -> bool:
    """Whether two learners are at the same moment, to the bit."""
    return (
        a.step == b.step
        and a.frozen == b.frozen
        and (a.gamma, a.fall) == (b.gamma, b.fall)
        and np.array_equal(a.memory, b.memory)
        and np.array_equal(a.network, b.network, equal_nan=True)
        and np.array_equal(a.world, b.world, equal_nan=True)
        and all(a.tally(k) == b.tally(k) for k in range(a.lanes))
    )


def _same(a: object, b: object) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    return np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True)
