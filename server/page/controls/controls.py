"""The controls of a live run: what it runs, how it learns, and how it is viewed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import viser

from hebbviz.limits import LARGEST_GAMMA
from hebbviz.numerics.counter_rng import LARGEST_SEED
from hebbviz.server.live.commands import (
    Choose,
    Command,
    Evaluate,
    NextLane,
    Pause,
    Reset,
    SetSpeed,
    SetWatch,
    SetWatchSpeed,
    ShowReward,
    StepOnce,
    Undo,
    WatchLane,
)
from hebbviz.server.live.pacing import MAX, REALTIME, Speed
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import status_text
from hebbviz.server.page.controls.rule import RuleControls
from hebbviz.server.page.widgets import Widgets, assign
from hebbviz.server.run.changes import Freeze, GiveReward, Press, SetBeta, SetGamma
from hebbviz.sims import TASKS
from hebbviz.sims.figures import palette
from hebbviz.sims.program.learner_from_arguments import MOST_SHOWN_LANES
from hebbviz.sims.program.typed_numbers import about_commas, whole
from hebbviz.task.base import Task
from hebbviz.task.presets import Switch
from hebbviz.task.scene import Control
from hebbviz.topology import parse_hidden

GREATEST_BETA = 0.999999
SHORTEST, LONGEST = 0.0, 4.0
"""Ends of the memory slider, log10 of 1/(1−β): 1 to 10 000 steps."""
LEAST_GAMMA, GREATEST_GAMMA = -8.0, -1.0
"""Ends of the step size slider, log10 of γ."""
SPEEDS = ("1", "2", "5", "10", "25", "50", "100", "1000", "10000")

N = TypeVar("N", int, float)


class Controls:
    """Builds the widgets of the main panel; `follow` shows the state in a snapshot."""

    def __init__(self, widgets: Widgets, seed: int) -> None:
        self._ui, self._gui = widgets, widgets.gui
        self._task_buttons: list[Any] = []
        self._task_keys: list[Any] = []
        self._switches: list[Any] = []
        self._shown_task: tuple[str, str] | None = None
        self._paused = False
        gui = widgets.gui
        self._run_folder = gui.add_folder("Run")
        with self._run_folder:
            self._build_run()
        learning = gui.add_folder("Learning")
        with learning:
            self._build_learning()
        self._rule = RuleControls(widgets, learning)
        self._task_folder = gui.add_folder("Task controls")
        self._task_folder_at = self._task_folder.order
        with self._task_folder:
            self._build_reward()
        with gui.add_folder("Watch"):
            self._build_watch()
        with gui.add_folder("Network, seed, exact speed"):
            self._build_more(seed)
        self._build_keys()

    # Building

    def _build_run(self) -> None:
        gui = self._gui
        self.task = gui.add_dropdown(
            "task", tuple(TASKS.names), hint="the world that the network learns in"
        )
        self.preset = gui.add_dropdown("preset", ("quick",), hint="a configuration of the task")
        self.preset_note = gui.add_markdown("")
        self.pause = gui.add_button(
            "Pause", icon=viser.Icon.PLAYER_PAUSE, color=palette.BRAND, hint="space"
        )
        self.steps = gui.add_button_group("step", ("1 step", "10", "100"), hint="N: one step")
        self.reset = gui.add_button(
            "Reset", icon=viser.Icon.RESTORE, hint="R: same seed, same β and γ"
        )
        self.undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="U")
        self.speed = gui.add_dropdown("speed", (MAX, REALTIME, *SPEEDS), hint="steps per second")
        self.achieved = gui.add_markdown("")
        self._ui.when(self.task, Choose)
        self._ui.when(self.preset, lambda v: Choose(self._ui.snapshot.run.task_name, v))
        self._ui.when(self.speed, lambda v: SetSpeed(_speed(v)))
        self._ui.when(self.steps, lambda v: StepOnce(int(v.split()[0])))
        self._ui.press(self.pause, lambda: Pause(not self._paused))
        self._ui.press(self.reset, Reset)
        self._ui.press(self.undo, Undo)

    def _build_learning(self) -> None:
        gui = self._gui
        self.beta = gui.add_text(
            "β", "0.98", hint="the fraction of a trace that remains after a step"
        )
        self.memory = gui.add_slider(
            "β by memory",
            SHORTEST,
            LONGEST,
            0.01,
            1.7,
            marks=((0.0, "1"), (1.0, "10"), (2.0, "100"), (3.0, "1000"), (4.0, "10⁴")),
            hint="β by its time constant 1/(1−β) in steps, logarithmic",
        )
        self.memory_words = gui.add_markdown("")
        self.gamma = gui.add_text("γ", "0.01", hint="the step size: how far a reward moves w")
        self.step_size = gui.add_slider(
            "γ, step size",
            LEAST_GAMMA,
            GREATEST_GAMMA,
            0.05,
            -2.0,
            marks=tuple((float(k), f"1e{k}") for k in (-8, -6, -4, -2)),
            hint="γ, logarithmic",
        )
        self.frozen = gui.add_checkbox("freeze learning", False, hint="F: γ is restored afterwards")
        self._ui.when(self.beta, self._set_typed_beta)
        self._ui.when(self.memory, lambda v: SetBeta(round(1.0 - 10.0**-v, 6)))
        self._ui.when(self.gamma, self._set_typed_gamma)
        self._ui.when(self.step_size, lambda v: SetGamma(float(f"{10.0**v:.3g}")))
        self._ui.when(self.frozen, lambda v: Freeze(bool(v)))

    def _build_reward(self) -> None:
        gui = self._gui
        self.amount = gui.add_number("amount", 1.0, min=0.0, max=1e6, step=0.5)
        self.reward = gui.add_button_group("reward", ("+ reward", "− punishment"))
        self._ui.when(
            self.reward,
            lambda v: GiveReward(float(self.amount.value) * (1 if v.startswith("+") else -1)),
        )

    def _build_watch(self) -> None:
        gui = self._gui
        self.lane = gui.add_number(
            "lane",
            0,
            min=0,
            max=0,
            step=1,
            visible=False,
            hint="the replica that is shown; G: previous, H: next",
        )
        self._ui.when(self.lane, lambda v: WatchLane(int(v)))
        self.watch = gui.add_checkbox(
            "watch", True, hint="play slow excerpts while the run continues at full speed"
        )
        self.watch_speed = gui.add_slider(
            "watch speed", 1.0, 200.0, 1.0, 50.0, hint="steps per second of the excerpts"
        )
        self.show_reward = gui.add_button(
            "Latest reward, slowly", icon=viser.Icon.BOLT, hint="L: r arrives, z, Δw"
        )
        self._ui.when(self.watch, lambda v: SetWatch(bool(v)))
        self._ui.when(self.watch_speed, lambda v: SetWatchSpeed(float(v)))
        self.evaluate = gui.add_button(
            "Evaluate a frozen copy", icon=viser.Icon.SNOWFLAKE, hint="the run continues meanwhile"
        )
        self._ui.press(self.show_reward, ShowReward)
        self._ui.press(self.evaluate, Evaluate)

    def _build_more(self, seed: int) -> None:
        gui = self._gui
        self.typed_speed = gui.add_text("steps/s", MAX, hint="any speed, or max, or realtime")
        self.seed = gui.add_text("seed", str(seed), hint="a different seed starts a new run")
        self.new_seed = gui.add_button("New seed", icon=viser.Icon.DICE_5)
        self.hidden = gui.add_text("hidden", "8", hint="sizes of the hidden layers: 16 or 8,8")
        self.lanes = gui.add_number(
            "lanes",
            1,
            min=1,
            max=MOST_SHOWN_LANES,
            step=1,
            hint="the number of replicas that run side by side, each with its own random numbers. "
            "Changing it starts a new run; lane 0 stays the same. A world that is stepped in "
            "Python, such as the pendulum, takes proportionally longer",
        )
        self._ui.when(self.typed_speed, lambda v: SetSpeed(_speed(v)))
        self._ui.when(self.seed, self._choose_seed)
        self._ui.when(self.hidden, self._choose_hidden)
        self._ui.when(self.lanes, self._choose_lanes)
        self._ui.press(
            self.new_seed, lambda: Reset(seed=(self._ui.snapshot.run.seed + 1) % (LARGEST_SEED + 1))
        )

    def _build_keys(self) -> None:
        """Keys that viser's camera does not use: it has W, A, S, D, Q, E and the arrows."""
        self._ui.key("Pause or run", "space", lambda: Pause(not self._paused))
        self._ui.key("Step once", "N", StepOnce)
        self._ui.key("Reset", "R", Reset)
        self._ui.key("Undo", "U", Undo)
        self._ui.key("Freeze learning", "F", lambda: Freeze(not _in_force(self._ui.snapshot)[2]))
        self._ui.key("Latest reward, slowly", "L", ShowReward)
        self._ui.key("Previous lane", "G", lambda: NextLane(-1))
        self._ui.key("Next lane", "H", NextLane)
        amount = self.amount
        self._ui.key("Manual reward", "P", lambda: GiveReward(float(amount.value)))
        self._ui.key("Manual punishment", "O", lambda: GiveReward(-float(amount.value)))

    @property
    def after_run(self) -> float:
        """The order of a folder that follows the first one."""
        return self._run_folder.order + 0.5

    # Following the run

    def follow(self, snapshot: Snapshot) -> None:
        """Show the current state. Widgets that somebody is using are left alone for a moment."""
        self._follow_task(snapshot)
        self._follow_run(snapshot)
        self._follow_learning(snapshot)
        self._ui.put(self.watch, snapshot.view.watching)
        self._ui.put(self.watch_speed, min(200.0, max(1.0, snapshot.view.watch_speed)))

    def say_speed(self, text: str) -> None:
        assign(self.achieved, "content", text)

    def _follow_task(self, snapshot: Snapshot) -> None:
        task = snapshot.run.task
        key = (snapshot.run.task_name, task.preset_name)
        if key == self._shown_task:
            return
        self._shown_task = key
        names = (
            *TASKS.names,
            *((snapshot.run.task_name,) if snapshot.run.task_name not in TASKS.names else ()),
        )
        assign(self.task, "options", names)
        assign(self.task, "value", snapshot.run.task_name)
        assign(self.preset, "options", tuple(task.presets))
        assign(self.preset, "value", task.plain_preset)
        self.preset_note.content = f"{task.summary}. *Preset: {task.preset.note}.*"
        assign(self.amount, "value", task.hand_reward)
        self._build_switches(task)
        self._build_task_buttons(task)
        by_hand = self._run_folder.order + 0.25 if task.controls else self._task_folder_at
        assign(self._task_folder, "order", by_hand)

    def _build_switches(self, task: Task) -> None:
        """The task's switches, below its preset."""
        for handle in self._switches:
            handle.remove()
        with self._run_folder:
            self._switches = [self._add_switch(s, task) for s in task.switches]

    def _add_switch(self, switch: Switch, task: Task) -> Any:
        handle = self._gui.add_checkbox(
            switch.name,
            task.settings[switch.name],
            order=self.preset_note.order + 0.5,
            hint=f"{switch.words}. Changing it starts a new run with the current β, γ, rule and "
            "network",
        )
        self._ui.when(handle, lambda v: Reset(switch=(switch.name, bool(v))))
        return handle

    def _build_task_buttons(self, task: Task) -> None:
        for handle in (*self._task_buttons, *self._task_keys):
            handle.remove()
        self._task_buttons, self._task_keys = [], []
        with self._task_folder:
            for control in task.controls:
                self._add_task_button(control)

    def _add_task_button(self, control: Control) -> None:
        def press() -> Press:
            return Press(control.name)

        key = f" (key {control.key.upper()})" if control.key else ""
        button = self._gui.add_button(control.name, hint=f"{control.hint}{key}")
        self._ui.press(button, press)
        self._task_buttons.append(button)
        if control.key:
            self._task_keys.append(self._ui.key(control.name, control.key.upper(), press))

    def _follow_run(self, snapshot: Snapshot) -> None:
        go_on = "Run" if snapshot.view.past is None else "Play"
        assign(self.pause, "label", go_on if snapshot.pacing.paused else "Pause")
        if snapshot.pacing.paused != self._paused:
            self._paused = snapshot.pacing.paused
            icon = viser.Icon.PLAYER_PLAY if snapshot.pacing.paused else viser.Icon.PLAYER_PAUSE
            self.pause.icon = icon
        undo = f"Undo: {snapshot.run.undo_words}" if snapshot.run.undo_words else "Undo"
        assign(self.undo, "label", undo)
        assign(self.undo, "disabled", snapshot.run.undo_words is None)
        self._ui.put(self.seed, str(snapshot.run.seed))
        self._ui.put(self.lanes, snapshot.run.lanes)
        assign(self.lane, "visible", snapshot.run.lanes > 1)
        assign(self.lane, "max", snapshot.run.lanes - 1)
        self._ui.put(self.lane, snapshot.run.lane)
        hidden = _hidden(snapshot)
        assign(self.hidden, "visible", hidden is not None)
        self._ui.put(self.hidden, ",".join(map(str, hidden or ())) or "none")
        speed = (
            snapshot.pacing.speed
            if isinstance(snapshot.pacing.speed, str)
            else f"{snapshot.pacing.speed:g}"
        )
        choices = (MAX, *((REALTIME,) if snapshot.run.task.dt else ()), *SPEEDS)
        if speed not in choices:
            choices = (*choices, speed)
        assign(self.speed, "options", choices)
        self._ui.put(self.speed, speed)
        self._ui.put(self.typed_speed, speed)

    def _follow_learning(self, snapshot: Snapshot) -> None:
        """β, γ and freezing; in the past, those of the step that is shown."""
        beta, gamma, frozen = _in_force(snapshot)
        self._ui.put(self.beta, f"{min(beta, GREATEST_BETA):.6g}")
        memory = min(LONGEST, max(SHORTEST, -math.log10(1.0 - beta)))
        self._ui.put(self.memory, round(memory, 2))
        assign(
            self.memory_words,
            "content",
            f"trace lasts {status_text.memory(beta, snapshot.run.task.dt)}",
        )
        self._ui.put(self.gamma, f"{gamma:.4g}")
        log = min(GREATEST_GAMMA, math.log10(max(gamma, 10.0**LEAST_GAMMA)))
        self._ui.put(self.step_size, round(log, 2))
        self._ui.put(self.frozen, frozen)
        self._rule.follow(snapshot)

    # Typed values: no command if nothing changes

    def _set_typed_beta(self, text: str) -> Command | None:
        beta = _parsed(float, text, "β must be", 0.0, GREATEST_BETA)
        return None if beta == _in_force(self._ui.snapshot)[0] else SetBeta(beta)

    def _set_typed_gamma(self, text: str) -> Command | None:
        gamma = _parsed(float, text, "γ must be", 0.0, LARGEST_GAMMA)
        return None if gamma == _in_force(self._ui.snapshot)[1] else SetGamma(gamma)

    def _choose_seed(self, text: str) -> Command | None:
        seed = _parsed(whole, text, "seed must be a whole number", 0, LARGEST_SEED)
        return None if seed == self._ui.snapshot.run.seed else Reset(seed=seed)

    def _choose_lanes(self, lanes: int) -> Command | None:
        return None if lanes == self._ui.snapshot.run.lanes else Reset(lanes=lanes)

    def _choose_hidden(self, text: str) -> Command | None:
        sizes = parse_hidden(text)
        snapshot = self._ui.snapshot
        if sizes == _hidden(snapshot):
            return None
        return Choose(snapshot.run.task_name, snapshot.run.task.preset_name, sizes)


