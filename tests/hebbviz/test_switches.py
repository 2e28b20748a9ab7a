"""What is switched on or off beside a preset is part of the setting, everywhere."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hebbviz.conformance import same_learner
from hebbviz.learner import saves
from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.run.changes import Freeze, SetBeta, SetRule
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.sonar import ENERGIES, Sonar
from hebbviz.task.presets import UnknownPreset

BASELINE = "baseline:time=50"


def is_centred(learner: Learner) -> bool:
    """Energies are from 0 to 1; only less their mean some of them are negative."""
    return bool(learner.activities[:ENERGIES, 0].min() < 0.0)


@pytest.mark.parametrize(
    ("spec", "name", "on"),
    [
        ("quick", "quick", set()),
        ("quick:", "quick", set()),
        ("quick:centred=no", "quick", set()),
        ("quick:centred=yes", "quick:centred=yes", {"centred"}),
        ("quick:constant=yes,scaled=yes", "quick:scaled=yes,constant=yes", {"scaled", "constant"}),
        ("best:centred=yes", "best", {"centred", "scaled", "constant"}),
        ("best:centred=yes,centred=no", "best:centred=no", {"scaled", "constant"}),
        ("best:constant=no,centred=no", "best:centred=no,constant=no", {"scaled"}),
    ],
)
def test_a_setting_has_one_name_and_that_makes_it_again(spec: str, name: str, on: set[str]) -> None:
    task = make_task("sonar", spec)
    assert task.preset_name == name
    assert {switch for switch, is_on in task.settings.items() if is_on} == on
    assert task.plain_preset == spec.partition(":")[0]
    assert is_centred(Learner(task)) == ("centred" in on)
    again = make_task("sonar", task.preset_name)
    assert (again.preset_name, again.preset) == (name, task.preset)
    plain = Sonar.presets[task.plain_preset]
    assert (task.preset is plain) == (":" not in name)
    assert task.note.startswith(plain.note), "what a figure says of it"
    assert ("less their mean" in task.note) == ("centred" in on)
    for value in (True, False):
        switched = make_task("sonar", task.switched("centred", value))
        assert switched.settings == task.settings | {"centred": value}


@pytest.mark.parametrize("preset", ["best:centred", "best:Centred=yes", ":centred=yes"])
def test_only_what_is_spelled_well_is_taken(preset: str) -> None:
    with pytest.raises(UnknownPreset, match=r"task 'sonar' has no|must be yes or no"):
        Sonar(preset)


def test_a_run_begins_again_with_a_switch_set_and_all_else_as_it_is() -> None:
    run = Run(Learner(make_task("sonar"), hidden=(5,), seed=3, lanes=2), make_task)
    for change in (SetBeta(0.25), SetRule(BASELINE), Freeze(frozen=True)):
        run.change(change)
    run.advance(600)
    before = run.learner
    run.reset(switch=("centred", True))
    learner = run.learner
    assert is_centred(learner) and not is_centred(before)
    assert (learner.step, learner.seed, learner.lanes) == (0, 3, 2)
    assert (learner.beta, str(learner.rule), learner.frozen) == (0.25, BASELINE, True)
    assert learner.topology == before.topology
    assert run.undo_words == "centred on"
    run.reset(seed=9)
    assert is_centred(run.learner), "another seed leaves it switched on"
    run.undo()
    run.undo()
    assert run.learner is before
    assert run.learner.step == 600


def test_a_switch_that_brings_an_input_fits_the_network_to_it_and_undo_takes_it_back() -> None:
    run = Run(Learner(make_task("sonar"), hidden=(5,), lanes=2), make_task)
    run.advance(600)
    before = run.learner
    run.reset(switch=("constant", True))
    assert run.learner.topology.describe() == "61-5-1"
    assert (run.learner.activities[ENERGIES] == 1.0).all()
    run.advance(600)
    run.reset(switch=("constant", False))
    assert run.learner.topology == before.topology
    run.undo()
    assert run.learner.topology.describe() == "61-5-1"
    assert run.learner.step == 600
    run.undo()
    assert run.learner is before


def test_an_unknown_switch_leaves_the_run_as_it_is() -> None:
    run = Run(Learner(make_task("sonar")), make_task)
    with pytest.raises(ValueError, match="no switch 'bent'; it has centred, scaled, constant"):
        run.reset(switch=("bent", True))
    assert run.undo_words is None


def test_saves_and_recordings_go_on_as_what_they_were(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved, record, preset = tmp_path / "a.npz", tmp_path / "a.rrd", "best:centred=no"
    given = ["train", "--json", "--steps"]
    sonar = ["--task", "sonar", "--preset", preset, "--hidden", "4", "--record", str(record)]
    assert main([*given, "300", *sonar, "--save", str(saved)]) == 0
    assert json.loads(capsys.readouterr().out)["preset"] == preset
    assert (
        main([*given, "200", "--load", str(saved), "--preset", preset, "--save", str(saved)]) == 0
    )
    assert json.loads(capsys.readouterr().out)["total_steps"] == 500
    whole = Learner(make_task("sonar", preset), hidden=(4,))
    whole.skip(300)
    recording = open_recording(record)
    header = recording.header
    run = recording.run(make_task, make_task(header.task, header.preset))
    assert same_learner(run.learner, whole)
    whole.skip(200)
    loaded = saves.load(saved, make_task)
    assert same_learner(loaded, whole)
    assert not is_centred(loaded)
    assert main([*given, "1", "--load", str(saved), "--preset", "best"]) == 2
    told = capsys.readouterr().err
    assert f"which holds {preset}" in told and told.count("\n") == 1
