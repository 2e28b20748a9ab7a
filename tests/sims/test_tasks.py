"""Every task keeps to the contract, and what breaks it is told in a line and does no harm."""

import re
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from hebbviz.conformance import (
    CHECKS,
    MakeTask,
    check_attributes,
    check_compiled,
    check_evaluation,
    same_learner,
)
from hebbviz.learner.learner import Learner, TaskError
from hebbviz.numerics import counter_rng
from hebbviz.numerics.compile import called
from hebbviz.numerics.counter_rng import Draws, four_uniforms
from hebbviz.sims import TASKS
from hebbviz.sims.loading import make_task
from hebbviz.task.base import CompiledTask, Input, Output, Task
from hebbviz.task.presets import Preset
from hebbviz.task.scene import Control
from hebbviz.task.signature import WORLD

LEVER = f"{Path(__file__).parents[1] / 'examples' / 'lever.py'}:Lever"


TOLD = [("synapse", "script"), ("lever", None), *((name, None) for name in TASKS.names)]
SLOW = ("synapse", "lever")
"""In Python, where the 10⁵ steps of an evaluation take long."""


@pytest.mark.parametrize(
    ("name", "preset", "check"),
    [
        pytest.param(
            name, preset, check, id="-".join(filter(None, (name, preset, check.__name__))),
            marks=[pytest.mark.slow] if check is check_evaluation and name in SLOW else [],
        )
        for name, preset in TOLD
        for check in CHECKS
    ],
)  # fmt: skip
def test_a_task_keeps_to_the_contract(name, preset, check):
    check(lambda: make_task(LEVER if name == "lever" else name, preset))


def test_the_suite_sees_what_is_wrong():
    """Each wrong task fails, so the checks can; those that take no time are enough."""
    for wrong in (Remembers, Overwrites, ChangesShape, ReadsDice, NamesTwice):
        assert _fails(wrong), wrong.__name__


def test_the_worked_example_is_learnt():
    learner = Learner(make_task(LEVER))
    assert 0.4 < learner.advance(200).reward.mean() < 0.65
    learner.advance(17_800)
    assert learner.advance(2_000).reward.mean() > 0.9


def _fails(make: MakeTask) -> bool:
    try:
        for check in CHECKS:
            if check is not check_evaluation:
                check(make)
    except (AssertionError, TaskError):
        return True
    return False


class Good(Task):
    """Counts its steps in state[0]; sees a random number; is paid for firing."""

    name = "good"
    inputs = (Input("in"),)
    outputs = (Output("out", "yes", "no"),)
    presets: ClassVar = {"only": Preset(0.5, 0.1, "a note")}

    def restart(self, draws):
        return np.zeros(3)

    def transition(self, state, action, draws):
        return np.array([state[0] + 1.0, action[0], draws(1)[0]])

    def observation(self, state):
        return state[2:]

    def reward(self, state):
        return state[1]


def test_the_good_task_passes():
    assert not _fails(Good)


class Remembers(Good):
    steps = 0

    def transition(self, state, action, draws):
        self.steps += 1
        return np.array([state[0] + 1.0, action[0], self.steps % 7.0])


class Overwrites(Good):
    def observation(self, state):
        state[2] += 1.0
        return state[2:]


class ChangesShape(Good):
    def transition(self, state, action, draws):
        return np.append(super().transition(state, action, draws), np.zeros(state[0] > 5.0))


class ReadsDice(Good):
    dice = np.random.default_rng(0)

    def transition(self, state, action, draws):
        return np.array([state[0] + 1.0, action[0], self.dice.random()])


class NamesTwice(Good):
    inputs = (Input("in"), Input("in"))

    def observation(self, state):
        return np.array([state[2], 0.0])


