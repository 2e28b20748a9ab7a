"""Other rules than the paper's: what they send, and that they are a part of the run like it."""

import math
import re
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hebbviz import sims
from hebbviz.conformance import check_rule, same_learner
from hebbviz.engine.loop import FALL_EVERY
from hebbviz.learner.learner import Learner, TaskError
from hebbviz.learner.saves import BadFile, load, save
from hebbviz.rules import base as rules
from hebbviz.rules.base import Rule, make_rule, parameter, register, rule_names
from hebbviz.rules.baseline import Baseline
from hebbviz.rules.paper import Paper
from hebbviz.rules.trial import try_out
from hebbviz.rules.yoked import Yoked
from hebbviz.server.live.fork import KINDS, Difference, Fork
from hebbviz.server.recording.header import check_recordable
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.recording.targets import FileTarget
from hebbviz.server.run.changes import SetBeta, SetFall, SetRule
from hebbviz.server.run.run import Run
from hebbviz.sims.experiments import Plan
from hebbviz.sims.experiments.run import _completed
from hebbviz.sims.loading import compiled_twin, load_rule, make_task
from hebbviz.sims.worlds.lamps import Lamps, small_example
from hebbviz.task.base import Reading

LEVER = f"{Path(__file__).parents[1] / 'examples' / 'lever.py'}:Lever"


def in_lanes(make):
    return compiled_twin(make())


def has_lanes(make):
    task = make()
    return compiled_twin(task) is not task


TASKS = {name: partial(make_task, name) for name in sims.TASKS.names}
TASKS |= {"lamps": Lamps, "lever": partial(make_task, LEVER)}
TASKS |= {f"{name} in lanes": partial(in_lanes, m) for name, m in TASKS.items() if has_lanes(m)}
OWN = """
from dataclasses import dataclass
from hebbviz.rules import Rule, parameter
from hebbviz.task import Reading

@dataclass(frozen=True)
class Late(Rule):
    name = "late"
    summary = "the reward of the step before, times something"
    memory = (Reading("reward before"),)
    times: float = parameter(2.0, least=0.0, most=10.0)

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        for lane in range(len(reward)):
            sent[lane] = constants[0] * memory[0, lane]
            memory[0, lane] = reward[lane]
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A rule in a user's own file, unknown by its name until it is loaded."""
    monkeypatch.setattr(rules, "_own", {})
    path = tmp_path / "late.py"
    path.write_text(OWN)
    return f"{path}:Late"


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("rule", [Paper(), Baseline(time=20.0), Yoked()], ids=str)
def test_every_rule_fits_every_task(rule, task):
    check_rule(rule, TASKS[task])


@dataclass(frozen=True)
class Ends(Rule):
    """Sends 1 where an episode ended, whatever the reward."""

    name = "ends"

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        for lane in range(len(ended)):
            sent[lane] = ended[lane]


@pytest.mark.parametrize("task", ["pendulum", "pendulum in lanes"])
def test_a_rule_is_told_where_episodes_end(task):
    """In every lane, at the step itself: at the one whose reward is −1."""
    learner = Learner(TASKS[task](), rule=Ends(), lanes=3, seed=2)
    block = learner.advance(400)
    assert np.array_equal(block.broadcast, block.ended)
    ends = []
    for _ in range(200):
        learner.advance(1)
        raw, sent = learner._tiles.read("reward")
        assert np.array_equal(sent, -raw)
        ends.append(sent)
    assert block.ended.any()
    assert len(np.unique(ends, axis=1).T) == 3, "no two lanes end alike"


# The reward baseline


def baselines(reward, time):
    """b_{t−1} of each step: what is taken off its reward."""
    b, before = 0.0, np.empty(len(reward))
    for t, r in enumerate(reward):
        before[t] = b
        b += (r - b) / time
    return before, b


@pytest.mark.parametrize("task", ["lamps", "pendulum"])
def test_the_baseline_is_the_mean_of_the_rewards_before(task):
    learner = Learner(TASKS[task](), rule=Baseline(time=50.0), seed=2)
    block = learner.advance(700)
    before, last = baselines(block.reward, 50.0)
    assert np.ptp(block.reward) > 0
    np.testing.assert_allclose(block.broadcast, block.reward - before, rtol=0, atol=1e-12)
    np.testing.assert_allclose(learner.memory, [[last]], rtol=0, atol=1e-12)