def _parsed(kind: Callable[[str], N], text: str, must_be: str, least: N, most: N) -> N:
    """The number that was typed; raises ValueError if it is no number or out of range."""
    try:
        value = kind(text)
    except ValueError:
        value = most + 1
    if not least <= value <= most:
        raise ValueError(
            f"{must_be} from {least:.10g} to {most:.10g}, got {text[:40]!r}{about_commas(text)}"
        )
    return value


def _speed(text: str) -> Speed:
    """Steps per second, or a word; `SetSpeed` knows two."""
    try:
        return float(text)
    except ValueError:
        return text.strip()


def _in_force(snapshot: Snapshot) -> tuple[float, float, bool]:
    """β, γ and whether learning is frozen, at the past step that is shown, or now."""
    if snapshot.view.past is None:
        return snapshot.run.beta, snapshot.run.gamma, snapshot.run.frozen
    shown = snapshot.view.frame
    return float(shown.beta[0]), shown.step_size, shown.frozen


def _hidden(snapshot: Snapshot) -> tuple[int, ...] | None:
    """Sizes of the hidden layers; None if the network is not defined by sizes."""
    network = snapshot.run.live.topology
    sizes = tuple(g.size for g in network.neuron_groups[:-1])
    try:
        return sizes if snapshot.run.task.topology(sizes) == network else None
    except ValueError:
        return None