class Breaks(Good):
    """Good for 50 steps; then not, in one lane of seed 0."""

    def __init__(self, how, lane=0):
        super().__init__()
        self.how, self.lane = how, lane

    def breaks(self, state, how, step=51):
        """Whether it does so in this way, in a state it came into at that step."""
        mine = [step, Draws(0, self.lane, step - 1)(1)[0]]
        return self.how == how and state[::2].tolist() == mine

    def transition(self, state, action, draws):
        if self.breaks(state, "raises", 50):
            raise RuntimeError("the second line\nis not told")
        if self.breaks(state, "shape", 50):
            return np.zeros(4)
        if self.breaks(state, "nothing", 50):
            return None
        return super().transition(state, action, draws)

    def observation(self, state):
        if self.breaks(state, "infinite input"):
            return np.array([np.inf])
        if self.breaks(state, "input shape"):
            return np.zeros(2)
        return super().observation(state)

    def reward(self, state):
        if self.breaks(state, "no number"):
            return "much"
        return np.nan if self.breaks(state, "nan reward") else super().reward(state)

    def clamps(self, state):
        return np.zeros(7) if self.breaks(state, "clamps") else super().clamps(state)

    def ended(self, state):
        if self.breaks(state, "ended"):
            raise KeyError(state[0])
        return False


class Forced(Good):
    """All neurons are made to fire at every other step: after the 50th, but not after the 51st."""

    def clamps(self, state):
        return np.full(9, np.nan if state[0] % 2 else 1.0)


class BreaksForced(Breaks, Forced):
    pass


@pytest.mark.parametrize("kinds", [(Good, Breaks), (Forced, BreaksForced)], ids=["free", "forced"])
@pytest.mark.parametrize("lanes", [1, 2, 66])
@pytest.mark.parametrize(
    "how",
    ["raises", "shape", "nothing", "infinite input", "input shape", "no number", "nan reward",
     "clamps", "ended"],
)  # fmt: skip
def test_a_failure_in_mid_run_changes_nothing(how, lanes, kinds):
    """Of the last lane: what came before it, in another tile too, has not happened."""
    good, breaks = Learner(kinds[0](), lanes=lanes), Learner(kinds[1](how, lanes - 1), lanes=lanes)
    good.advance(50)
    for failing in (breaks.advance, breaks.skip, breaks.advance):
        with pytest.raises(TaskError, match=r"^task 'good' failed: [^\n]*$"):
            failing(100)
        assert same_learner(good, breaks)
    breaks.task.how = "not"
    good.advance(100)
    breaks.advance(100)
    assert same_learner(good, breaks)


@pytest.mark.parametrize(("how", "lanes"), [("clamps", 1), ("infinite input", 66)])
def test_the_summary_after_a_failure_counts_the_good_steps(how, lanes):
    good, breaks = Learner(Good(), lanes=lanes), Learner(Breaks(how, lanes - 1), lanes=lanes)
    good.advance(50)
    with pytest.raises(TaskError):
        breaks.advance(100)
    expected, since = good.frame().since, breaks.frame().since
    assert since.steps == since.tally.steps == 50
    assert np.array_equal(since.spikes, expected.spikes)
    assert np.array_equal(since.potential_range, expected.potential_range)


@called(WORLD)
def answer(world, action, data, keys, step, observation, reward, ended):
    """`Good`, compiled; `data` says the step and the lane of which reward and input are what."""
    for lane in range(world.shape[1]):
        draw = four_uniforms(keys[0, lane], keys[1, lane], counter_rng.WORLD, step, 0)[0]
        world[0, lane] += 1.0
        world[1, lane], world[2, lane] = action[0, lane], draw
        reward[lane], observation[0, lane] = action[0, lane], draw
        if step == data[0, 0] and keys[1, lane] == data[0, 1]:
            reward[lane] += data[0, 2]
            observation[0, lane] += data[0, 3]
    return 1


class Compiled(Good, CompiledTask):
    answer = answer

    def __init__(self, preset=None, *, step=-1, lane=0, reward=0.0, seen=0.0):
        super().__init__(preset)
        self._data = np.array([[step, lane, reward, seen]])

    def data(self):
        return self._data


@pytest.mark.parametrize("lanes", [1, 66])
@pytest.mark.parametrize("how", [{"reward": np.nan}, {"reward": -np.inf}, {"seen": np.nan}])
def test_a_compiled_task_that_fails_takes_back_the_call(how, lanes):
    """Its last lane answers with no finite number, the input's at the last step."""
    good = Learner(Compiled(), lanes=lanes)
    breaks = Learner(Compiled(step=50, lane=lanes - 1, **how), lanes=lanes)
    good.skip(20)
    breaks.skip(20)
    for failing in (breaks.skip, breaks.advance, breaks.advance):
        with pytest.raises(TaskError, match=r"^task 'good' failed: .* is not a finite number$"):
            failing(31)
        assert same_learner(good, breaks)
    good.advance(30)
    breaks.advance(30)
    assert same_learner(good, breaks)
    expected, since = good.frame().since, breaks.frame().since
    assert since.tally == expected.tally
    for name in ("spikes", "potential_range", "weight_change"):
        assert np.array_equal(getattr(since, name), getattr(expected, name))


