"""What is seen agrees with what is: scales, colours, pictures made of numbers, words."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hebbviz.learner.learner import Learner
from hebbviz.rules.base import make_rule
from hebbviz.rules.paper import PAPER
from hebbviz.server.page import status_text
from hebbviz.server.page.images import RASTER_STEPS, WIDTH, heat_map, raster
from hebbviz.server.scene.appearance import (
    LARGEST_RING,
    MOST_SYNAPSES_DRAWN,
    Looks,
    Scale,
    endpoints,
    largest_synapses,
    place,
    unit_names,
)
from hebbviz.server.scene.reward_pulse import Pulse, arrival
from hebbviz.sims.figures import palette
from hebbviz.sims.loading import make_task
from hebbviz.topology import SYMMETRIC, Group, Projection, Topology, feedforward

SIZES = st.floats(1e-12, 1e12)


@given(st.lists(SIZES, min_size=1, max_size=30))
def test_a_scale_covers_its_values_and_moves_only_when_it_must(values: list[float]) -> None:
    scale = Scale()
    for value in values:
        before = scale.full
        full = scale.fit(value)
        assert value <= full * (1 + 1e-9)
        if 0.2 * before <= value <= before:
            assert full == before
        mantissa = full / 10 ** np.floor(np.log10(full) + 1e-9)
        assert min(abs(mantissa - m) for m in (1, 2, 5, 10)) < 1e-6


def test_every_synapse_runs_between_its_units_at_any_topology() -> None:
    topology = Topology(
        (Group("x", 3, is_input=True), Group("a", 2), Group("b", 4)),
        (Projection("x", "a"), Projection("a", "b"), Projection("b", "b"), Projection("x", "b")),
        "b",
        SYMMETRIC,
    )
    pre, post = endpoints(topology)
    assert len(pre) == len(post) == topology.synapses
    for k, p in enumerate(topology.projections):
        where, (rows, columns) = topology.synapses_of(k), topology.shape(p)
        for s in range(where.start, where.stop):
            i, j = divmod(s - where.start, columns)
            assert post[s] == topology.first_unit(p.post) + i
            assert pre[s] == topology.first_unit(p.pre) + j
        assert where.stop - where.start == rows * columns
    assert len(set(map(tuple, place(topology).units.round(9)))) == topology.units


@pytest.mark.parametrize("size", [3, 6, LARGEST_RING])
def test_neurons_that_hear_each_other_stand_in_a_ring(size: int) -> None:
    """So that no synapse between two of them runs through a third."""
    layers = feedforward(2, (size,), 1)
    loop = Projection("hidden", "hidden")
    ring = place(replace(layers, projections=(*layers.projections, loop)))
    at, radius = ring.units[2:-1], ring.radius[2:-1]
    for a, b, c in permutations(range(size), 3):
        along = (at[b] - at[a]) / np.linalg.norm(at[b] - at[a])
        aside = np.linalg.norm(np.cross(at[c] - at[a], along))
        beyond = along @ (at[c] - at[a])
        assert aside > radius[c] or not 0 < beyond < np.linalg.norm(at[b] - at[a])
    assert np.ptp(place(layers).units[2:-1, 2]) == 0.0


def test_a_spike_is_lit_and_silence_is_not_and_sizes_follow_the_numbers() -> None:
    learner = Learner(make_task("pendulum"))
    looks = Looks(learner.topology, palette.DARK)
    for _ in range(50):
        learner.advance(1)
        frame = learner.frame()
        look = looks.look(frame)
        fired = frame.fired > 0
        assert (look.neuron_colors[fired] == palette.SPIKE).all()
        assert not (look.neuron_colors[~fired] == palette.SPIKE).all(axis=1).any()
        order = np.argsort(np.abs(frame.weight))
        assert (np.diff(look.weight_radius[order]) >= 0).all()
        assert (np.sign(look.trace_height) == np.sign(frame.trace)).all()
        assert (np.sign(look.input_height) == np.sign(frame.activity[:8])).all()


def test_after_a_leap_the_light_is_of_who_fired_in_the_step_that_is_shown() -> None:
    learner = Learner(make_task("pendulum"))
    looks = Looks(learner.topology, palette.DARK)
    for leaps, step in enumerate((57, 203, 31, 31, 0)):
        moment = Learner(make_task("pendulum"), seed=leaps)
        moment.skip(step)
        frame = moment.frame()
        assert frame.since.steps == 0
        for _ in range(3):
            look = looks.look(frame, leaps=leaps)
            lit = (look.neuron_colors == palette.SPIKE).all(axis=1)
            assert lit.tolist() == (frame.activity[8:] > 0).tolist()


def test_many_steps_in_a_picture_are_a_rate() -> None:
    learner = Learner(make_task("pendulum"))
    learner.advance(400)
    frame = learner.frame()
    look = Looks(learner.topology, palette.DARK).look(frame)
    rate = frame.since.spikes / 400
    expected = palette.blend(rate, palette.DARK.idle, palette.SPIKE)
    np.testing.assert_array_equal(look.neuron_colors, expected)


def test_of_a_large_network_the_largest_synapses_are_drawn() -> None:
    weight = np.random.default_rng(0).normal(size=5000)
    drawn = largest_synapses(weight)
    assert len(set(drawn)) == MOST_SYNAPSES_DRAWN
    rest = np.setdiff1d(np.arange(5000), drawn)
    assert np.abs(weight[drawn]).min() >= np.abs(weight[rest]).max()


def test_the_raster_shows_every_spike_at_its_step_and_neuron() -> None:
    learner = Learner(make_task("pendulum", "quick"))
    block = learner.advance(RASTER_STEPS + 40).tail(RASTER_STEPS)
    image = raster(block, learner.topology, palette.DARK)
    row, column = image.shape[0] // 7, WIDTH // RASTER_STEPS
    lit = image[row // 2 :: row, ::column][1:7] != palette.DARK.zero
    np.testing.assert_array_equal(lit.any(axis=2), block.fired.T > 0)
    punished = (image[row // 2, ::column] == palette.PUNISHMENT).all(axis=1)
    np.testing.assert_array_equal(punished, block.broadcast < 0)


def test_the_raster_shows_rewards_and_not_what_a_baseline_makes_of_none() -> None:
    learner = Learner(make_task("pendulum", "baseline"))
    learner.skip(2000)
    block = learner.advance(RASTER_STEPS)
    assert (block.broadcast != 0.0).all()
    image = raster(block, learner.topology, palette.DARK, rule=learner.rule)
    row, column = image.shape[0] // 19, WIDTH // RASTER_STEPS
    lit = (image[row // 2, ::column] != palette.DARK.zero).any(axis=1)
    np.testing.assert_array_equal(lit, block.ended)


def test_a_heat_map_is_neutral_at_zero_and_full_at_its_scale() -> None:
    values = np.array([[0.0, 2.0], [-2.0, 1.0]])
    hues = palette.WEIGHT_POSITIVE, palette.WEIGHT_NEGATIVE
    image = heat_map(values, 2.0, *hues, palette.LIGHT)
    half = image.shape[0] // 4, image.shape[1] // 4
    centers = image[half[0] :: 2 * half[0], half[1] :: 2 * half[1]]
    assert tuple(centers[0, 0]) == palette.LIGHT.zero
    assert tuple(centers[0, 1]) == palette.WEIGHT_POSITIVE
    assert tuple(centers[1, 0]) == palette.WEIGHT_NEGATIVE


def test_opposite_signs_are_told_apart_without_red_or_green_cones() -> None:
    """Projected as by Viénot et al. (1999), opposite hues still differ plainly."""
    blind = {
        "protanope": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
        "deuteranope": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
    }
    pairs = (
        (palette.WEIGHT_POSITIVE, palette.WEIGHT_NEGATIVE),
        (palette.TRACE_POSITIVE, palette.TRACE_NEGATIVE),
        (palette.REWARD, palette.PUNISHMENT),
    )
    for matrix in blind.values():
        for a, b in pairs:
            seen = [np.array(matrix) @ (np.array(c) / 255) ** 2.2 for c in (a, b)]
            assert np.linalg.norm(seen[0] - seen[1]) > 0.15


def test_words_tell_when_the_network_is_stuck_and_not_otherwise() -> None:
    learner = Learner(make_task("pendulum"))
    learner.advance(30_000)
    assert status_text.stuck([learner.frame()]) is None
    for high in (0, 30_000):  # outputs that never fire, or always
        learner.advance(30_000)
        frame = learner.frame()
        spikes = np.array([15_000] * 4 + [high] * 2)
        stuck = status_text.stuck([replace(frame, since=replace(frame.since, spikes=spikes))])
        assert "constant" in (stuck or "")
    certain = np.stack([np.full(6, 20.0), np.full(6, 30.0)])
    since = replace(frame.since, potential_range=certain)
    assert "saturated" in (status_text.stuck([replace(frame, since=since)]) or "")
    assert status_text.stuck([replace(frame, since=replace(since, steps=1_000))]) is None


def test_every_unit_has_a_name_of_its_own() -> None:
    topology = feedforward(3, (2, 2), 1)
    names = unit_names(topology, ("p", "q", "r"))
    assert len(set(names)) == topology.units


# Rewards in words


class Heard:
    """What a pulse says and draws on a scene."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []

    def say(self, reward: str, world: str) -> None:
        self.said.append((reward, world))

    def draw_change(self, *_: object) -> None: ...

    def draw_pulse(self, *_: object) -> None: ...


