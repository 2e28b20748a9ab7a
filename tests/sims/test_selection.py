"""Nested selection of sonar's setting: what each run may see, and what the choice follows from."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.sims.experiments import Interrupted, Plan
from hebbviz.sims.figures import selection, sonar
from hebbviz.sims.figures.run_figure import Work
from hebbviz.sims.figures.selection import outer_plans, select
from hebbviz.sims.figures.sonar_splits import VALIDATION, Inner, Outer
from hebbviz.sims.worlds.sonar import GRID, PATTERNS, TRAINING, Sonar, load

ORDER, MEAN = 9, 9 + PATTERNS
PLAN = Plan(
    task="sonar", preset="best", seed=5, lanes=3, segments=1, segment_steps=2 * Sonar("best").epoch,
    evaluate=1, options={"dtype": "float32"},
)  # fmt: skip


def order_of(task, lanes=1, first_lane=0):
    """The patterns of each lane, the training set first, (lanes, 208)."""
    learner = Learner(task, seed=5, lanes=lanes, first_lane=first_lane, hidden=())
    return learner.world[ORDER:MEAN].T.astype(int)


def test_an_inner_run_learns_within_the_training_set_of_its_split():
    inner = TRAINING - VALIDATION
    assert (inner, VALIDATION) == (140, 47), "a quarter of the training set validates"
    np.testing.assert_array_equal(order_of(Inner("best"), 3), order_of(Sonar("best"), 3))
    learner = Learner(Inner("best"), seed=5, hidden=())
    (order,) = order_of(Sonar("best"))
    np.testing.assert_allclose(
        learner.world[MEAN : MEAN + 60, 0], load()[order[:inner], :60].mean(0)
    )
    shown = set()
    for _ in range(2 * inner):
        shown.add(int(learner.world[3, 0]))
        learner.skip(learner.task.hold)
    assert shown == set(order[:inner])
    assert learner.task.epoch == inner * learner.task.hold


def test_nothing_that_chooses_depends_on_the_test_set(monkeypatch):
    """With other patterns in its place a run and its validation error are the same, to the bit."""
    (order,) = order_of(Sonar("best"))

    def validated():
        learner = Learner(Inner("best"), seed=5, hidden=(3,))
        learner.skip(learner.task.epoch)
        return learner.weights.copy(), learner.task.evaluate(learner)

    weights, errors = validated()
    other = load().copy()
    other[order[TRAINING:]] = 1.0 - other[order[TRAINING:]]
    monkeypatch.setattr("hebbviz.sims.worlds.sonar.load", lambda: other)
    again, same = validated()
    np.testing.assert_array_equal(weights, again)
    assert same == errors
    assert errors.keys() == {"training_error", "validation_error"}
    other[order[TRAINING - VALIDATION : TRAINING]] = 0.5
    assert validated()[1]["validation_error"] != errors["validation_error"], "but on these it does"


def test_an_outer_run_has_the_split_that_it_is_given():
    splits = (4, 0, 7)
    task = Outer("best", first_lane=2, splits=splits)
    found, known = order_of(task, 3, first_lane=2), order_of(Sonar("best"), 8)
    np.testing.assert_array_equal(found, known[list(splits)])
    assert (task.training, task.held_out) == (187, 21)


def test_each_split_is_run_once_with_what_was_chosen_and_numbers_of_its_own():
    chosen = np.array([1, 0, 3, 1, 0, 1])
    plans = outer_plans(PLAN, chosen)
    assert [p.splits for p in plans] == [(1, 4), (0, 3, 5), (2,)]
    assert [(p.preset, p.gamma) for p in plans] == [
        (GRID[k].preset, GRID[k].gamma) for k in (0, 1, 3)
    ]  # fmt: skip
    numbers = [k for p in plans for k in range(p.first_lane, p.first_lane + p.lanes)]
    assert numbers == list(range(6))
    assert len({p.digest() for p in plans}) == 3


def cheap(monkeypatch):
    """Runs of the same kinds, with few hidden units and short evaluations."""
    monkeypatch.setattr("hebbviz.sims.worlds.sonar.HOLD", 100)
    for kind in (Inner, Outer):
        monkeypatch.setattr(kind, "topology", lambda self, _=None: Sonar.topology(self, (2,)))


def test_the_setting_is_that_of_the_least_validation_error(monkeypatch, tmp_path):
    """Told again by learners of one's own; and an interruption changes nothing."""
    cheap(monkeypatch)
    told: list[float] = []
    found = select(PLAN, Work(tmp_path / "whole", progress=told.append))
    assert told == sorted(told) and told[-1] == 1.0, "the bar goes on, and to its end"
    for k, setting in enumerate(GRID):
        task = Inner(setting.preset)
        learner = Learner(task, gamma=setting.gamma, seed=5, lanes=3, dtype="float32")
        learner.skip(2 * task.epoch)
        errors = task.evaluate(learner)["validation_error"]
        np.testing.assert_array_equal(found.validation[k], errors)
    np.testing.assert_array_equal(found.chosen, found.validation.argmin(axis=0))
    np.testing.assert_array_equal(found.of_chosen, found.validation.min(axis=0))
    assert sum(found.counts) == 3
    for plan in outer_plans(PLAN, found.chosen):
        learner = plan.learner(plan.first_lane, plan.lanes)
        learner.skip(PLAN.steps)
        for name, errors in learner.task.evaluate(learner).items():
            got = found.curves.figures[name][list(plan.splits), -1]
            np.testing.assert_array_equal(got, errors)
    stop = threading.Event()
    stopped = Work(tmp_path / "cut", stop, lambda done: stop.set() if done > 0.3 else None)
    with pytest.raises(Interrupted):
        select(PLAN, stopped)
    again = select(PLAN, Work(tmp_path / "cut", progress=(left := []).append))
    assert left[0] > 0.0, "it goes on"
    np.testing.assert_array_equal(again.validation, found.validation)
    for name, errors in found.curves.figures.items():
        np.testing.assert_array_equal(again.curves.figures[name], errors)


