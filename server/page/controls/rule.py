"""The controls of the rule: which one, its parameters, and over how many steps γ falls."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import viser

from hebbviz.learner.frames import Frame
from hebbviz.rules.base import Rule, rule_class, rule_names
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.widgets import Widgets, assign
from hebbviz.server.run.changes import SetFall, SetRule
from hebbviz.sims.program.typed_numbers import about_commas

NEVER = "never"


class RuleControls:
    """Builds the widgets at the end of a folder; `follow` shows the state in a snapshot."""

    def __init__(self, widgets: Widgets, folder: viser.GuiFolderHandle) -> None:
        self._ui, self._folder = widgets, folder
        self._parameters: dict[str, Any] = {}
        self._rule: Rule | None = None
        self._fall = math.inf
        gui = widgets.gui
        with folder:
            self.fall = gui.add_text(
                "γ falls over",
                NEVER,
                hint="T in steps, or never: at step t the effective γ is γ T/(T + t)",
            )
            self.in_force = gui.add_markdown("")
            self.rule = gui.add_dropdown(
                "rule", rule_names(), hint="how the reward becomes the signal that synapses receive"
            )
            self.words = gui.add_markdown("")
        widgets.when(self.rule, SetRule)
        widgets.when(self.fall, self._typed_fall)

    def follow(self, snapshot: Snapshot) -> None:
        """Show the current state; in the past, the state at the step that is shown."""
        frame = snapshot.run.live if snapshot.view.past is None else snapshot.view.frame
        rule = frame.rule
        fits = tuple(n for n in rule_names() if rule_class(n).fits(snapshot.run.lanes))
        assign(self.rule, "options", fits)
        self._ui.put(self.rule, rule.name)
        if type(rule) is not type(self._rule):
            self._build_parameters(rule)
        self._rule, self._fall = rule, frame.fall
        for name, handle in self._parameters.items():
            self._ui.put(handle, float(getattr(rule, name)))
        assign(self.words, "content", _words(frame))
        self._ui.put(self.fall, NEVER if math.isinf(frame.fall) else f"{frame.fall:g}")
        assign(self.in_force, "visible", not math.isinf(frame.fall))
        assign(self.in_force, "content", f"effective γ {float(frame.gamma[0]):.3g}")

    def _build_parameters(self, rule: Rule) -> None:
        for handle in self._parameters.values():
            handle.remove()
        self._parameters = {}
        with self._folder:
            for field in dataclasses.fields(rule):
                self._parameters[field.name] = self._add(rule, field)

    def _add(self, rule: Rule, field: dataclasses.Field[Any]) -> Any:
        said, name = field.metadata, field.name
        unit = f" ({said['unit']})" if said["unit"] else ""
        handle = self._ui.gui.add_number(
            f"{name}{unit}",
            float(getattr(rule, name)),
            min=said["least"],
            max=said["most"],
            hint=said["hint"],
        )

        def command(value: float) -> SetRule | None:
            assert self._rule is not None
            changed = dataclasses.replace(self._rule, **{name: float(value)})
            return None if changed == self._rule else SetRule(str(changed))

        self._ui.when(handle, command)
        return handle

    def _typed_fall(self, text: str) -> SetFall | None:
        try:
            change = SetFall(math.inf if text.strip() == NEVER else float(text))
        except ValueError as error:
            raise ValueError(
                f"the fall of γ must be a number of steps from 1, or {NEVER}, got {text[:40]!r}"
                f"{about_commas(text)}"
            ) from error
        return None if change.fall == self._fall else change


def _words(frame: Frame) -> str:
    """The rule's summary, and its memory now."""
    kept = zip(frame.rule.memory, frame.memory.tolist(), strict=True)
    now = "".join(f", {reading.name} **{_shown(value):.4g}**" for reading, value in kept)
    return f"{frame.rule.summary}{now}"


def _shown(value: float) -> float:
    """The value; rounding errors of a sum, or of a mean that has decayed, count as 0."""
    return round(value, 12) + 0.0
