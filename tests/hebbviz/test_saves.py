"""A saved learner continues exactly; anything else is told from one, in a line."""

import io
import json
import os
import pickle
import resource
import shutil
import signal
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hebbviz.conformance import same_learner
from hebbviz.learner.learner import Learner, TaskError
from hebbviz.learner.saves import FORMAT, BadFile, load, save
from hebbviz.sims.loading import make_task
from hebbviz.topology import BINARY, Group, Projection, Topology


@pytest.fixture
def learner():
    made = Learner(make_task("pendulum", "raw"), seed=3, lanes=2, first_lane=1)
    made.advance(100)
    return made


@pytest.fixture
def path(learner, tmp_path):
    return save(learner, tmp_path / "saved.npz")


def test_a_file_holds_everything(learner, path):
    learner.freeze(frozen=True)
    learner.set_beta(0.123)
    save(learner, path)
    again = load(path, make_task)
    assert same_learner(learner, again)
    assert again.task.preset_name == "raw"
    assert again.topology == learner.topology
    assert (again.seed, again.lanes, again.first_lane) == (3, 2, 1)
    assert (again.beta, again.gamma, again.frozen) == (0.123, learner.gamma, True)
    for one in (learner, again):
        one.freeze(frozen=False)
        one.advance(200)
    assert same_learner(learner, again)


def test_any_topology_and_any_number_is_kept(tmp_path):
    topology = Topology(
        (Group("x ä", 1), Group("in", 8, is_input=True), Group("o", 2)),
        (Projection("in", "o"), Projection("x ä", "x ä"), Projection("o", "x ä")), "o", BINARY,
    )  # fmt: skip
    learner = Learner(make_task("pendulum"), topology=topology)
    learner.set_weights(np.array([np.inf, -0.0, 5e-324, *[1e308] * 16])[:, None])
    again = load(save(learner, tmp_path / "a.file"), make_task)
    assert again.topology == topology
    assert same_learner(learner, again)


def test_the_ending_is_added_and_nothing_else_is_left(learner, tmp_path):
    assert save(learner, tmp_path / "a") == tmp_path / "a.npz"
    assert save(learner, str(tmp_path / "b.npz")) == tmp_path / "b.npz"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


GOLDEN = Path(__file__).parents[1] / "golden"


def test_a_save_of_format_1_still_loads_and_goes_on(tmp_path):
    """Golden, of the paper's rule: what it holds, to the bit."""
    old = load(GOLDEN / "save-1.npz", make_task)
    assert (old.task.name, old.task.preset_name, old.step) == ("gradient", "learning", 500)
    assert (old.seed, old.lanes, old.first_lane) == (5, 2, 1)
    assert (old.beta, old.gamma, old.fall, old.frozen) == (0.75, 0.02, np.inf, False)
    assert (str(old.rule), old.dtype) == ("paper", np.float64)
    first = [1.2726210581217912, -1.2101851697010149, -0.8245928170489237, 0.9445800368529658]
    assert old.weights[:4, 0].tolist() == first
    assert old.tally().reward == 302.0
    goes_on_alike(old, tmp_path)


def test_a_save_of_format_2_still_loads_and_goes_on(tmp_path):
    """Golden, of another rule, a γ that falls and float32."""
    old = load(GOLDEN / "save-2.npz", make_task)
    assert (old.task.name, old.task.preset_name, old.step) == ("pendulum", "quick", 500)
    assert (old.topology.describe(), old.seed, old.lanes) == ("8-2-2", 6, 1)
    assert (old.fall, old.frozen) == (1e4, True)
    assert (str(old.rule), old.dtype) == ("baseline:time=50", np.float32)
    first = [0.03850361704826355, -0.03323657810688019, 0.015270865522325039, -0.05671611800789833]
    assert old.weights[:4, 0].tolist() == first
    assert old.memory[0, 0] == pytest.approx(-0.03019069, rel=1e-6)
    assert old.tally().ended == 17.0
    old.freeze(frozen=False)
    goes_on_alike(old, tmp_path)


