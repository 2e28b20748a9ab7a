"""A signal in noise: what it is measured against, what is shown of it, and that it learns."""

import itertools

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.filtering import BASELINE, COLUMNS, NOISE, SWITCH, Filtering, bayes_filter
from hebbviz.task.finite import NOTHING

LANES = 8


def table(world, says):
    """The exact share of right answers of a memoryless policy, a control for each sight."""

    class Fixed:
        def probabilities(self, theta):
            return np.eye(world.controls)[list(says)]

        def score(self, theta):
            return np.zeros((world.sights, world.controls, 1))

    return world.under(Fixed(), np.zeros(1)).average_reward


def test_the_baseline_is_the_best_without_a_memory():
    shares = [table(Filtering.pomdp, says) for says in itertools.product((0, 1), repeat=2)]
    assert max(shares) == pytest.approx(BASELINE, abs=1e-12)
    assert table(Filtering.pomdp, (0, 1)) == pytest.approx(BASELINE, abs=1e-12)


def recorded(steps, seed=0):
    """Signals and what was seen of them in a run of the world, 0 for -1."""
    learner = Learner(Filtering(), seed=seed)
    world = learner.advance(steps, closely=True).world
    return world[:, 0].astype(int) >> 1, world[:, 1].astype(int)


def test_the_world_is_as_it_says():
    signal, seen = recorded(200_000)
    switches = np.diff(signal) != 0
    assert switches.mean() == pytest.approx(SWITCH, abs=0.002)
    assert (signal != seen).mean() == pytest.approx(NOISE, abs=0.004)


def test_the_bayes_filter_lies_between_its_bounds():
    """The bounds close in as they see more; the filter itself, run on the world, is between."""
    bounds = [bayes_filter(seen) for seen in (1, 4, 8, 12, 18)]
    lower, upper = zip(*bounds, strict=True)
    assert list(lower) == sorted(lower)
    assert list(upper) == sorted(upper, reverse=True)
    assert lower[0] == pytest.approx(BASELINE)
    assert 0.0 < upper[-1] - lower[-1] < 1e-4
    signal, seen = recorded(200_000)
    belief, right, late = 0.5, 0, 0
    for now, y, after in zip(signal[:-1], seen[:-1], signal[1:], strict=True):
        belief = belief * (1 - SWITCH) + (1 - belief) * SWITCH
        one = belief * (1 - NOISE if y else NOISE)
        belief = one / (one + (1 - belief) * (NOISE if y else 1 - NOISE))
        right += (belief > 0.5) == now
        late += (belief > 0.5) == after
    best = upper[-1]
    assert right / len(signal) == pytest.approx(best, abs=0.004)
    assert late / len(signal) == pytest.approx(0.909, abs=0.004)
    assert best * (1 - SWITCH) + (1 - best) * SWITCH == pytest.approx(0.909, abs=5e-4)


def test_it_is_learnt_well_above_the_baseline():
    """8 seeds, 300 000 steps each; of 32, after 10⁶, the worst was right 0.88 of the time."""
    learner = Learner(Filtering(), lanes=LANES)
    learner.skip(240_000)
    before = [learner.tally(k) for k in range(LANES)]
    learner.skip(60_000)
    right = [(learner.tally(k) - b).average_reward for k, b in enumerate(before)]
    assert min(right) > BASELINE + 0.04
    assert np.median(right) > BASELINE + 0.06
    assert max(right) < bayes_filter()[1]


def test_it_is_the_memory_that_does_it():
    """Without a hidden layer nothing is remembered, and the baseline is the most."""
    learner = Learner(Filtering(), hidden=(), lanes=LANES)
    assert len(learner.topology.projections) == 1
    learner.skip(100_000)
    before = sum(learner.tally(k).reward for k in range(LANES))
    learner.skip(50_000)
    share = (sum(learner.tally(k).reward for k in range(LANES)) - before) / (50_000 * LANES)
    assert BASELINE - 0.01 < share < BASELINE + 0.005


def test_hidden_layers_hear_themselves():
    names = {p.name for p in Filtering().topology((3, 2)).projections}
    assert {"hidden 1 → hidden 1", "hidden 2 → hidden 2", "hidden 1 → hidden 2"} <= names
    assert "output → output" not in names


def test_what_is_shown_is_what_happened():
    """Rows of signals, sights and answers, against the run they are of."""
    task = Filtering()
    learner = Learner(task, seed=3)
    block = learner.advance(60, closely=True)
    signal, seen = block.world[:, 0].astype(int) >> 1, block.world[:, 1].astype(int)
    rows = task.traces(block.world)
    answered = block.fired[:, -1]
    for step in range(COLUMNS, 60):
        shown = slice(step - COLUMNS + 1, step + 1)
        assert np.array_equal(rows[0][step], signal[shown])
        assert np.array_equal(rows[1][step], seen[shown])
        assert np.array_equal(rows[2][step][:-1], answered[shown.start + 1 : shown.stop])
        assert rows[2][step][-1] == NOTHING
    assert (rows[0][3][: COLUMNS - 5] == NOTHING).all()
    right = task.read(block.world)[:, 0] == task.read(block.world)[:, 2]
    assert np.array_equal(right, block.reward == 1.0)


class Forgetful(Filtering):
    """The same, without a past to show."""

    past = 0
    props = ()


class Old(Forgetful):
    past = 17


def test_the_past_is_shown_and_changes_nothing():
    with_past, without = (Learner(make(), seed=2, lanes=3) for make in (Filtering, Forgetful))
    for learner in (with_past, without):
        learner.advance(500)
    assert np.array_equal(with_past.network, without.network, equal_nan=True)
    assert np.array_equal(with_past.world[:2], without.world)
    assert [row.shape for row in without.task.history(without.world.T)] == [(3, 1), (3, 1)]


def test_a_past_that_is_too_long_is_refused():
    with pytest.raises(ValueError, match="a past of 17 steps of 8 pairs is too long"):
        Old()


def test_the_figures_stand_side_by_side():
    task = make_task("filtering")
    learner = Learner(task)
    learner.advance(1000)
    results, frozen = task.results(learner, learner.tally()), task.evaluate(learner)
    assert set(results) == {"right", "baseline", "best"}
    assert set(frozen) == {"right", "baseline", "best"}
    assert results["baseline"] < results["best"]
    assert frozen["baseline"] < frozen["best"]
    assert set(task.frozen_figures) < set(frozen)
