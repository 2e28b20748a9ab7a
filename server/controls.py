"""The controls: widgets that put commands on the worker's queue, and follow what holds.

One run serves all tabs, so a widget shows the run's state, whoever changed it. A callback only
makes a command; a value that is refused is said in a notice and the widget goes back.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable
from typing import Any

import viser

from hebbviz.chance import LARGEST_SEED
from hebbviz.task import Control, Task
from hebbviz.topology import parse_hidden
from server import words
from server.commands import (
    MAX,
    REALTIME,
    Choose,
    Command,
    Evaluate,
    Freeze,
    GiveReward,
    Pause,
    Press,
    Reset,
    SetBeta,
    SetGamma,
    SetSpeed,
    SetWatch,
    SetWatchSpeed,
    ShowReward,
    StepOnce,
    Undo,
)
from server.worker import Picture
from sims import TASKS

GREATEST_BETA = 0.999999
SHORTEST, LONGEST = 0.0, 4.0
"""Ends of the memory slider, log10 of 1/(1−β): 1 to 10 000 steps."""
LEAST_GAMMA, GREATEST_GAMMA = -8.0, -1.0
"""Ends of the step size slider, log10 of γ."""
QUIET_SECONDS = 2.5
"""A widget that was just moved by hand is not set back to the run's value before this."""
TYPING_SECONDS = 0.6
"""A typed value that may be only a beginning is taken when nothing was typed for so long."""
SPEEDS = ("1", "2", "5", "10", "25", "50", "100", "1000", "10000")

Send = Callable[[Command], None]
Notify = Callable[[str], None]


