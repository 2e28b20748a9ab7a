"""One trajectory, to the bit, however it was cut, watched, saved or accompanied."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hebbviz.conformance import same_learner
from hebbviz.learner.frames import join
from hebbviz.learner.learner import Learner
from hebbviz.learner.saves import load, save
from hebbviz.sims.loading import make_task
from hebbviz.task.base import Tally
from hebbviz.topology import Topology

# Sonar changes its pattern every 1 000 steps; a pendulum falls about every 30.
LEVER = f"{Path(__file__).parents[1] / 'examples' / 'lever.py'}:Lever"
RUNS = {"sonar": ("sonar", "quick", 3500), "pendulum": ("pendulum", "quick", 1500),
        "synapse": ("synapse", "hand", 300), "script": ("synapse", "script", 300),
        "lever": (LEVER, None, 500)}  # fmt: skip

EACH = pytest.mark.parametrize("run", RUNS)


def new(run, **settings):
    name, preset, _ = RUNS[run]
    return Learner(make_task(name, preset), **settings)


def length(run):
    return RUNS[run][2]


def straight(run, **settings):
    """The run in one go."""
    learner = new(run, **settings)
    learner.advance(length(run))
    return learner


def cuts(total, seed):
    """Random stretches that add up to `total`, some of them empty."""
    rng = np.random.default_rng(seed)
    while total > 0:
        part = min(total, int(rng.integers(0, 200)))
        yield part
        total -= part


@EACH
def test_the_length_of_blocks_makes_no_difference(run):
    whole = new(run, seed=5, lanes=2)
    block = whole.advance(length(run))
    singly, cut = new(run, seed=5, lanes=2), new(run, seed=5, lanes=2)
    fired = [singly.advance(1).fired for _ in range(length(run))]
    assert same_learner(whole, singly)
    assert np.array_equal(block.fired, np.concatenate(fired))
    rng = np.random.default_rng(1)
    parts = []
    for part in cuts(length(run), 0):
        parts.append(cut.advance(part))
        if rng.random() < 0.5:
            cut.frame()
        if rng.random() < 0.5:
            cut.probe(rng.integers(0, cut.topology.synapses, 3).tolist())
            _ = cut.weights, cut.traces, cut.world, cut.keyframe(), cut.twin()
    assert same_learner(whole, cut)
    for name in ("fired", "reward", "broadcast", "ended"):
        joined = np.concatenate([getattr(p, name) for p in parts])
        assert np.array_equal(getattr(block, name), joined)


@EACH
def test_skipping_is_advancing(run):
    skipped = new(run, seed=5)
    for part in cuts(length(run), 3):
        skipped.skip(part)
    assert same_learner(straight(run, seed=5), skipped)


@pytest.mark.parametrize(("run", "lanes"), [("sonar", 64), *product(RUNS, (2, 5))])
def test_a_lane_does_not_see_the_others(run, lanes):
    together = straight(run, seed=9, lanes=lanes, first_lane=10)
    for lane in {0, 1, lanes // 2, lanes - 1}:
        alone = straight(run, seed=9, first_lane=10 + lane)
        assert np.array_equal(alone.network[:, 0], together.network[:, lane], equal_nan=True)
        assert np.array_equal(alone.world[:, 0], together.world[:, lane], equal_nan=True)
        assert alone.tally() == together.tally(lane)


def test_lanes_and_seeds_are_different_runs():
    lanes = straight("pendulum", seed=1, lanes=3)
    ends = {tuple(lanes.weights[:, k]) for k in range(3)}
    assert len({*ends, tuple(straight("pendulum", seed=2).weights[:, 0])}) == 4


@EACH
def test_saving_makes_no_difference(run, tmp_path):
    learner = new(run, seed=6, lanes=3, first_lane=4)
    learner.set_beta(0.37)
    learner.set_gamma(0.011)
    learner.advance(length(run) // 3)
    learner.give_reward(2.0)
    path = save(learner, tmp_path / "run", task_name=RUNS[run][0])
    again = load(path, make_task)
    assert same_learner(learner, again)
    assert (again.beta, again.gamma) == (learner.beta, learner.gamma)
    for one in (learner, again):
        one.advance(length(run) - one.step)
    assert same_learner(learner, again)


@EACH
def test_going_back_makes_no_difference(run):
    learner = new(run, seed=7, lanes=2)
    learner.advance(length(run) // 3 + 1)
    moment = learner.keyframe()
    learner.set_beta(0.1)
    learner.freeze(frozen=True)
    learner.advance(length(run))
    kept = moment.network.copy(), moment.world.copy()
    learner.restore(moment)
    learner.advance(length(run) - learner.step)
    assert same_learner(straight(run, seed=7, lanes=2), learner)
    assert np.array_equal(kept[0], moment.network, equal_nan=True)
    assert np.array_equal(kept[1], moment.world, equal_nan=True)


def commands(run, learner):
    """What can be done to a learner, as (step, command)."""
    total = length(run)
    yield total // 10, lambda s: s.set_beta(0.3)
    yield total // 7, lambda s: s.give_reward(1.5)
    yield total // 5, lambda s: s.freeze(frozen=True)
    yield total // 4, lambda s: s.set_gamma(0.2)
    for k, control in enumerate(learner.task.controls):
        yield total // 3 + k, lambda s, name=control.name: s.press(name)
    yield total // 2, lambda s: s.freeze(frozen=False)
    yield total // 2 + 9, lambda s: s.set_gamma(0.003)
    yield total // 2 + 9, lambda s: s.set_beta(0.9)


def obey(run, learner, stretch):
    """Run to the end with the commands at their steps, in blocks of at most `stretch`."""
    for step, command in [*commands(run, learner), (length(run), lambda s: None)]:
        while learner.step < step:
            learner.advance(min(stretch, step - learner.step))
        if learner.step == step:
            command(learner)


@EACH
def test_commands_replayed_at_their_steps_make_the_same_run(run):
    first, replayed, plain = (new(run, seed=8, lanes=2) for _ in range(3))
    obey(run, first, 10_000)
    obey(run, replayed, 13)
    plain.advance(length(run))
    assert same_learner(first, replayed)
    assert not same_learner(first, plain)


@EACH
def test_a_replay_from_a_keyframe_is_the_same_too(run):
    learner = new(run, seed=8)
    start = learner.keyframe()
    obey(run, learner, 50)
    end = learner.keyframe()
    learner.restore(start)
    obey(run, learner, 1000)
    assert np.array_equal(end.network, learner.network, equal_nan=True)
    assert np.array_equal(end.world, learner.world, equal_nan=True)
    assert learner.step == end.step


# Summaries


def summed_up(run, stretch, *, lane):
    """Over every stretch: the Frame, and the single steps it sums up."""
    whole, single = (new(run, seed=4, lanes=2) for _ in range(2))
    last = whole.topology.synapses - 1
    held_and_dense = [0, last // 2, last]
    for learner in (whole, single):
        learner.watch = lane
        learner.probe(held_and_dense)
        learner.frame()
    for _ in range(length(run) // stretch):
        before = single.weights[:, lane], single.tally()
        whole.advance(stretch)
        steps = []
        for _ in range(stretch):
            block = single.advance(1)
            steps.append((block, single.potentials[:, lane], single.traces[held_and_dense, lane]))
        yield whole.frame(), single, steps, before


@EACH
@pytest.mark.parametrize("lane", [0, 1])
def test_a_summary_sums_up_every_step(run, lane):
    for frame, single, steps, (weight, tally) in summed_up(run, 150, lane=lane):
        since = frame.since
        fired = np.concatenate([b.fired for b, _, _ in steps])
        v, z = np.array([v for _, v, _ in steps]), np.array([z for _, _, z in steps])
        assert since.steps == since.tally.steps == 150
        assert np.array_equal(since.spikes, fired.sum(axis=0))
        assert np.array_equal(since.potential_range, [v.min(axis=0), v.max(axis=0)])
        assert np.array_equal(since.probe_range, [z.min(axis=0), z.max(axis=0)])
        assert since.tally == single.tally() - tally
        assert np.isclose(since.tally.reward, sum(b.reward[0] for b, _, _ in steps))
        assert since.tally.ended == sum(b.ended[0] for b, _, _ in steps)
        assert np.array_equal(since.weight_change, single.weights[:, lane] - weight)


@EACH
def test_a_frame_is_the_moment(run):
    learner = new(run, seed=4, lanes=2)
    learner.watch = 1
    learner.advance(101)
    frame = learner.frame()
    assert frame.step == 101
    assert np.array_equal(frame.weight, learner.weights[:, 1])
    assert np.array_equal(frame.trace, learner.traces[:, 1])
    assert np.array_equal(frame.activity, learner.activities[:, 1])
    assert np.array_equal(frame.potential, learner.potentials[:, 1])
    assert np.array_equal(frame.world, learner.world[:, 1])
    assert frame.tally == learner.tally(1)
    copies = {k: np.array(v) for k, v in vars(frame).items() if isinstance(v, np.ndarray)}
    learner.advance(100)
    for name, array in copies.items():
        assert np.array_equal(getattr(frame, name), array), f"{name} is not the Frame's own"


def test_a_frame_right_after_another_sums_up_nothing():
    learner = new("pendulum")
    learner.advance(100)
    learner.frame()
    since = learner.frame().since
    assert since.steps == 0
    assert since.tally == Tally(0, 0.0, 0.0, 0.0)
    assert not since.spikes.any()
    assert not since.weight_change.any()


@EACH
def test_a_frozen_copy_starts_its_own_count_and_never_learns(run):
    learner = straight(run, lanes=2)
    learner.watch = 1
    copy = learner.frozen_copy()
    assert np.array_equal(copy.weights, learner.weights)
    copy.advance(200)
    since = copy.frame().since
    assert since.steps == since.tally.steps == 200
    assert not since.weight_change.any()
    assert np.array_equal(copy.weights, learner.weights)
    assert copy.watch == 1


def test_a_beta_that_float32_rounds_to_1_can_be_had_again():
    learner = new("sonar", beta=0.99999999, dtype="float32", lanes=2)
    learner.advance(300)
    twin, copy = learner.twin(), learner.frozen_copy()
    assert same_learner(twin, new("sonar", beta=0.99999999, dtype="float32", lanes=2))
    assert np.array_equal(copy.weights, learner.weights.astype(np.float32))
    twin.restore(learner.keyframe())
    assert same_learner(twin, learner)
    twin.set_beta(twin.beta)
    assert same_learner(twin, learner)
    assert twin.beta == twin.frame().beta.max() < 1.0


# Commands


def test_reward_by_hand_is_broadcast_once_and_not_the_tasks():
    learner = new("pendulum")
    learner.give_reward(2.0)
    learner.give_reward(0.5)
    block = learner.advance(3)
    assert (block.broadcast - block.reward).tolist() == [2.5, 0.0, 0.0]
    assert learner.tally().broadcast - learner.tally().reward == 2.5


def test_frozen_weights_stay_and_traces_go_on():
    learner = straight("sonar")
    learner.freeze(frozen=True)
    learner.set_gamma(0.5)
    weights, traces = learner.weights, learner.traces
    learner.advance(1500)
    assert np.array_equal(weights, learner.weights)
    assert not np.array_equal(traces, learner.traces)
    assert learner.gamma == 0.5
    learner.freeze(frozen=False)
    learner.advance(100)
    assert not np.array_equal(weights, learner.weights)


def test_weights_that_are_set_are_there_and_traces_stay():
    learner = straight("sonar", lanes=2)
    learner.advance(77)
    traces = learner.traces
    weights = np.random.default_rng(0).normal(size=traces.shape)
    learner.set_weights(weights)
    assert np.array_equal(learner.weights, weights)
    assert np.array_equal(learner.traces, traces)
    before = learner.activities
    learner.advance(1)
    p = learner.topology.projections[0]
    where = learner.topology.synapses_of(0)
    for lane in range(2):
        w = weights[where, lane].reshape(learner.topology.shape(p))
        v = w @ before[learner.topology.units_of(p.pre), lane]
        rows = learner.topology.neurons_of(p.post)
        assert np.allclose(learner.potentials[rows, lane], v, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: s.set_beta(1.0), r"beta must be in \[0, 1\), got 1.0"),
        (lambda s: s.set_beta(-0.1), "beta must be"),
        (lambda s: s.set_beta(np.nan), "beta must be"),
        (lambda s: s.set_beta("0.5"), "beta must be"),
        (lambda s: s.set_gamma(-1e-9), "gamma .* must be from 0"),
        (lambda s: s.set_gamma(np.inf), "gamma"),
        (lambda s: s.set_gamma(True), "gamma"),
        (lambda s: s.give_reward(np.nan), "reward must be"),
        (lambda s: s.give_reward(1e7), "reward must be"),
        (lambda s: s.advance(-1), "steps must not be negative"),
        (lambda s: s.skip(-1), "steps must not be negative"),
        (lambda s: s.probe([10**6]), "synapse must be below"),
        (lambda s: s.probe([-1]), "synapse must be below"),
        (lambda s: new("lever", lanes=0), "lanes must be"),
        (lambda s: new("lever", first_lane=-1), "first_lane must be"),
        (lambda s: new("lever", seed=-1), "seed must be"),
        (lambda s: new("lever", topology=s.topology), "has 1 inputs, the network 60"),
        (lambda s: s.restore(new("lever").keyframe()), "keyframe of this network"),
        (lambda s: Topology(s.topology.groups, (), "output"), "at least one projection"),
    ],
)
def test_what_is_out_of_range_is_refused_and_changes_nothing(call, words):
    learner, untouched = new("sonar"), new("sonar")
    with pytest.raises(ValueError, match=words):
        call(learner)
    assert same_learner(learner, untouched)
    learner.advance(10)
    untouched.advance(10)
    assert same_learner(learner, untouched)


@EACH
def test_looking_closely_makes_no_difference_and_tells_every_step(run):
    plain, close = new(run, seed=5, lanes=2), new(run, seed=5, lanes=2)
    for learner in (plain, close):
        learner.watch = 1
    frames = []
    for _ in range(60):
        plain.advance(1)
        frames.append(plain.frame())
    parts = [close.advance(n, closely=True) for n in (1, 0, 20, 39)]
    assert same_learner(plain, close)
    block = join(parts)
    assert np.array_equal(block.potential, [f.potential for f in frames])
    rows = ~block.ended
    assert np.array_equal(block.world[rows], np.array([f.world for f in frames])[rows])
    assert np.array_equal(block.fired, [f.fired for f in frames])


def test_parts_of_a_block_are_its_steps():
    learner = new("pendulum", seed=2)
    learner.advance(10)
    block = learner.advance(50, closely=True)
    part = block.part(20, 35)
    assert (part.start, part.end) == (20, 35)
    for name in ("fired", "reward", "broadcast", "ended", "potential", "world"):
        assert np.array_equal(getattr(part, name), getattr(block, name)[10:25])
    assert len(block.part(0, 5).fired) == len(block.part(70, 90).fired) == 0
    assert block.tail(7).start == 53
    far = learner.advance(3)
    assert len(join([block, far]).fired) == 53
    assert len(join([block, far]).potential) == 0, "not all of it was seen closely"
    with pytest.raises(ValueError, match="does not follow on"):
        join([far, block])


@EACH
def test_a_reward_in_place_of_the_tasks_own(run):
    own, same, other = (new(run, seed=4) for _ in range(3))
    block = own.advance(300)
    again = same.advance(300, reward=block.reward)
    assert same_learner(own, same), "its own reward given back changes nothing"
    assert np.array_equal(again.reward, block.reward)
    given = np.sin(np.arange(300.0))
    told = other.advance(300, reward=given)
    assert np.array_equal(told.broadcast, given)
    still = new(run, seed=4)
    before = still.weights
    still.advance(300, reward=np.zeros(300))
    assert np.array_equal(still.weights, before), "without reward no weight moves"
    assert still.tally().broadcast == 0.0


@pytest.mark.parametrize("reward", [np.zeros(3), np.full(5, np.nan), np.full(5, np.inf)])
def test_rewards_that_do_not_fit_are_refused(reward):
    with pytest.raises(ValueError, match="reward must be 5 finite numbers"):
        new("sonar").advance(5, reward=reward)


@EACH
def test_reward_by_hand_is_added_to_a_reward_that_replaces_the_tasks(run):
    learner = new(run, seed=3)
    learner.give_reward(0.25)
    told = learner.advance(3, reward=np.array([1.0, -1.0, 0.5]))
    assert told.broadcast.tolist() == [1.25, -1.0, 0.5]


@EACH
def test_a_keyframes_digest_tells_every_bit(run):
    learner = straight(run, seed=3)
    keyframe = learner.keyframe()
    digest = keyframe.digest()
    assert digest == straight(run, seed=3).keyframe().digest()
    for change in ("network", "world", "gamma"):
        array = getattr(keyframe, change).copy()
        array.flat[0] = np.nextafter(array.flat[0], np.inf)
        assert replace(keyframe, **{change: array}).digest() != digest
    assert replace(keyframe, step=keyframe.step + 1).digest() != digest
    assert replace(keyframe, frozen=True).digest() != digest


def test_the_settings_of_a_run_make_it_again() -> None:
    task = make_task("synapse")
    learner = Learner(
        task, beta=0.7, gamma=0.3, fall=500.0, seed=9, lanes=2, first_lane=4, dtype="float32"
    )
    learner.freeze(True)
    again = Learner.of(task, learner.settings)
    assert again.settings == learner.settings
    learner.advance(300)
    again.advance(300)
    assert same_learner(learner, again)