class Clamping(Forced, Compiled):
    pass


def test_a_compiled_task_with_clamps_is_refused():
    """They would be asked for at the start alone."""
    check_attributes(Compiled)
    check_compiled(Compiled)
    with pytest.raises(ValueError, match=r"^task 'good' is compiled, so its clamps would never"):
        Learner(Clamping())
    with pytest.raises(AssertionError, match="has no clamps"):
        check_attributes(Clamping)


class Interrupted(Good):
    def transition(self, state, action, draws):
        if state[0] == 50.0:
            raise KeyboardInterrupt
        return super().transition(state, action, draws)


def test_an_interrupt_leaves_whole_steps():
    good, stopped = Learner(Good()), Learner(Interrupted())
    good.advance(50)
    with pytest.raises(KeyboardInterrupt):
        stopped.advance(100)
    assert same_learner(good, stopped)


class Button(Good):
    controls = (Control("break", ""), Control("bend", ""), Control("blind", ""))

    def press(self, state, control):
        if control == "break":
            raise RuntimeError("stuck")
        return np.zeros(7) if control == "bend" else np.full(3, np.nan)


@pytest.mark.parametrize("control", ["break", "bend", "blind"])
def test_a_button_that_fails_changes_nothing(control):
    good, button = Learner(Good(), lanes=2), Learner(Button(), lanes=2)
    good.advance(10)
    button.advance(10)
    with pytest.raises(TaskError, match=r"^task 'good' failed: [^\n]*$"):
        button.press(control)
    good.advance(10)
    button.advance(10)
    assert same_learner(good, button)


def test_an_unknown_button_or_place_is_refused():
    learner = Learner(make_task("synapse"))
    with pytest.raises(ValueError, match="has no control 'lunch'"):
        learner.press("lunch")
    with pytest.raises(TaskError, match="must keep its shape"):
        learner.place(np.zeros((3, 1)))


class WholeNumbers(Good):
    """Returns integers and lists where it can; numbers below 1 must not be cut off."""

    def restart(self, draws):
        return [0, 0, 0]

    def transition(self, state, action, draws):
        return [state[0] + 1.0, 1, 0.5]

    def observation(self, state):
        return [0] if state[0] == 0 else [state[2]]


def test_inputs_are_not_rounded_to_the_kind_of_the_first():
    learner = Learner(WholeNumbers())
    learner.advance(1)
    assert learner.activities[0, 0] == 0.5
    assert learner.world.dtype == np.float64


class Episodes(Good):
    """Every step ends an episode; both parts keep the first draw."""

    def transition(self, state, action, draws):
        return np.array([draws(1)[0], 0.0, 0.0])

    def reward(self, state):
        return state[0]

    def ended(self, state):
        return True

    def restart(self, draws):
        return np.array([0.0, 0.0, draws(1)[0]])


def test_a_restart_has_draws_of_its_own():
    learner = Learner(Episodes())
    ends, starts = [], []
    for _ in range(2000):
        ends.append(learner.advance(1).reward[0])
        starts.append(learner.world[2, 0])
    assert abs(np.corrcoef(ends, starts)[0, 1]) < 0.1
    assert len(set(starts)) == 2000