class Controls:
    """Builds the widgets of the main panel; `follow` shows what a Picture says."""

    def __init__(self, gui: viser.GuiApi, send: Send, notify: Notify, seed: int) -> None:
        self._gui, self._send, self._notify = gui, send, notify
        self._touched: dict[int, float] = {}
        self._put_before: dict[int, Any] = {}
        self._waiting: dict[int, threading.Timer] = {}
        self._task_buttons: list[Any] = []
        self._task_keys: list[Any] = []
        self._shown_task: tuple[str, str] | None = None
        self._paused = False
        self._picture: Picture | None = None
        with gui.add_folder("Run"):
            self._build_run()
        with gui.add_folder("Learning"):
            self._build_learning()
        self._task_folder = gui.add_folder("By hand")
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
        self.task = gui.add_dropdown("task", tuple(TASKS), hint="the world to learn in")
        self.preset = gui.add_dropdown("preset", ("quick",), hint="a setting of the task")
        self.preset_note = gui.add_markdown("")
        self.pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, hint="space")
        self.steps = gui.add_button_group("step", ("1 step", "10", "100"), hint="N: one step")
        self.reset = gui.add_button(
            "Reset", icon=viser.Icon.RESTORE, hint="R: same seed, keeps β, γ"
        )
        self.undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="U")
        self.speed = gui.add_dropdown("speed", (MAX, REALTIME, *SPEEDS), hint="steps per second")
        self.achieved = gui.add_markdown("")
        self._when(self.task, Choose)
        self._when(self.preset, lambda v: Choose(self._of_picture().task_name, v))
        self._when(self.speed, lambda v: SetSpeed(v if v in (MAX, REALTIME) else float(v)))
        self._when(self.steps, lambda v: StepOnce(int(v.split()[0])))
        self._press(self.pause, lambda: Pause(not self._paused))
        self._press(self.reset, Reset)
        self._press(self.undo, Undo)

    def _build_learning(self) -> None:
        gui = self._gui
        self.beta = gui.add_number(
            "beta", 0.98, min=0.0, max=GREATEST_BETA, step=0.001,
            hint="β, how much of a trace is left after a step",
        )  # fmt: skip
        self.memory = gui.add_slider(
            "memory", SHORTEST, LONGEST, 0.01, 1.7,
            marks=((0.0, "1"), (1.0, "10"), (2.0, "100"), (3.0, "1000"), (4.0, "10⁴")),
            hint="β by its time constant 1/(1−β) in steps, logarithmic",
        )  # fmt: skip
        self.memory_words = gui.add_markdown("")
        self.gamma = gui.add_text(
            "gamma", "0.01", hint="γ, the step size: how far a reward moves w"
        )
        self.step_size = gui.add_slider(
            "step size", LEAST_GAMMA, GREATEST_GAMMA, 0.05, -2.0,
            marks=tuple((float(k), f"1e{k}") for k in (-8, -6, -4, -2)),
            hint="γ, logarithmic",
        )  # fmt: skip
        self.frozen = gui.add_checkbox("freeze learning", False, hint="F: γ is remembered")
        self._when(self.beta, lambda v: SetBeta(float(v)), unfinished=lambda v: v == 0)
        self._when(self.memory, lambda v: SetBeta(round(1.0 - 10.0**-v, 6)))
        self._when(self.gamma, self._set_typed_gamma, unfinished=_may_go_on)
        self._when(self.step_size, lambda v: SetGamma(float(f"{10.0**v:.3g}")))
        self._when(self.frozen, lambda v: Freeze(bool(v)))

    def _build_reward(self) -> None:
        gui = self._gui
        self.amount = gui.add_number("amount", 1.0, min=0.0, max=1e6, step=0.5)
        self.reward = gui.add_button_group("reward", ("+ reward", "− punishment"))
        self._when(
            self.reward,
            lambda v: GiveReward(float(self.amount.value) * (1 if v.startswith("+") else -1)),
        )

    def _build_watch(self) -> None:
        gui = self._gui
        self.watch = gui.add_checkbox(
            "watch", True, hint="while the run goes on, play excerpts that the eye can follow"
        )
        self.watch_speed = gui.add_slider(
            "watch speed", 1.0, 200.0, 1.0, 50.0, hint="steps per second of the excerpts"
        )
        self.show_reward = gui.add_button(
            "Latest reward, slowly", icon=viser.Icon.BOLT, hint="L: r arrives, z, Δw"
        )
        self._when(self.watch, lambda v: SetWatch(bool(v)))
        self._when(self.watch_speed, lambda v: SetWatchSpeed(float(v)))
        self.evaluate = gui.add_button(
            "Evaluate a frozen copy", icon=viser.Icon.SNOWFLAKE, hint="the run goes on meanwhile"
        )
        self._press(self.show_reward, ShowReward)
        self._press(self.evaluate, Evaluate)

    def _build_more(self, seed: int) -> None:
        gui = self._gui
        self.typed_speed = gui.add_number(
            "steps/s", 50.0, min=0.01, max=1e9, step=1.0, hint="any speed; press enter"
        )
        self.seed = gui.add_number(
            "seed", seed, min=0, max=LARGEST_SEED, step=1, hint="another seed starts a new run"
        )
        self.new_seed = gui.add_button("New seed", icon=viser.Icon.DICE_5)
        self.hidden = gui.add_text("hidden", "8", hint="sizes of the hidden layers: 16 or 8,8")
        self._when(self.typed_speed, lambda v: SetSpeed(float(v)))
        self._when(self.seed, lambda v: Reset(seed=int(v)), unfinished=lambda _: True)
        self._when(self.hidden, self._choose_hidden, unfinished=lambda _: True)
        self._press(self.new_seed, lambda: Reset(seed=(int(self.seed.value) + 1) % LARGEST_SEED))

    def _build_keys(self) -> None:
        """Keys that viser's camera does not use: it has W, A, S, D, Q, E and the arrows."""
        self._key("Pause or run", "space", lambda: Pause(not self._paused))
        self._key("Step once", "N", StepOnce)
        self._key("Reset", "R", Reset)
        self._key("Undo", "U", Undo)
        self._key("Freeze learning", "F", lambda: Freeze(not self._of_picture().frozen))
        self._key("Latest reward, slowly", "L", ShowReward)
        amount = self.amount
        self._key("Reward by hand", "P", lambda: GiveReward(float(amount.value)))
        self._key("Punishment by hand", "O", lambda: GiveReward(-float(amount.value)))

    # Following the run

    def follow(self, picture: Picture) -> None:
        """Show what holds. Widgets somebody is using are left alone for a moment."""
        if self._picture is not None and self._picture.run_number != picture.run_number:
            self._touched.clear()  # after an undo or a reset, what was typed before is past
        self._picture = picture
        self._follow_task(picture)
        self._follow_run(picture)
        self._follow_learning(picture)
        self._put(self.watch, picture.watching)
        self._put(self.watch_speed, min(200.0, max(1.0, picture.watch_speed)))

    def say_speed(self, text: str) -> None:
        _set(self.achieved, "content", text)

    def _follow_task(self, picture: Picture) -> None:
        task = picture.task
        key = (picture.task_name, task.preset_name)
        if key == self._shown_task:
            return
        self._shown_task = key
        names = (*TASKS, *((picture.task_name,) if picture.task_name not in TASKS else ()))
        _set(self.task, "options", names)
        _set(self.task, "value", picture.task_name)
        _set(self.preset, "options", tuple(task.presets))
        _set(self.preset, "value", task.preset_name)
        self.preset_note.content = f"{task.summary}. *{task.preset.note}.*"
        _set(self.amount, "value", task.hand_reward)
        self._build_task_buttons(task)

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
        self._press(button, press)
        self._task_buttons.append(button)
        if control.key:
            self._task_keys.append(self._key(control.name, control.key.upper(), press))

    def _follow_run(self, picture: Picture) -> None:
        if picture.paused != self._paused:
            self._paused = picture.paused
            self.pause.label = "Run" if picture.paused else "Pause"
            icon = viser.Icon.PLAYER_PLAY if picture.paused else viser.Icon.PLAYER_PAUSE
            self.pause.icon = icon
        undo = f"Undo: {picture.undo_words}" if picture.undo_words else "Undo"
        _set(self.undo, "label", undo)
        _set(self.undo, "disabled", picture.undo_words is None)
        self._put(self.seed, picture.seed)
        _set(self.hidden, "disabled", type(picture.task).topology is not Task.topology)
        self._put(self.hidden, ",".join(map(str, _hidden(picture))) or "none")
        speed = picture.speed if isinstance(picture.speed, str) else f"{picture.speed:g}"
        choices = (MAX, *((REALTIME,) if picture.task.dt else ()), *SPEEDS)
        if speed not in choices:
            choices = (*choices, speed)
        _set(self.speed, "options", choices)
        self._put(self.speed, speed)
        if not isinstance(picture.speed, str):
            self._put(self.typed_speed, float(picture.speed))

    def _follow_learning(self, picture: Picture) -> None:
        beta, gamma = picture.beta, picture.gamma
        self._put(self.beta, round(min(beta, GREATEST_BETA), 6))
        memory = min(LONGEST, max(SHORTEST, -math.log10(1.0 - beta)))
        self._put(self.memory, round(memory, 2))
        _set(self.memory_words, "content", f"trace lasts {words.memory(beta, picture.task.dt)}")
        self._put(self.gamma, f"{gamma:.4g}")
        log = min(GREATEST_GAMMA, math.log10(max(gamma, 10.0**LEAST_GAMMA)))
        self._put(self.step_size, round(log, 2))
        self._put(self.frozen, picture.frozen)

    # Small things

    def _when(
        self,
        handle: Any,
        command: Callable[[Any], Command | None],
        *,
        unfinished: Callable[[Any], bool] = lambda _: False,
    ) -> None:
        """Send what `command` makes of a widget's new value, when a page changed it.

        A value may be `unfinished`: a page sends every key that is typed, and a 1 may become 1e-3.
        Such a value waits until nothing more is typed.
        """

        def act() -> None:
            self._try(lambda: command(handle.value))

        def changed(event: Any) -> None:
            if event.client is None:
                return
            self._touched[id(handle)] = time.monotonic()
            self._put_before.pop(id(handle), None)
            waiting = self._waiting.pop(id(handle), None)
            if waiting is not None:
                waiting.cancel()
            if unfinished(handle.value):
                self._waiting[id(handle)] = timer = threading.Timer(TYPING_SECONDS, act)
                timer.daemon = True
                timer.start()
            else:
                act()

        if isinstance(handle, viser.GuiButtonGroupHandle):
            handle.on_click(changed)
        else:
            handle.on_update(changed)

    def _press(self, handle: Any, command: Callable[[], Command]) -> None:
        handle.on_click(lambda _: self._try(command))

    def _key(self, label: str, key: Any, command: Callable[[], Command]) -> Any:
        handle = self._gui.add_command(label, hotkey=key)
        handle.on_trigger(lambda _: self._try(command))
        return handle

    def _try(self, command: Callable[[], Command | None]) -> None:
        try:
            made = command()
        except ValueError as error:
            self._notify(str(error))
            return
        if made is not None:
            self._send(made)

    def _put(self, handle: Any, value: Any) -> None:
        """Set a widget to what holds, when that has become another or was lately touched by hand.

        A widget that merely differs is left alone: what was typed may still be on its way here.
        """
        key = id(handle)
        touched = self._touched.get(key)
        if touched is not None:
            if time.monotonic() - touched < QUIET_SECONDS:
                return
            self._touched.pop(key, None)
        elif self._put_before.get(key) == value:
            return
        self._put_before[key] = value
        _set(handle, "value", value)

    def _of_picture(self) -> Picture:
        if self._picture is None:
            raise ValueError("the run is only starting: try again in a moment")
        return self._picture

    def _choose_hidden(self, text: str) -> Command | None:
        sizes = parse_hidden(text)
        picture = self._of_picture()
        if list(sizes) == _hidden(picture):
            return None
        return Choose(picture.task_name, picture.task.preset_name, sizes)

    def _set_typed_gamma(self, text: str) -> Command:
        try:
            gamma = float(text)
        except ValueError:
            raise ValueError(f"gamma must be a number such as 1e-3, got {text[:40]!r}") from None
        return SetGamma(gamma)


def _hidden(picture: Picture) -> list[int]:
    """Sizes of the hidden layers; a task with a network of its own has none."""
    if type(picture.task).topology is not Task.topology:
        return []
    return [g.size for g in picture.live.topology.neuron_groups][:-1]


def _may_go_on(text: str) -> bool:
    """Whether a typed γ may be only the beginning of one: 1, or 1e-, but not 0.01 or 1e-3."""
    return re.fullmatch(r"\s*\d*\.\d+\s*|\s*[\d.]+[eE]-?\d+\s*", text) is None


def _set(handle: Any, name: str, value: Any) -> None:
    """Assign only what differs: each assignment is a message to every tab."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
