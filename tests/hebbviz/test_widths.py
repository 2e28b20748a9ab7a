"""Lanes in float32, tiles of every width, and the compiled pendulum beside the one in pymunk."""

import numpy as np
import pytest

from hebbviz.conformance import check_task
from hebbviz.learner.learner import Learner
from hebbviz.learner.saves import load, save
from hebbviz.numerics.compile import WIDTHS, compiled
from hebbviz.numerics.counter_rng import unit
from hebbviz.numerics.logistic import sigmoid
from hebbviz.sims.loading import compiled_twin, make_task
from hebbviz.sims.worlds.pendulum.compiled import PendulumLanes
from hebbviz.sims.worlds.pendulum.physics import FARTHEST, FARTHEST_TURN, PLANT
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.topology import SYMMETRIC
from tests.hebbviz.test_kernel import STEPS, Chatter, everything, flat, follow

WIDEST = WIDTHS[-2] + 1
"""Lanes that are in a tile of the widest kind, and leave most of it idle."""
EXACT = {np.float64: 0.0, np.float32: 2e-7}
"""How far σ in float32 may be from σ, in probability."""


def compiled_task(name):
    return compiled_twin(make_task(name, None))


@compiled
def sigmoids(v):
    out = np.empty_like(v)
    for k in range(v.size):
        out[k] = sigmoid(v[k])
    return out


@compiled
def units(words, like):
    out = np.empty(words.size, like.dtype)
    for k in range(words.size):
        out[k] = unit(words[k], like[0])
    return out


def test_sigma_in_float32_is_sigma():
    v = np.concatenate([np.linspace(-120, 120, 200_001), [0.0, -0.0, 1e-30, 1e30, -1e30]])
    exact = 1.0 / (1.0 + np.exp(-np.clip(v.astype(np.float32).astype(np.float64), -700, 700)))
    got = sigmoids(v.astype(np.float32))
    assert got.dtype == np.float32
    assert np.abs(got - exact).max() < EXACT[np.float32]
    middle = np.abs(v) < 80
    assert (np.abs(got - exact)[middle] <= 3e-7 * exact[middle]).all()


def test_draws_in_float32_are_those_of_float64_cut_to_24_bits():
    words = np.random.default_rng(0).integers(0, 2**32, 100_000, dtype=np.uint32)
    words[:3] = 0, 2**32 - 1, 255
    wide, narrow = units(words, np.zeros(1)), units(words, np.zeros(1, dtype=np.float32))
    assert (narrow >= 0).all() and (narrow < 1).all()
    assert np.array_equal(narrow, np.floor(wide * 2**24) / 2**24)


@pytest.mark.parametrize("name", ["sonar", "pendulum", "prediction"])
@pytest.mark.parametrize(
    ("dtype", "few", "lanes"),
    [(np.float64, 1, lanes) for lanes in (3, WIDTHS[-1], WIDTHS[-1] + 3)]
    + [(np.float32, WIDEST, WIDTHS[-1] + 3)]
    + [  # it takes long to compile the other widths for float32
        pytest.param(np.float32, 1, lanes, marks=pytest.mark.slow) for lanes in (3, WIDTHS[-1])
    ],
)
def test_a_lane_is_the_same_in_a_tile_of_any_width(name, dtype, few, lanes):
    """To the bit: alone, among a few, among many, and in a learner of several tiles."""
    steps, lane = 2300, 1
    first = Learner(compiled_task(name), seed=4, first_lane=lane, lanes=few, dtype=dtype)
    first.advance(steps)
    among = Learner(compiled_task(name), seed=4, lanes=lanes, dtype=dtype)
    for part in (1, 700, steps - 701):
        among.skip(part)
    assert np.array_equal(first.network[:, 0], among.network[:, lane], equal_nan=True)
    assert np.array_equal(first.world[:, 0], among.world[:, lane])


@pytest.mark.parametrize("name", ["sonar", "pendulum"])
def test_float32_goes_on_exactly_after_saves_and_keyframes(name, tmp_path):
    whole = Learner(compiled_task(name), seed=4, lanes=WIDEST, dtype="float32")
    other = Learner(compiled_task(name), seed=4, lanes=WIDEST, dtype="float32")
    whole.skip(2500)
    other.skip(1300)
    moment, path = other.keyframe(), save(other, tmp_path / "saved")
    for again in (other.twin(), load(path, lambda *_: compiled_task(name))):
        assert again.dtype is np.float32
        again.restore(moment)
        again.skip(1200)
        assert np.array_equal(again.network, whole.network, equal_nan=True)
        assert np.array_equal(again.world, whole.world)


@pytest.mark.slow
def test_float32_follows_the_reference_as_far_as_it_can_see():
    """The same spikes as float64 all the way here, so w and z differ by rounding alone."""
    topology = everything(SYMMETRIC)
    task = Chatter(topology, 7)
    learner = Learner(task, topology=topology, beta=0.9, gamma=1e-3, seed=11, dtype="float32")
    fired, reference = follow(learner, task, STEPS)
    same = (learner.advance(STEPS).fired == fired).all(axis=1)
    assert same.all()
    for got, exact in ((learner.weights, reference.weights), (learner.traces, reference.traces)):
        exact = flat(exact)
        assert np.abs(got[:, 0] - exact).max() < 1e-3 * max(1.0, np.abs(exact).max())