def test_what_is_said_last_is_of_what_is_seen() -> None:
    learner, scene = Learner(make_task("sonar"), seed=1), Heard()
    pulse = Pulse(learner.topology.synapses)
    for k in range(5):  # faster than words can be read
        learner.advance(1)
        pulse.follow(learner.frame(), scene, f"step {k}", leaps=0, still=False)  # type: ignore[arg-type]
    assert len(scene.said) < 5
    still = learner.frame()
    assert still.since.steps == 0
    pulse.follow(still, scene, "nothing new", leaps=0, still=True)  # type: ignore[arg-type]
    assert scene.said[-1][1] == "step 4"
    count = len(scene.said)
    pulse.follow(still, scene, "nothing new", leaps=0, still=True)  # type: ignore[arg-type]
    assert len(scene.said) == count, "once"


@pytest.mark.parametrize("preset", ["baseline", "quick"])
def test_a_reward_is_told_of_when_it_comes_not_what_a_baseline_makes_of_none(preset: str) -> None:
    learner, scene = Learner(make_task("pendulum", preset), seed=1), Heard()
    learner.skip(2000)
    pulse, rewards = Pulse(learner.topology.synapses), 0
    learner.frame()
    for k in range(300):
        by_hand = 0.5 * (k in {150, 250})
        learner.give_reward(by_hand)
        came = bool(learner.advance(1).reward[0]) or by_hand > 0.0
        pulse.follow(learner.frame(), scene, "", leaps=k, still=True)  # type: ignore[arg-type]
        assert bool(scene.said[-1][0]) == came
        rewards += came
    assert rewards > 5