def goes_on_alike(learner, tmp_path):
    """It goes on, and so does what is saved of it now."""
    again = load(save(learner, tmp_path / "again"), make_task)
    before = learner.weights
    for one in (learner, again):
        one.advance(200)
    assert same_learner(learner, again)
    assert not np.array_equal(learner.weights, before)


def test_there_is_a_golden_save_of_each_format():
    wanted = {f"save-{number}.npz" for number in range(1, FORMAT + 1)}
    assert {file.name for file in GOLDEN.glob("*.npz")} == wanted


def attempt(path):
    """Load, or be told in one line that it cannot be; whether it could."""
    try:
        load(path, make_task).advance(1)
    except BadFile as error:
        told = str(error)
    except OSError:
        return False
    else:
        return True
    assert str(path) in told
    assert "\n" not in told
    return False


def test_truncated_files_are_told(path, tmp_path):
    whole = path.read_bytes()
    damaged = tmp_path / "damaged.npz"
    for end in {0, 1, 4, 30, *np.random.default_rng(0).integers(0, len(whole), 100).tolist()}:
        damaged.write_bytes(whole[:end])
        assert not attempt(damaged), end


@pytest.mark.filterwarnings("ignore")  # numpy and zipfile warn of what they stumble over
def test_files_with_a_wrong_byte_are_told_or_harmless(learner, path, tmp_path):
    """Numbers that differ from the saved ones never come back."""
    whole = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    damaged = tmp_path / "damaged.npz"
    rng = np.random.default_rng(1)
    directory = rng.integers(whole.size - 500, whole.size, 300)
    for place in [*range(300), *directory.tolist(), *rng.integers(0, whole.size, 300).tolist()]:
        changed = whole.copy()
        changed[place] ^= rng.integers(1, 256, dtype=np.uint8)
        damaged.write_bytes(changed.tobytes())
        if attempt(damaged):
            assert same_learner(load(damaged, make_task), learner), place


@pytest.mark.parametrize("kind", [b"<f4", b"<f2", b">f8", b"<i4"])
def test_numbers_of_another_kind_are_told(tmp_path, kind):
    """Less of a large entry is read then, and its checksum would not be."""
    path = save(Learner(make_task("pendulum", "quick"), hidden=(300,)), tmp_path / "large.npz")
    whole = path.read_bytes()
    assert whole.count(b"<f8") == 3
    place = -1
    for _ in range(3):
        place = whole.index(b"<f8", place + 1)
        path.write_bytes(whole[:place] + kind + whole[place + 3 :])
        assert not attempt(path)


def rewritten(path, **entries):
    """The file with some entries of its header changed, its checksums right."""
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays["header"])) | entries
    np.savez(path, **arrays | {"header": np.array(json.dumps(header))})


def test_a_newer_format_is_told(path):
    rewritten(path, format=FORMAT + 1)
    with pytest.raises(BadFile, match=r"has format 3, newer than this hebbviz knows \(2\)"):
        load(path, make_task)


@pytest.mark.parametrize(
    "entries",
    [
        {"format": "1"}, {"program": "else"}, {"topology": None}, {"topology": {}},
        {"lanes": 3}, {"lanes": 10**9}, {"lanes": -1}, {"lanes": float("inf")},
        {"first_lane": -1}, {"first_lane": 2**40}, {"seed": -1}, {"seed": "x"}, {"step": None},
        {"step": -5}, {"step": 10**30}, {"step": 2**62}, {"step": 1.0}, {"step": True},
        {"seed": 1.5}, {"seed": True}, {"lanes": 2.9}, {"first_lane": 1.5}, {"frozen": "no"},
        {"frozen": 1}, {"task": ["pendulum"]}, {"preset": None}, {"dtype": 64}, {"dtype": "int64"},
        {"fall": 0.5}, {"fall": "never"}, {"fall": float("nan")},
        {"task": "sonar", "preset": "quick"},
        {"topology": {"groups": [["a", 1, False]], "projections": [["a", "a"]], "output": "a",
                      "activity": [0, 1]}},
        {"topology": {"groups": [["a", 10**9, False]], "projections": [["a", "a"]],
                      "output": "a", "activity": [0, 1]}},
    ],
    ids=str,
)  # fmt: skip
def test_a_header_that_does_not_fit_is_told(path, entries):
    rewritten(path, **entries)
    with pytest.raises(BadFile) as told:
        load(path, make_task)
    assert "\n" not in str(told.value)