def test_float32_and_float64_learn_alike():
    """Sonar, 64 replicas each: errors while learning whose means agree within their noise."""
    errors = []
    for dtype in (np.float32, np.float64):
        learner = Learner(make_task("sonar", "quick"), lanes=64, seed=2, dtype=dtype)
        learner.skip(187_000)
        tallies = learner.skip_tallied(2 * 187_000)
        errors.append(np.array([1.0 - t.average_reward for t in tallies]))
    spread = np.sqrt(sum(e.var(ddof=1) / len(e) for e in errors))
    assert errors[0].mean() < 0.4
    assert abs(errors[0].mean() - errors[1].mean()) < 4.0 * spread


def test_the_tally_of_float32_counts_beyond_what_float32_can():
    learner = Learner(make_task("sonar"), lanes=WIDEST, dtype="float32")
    moment = learner.keyframe()
    big = moment.network.copy()
    rows = learner.layout.packed["tally"]
    big[rows] = 2.0**30 + 1.0
    learner.restore(type(moment)(**{**vars(moment), "network": big}))
    learner.skip(1000)
    assert learner.tally().reward > 2.0**30 + 1.0
    assert learner.tally().reward == int(learner.tally().reward)


# The pendulum


def test_the_compiled_pendulum_keeps_to_the_contract():
    check_task(PendulumLanes)


def test_it_is_the_pymunk_world_with_bounces():
    """Over 2 s from 200 starts near the walls, within 1e-9."""
    pymunk, lanes = Pendulum(), PendulumLanes()
    rng = np.random.default_rng(0)
    bounces = 0
    for _ in range(200):
        rod = np.array([*(0.3 * rng.normal(size=2)), 1.0])
        state = np.zeros(12)
        state[:2], state[2:4] = rng.uniform(-2.4, 2.4, 2), rng.uniform(-3, 3, 2)
        state[4:7] = rod / np.linalg.norm(rod)
        a, b = state.copy(), state.copy()
        for _ in range(100):
            action = rng.choice([-1.0, 1.0], 2)
            before = a
            a, b = pymunk.transition(a, action, None), lanes.transition(b, action, None)
            bounces += (before[2:4] * a[2:4] < 0).any() and (abs(a[:2]) > FARTHEST - 0.2).any()
            if pymunk.ended(a):
                break
            assert np.abs(a - b).max() < 1e-9
    assert bounces > 50


@pytest.mark.parametrize("width", WIDTHS[1:])
def test_lanes_at_walls_and_with_spinning_rods_step_as_pymunk_does(width):
    """One step of every lane of a tile, some common, some not: within 1e-9, and as if alone."""
    rng, lanes, pymunk = np.random.default_rng(1), PendulumLanes(), Pendulum()
    learner = Learner(lanes, lanes=width)
    met = spun = plain = 0
    for _ in range(512 // width):
        rod = np.array([0.4, 0.4, 0.0])[:, None] * rng.normal(size=(3, width)) + [[0], [0], [1]]
        world = np.zeros((12, width))
        world[:2] = rng.choice([-1, 1], (2, width)) * (FARTHEST - rng.exponential(0.1, (2, width)))
        world[:2].clip(-FARTHEST, FARTHEST, out=world[:2])
        world[2:4] = rng.normal(0, 2, (2, width))
        world[4:7] = rod / np.linalg.norm(rod, axis=0)
        world[7:10] = np.cross(world[4:7], rng.normal(0, 7, (3, width)), axis=0)
        learner.restore(type(moment := learner.keyframe())(**{**vars(moment), "world": world}))
        learner.advance(1)
        for lane in range(width):
            start, end = world[:, lane], learner.world[:, lane]
            action = learner.activities[-2:, lane]
            want = pymunk.transition(start, action, None)
            if pymunk.ended(want):
                continue
            assert np.abs(end - want).max() < 1e-9
            assert np.array_equal(end, lanes.transition(start, action, None))
            bounced = (np.abs(end[2:4] - start[2:4]) > 0.5).any()
            turns = np.linalg.norm(start[7:10]) * PLANT.time_step > FARTHEST_TURN
            met, spun, plain = met + bounced, spun + turns, plain + (not bounced and not turns)
    assert min(met, spun, plain) > 50


def test_what_was_learnt_in_lanes_balances_in_pymunk():
    """And the other way round a learner goes on in the other world: their states are the same."""
    lanes = Learner(PendulumLanes("quick"), lanes=16, seed=1)
    lanes.skip(150_000)
    falls = [t.ended for t in lanes.skip_tallied(50_000)]
    best = int(np.argmin(falls))
    pymunk = Learner(Pendulum("quick"), seed=1, first_lane=best)
    pymunk.restore(lanes.keyframe().lane(best))
    pymunk.freeze(True)
    before = pymunk.tally()
    pymunk.skip(5_000)
    stood = pymunk.task.score(pymunk.tally() - before).value
    assert stood > 3.0
