"""What is compiled for one network alone makes the same run as what is compiled for all."""

import numpy as np
import pytest

from hebbviz.engine.layout import Layout
from hebbviz.engine.unrolled import plan_of
from hebbviz.learner.learner import Learner
from hebbviz.rules.baseline import Baseline
from hebbviz.sims.loading import compiled_twin, make_task
from hebbviz.topology import BINARY, SYMMETRIC, Group, Projection, Topology, feedforward


def tangle(activity, inputs, outputs):
    """Groups in no order, of which two excite each other, one hears itself and one hears nobody."""
    groups = (
        Group("out", outputs), Group("in", inputs, is_input=True), Group("deaf", 1),
        Group("a", 2), Group("b", 3),
    )  # fmt: skip
    pairs = [("b", "a"), ("in", "b"), ("a", "b"), ("in", "out"), ("b", "out"), ("a", "a"),
             ("deaf", "out")]  # fmt: skip
    return Topology(groups, tuple(Projection(*pair) for pair in pairs), "out", activity)


def tangled(name, activity):
    task = compiled_twin(make_task(name))
    return tangle(activity, len(task.inputs), len(task.outputs))


def live_through(learner):
    """Everything that a command or a glance may change in mid-run."""
    learner.skip(1)
    learner.skip(2)
    learner.skip(700)
    learner.set_beta(0.7)
    learner.give_reward(2.5)
    learner.skip(3)
    learner.advance(40)
    learner.set_rule(Baseline(time=50.0))
    learner.set_fall(1000.0)
    learner.skip(300)
    learner.freeze(True)
    learner.skip(20)
    learner.freeze(False)
    moment = learner.keyframe()
    learner.skip(100)
    learner.restore(moment)
    learner.skip(1000)


@pytest.mark.slow  # each is compiled for a while
@pytest.mark.parametrize(
    ("task", "dtype", "lanes", "topology"),
    [
        ("gradient", "float64", 5, tangled("gradient", SYMMETRIC)),
        ("gradient", "float32", 5, tangled("gradient", BINARY)),
        ("prediction", "float64", 64, None),
        ("sonar", "float32", 50, None),
        ("sonar", "float64", 67, None),
        ("pendulum", "float32", 64, None),
    ],
)
def test_it_is_the_same_run_to_the_bit(task, dtype, lanes, topology):
    both = [
        Learner(compiled_twin(make_task(task)), topology=topology, gamma=0.01, seed=3, lanes=lanes,
                dtype=dtype, written_out=written_out)
        for written_out in (False, True)
    ]  # fmt: skip
    for learner in both:
        live_through(learner)
    general, written = both
    assert plan_of(general.layout) is not None
    assert np.array_equal(general.network, written.network, equal_nan=True)
    assert np.array_equal(general.world, written.world)
    assert np.array_equal(general.totals, written.totals)
    assert np.array_equal(general.memory, written.memory)
    assert len(np.unique(written.weights, axis=1).T) == lanes


def test_a_large_network_is_run_as_all_are():
    assert plan_of(Layout(feedforward(60, (8,), 1))) is not None
    assert plan_of(Layout(feedforward(60, (200,), 1))) is None
    both = [
        Learner(make_task("gradient"), hidden=(200,), lanes=3, written_out=written_out)
        for written_out in (False, True)
    ]
    for learner in both:
        learner.skip(30)
    assert np.array_equal(both[0].network, both[1].network, equal_nan=True)