GOOD_FILE = (Path(__file__).parents[1] / "examples" / "lever.py").read_text()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("def restart", "def begin", "the class has no method 'restart'"),
        ("def transition", "def move", "the class has no method 'transition'"),
        ("def observation", "def see", "the class has no method 'observation'"),
        ("def reward", "def rewards", "the class has no method 'reward'"),
        ("action, draws)", "action)", "transition must take (self, state, action, draws)"),
        ("restart(self, draws)", "restart(self)", "restart must take (self, draws)"),
        ("hidden = ()", "ended = lambda self: False", "ended must take (self, state)"),
        ('(Input("lamp"),)', 'Input("lamp")', "inputs must be a tuple of Input, with a comma"),
        ('(Input("lamp"),)', '("lamp",)', "inputs must be a tuple of Input"),
        ('silent="let go"),)', 'silent="let go"))', "outputs must be a tuple of Output"),
        ('{"quick": ', '(', "presets must be a dict"),
        ('{"quick": Preset', '{"quick": dict', "the values of presets must be a tuple of Preset"),
        (
            "class Lever", "class Levr",
            "no class Lever made from hebbviz.task.base.Task; it has Levr",
        ),
    ],
)  # fmt: skip
def test_a_file_that_cannot_work_is_refused_when_it_is_loaded(tmp_path, old, new, what):
    assert GOOD_FILE.count(old) == 1
    text = GOOD_FILE.replace(old, new)
    text = text.replace('not in the paper")}', 'not in the paper"),)') if new == "(" else text
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"^task [^\n]*{re.escape(what)}[^\n]*$"):
        make_task(f"{path}:Lever")


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("return state[1]", "return np.nan", "a reward, nan, is not a finite number"),
        ("return state[1]", "return 'one'", "reward must return a number, got 'one'"),
        ("return state[1]", "return state", "reward must return a number, got array"),
        ("return state[1]", "return None", "reward must return a number, got None"),
        ("return state[:1]", "return 1 / (1 - state[1:])", "an observation, inf of input 0"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("lanes", [1, 3])
def test_what_a_task_says_amiss_is_told_with_its_name(tmp_path, old, new, what, lanes):
    path = tmp_path / "mine.py"
    path.write_text(GOOD_FILE.replace(old, new))
    learner = Learner(make_task(f"{path}:Lever"), lanes=lanes)
    with np.errstate(all="ignore"), pytest.raises(TaskError, match=re.escape(what)):
        learner.advance(50)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("import numpy as np\n", "import numpy as np\nraise RuntimeError('two\\nlines')\n"),
        ("import numpy as np\n", "import numpy as np\nx = = 3\n"),
        ("import numpy as np\n", "import no_such_module_at_all\n"),
        ('    name = "lever"\n', ""),
        ('    inputs = (Input("lamp"),)\n', ""),
        ("    outputs = ", "    exits = "),
        ("    presets = ", "    settings = "),
        ("presets = {", "presets = {} and {"),
        ("class Lever(Task):", "class Lever:"),
        ("class Lever(Task):", "class Other(Task):"),
        ("    def restart", "    def __init__(self, preset):\n        1 / 0\n\n    def restart"),
        ("    def restart", "    def reset"),
        ("np.array([1.0, 0.0])", "np.array([np.nan, 0.0])"),
        ("np.array([1.0, 0.0])", "'one'"),
        ("return state[:1]", "return state"),
        ("return state[:1]", "return state[5]"),
        ("beta=0.5", "beta=1.5"),
        ("gamma=0.01", "gamma=float('nan')"),
        ("    hidden = ()\n", "    hidden = (0,)\n"),
        (
            "    def reward",
            "    def initial_weights(self, draws):\n        return 1 / 0\n\n    def reward",
        ),
        (
            "    def reward",
            "    def initial_weights(self, draws):\n        return draws[:0]\n\n    def reward",
        ),
    ],
    ids=range(21),
)
def test_a_bad_file_is_told_in_one_line(tmp_path, old, new):
    path = tmp_path / "mine.py"
    assert old in GOOD_FILE
    path.write_text(GOOD_FILE.replace(old, new))
    with pytest.raises((ValueError, TaskError)) as told:
        Learner(make_task(f"{path}:Lever"))
    assert str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("name", "preset", "words"),
    [
        ("chess", None, "there is no task 'chess'"),
        ("", None, "there is no task ''"),
        ("/nowhere/mine.py:Lever", None, "there is no file"),
        (LEVER.replace("Lever", "Nothing"), None, "has no class Nothing"),
        (LEVER.replace("Lever", "np"), None, "has no class np"),
        (LEVER, "slow", "has no preset 'slow'"),
        ("sonar", "slow", "has no preset 'slow'; choose from quick, paper"),
    ],
)
def test_a_name_of_nothing_is_refused(name, preset, words):
    with pytest.raises(ValueError, match=words) as told:
        make_task(name, preset)
    assert "\n" not in str(told.value)
