"""Every task keeps to the contract, and what breaks it is told in a line and does no harm."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from conformance import CHECKS, MakeTask, check_evaluation, same_learner

from hebbviz.learner import Learner, TaskError
from hebbviz.task import Control, Input, Output, Preset, Task
from sims import TASKS
from sims.loading import make_task

LEVER = f"{Path(__file__).parent / 'examples' / 'lever.py'}:Lever"


TOLD = [("synapse", "script"), ("lever", None), *((name, None) for name in TASKS)]
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
    """Good for 50 steps."""

    def __init__(self, how):
        super().__init__()
        self.how = how

    def transition(self, state, action, draws):
        if state[0] == 50.0 and self.how == "raises":
            raise RuntimeError("the second line\nis not told")
        if state[0] == 50.0 and self.how == "shape":
            return np.zeros(4)
        if state[0] == 50.0 and self.how == "nothing":
            return None
        return super().transition(state, action, draws)

    def observation(self, state):
        if state[0] == 51.0 and self.how == "infinite input":
            return np.array([np.inf])
        if state[0] == 51.0 and self.how == "input shape":
            return np.zeros(2)
        return super().observation(state)

    def reward(self, state):
        if state[0] == 51.0 and self.how == "no number":
            return "much"
        return np.nan if state[0] == 51.0 and self.how == "nan reward" else super().reward(state)

    def clamps(self, state):
        if state[0] == 51.0 and self.how == "clamps":
            return np.zeros(1)
        return None

    def ended(self, state):
        if state[0] == 51.0 and self.how == "ended":
            raise KeyError(state[0])
        return False


@pytest.mark.parametrize("lanes", [1, 2])
@pytest.mark.parametrize(
    "how",
    ["raises", "shape", "nothing", "infinite input", "input shape", "no number", "nan reward",
     "clamps", "ended"],
)  # fmt: skip
def test_a_failure_in_mid_run_changes_nothing(how, lanes):
    good, breaks = Learner(Good(), lanes=lanes), Learner(Breaks(how), lanes=lanes)
    good.advance(50)
    for failing in (breaks.advance, breaks.skip, breaks.advance):
        with pytest.raises(TaskError, match=r"^task 'good' failed: [^\n]*$"):
            failing(100)
        assert same_learner(good, breaks)
    breaks.task.how = "not"
    good.advance(100)
    breaks.advance(100)
    assert same_learner(good, breaks)


def test_the_summary_after_a_failure_counts_the_good_steps():
    good, breaks = Learner(Good()), Learner(Breaks("clamps"))
    good.advance(50)
    with pytest.raises(TaskError):
        breaks.advance(100)
    expected, since = good.frame().since, breaks.frame().since
    assert since.steps == since.tally.steps == 50
    assert np.array_equal(since.spikes, expected.spikes)
    assert np.array_equal(since.potential_range, expected.potential_range)


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


GOOD_FILE = (Path(__file__).parent / "examples" / "lever.py").read_text()


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