def test_of_settings_chosen_equally_often_the_least_validation_error_decides():
    chosen = np.array([0, 1, 0, 1, 2])
    validation = np.array([[0.2] * 5, [0.1] * 5, [0.05] * 5, [0.3] * 5])
    found = selection.Selection(validation, chosen, None)
    assert found.counts == [2, 2, 1, 0]
    assert found.most_often == GRID[1]


def test_the_preset_is_among_the_settings_it_was_chosen_from():
    best = Sonar("best").preset
    assert ("best", best.gamma) in [(s.preset, s.gamma) for s in GRID]


@pytest.mark.parametrize(
    ("preset", "name"),
    [("best", "validation_error"), ("best:centred=no", "validation_error"), ("paper", "test_error"),
     ("quick:scaled=yes", "test_error")],
)  # fmt: skip
def test_what_these_patterns_chose_has_no_test_error(preset, name):
    task = Sonar(preset)
    assert task.frozen_figures == ("training_error", name)
    learner = Learner(task, hidden=())
    assert tuple(task.evaluate(learner)) == task.frozen_figures
    assert set(task.results(learner, learner.tally())) == set(task.frozen_figures)


def test_the_figure_says_what_was_chosen_and_by_what(monkeypatch, tmp_path):
    cheap(monkeypatch)
    found = select(PLAN, Work(tmp_path))
    result = sonar._Result(PLAN, Sonar("best"), found.curves, found)
    numbers, words = sonar._numbers(result), " ".join(sonar._chosen(result))
    assert [g["chosen"] for g in numbers["grid"]] == found.counts
    for point, setting, errors in zip(numbers["grid"], GRID, found.validation, strict=True):
        assert (point["preset"], point["gamma"]) == (setting.preset, setting.gamma)
        assert point["validation_error"] == pytest.approx(errors.mean())
        assert point["validation_error_sd"] == pytest.approx(errors.std(ddof=1))
    test = found.curves.figures["test_error"][:, -1]
    assert numbers["test_error"] == pytest.approx(test.mean())
    assert numbers["test_error_sd"] == pytest.approx(test.std(ddof=1))
    assert numbers["test_error_se"] == pytest.approx(test.std(ddof=1) / 3**0.5)
    assert numbers["gamma"] is None, "each split has its own"
    assert "140 of the 187" in words and "13-fold" in numbers["back_propagation_protocol"]
    columns = sonar._table(result)
    chosen = [GRID[k] for k in found.chosen]
    for k, setting in enumerate(chosen):
        assert columns[f"setting_{k}"][0] == f"{setting.preset} gamma={setting.gamma}"