def changed(path, name, change):
    """The file with one of its arrays changed, its checksums right."""
    with np.load(path) as file:
        arrays = dict(file)
    arrays[name] = change(arrays[name])
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("section", "value", "words"),
    [
        *((None, value, "gamma") for value in (np.nan, -1.0, np.inf, 1e4)),
        *(("gamma", value, "gamma") for value in (np.nan, -1.0, np.inf)),
        *(("beta", value, "beta") for value in (np.nan, -0.1, 1.0, 1.5)),
    ],
)
def test_a_step_size_or_a_beta_that_cannot_be_is_told(learner, path, section, value, words):
    """In one projection of one lane: as γ was set, or as it and β are in force."""

    def change(array):
        row = -1 if section is None else learner.layout.packed[section].stop - 1
        array[row, 1] = value
        return array

    changed(path, "gamma" if section is None else "network", change)
    with pytest.raises(BadFile, match=f"does not fit task 'pendulum': {words}") as told:
        load(path, make_task)
    assert "\n" not in str(told.value)


def test_a_beta_that_float32_rounds_to_1_is_one_that_can_be(tmp_path):
    learner = Learner(make_task("pendulum"), beta=1.0 - 1e-9, dtype="float32")
    assert learner.keyframe().network[learner.layout.packed["beta"]].max() == 1.0
    again = load(save(learner, tmp_path / "saved"), make_task)
    assert same_learner(again, learner)
    assert again.beta == learner.beta < 1.0


def test_the_step_sizes_of_another_network_are_told(learner, path):
    """One projection's for all would be taken without a word."""
    changed(path, "gamma", lambda gamma: gamma[:1])
    with pytest.raises(BadFile, match=r"this network has γ of shape \(2, 2\), got \(1, 2\)"):
        load(path, make_task)
    moment = learner.keyframe()
    other, before = learner.twin(), learner.twin()
    for wrong in ({"gamma": moment.gamma[:, :1]}, {"step": -1}, {"fall": 0.0}):
        with pytest.raises(ValueError, match=r"γ of shape|step must be|fall .* must be"):
            other.restore(replace(moment, **wrong))
        assert same_learner(other, before)


@pytest.mark.parametrize(
    ("task", "row", "value"),
    [
        *(("sonar", row, value) for row in (1, 3, 7, 9, 216) for value in (-1.0, 0.5, 1e9, np.nan)),
        *(("sonar", 4, value) for value in (0.5, 1e9, np.nan)),
        *(("filtering", row, value) for row in (0, 1, 2) for value in (-1.0, 0.5, 1e18, np.nan)),
    ],
)
def test_a_world_in_a_state_that_cannot_be_is_told(tmp_path, task, row, value):
    """Compiled worlds look tables up by such numbers, and nobody asks whether they are in them."""
    path = save(Learner(make_task(task), lanes=2), tmp_path / "saved.npz")
    load(path, make_task)

    def change(world):
        world[row, 1] = value
        return world

    changed(path, "world", change)
    with pytest.raises(BadFile, match=f"does not fit task '{task}'"):
        load(path, make_task)


def test_a_task_that_is_not_there_is_told(path):
    rewritten(path, task="chess")
    with pytest.raises(ValueError, match="there is no task 'chess'"):
        load(path, make_task)