def test_reward_by_hand_comes_after_the_rule():
    """It is sent as it was given, and the baseline does not get used to it."""
    learner, other = (Learner(Lamps(), rule=Baseline(time=10.0)) for _ in range(2))
    learner.give_reward(3.0)
    given, plain = learner.advance(1), other.advance(1)
    assert given.broadcast[0] == plain.broadcast[0] + 3.0
    assert np.array_equal(learner.memory, other.memory)


class Shifted(Lamps):
    """The lamps with 5 added to every reward."""

    pomdp = replace(Lamps.pomdp, rewards=Lamps.pomdp.rewards + 5.0)


def test_a_number_added_to_all_rewards_is_taken_off_again():
    """m is the same in both worlds once b has taken it in; r stays 5 apart."""
    steps, runs = 3000, {}
    for task in (Lamps, Shifted):
        for rule in (Paper(), Baseline(time=100.0)):
            learner = Learner(task(), rule=rule, gamma=0.0, seed=4)
            runs[task, rule.name] = learner.advance(steps)
    late = slice(2000, None)
    gap = runs[Shifted, "baseline"].broadcast - runs[Lamps, "baseline"].broadcast
    assert gap[0] == 5.0
    assert np.abs(gap[late]).max() < 1e-7
    assert np.all(runs[Shifted, "paper"].broadcast - runs[Lamps, "paper"].broadcast == 5.0)


def estimate(rule, task, *, lanes=64, steps=20_000):
    """E[m z] with the weights all but held, and its standard error, (synapses,) each."""
    gamma = 1e-9
    learner = Learner(task, rule=rule, gamma=gamma, lanes=lanes, seed=5)
    learner.set_weights(np.repeat(small_example()[1][:, None], lanes, axis=1))
    learner.skip(2_000)
    before = learner.weights
    learner.skip(steps)
    mean = (learner.weights - before) / (gamma * steps)
    return mean.mean(axis=1), mean.std(axis=1, ddof=1) / math.sqrt(lanes)


def test_with_the_baseline_learning_has_the_same_direction_and_less_noise():
    """E[m z] is E[r z] of the exact chain, whatever is added to all rewards.

    The paper's rule shows it where nothing is added; with 5 added its noise drowns it.
    """
    network, weights = small_example()
    exact = network.at(weights).biased_gradient(Lamps().preset.beta)
    plain, plain_error = estimate(Paper(), Lamps())
    _, raw_error = estimate(Paper(), Shifted())
    mean, error = estimate(Baseline(time=500.0), Shifted())
    # T is 100 times 1/(1 − β), so that the mean is smaller by about 1 %
    assert np.all(np.abs(mean - exact) < 5.0 * error + 0.02 * np.abs(exact).max())
    assert np.all(np.abs(plain - exact) < 5.0 * plain_error)
    assert np.all(5.0 * plain_error < 0.5 * np.abs(exact))
    assert np.all(error < 0.5 * plain_error) and np.all(error < 0.1 * raw_error)


# The yoked control


