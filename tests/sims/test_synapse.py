"""The synapse does by script and by hand what the paper's figure of synaptic updates shows."""

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.synapse import BY_HAND, REWARD, SCRIPT

PRE, POST, PLAY, STOP = (c.name for c in make_task("synapse").controls)


class Watched:
    """A learner, and z and w after its last step."""

    def __init__(self, preset="hand"):
        self.learner = Learner(make_task("synapse", preset))

    def step(self, *buttons, reward=0.0):
        for button in buttons:
            self.learner.press(button)
        if reward:
            self.learner.give_reward(reward)
        self.learner.advance(1)
        return self

    @property
    def z(self):
        return float(self.learner.traces[0, 0])

    @property
    def w(self):
        return float(self.learner.weights[0, 0])

    @property
    def spikes(self):
        """Of the presynaptic and the postsynaptic side."""
        return tuple(self.learner.activities[:, 0].tolist())


def played(rounds=1):
    """z, w, change of w and spikes at each letter of one round of the script."""
    seen = Watched("script")
    rows = {}
    for row in range(rounds * len(SCRIPT)):
        before = seen.w
        seen.step()
        letter, pre, post, _, _ = SCRIPT[row % len(SCRIPT)]
        assert seen.learner.world[0, 0] == row % len(SCRIPT)
        assert seen.spikes == (float(pre), float(post))
        if letter:
            rows[letter] = (seen.z, seen.w - before)
    return rows


@pytest.fixture(scope="module", params=[1, 2, 20])
def rows(request):
    return played(request.param)


def test_the_script_has_every_letter_once():
    assert "".join(letter for letter, *_ in SCRIPT) == "abcdefghijkl"


def test_without_spikes_z_fades_and_a_reward_changes_little(rows):
    """(a) to (d)."""
    z = [rows[k][0] for k in "abcd"]
    assert z[0] > z[1] > z[2] > z[3] > 0
    assert np.allclose(np.diff(np.log(z)), np.log(0.8))
    assert 0 < rows["c"][1] < abs(rows["h"][1]) / 2
    assert 0 < rows["c"][1] < rows["l"][1] / 2


def test_a_presynaptic_spike_alone_lowers_z_and_then_the_synapse(rows):
    """(e) to (h)."""
    assert rows["f"][0] < rows["e"][0]
    assert rows["f"][0] < 0
    assert rows["g"][0] < 0
    assert rows["h"][0] < 0
    assert rows["h"][1] < 0


def test_a_postsynaptic_spike_after_it_raises_z_and_then_the_synapse(rows):
    """(i) to (l)."""
    assert rows["j"][0] > rows["i"][0]
    assert rows["j"][0] > 0
    assert rows["k"][0] > 0
    assert rows["l"][1] > 0


def test_only_a_reward_changes_the_synapse(rows):
    assert {letter for letter, (_, change) in rows.items() if change != 0.0} == set("chl")


def test_the_size_of_a_change_is_gamma_r_z(rows):
    for letter in "chl":
        z, change = rows[letter]
        assert change == pytest.approx(0.1 * REWARD * z, abs=1e-12)


def test_by_hand_pre_then_post_gives_a_positive_trace():
    s = Watched()
    s.step(PRE)
    assert s.spikes == (1.0, 0.0)
    assert s.z == 0.0
    s.step(POST)
    assert s.spikes == (0.0, 1.0)
    assert s.z == pytest.approx(1.0 - 1.0 / (1.0 + np.exp(-0.5)))
    w = s.w
    s.step(reward=REWARD)
    assert s.w > w


def test_by_hand_pre_alone_gives_a_negative_trace():
    s = Watched().step(PRE).step()
    assert s.z == pytest.approx(-1.0 / (1.0 + np.exp(-0.5)))
    assert s.step(reward=REWARD).w < 0.5


@pytest.mark.parametrize("pressed", [[(POST,), ()], [(POST,), (PRE,)], [(PRE, POST)]])
def test_by_hand_nothing_else_leaves_a_positive_trace(pressed):
    """A postsynaptic spike alone, before the presynaptic one, or at the same step as it."""
    s = Watched()
    for buttons in pressed:
        s.step(*buttons)
    assert s.z == 0.0
    s.step(reward=REWARD)
    fired = any(PRE in buttons for buttons in pressed)
    assert (s.z < 0.0) == fired
    assert (s.w < 0.5) == fired


def test_by_hand_nothing_happens_unasked():
    s = Watched()
    s.learner.advance(500)
    assert (s.z, s.w, s.spikes) == (0.0, 0.5, (0.0, 0.0))
    s.step(PRE)
    s.learner.advance(500)
    assert s.spikes == (0.0, 0.0)
    assert abs(s.z) < 1e-40


def test_punishment_is_the_opposite_of_reward():
    changes = [Watched().step(PRE).step(POST).step(reward=r).w - 0.5 for r in (REWARD, -REWARD)]
    assert changes[0] == pytest.approx(-changes[1])
    assert changes[0] > 0


def test_play_and_stop():
    s = Watched()
    s.step(PLAY)
    s.learner.advance(5)
    assert s.learner.world[0, 0] == 5
    s.step(STOP)
    assert s.learner.world[0, 0] == BY_HAND
    assert s.spikes == (0.0, 0.0)
    s.step(PLAY)
    assert s.spikes[0] == float(SCRIPT[0][1])
    s.step(PRE)
    assert s.learner.world[0, 0] == BY_HAND, "a hand on the buttons stops the script"
    assert s.spikes[0] == 1.0


def test_words_tell_every_row():
    task = Watched("script")
    words = set()
    for _ in SCRIPT:
        task.step()
        words.add(task.learner.task.pose(task.learner.world[:, 0]).words)
    assert len(words) == len({(a, e) for a, *_, e in SCRIPT})