class Unpickled:
    """Leaves a trace where it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (self.mark,)


def contents(mark):
    """Files that are no learners, by name."""
    npz, npy, objects, text = io.BytesIO(), io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez(npz, a=np.zeros(3))
    np.save(npy, np.zeros(3))
    np.savez(objects, header=np.array([Unpickled(mark)], dtype=object), network=np.zeros((1, 1)))
    with zipfile.ZipFile(text, "w") as archive:
        archive.writestr("header.npy", "not an array")
    return {
        "empty": b"", "text": b"a,b\n1,2\n", "npz of something else": npz.getvalue(),
        "npy": npy.getvalue(), "pickle": pickle.dumps(Unpickled(mark)),
        "pickle inside": objects.getvalue(), "zip of text": text.getvalue(),
        "header is no object": _npz(header=np.array("[1, 2]")),
        "header is no text": _npz(header=np.zeros(3)),
        "deep header": _npz(header=np.array("[" * 100_000)),
    }  # fmt: skip


def _npz(**arrays):
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@pytest.mark.parametrize("kind", contents(""))
def test_other_files_are_told_and_nothing_in_them_runs(kind, tmp_path):
    mark = tmp_path / "unpickled"
    path = tmp_path / "other.npz"
    path.write_bytes(contents(str(mark))[kind])
    with pytest.raises(BadFile, match="not a learner saved by hebbviz") as told:
        load(path, make_task)
    assert "\n" not in str(told.value)
    assert not mark.exists()


def test_no_file_is_an_os_error(tmp_path, learner):
    with pytest.raises(OSError, match="No such file"):
        load(tmp_path / "none.npz", make_task)
    with pytest.raises(OSError, match="No such file"):
        save(learner, tmp_path / "none" / "a.npz")
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(OSError, match="directory"):
        save(learner, tmp_path / "folder.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["folder.npz"]


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 KiB."""
    mount, umount = shutil.which("mount"), shutil.which("umount")
    disk = tmp_path / "disk"
    disk.mkdir()
    if not mount or not umount or os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    command = [mount, "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("mounting is not permitted here")
    yield disk
    subprocess.run([umount, str(disk)], check=True)


def test_a_full_disk_leaves_the_older_file(small_disk, learner):
    path = save(learner, small_disk / "run")
    large = Learner(make_task("pendulum", "raw"), hidden=(100, 100))
    with pytest.raises(OSError, match="No space left"):
        save(large, path)
    assert same_learner(load(path, make_task), learner)
    assert [p.name for p in small_disk.iterdir()] == ["run.npz"]


def test_a_write_that_is_cut_off_leaves_the_older_file(learner, path):
    """Stopped in the middle of the arrays, which are larger than a file may here be."""
    before = path.read_bytes()
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    usual = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            save(learner, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        signal.signal(signal.SIGXFSZ, usual)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_users_task_that_fails_while_loading_is_told(tmp_path):
    mine = tmp_path / "mine.py"
    source = (
        "import numpy as np\nfrom hebbviz.task import Input, Output, Preset, Task\n"
        "class Mine(Task):\n    name = 'mine'\n    inputs = (Input('i'),)\n"
        "    outputs = (Output('o', '1', '0'),)\n    presets = {'a': Preset(0.5, 0.1, 'n')}\n"
        "    def restart(self, draws): return np.zeros(1)\n"
        "    def transition(self, state, action, draws): return state\n"
        "    def observation(self, state): return state\n"
        "    def reward(self, state): return 0.0\n"
    )
    mine.write_text(source)
    spec = f"{mine}:Mine"
    path = save(Learner(make_task(spec)), tmp_path / "mine.npz", task_name=spec)
    assert load(path, make_task).task.name == "mine"
    mine.write_text(source.replace("np.zeros(1)", "1 / 0"))
    with pytest.raises(TaskError, match="ZeroDivisionError"):
        load(path, make_task)
    two = source.replace("np.zeros(1)", "np.zeros(2)")
    mine.write_text(two.replace("(self, state): return state", "(self, state): return state[:1]"))
    with pytest.raises(BadFile, match="has a world of shape"):
        load(path, make_task)