def late_reward(rule, task, *, steps, lanes):
    """Average reward of each lane over the second half."""
    learner = Learner(task, rule=rule, lanes=lanes, seed=3)
    learner.skip(steps // 2)
    before = [learner.tally(k) for k in range(lanes)]
    learner.skip(steps // 2)
    return np.array([(learner.tally(k) - before[k]).average_reward for k in range(lanes)])


def test_the_yoked_learn_nothing_where_the_rule_learns():
    """Chance earns 0.5; the yoked go here and there, to both sides of it alike."""
    steps = 60_000
    for rule in (Paper(), Baseline()):
        assert np.median(late_reward(rule, Lamps(), steps=steps, lanes=8)) > 0.7
    yoked = late_reward(Yoked(), Lamps(), steps=steps, lanes=64)
    assert abs(yoked.mean() - 0.5) < 4.0 * yoked.std(ddof=1) / math.sqrt(64)
    assert yoked.mean() < 0.56


def test_a_yoked_lane_is_sent_the_reward_of_the_next():
    learner = Learner(Lamps(), rule=Yoked(), lanes=3, seed=1)
    for _ in range(50):
        learner.advance(1)
        raw, sent = learner._tiles.read("reward")
        assert np.array_equal(sent, np.roll(raw, -1))


def test_one_lane_cannot_be_yoked():
    with pytest.raises(ValueError, match=r"^rule yoked needs 2 lanes or more.* has 1$"):
        Learner(Lamps(), rule=Yoked())
    learner = Learner(Lamps())
    with pytest.raises(ValueError, match="yoked"):
        learner.set_rule(Yoked())
    assert learner.rule == Paper()


def test_more_lanes_than_are_stepped_together_cannot_be_yoked():
    """The last of a tile would be sent the reward of its first."""
    learner = Learner(Lamps(), rule=Yoked(), lanes=64, seed=1)
    learner.advance(1)
    raw, sent = learner._tiles.read("reward")
    assert np.array_equal(sent, np.roll(raw, -1))
    words = r"^rule yoked lets lanes touch [^\n]* at most 64 lanes, this learner has 67$"
    with pytest.raises(ValueError, match=words):
        Learner(Lamps(), rule=Yoked(), lanes=67)
    learner = Learner(Lamps(), lanes=67)
    moment = learner.keyframe()
    with pytest.raises(ValueError, match=words):
        learner.set_rule(Yoked())
    with pytest.raises(ValueError, match=words):
        learner.restore(replace(moment, rule=Yoked()))
    assert learner.rule == Paper()
    assert learner.keyframe().digest() == moment.digest()


@dataclass(frozen=True)
class Among(Rule):
    """The reward less the mean over the lanes. One lane will do, though nothing is sent there."""

    name = "among"
    summary = "how much better than the other lanes"
    lanes_touch = True

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        mean = reward.mean()
        for lane in range(len(reward)):
            sent[lane] = reward[lane] - mean


class Apart(Among):
    """Does not say that lanes touch each other."""

    lanes_touch = False


def test_lanes_touch_each_other_whatever_the_least_of_them(monkeypatch):
    """They are not cut up, and none is recorded."""
    monkeypatch.setattr(rules, "_own", {"among": Among})
    options = {"rule": "among"}
    plan = Plan(task="lamps", lanes=60, segments=1, segment_steps=40, options=options)
    assert [(t.first_lane, t.lanes) for t in _completed(plan, [], 5)] == [(0, 60)]
    with pytest.raises(ValueError, match="lanes under rule among depend on each other"):
        check_recordable(Among())


def test_a_rule_that_hides_that_lanes_touch_each_other_is_found(monkeypatch):
    monkeypatch.setattr(rules, "_own", {"among": Among})
    check_rule(Among(), Lamps)
    monkeypatch.setattr(rules, "_own", {"among": Apart})
    with pytest.raises(AssertionError):
        check_rule(Apart(), Lamps)


# A γ that falls


def test_gamma_falls_as_it_is_said():
    learner = Learner(Lamps(), gamma=0.1, fall=1000.0)
    for _ in range(40):
        learner.advance(37)
        t = (learner.step - 1) // FALL_EVERY * FALL_EVERY  # of the last step made
        assert learner.gamma_in_force == pytest.approx(0.1 * 1000.0 / (1000.0 + t), rel=1e-15)
        assert learner.gamma == 0.1
    learner.freeze(True)
    assert learner.gamma_in_force == 0.0
    learner.freeze(False)
    learner.set_fall(math.inf)
    assert learner.gamma_in_force == 0.1


@pytest.mark.parametrize("task", ["sonar", "pendulum"])
def test_a_fall_is_the_same_however_the_run_is_cut(task):
    whole, cut = (Learner(TASKS[task](), fall=300.0, rule=Baseline(time=30.0)) for _ in range(2))
    blocks = [whole.advance(1100)]
    pieces = [cut.advance(n, closely=True) for n in (1, 255, 256, 300, 288)]
    assert same_learner(whole, cut)
    assert np.array_equal(blocks[0].fired, np.concatenate([p.fired for p in pieces]))
    assert np.array_equal(blocks[0].broadcast, np.concatenate([p.broadcast for p in pieces]))
    skipped = Learner(TASKS[task](), fall=300.0, rule=Baseline(time=30.0))
    skipped.skip(1100)
    assert same_learner(whole, skipped)


def test_what_is_sent_in_place_of_the_reward_falls_in_line():
    """`advance(reward=)` reaches the step it is for, across the edges at which γ is set anew."""
    sent = np.random.default_rng(0).normal(size=700)
    block = Learner(Lamps(), fall=100.0, rule=Baseline()).advance(700, reward=sent)
    assert np.array_equal(block.broadcast, sent)


@pytest.mark.parametrize("fall", [0.0, 0.5, -3.0, math.nan, 1e300])
def test_a_fall_out_of_bounds_is_refused(fall):
    with pytest.raises(ValueError, match=r"^fall .*must be from 1"):
        Learner(Lamps(), fall=fall)
    with pytest.raises(ValueError, match="fall"):
        SetFall(fall)


# Names and parameters


@pytest.mark.parametrize("rule", [Paper(), Baseline(), Baseline(time=1 / 3 + 5), Yoked()], ids=str)
def test_a_rule_is_made_again_from_its_text(rule):
    assert make_rule(str(rule)) == rule
    assert rule.name in rule_names()


@pytest.mark.parametrize(
    ("spec", "what"),
    [("nothing", "there is no rule 'nothing'"), ("baseline:tim=3", "has no parameter 'tim'"),
     ("baseline:time=x", "time must be a number"), ("baseline:time=0", "time must be from 1"),
     ("baseline:time=nan", "time must be a number"), ("paper:a=1", "it has none"),
     ("../x", "there is no rule"), ("", "there is no rule ''")],
)  # fmt: skip
def test_a_wrong_rule_is_refused(spec, what):
    with pytest.raises(ValueError, match=re.escape(what)):
        make_rule(spec)
    with pytest.raises(ValueError, match=re.escape(what)):
        SetRule(spec)


def test_a_name_that_is_taken_is_refused():
    class Mine(Paper):
        name = "baseline"

    with pytest.raises(ValueError, match="comes with hebbviz"):
        register(Mine)


def test_a_rule_that_cannot_be_compiled_is_told():
    @dataclass(frozen=True)
    class Broken(Rule):
        name = "broken"

        @staticmethod
        def modulate(memory, constants, reward, ended, sent):
            sent[:] = eval("reward")

    with pytest.raises(ValueError, match=r"^rule broken: modulate cannot be compiled: "):
        Learner(Lamps(), rule=Broken())


def rule_of(modulate, kept=()):
    """A rule of this function."""
    said = {"name": "mine", "memory": kept, "modulate": staticmethod(modulate)}
    return dataclass(frozen=True)(type("Mine", (Rule,), said))()


def raises(memory, constants, reward, ended, sent):
    raise KeyError("no\nmore")


def raises_at_ends(memory, constants, reward, ended, sent):
    if ended[0]:
        raise KeyError("no more")
    sent[:] = reward


def writes_beyond(memory, constants, reward, ended, sent):
    sent[:] = reward
    sent[len(sent)] = 1.0


def keeps_without_room(memory, constants, reward, ended, sent):
    sent[:] = reward
    memory[0, 0] = 1.0


def changes_the_reward(memory, constants, reward, ended, sent):
    reward *= 2.0
    sent[:] = reward


def sends_nothing(memory, constants, reward, ended, sent):
    sent = reward  # noqa: F841


def sends_at_rewards_alone(memory, constants, reward, ended, sent):
    for lane in range(len(reward)):
        if reward[lane] != 0.0:
            sent[lane] = reward[lane]


def divides(memory, constants, reward, ended, sent):
    sent[:] = 1.0 / reward


def takes_itself(self, memory, constants, reward, ended, sent):
    sent[:] = reward


@pytest.mark.parametrize(
    ("modulate", "what"),
    [(raises, "KeyError: 'no\\nmore'"), (raises_at_ends, "KeyError"),
     (writes_beyond, "IndexError: index 1 is out of bounds"),
     (keeps_without_room, "IndexError: index 0 is out of bounds"),
     (changes_the_reward, "read-only"), (takes_itself, "missing 1 required"),
     (sends_nothing, "must send a finite number in each lane at each step, got nan"),
     (sends_at_rewards_alone, "got nan"), (divides, "got inf"),
     (Rule.modulate, "the class has no method 'modulate'")],
)  # fmt: skip
def test_a_rule_that_fails_is_refused_before_it_is_compiled(modulate, what):
    learner = Learner(Lamps())
    with pytest.raises(ValueError, match=f"^rule mine: [^\n]*{re.escape(what)}[^\n]*$"):
        learner.set_rule(rule_of(modulate))
    assert learner.rule == Paper()


@pytest.mark.parametrize("least", [1, 2, 5])
def test_a_rule_is_tried_out_in_as_many_lanes_as_it_needs(least):
    def modulate(memory, constants, reward, ended, sent):
        tried.append(len(reward))
        sent[:] = reward

    tried = []
    rule = rule_of(modulate)
    type(rule).least_lanes = least
    try_out(rule)
    assert set(tried) == {least, least + 2}


COUNT = (Reading("steps"),)


def divides_late(memory, constants, reward, ended, sent):
    for lane in range(len(reward)):
        memory[0, lane] += 1.0
        sent[lane] = 1.0 / (50.0 - memory[0, lane])


def grows(memory, constants, reward, ended, sent):
    for lane in range(len(reward)):
        memory[0, lane] = 1e20 * memory[0, lane] + 1.0
        sent[lane] = reward[lane]


@pytest.mark.parametrize("task", ["lamps", "lever"])
@pytest.mark.parametrize(
    ("modulate", "at", "what"),
    [(divides_late, 49, "sent"), (grows, 16, "kept")],
)  # fmt: skip
@pytest.mark.parametrize("lanes", [1, 3])
def test_what_is_not_finite_in_mid_run_is_told_of_the_rule(task, modulate, at, what, lanes, capfd):
    """And the learner is where a failing task would leave it."""
    learner = Learner(TASKS[task](), rule=rule_of(modulate, COUNT), lanes=lanes)
    learner.advance(10)
    with pytest.raises(TaskError, match=f"^rule mine {what} what is not a finite number$"):
        learner.skip(100)
    assert learner.step == (at if task == "lever" else 10)
    assert np.isfinite(learner.weights).all() and np.isfinite(learner.memory).all()
    assert np.isfinite(learner.totals).all()
    learner.advance(at - learner.step)
    assert capfd.readouterr().err == ""


@dataclass(frozen=True)
class Same(Rule):
    """The paper's rule by the way of all others."""

    name = "same"
    unused: float = parameter(0.0, least=0.0, most=1.0)
    modulate = staticmethod(Paper.modulate)


@pytest.mark.parametrize("task", ["sonar", "pendulum"])
def test_the_paper_rule_is_the_reward_itself(task):
    """It is not called; a rule that is called and sends r makes the same run."""
    plain, called = (Learner(TASKS[task](), lanes=2, rule=rule) for rule in (Paper(), Same()))
    plain.advance(1500), called.advance(1500)
    assert same_learner(plain, called)


# A part of the run


def test_a_rule_in_a_file_of_its_own_is_saved_and_loaded(own, tmp_path):
    learner = Learner(Lamps(), rule=load_rule(f"{own}:times=3"), fall=5000.0)
    block = learner.advance(600)
    assert np.array_equal(block.broadcast[1:], 3.0 * block.reward[:-1])
    path = save(learner, tmp_path / "late", task_name="lamps")
    again = load(path, lambda *_: Lamps())
    assert str(again.rule) == "late:times=3"
    learner.advance(300), again.advance(300)
    assert same_learner(learner, again)
    rules._own.clear()
    with pytest.raises(BadFile, match=r"there is no rule 'late'.*--rule path\.py:Name"):
        load(path, lambda *_: Lamps())


@pytest.mark.parametrize(
    ("spec", "what"),
    [("nowhere.py:Late", "rule nowhere.py:Late: there is no file nowhere.py"),
     ("{file}:Nothing", "has no class Nothing made from hebbviz.rules.base.Rule"),
     ("{file}:Late:times=11", "times must be from 0 to 10")],
)  # fmt: skip
def test_a_wrong_file_is_told(own, spec, what):
    with pytest.raises(ValueError, match=re.escape(what)):
        load_rule(spec.format(file=own.rpartition(":")[0]))


def test_files_of_the_first_format_are_of_the_paper_rule(tmp_path):
    learner = Learner(Lamps())
    learner.advance(100)
    with np.load(save(learner, tmp_path / "old")) as saved:
        assert '"format": 1' in str(saved["header"])
        assert set(saved) == {"header", "network", "world", "gamma"}
    again = load(tmp_path / "old.npz", lambda *_: Lamps())
    assert (again.rule, again.fall) == (Paper(), math.inf)
    assert again.keyframe().digest() == learner.keyframe().digest()


def test_a_digest_tells_rules_and_what_they_keep_apart():
    frames = {rule: Learner(Lamps(), rule=rule).keyframe() for rule in (Paper(), Baseline())}
    keyframe = frames[Baseline()]
    others = (
        frames[Paper()], replace(keyframe, rule=Baseline(time=9.0)), replace(keyframe, fall=9.0),
        replace(keyframe, memory=keyframe.memory + 1.0),
    )  # fmt: skip
    assert len({k.digest() for k in (keyframe, *others)}) == 5


def new_run(**settings):
    return Run(Learner(Lamps(), **settings), lambda *_: Lamps())


def test_the_rule_is_changed_in_mid_run_and_changed_back():
    run = new_run()
    run.advance(500)
    before = run.moment().keyframe
    run.change(SetRule("baseline:time=40"))
    run.change(SetFall(2000.0))
    run.advance(500)
    run.keep()
    run.change(SetRule("baseline:time=80"))
    assert run.learner.memory == 0.0, "its memory is empty"
    run.advance(300)
    assert [str(c.change) for c in run.log] == [
        "rule baseline:time=40", "γ falls over 2000 steps", "rule baseline:time=80"
    ]  # fmt: skip
    end = run.moment().keyframe.digest()
    for step in (0, 1000):  # made again from before the changes and from among them
        replay = run.replay(run.tape.before(step))
        replay.go_to(run.learner.step)
        assert replay.learner.keyframe().digest() == end
    for _ in range(3):
        run.undo()
    assert run.learner.rule == Paper()
    assert run.learner.keyframe().digest() == before.digest()


def test_a_new_run_keeps_the_rule_and_a_copy_has_it_too():
    run = new_run(rule=Baseline(time=7.0), fall=900.0)
    run.advance(300)
    for made in (run.learner.twin(), run.learner.frozen_copy(), run.replay(run.moment()).learner):
        assert (made.rule, made.fall) == (Baseline(time=7.0), 900.0)
    for kind in KINDS:
        fork = Fork(run, Difference(kind, 0.5))
        assert (fork.learner.rule, fork.learner.fall) == (Baseline(time=7.0), 900.0)
        assert np.array_equal(fork.learner.memory, run.learner.memory)
    run.reset()
    assert (run.learner.rule, run.learner.fall, run.learner.step) == (Baseline(time=7.0), 900.0, 0)


def test_a_preset_brings_its_rule():
    class Best(Lamps):
        presets = {"best": replace(Lamps.presets["quick"], rule="baseline:time=9", fall=1e5)}

    learner = Learner(Best())
    assert (learner.rule, learner.fall) == (Baseline(time=9.0), 1e5)
    assert Learner(Best(), rule=Paper(), fall=math.inf).fall == math.inf


def test_a_recording_holds_the_rule(tmp_path):
    """Begun with one rule, changed to others in its course, and made again to the bit."""
    run = new_run(rule=Baseline(time=30.0), seed=6)
    notices = []
    recorder = Recorder(FileTarget(tmp_path / "run.rrd"), run, on_notice=notices.append)
    run.followers.append(recorder)
    digests = {}
    for change in (
        None,
        SetRule("paper"),
        SetBeta(0.7),
        SetFall(700.0),
        SetRule("baseline:time=9"),
    ):
        if change is not None:
            run.change(change)
        for _ in range(4):
            run.advance(100)
            run.frame()
        run.keep()
        digests[run.learner.step] = run.moment().keyframe.digest()
    run.followers.clear()
    recorder.close(run)
    assert not notices
    recording = open_recording(tmp_path / "run.rrd")
    assert (recording.header.rule, recording.header.fall) == ("baseline:time=30", math.inf)
    again = recording.run(lambda *_: Lamps(), Lamps())
    assert again.learner.keyframe().digest() == run.learner.keyframe().digest()
    assert {m.step: m.keyframe.digest() for m in recording.moments}.items() >= digests.items()
    for before, after in pairwise(recording.moments):
        replay = again.replay(before, until=after)
        replay.go_to(after.step)
        assert replay.learner.keyframe().digest() == after.keyframe.digest()


def test_where_lanes_touch_each_other_none_is_recorded(tmp_path):
    """Refused at the start; a rule that would make it so later is refused while it goes on."""
    notices = []
    recordings = Recordings(new_run(lanes=2, rule=Yoked()), Options(), on_notice=notices.append)
    with pytest.raises(
        ValueError, match=r"^a recording holds one lane, but lanes under rule yoked "
    ):
        recordings.start(tmp_path / "yoked.rrd")
    assert not list(tmp_path.iterdir())
    run = new_run(lanes=2)
    recordings = Recordings(run, Options(), on_notice=notices.append)
    recordings.check_rule(Yoked())
    recordings.start(tmp_path / "paper.rrd")
    recordings.check_rule(Baseline())
    with pytest.raises(ValueError, match="under rule yoked"):
        recordings.check_rule(Yoked())
    recordings.stop()
    recordings.check_rule(Yoked())
    assert not notices
