"""Many lanes in a run: each is the run that it would be alone, whichever of them is watched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hebbviz.conformance import same_learner
from hebbviz.learner.frames import join
from hebbviz.learner.learner import Learner
from hebbviz.server.live.commands import (
    BackToNow,
    EndFork,
    NextLane,
    Pause,
    Reset,
    Seek,
    SetSpeed,
    StartFork,
    TakeOver,
    Undo,
    WatchLane,
)
from hebbviz.server.live.excerpts import Watch
from hebbviz.server.live.fork import BETA, GAMMA, KINDS, Difference, Fork
from hebbviz.server.live.playback import Player
from hebbviz.server.page.panels import learning_curve
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.targets import FileTarget
from hebbviz.server.run.changes import Change, Freeze, GiveReward, SetBeta, SetGamma
from hebbviz.server.run.event_windows import ENOUGH, latest, pooled, pooled_curve, pools
from hebbviz.server.run.history import Curve, Curves, Totals
from hebbviz.server.run.lane_spread import Scores, Spread
from hebbviz.server.run.run import Run
from hebbviz.sims.experiments.statistics import quantiles
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.learner_from_arguments import MOST_SHOWN_LANES
from tests.server.test_worker import bench

LANES, SEED, STEPS = 5, 3, 3500
TASKS = ["sonar", "pendulum"]
PATIENCE = 20.0
"""Seconds; another run may take the machine meanwhile."""
CHANGES: dict[int, Change] = {
    700: SetBeta(0.6), 1500: GiveReward(2.0), 1501: Freeze(frozen=True), 2000: Freeze(frozen=False)
}  # fmt: skip


def new_run(task: str = "sonar", lanes: int = LANES, first_lane: int = 0) -> Run:
    made = make_task(task)
    return Run(Learner(made, seed=SEED, lanes=lanes, first_lane=first_lane), make_task)


def go_on(run: Run, until: int = STEPS, watched: dict[int, int] | None = None) -> Run:
    """With the changes, and with a lane chosen at some steps."""
    watched = watched or {}
    while run.learner.step < until:
        step = run.learner.step
        if step in CHANGES and not any(c.step == step for c in run.log):
            run.change(CHANGES[step])
        if step in watched:
            run.look_at(watched[step])
        if step % 500 == 0:
            run.keep()
        stops = [s for s in (*CHANGES, *watched, step // 500 * 500 + 500, until) if s > step]
        run.advance(min(stops) - step)
    return run


@pytest.fixture(scope="module", params=TASKS)
def many(request: pytest.FixtureRequest) -> Run:
    return go_on(new_run(request.param))


@pytest.fixture(scope="module")
def alone(many: Run) -> list[Run]:
    """Each lane as a run of its own."""
    return [go_on(new_run(many.task_name, 1, k)) for k in range(LANES)]


def assert_is_lane(one: Learner, lane: int, of_many: Learner) -> None:
    """A learner of one lane is that lane of another, to the bit."""
    a, b = one.keyframe(), of_many.keyframe().lane(lane)
    assert a.digest() == b.digest()


# The laws


def test_each_lane_is_the_run_that_it_would_be_alone(many: Run, alone: list[Run]) -> None:
    for lane, one in enumerate(alone):
        assert_is_lane(one.learner, lane, many.learner)


def test_the_curve_of_a_lane_is_that_of_its_own_run(many: Run, alone: list[Run]) -> None:
    for lane, one in enumerate(alone):
        curves = (r.history.curves(Totals.of(r.learner)) for r in (many, one))
        ours, own = (c.lane(k) for c, k in zip(curves, (lane, 0), strict=True))
        for name in ("end", "steps", "reward", "broadcast", "ended"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(own, name))
        assert many.history.edges(lane) == one.history.edges()


@settings(max_examples=10, deadline=None)
@given(watched=st.dictionaries(st.integers(0, STEPS - 1), st.integers(0, LANES - 1), max_size=6))
def test_choosing_a_lane_changes_nothing_but_what_is_seen(watched: dict[int, int]) -> None:
    run, rests = new_run(), go_on(new_run())
    seen: list[tuple[int, int]] = []
    for end in (1000, 2222, STEPS):
        go_on(run, end, watched)
        seen.append((run.learner.watch, run.learner.step))
        frame = run.frame()
        np.testing.assert_array_equal(frame.weight, run.learner.weights[:, run.learner.watch])
        assert frame.tally == run.learner.tally(run.learner.watch)
    assert same_learner(run.learner, rests.learner)
    assert run.log == rests.log


def test_a_frame_sums_up_the_watched_lane_alone() -> None:
    run, one = new_run(), Learner(make_task("sonar"), seed=SEED, first_lane=4)
    run.advance(300)
    run.look_at(4)
    block, frame = run.advance(200), run.frame()
    one.skip(300)
    want_block, want = one.advance(200), one.frame()
    np.testing.assert_array_equal(block.fired, want_block.fired)
    assert (frame.since.steps, frame.since.tally) == (200, want.since.tally)
    for name in ("spikes", "potential_range", "weight_change"):
        np.testing.assert_array_equal(getattr(frame.since, name), getattr(want.since, name))
    np.testing.assert_array_equal(frame.trace, want.trace)


# Mean and band


def test_mean_and_band_are_those_of_the_runs_alone(many: Run, alone: list[Run]) -> None:
    task = many.learner.task
    spread = Scores(task).spread(many.history.curves())
    scores = np.array([
        [task.score(t).value for t in one.history.curves().lane(0).tallies()] for one in alone
    ])  # fmt: skip
    assert len(spread.x) == STEPS // many.history.window
    if task.measure.logarithmic:
        want = np.quantile(scores, (0.25, 0.5, 0.75), axis=0)
    else:
        mean, deviation = scores.mean(axis=0), scores.std(axis=0, ddof=1)
        want = np.array([mean - deviation, mean, mean + deviation])
    np.testing.assert_allclose([spread.low, spread.middle, spread.high], want, rtol=1e-12)


def test_of_one_lane_the_band_is_its_curve() -> None:
    values = np.array([[3.0], [5.0]])
    measure = make_task("sonar").measure
    for kind in (measure, replace(measure, logarithmic=True, span=(1.0, 10.0))):
        spread = Spread.of(np.array([1.0, 2.0]), values, kind)
        for curve in (spread.low, spread.middle, spread.high):
            np.testing.assert_array_equal(curve, values[:, 0])


@given(st.lists(st.integers(0, 5), min_size=1), st.integers(0, 5))
@example([1, 2, 3, 4], 0)
@example([1, 2, 3, 4], 2)
def test_lanes_without_an_event_are_longer_than_all_others(seen: list[int], without: int) -> None:
    """Quantiles are those of lanes that had their event at last, as far as these do not count."""
    values = np.array([*seen, *[np.inf] * without])
    shares = (0.25, 0.5, 0.75)
    late = [np.quantile([*seen, *[after] * without], shares) for after in (1e3, 2e3)]
    want = np.where(late[0] == late[1], late[0], np.inf)
    np.testing.assert_allclose(quantiles(values, shares), want, rtol=1e-12)


SECONDS = 10.0
"""Of a window of 500 steps."""


def curve_of(falls: list[float]) -> Curve:
    many, n = np.array(falls, dtype=float), len(falls)
    return Curve(500, 500.0 * np.arange(1, n + 1), np.full(n, 500.0), -many, -many, many)


def test_windows_are_summed_up_until_five_falls() -> None:
    """So a window with one fall does not show its own length, nor is one without left out."""
    task = make_task("pendulum")
    falls = [9, 5, 0, 2, 0, 1, 3, 0, 0]
    end, value = learning_curve._scores(task, curve_of(falls))
    np.testing.assert_array_equal(end, [500, 1000, 4500])
    np.testing.assert_allclose(value, [10 / 9, 2.0, 70 / 6])
    assert len(learning_curve._dots(task, curve_of(falls))[0]) == 0
    end, value = learning_curve._scores(task, curve_of([1, 0]))
    assert value.tolist() == [20.0], "fewer at the start are one pool"
    words = learning_curve._now(task, curve_of([9, 1, 0, 3, 1]))
    assert "8 s (5 falls; 95 %: " in words and "over the last 2,000 steps" in words


def test_a_run_that_never_fell_has_no_time_to_fall_but_a_dot() -> None:
    task = make_task("pendulum")
    assert np.isnan(learning_curve._scores(task, curve_of([0, 0, 0]))[1]).all()
    (x,), (over,) = learning_curve._dots(task, curve_of([0, 0, 0]))
    assert (x, over) == (1500.0, pytest.approx(30.0 / -np.log(0.05)))
    lanes = Spread.of(np.array([500.0]), np.array([[5.0, np.inf, np.inf]]), task.measure)
    (_, middle), ((_, low), (_, high)) = learning_curve._drawn(lanes, task.measure)
    assert np.isnan(middle).all()
    assert high == low == task.measure.span[1]


def test_the_curve_is_right_where_windows_are_far_shorter_than_the_time_to_fall() -> None:
    """Falls by chance, 100 s apart on average, in windows of 10 s: over many runs, all points."""
    task, coins = make_task("pendulum"), np.random.default_rng(4)
    curves = [curve_of(coins.poisson(SECONDS / 100.0, 512).tolist()) for _ in range(200)]
    values = np.concatenate([learning_curve._scores(task, curve)[1] for curve in curves])
    assert len(values) > 200 * 7
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert abs(values.mean() - 100.0) < SECONDS / 2.0 + 4.0 * error, "a pool ends with its window"


def test_lanes_are_pooled_each_by_itself() -> None:
    coins = np.random.default_rng(5)
    falls = coins.poisson(0.7, (40, 6)).astype(float)
    falls[:, 5] = 0.0
    found = pools(falls)
    for lane in range(5):
        alone = pooled_curve(curve_of(falls[:, lane].tolist()), falls[:, lane])
        last = np.append(np.diff(found[:, lane]) > 0, True)
        np.testing.assert_array_equal(pooled(falls, found)[last, lane], alone.ended)
        assert (alone.ended >= ENOUGH).all()
        assert alone.steps.sum() == 40 * 500.0
        assert falls[-latest(falls[:, lane]) :, lane].sum() >= ENOUGH
        assert falls[-latest(falls[:, lane]) :, lane][1:].sum() < ENOUGH
    assert (found[:, 5] == 0).all()
    assert latest(falls[:, 5]) == 40


def test_scores_that_are_known_are_not_made_again_and_stay_true() -> None:
    """Through a doubling of the windows, and an undo."""
    run, scores = new_run("pendulum", 2), Scores(make_task("pendulum"))
    run.history.window = 8
    for end in (100, 101, 4100, 4110):
        while run.learner.step < end:
            run.advance(end - run.learner.step)
        if end == 100:
            run.change(SetBeta(0.5))
        curves = run.history.curves(Totals.of(run.learner))
        fresh = Scores(run.learner.task).of(curves)
        np.testing.assert_array_equal(scores.of(curves), fresh)
    assert run.history.window == 16
    run.undo()
    curves = run.history.curves()
    np.testing.assert_array_equal(scores.of(curves), Scores(run.learner.task).of(curves))


@given(st.lists(st.integers(0, 2), min_size=1, max_size=80), st.integers(1, 20), st.integers(1, 3))
def test_coarser_windows_sum_to_the_same(rewards: list[int], most: int, window: int) -> None:
    total = np.cumsum([0, *rewards])
    edges = tuple(Totals(window * k, np.full((3, 2), float(n))) for k, n in enumerate(total))
    coarse = Curves(window, edges).coarser(most)
    curve = coarse.lane(1)
    assert len(curve.end) <= most
    assert coarse.window % window == 0
    for end, steps, reward in zip(curve.end, curve.steps, curve.reward, strict=True):
        first, last = int(end - steps) // window, int(end) // window
        assert reward == total[last] - total[first]
    assert (curve.steps == coarse.window).all()
    assert not len(curve.end) or curve.end[-1] > edges[-1].steps - coarse.window


# Going back


def test_undo_and_another_number_of_lanes(many: Run) -> None:
    run = go_on(new_run(many.task_name), 1000)
    run.look_at(3)
    before = run.learner.keyframe().digest()
    run.reset(lanes=2)
    assert (run.learner.lanes, run.learner.watch, run.learner.seed) == (2, 0, SEED)
    assert run.undo_words == "2 lanes"
    run.advance(50)
    again = Learner(make_task(many.task_name), seed=SEED, beta=0.6)
    again.skip(run.learner.step)
    assert_is_lane(again, 0, run.learner)
    run.undo()
    assert (run.learner.keyframe().digest(), run.learner.watch) == (before, 0)
    assert same_learner(go_on(run).learner, many.learner)
    run.look_at(3)
    run.reset()
    assert (run.learner.lanes, run.learner.watch) == (LANES, 3)


def test_another_task_begins_with_one_lane_and_another_network_with_as_many() -> None:
    run = new_run()
    run.choose("sonar", "paper", (4,))
    assert run.learner.lanes == LANES
    run.choose("pendulum")
    assert run.learner.lanes == 1


def test_the_past_shows_the_chosen_lane_and_can_be_taken_over(many: Run, alone: list[Run]) -> None:
    run = go_on(new_run(many.task_name))
    run.look_at(2)
    player = Player(run)
    player.seek(1742)
    one = Learner(make_task(many.task_name), seed=SEED, first_lane=2)
    blocks = []
    while one.step < 1742:
        if one.step in CHANGES:
            CHANGES[one.step].apply(one)
        blocks.append(one.advance(min(s for s in (*CHANGES, 1742) if s > one.step) - one.step))
    assert_is_lane(one, 2, player.replay.learner)
    recent = player.trail.recent
    assert recent is not None
    np.testing.assert_array_equal(recent.fired, join(blocks).tail(len(recent.fired)).fired)
    np.testing.assert_array_equal(player.trail.frames[-1].weight, one.weights[:, 0])
    run.take_over(player.replay)
    assert run.history.edges(2) == tuple(t for t in alone[2].history.edges() if t.steps <= 1742)
    assert same_learner(go_on(run).learner, many.learner)
    assert run.history.edges(4) == alone[4].history.edges()


def test_excerpts_go_on_in_the_chosen_lane() -> None:
    run, watch = new_run(), Watch()
    watch.on = True
    for _ in range(50):
        moment = run.moment()
        watch.note(moment, run.advance(20))
    assert watch.play(run, 0.1) is not None
    watch.look_at(4)
    played = watch.play(run, 1.0)
    assert played is not None
    replay, block = played
    one = Learner(make_task("sonar"), seed=SEED, first_lane=4)
    one.skip(replay.learner.step)
    np.testing.assert_array_equal(replay.learner.frame().weight, one.frame().weight)
    assert block is not None
    assert_is_lane(one, 4, replay.learner)
    assert not watch.show_reward(run), "the latest reward was another lane's"


@pytest.mark.parametrize("kind", KINDS)
def test_a_fork_does_not_depend_on_the_watched_lane(kind: str) -> None:
    value = 0.9 if kind == BETA else 1e-2 if kind == GAMMA else None
    ends = []
    for lane in (0, 3):
        run = go_on(new_run(), 600)
        fork = Fork(run, Difference(kind, value))
        fork.look_at(lane)
        run.look_at(lane)
        for _ in range(4):
            run.advance(100)
            fork.follow(run.learner.step)
        assert fork.frame().tally == fork.learner.tally(lane)
        ends.append((run.learner.keyframe().digest(), fork.learner.keyframe().digest()))
    assert ends[0] == ends[1]
    assert ends[0][0] != ends[0][1]


# Recordings


def test_the_watched_lane_is_recorded_as_the_run_that_it_is(tmp_path: Path) -> None:
    run = new_run()
    run.look_at(1)
    recorder = Recorder(FileTarget(tmp_path / "run.rrd"), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    go_on(run, watched={1600: 4})
    recorder.close(run)
    first, second = (open_recording(tmp_path / name) for name in ("run.rrd", "run-2.rrd"))
    assert first.ending == "lane 4 was selected"
    assert [r.header.first_lane for r in (first, second)] == [1, 4]
    assert (first.last_step, second.header.step, second.last_step) == (1600, 1600, STEPS)
    back = second.run(make_task, make_task("sonar"))
    assert_is_lane(back.learner, 4, run.learner)
    assert back.history.edges() == run.history.edges(4)
    replay = first.run(make_task, make_task("sonar")).replay(first.moments[0])
    replay.go_to(1600)
    assert replay.moment().keyframe.digest() == first.moments[-1].keyframe.digest()
    one = go_on(new_run("sonar", 1, 1), 1600)
    assert_is_lane(replay.learner, 0, one.learner)


# Through the worker


def test_the_worker_shows_the_chosen_lane_everywhere() -> None:
    with bench(new_run(), SetSpeed(2000.0)) as b:
        b.send(WatchLane(2))
        snapshot = b.until(lambda p: p.run.lane == 2 and p.run.live.step > 3000, PATIENCE)
        assert snapshot.run.lanes == LANES
        own = snapshot.run.curves.lane(2)
        np.testing.assert_array_equal(snapshot.run.curve.reward, own.reward)
        b.send(Pause(paused=True), Seek(1500))
        past = b.until(lambda p: p.view.past is not None and p.view.frame.step == 1500, PATIENCE)
        one = Learner(make_task("sonar"), seed=SEED, first_lane=2)
        one.skip(1500)
        np.testing.assert_array_equal(past.view.frame.weight, one.weights[:, 0])
        b.send(WatchLane(4))
        past = b.until(lambda p: p.run.lane == 4, PATIENCE)
        other = Learner(make_task("sonar"), seed=SEED, first_lane=4)
        other.skip(1500)
        np.testing.assert_array_equal(past.view.frame.weight, other.weights[:, 0])
        b.send(TakeOver(), Pause(paused=True), StartFork(GAMMA, 0.5), WatchLane(1))
        both = b.until(lambda p: p.view.other is not None and p.run.lane == 1, PATIENCE)
        assert both.view.other is not None
        assert both.view.other.frame.tally == both.run.live.tally
        b.send(EndFork(keep_other=True), Undo(), BackToNow(), WatchLane(LANES), WatchLane(-1))
        b.until(lambda _: len(b.notices) >= 3, PATIENCE)
        assert b.notices[1:] == [
            f"lane must be from 0 to {LANES - 1}, got {k}" for k in (LANES, -1)
        ]
        b.send(NextLane(), NextLane(-1), NextLane(-1), NextLane(-1))
        b.until(lambda p: p.run.lane == LANES - 1, PATIENCE)
        b.send(Reset(lanes=1), SetGamma(0.1), NextLane())
        alone = b.until(lambda p: p.run.lanes == 1 and p.run.gamma == 0.1, PATIENCE)
        assert (alone.run.lane, alone.run.undo_words) == (0, "γ 0.1")


@pytest.mark.parametrize("lanes", [0, -1, MOST_SHOWN_LANES + 1])
def test_a_number_of_lanes_has_bounds(lanes: int) -> None:
    with pytest.raises(ValueError, match=f"lanes must be from 1 to {MOST_SHOWN_LANES}, got"):
        Reset(lanes=lanes)