def test_after_a_leap_no_former_reward_is_told_of() -> None:
    learner, scene = Learner(make_task("sonar"), seed=1), Heard()
    pulse = Pulse(learner.topology.synapses)
    for leaps in range(1, 41):
        learner.skip(50)
        learner.advance(1)
        frame = learner.frame()
        pulse.follow(frame, scene, "", leaps=leaps, still=True)  # type: ignore[arg-type]
        told = scene.said[-1][0]
        assert told == (arrival(frame) if frame.since.tally.broadcast else "")
    assert {bool(reward) for reward, _ in scene.said} == {True, False}


def test_a_reward_is_told_as_it_came_and_as_it_was_sent() -> None:
    learner = Learner(make_task("sonar"), seed=1, rule=make_rule("baseline:time=10"))
    learner.skip(1000)
    learner.advance(1)
    frame = learner.frame()
    raw, sent = frame.reward
    assert raw in (0.0, 1.0)
    assert arrival(frame).startswith(f"r = {raw:+.3g}, m = {sent:+.3g}: Δw = γ m z, at most ")
    learner.set_rule(PAPER)
    learner.advance(20)
    frame = learner.frame()
    right = int(frame.since.tally.reward)
    assert 1 < right <= 20
    assert arrival(frame).startswith(f"Σ r = {right:+}: Δw = Σ γ r z, at most ")
