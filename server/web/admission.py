"""Admission of a page's messages: which of viser's, in what form, with which widget values.

Everything here is a pure check. A message that fails raises `Refused`, with one line for the user.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import msgspec
from viser import _gui_handles as gui
from viser import _messages as viser_messages

from hebbviz.server.web.refusal import Refused, shown

MAX_TEXT = 10_000
MAX_STEP = 2**53
"""Whole numbers below this are the same on a page, where all numbers are floats."""


class MovingSlider(gui.GuiSliderHandle[int]):
    """A slider in the place of another, whose ends move with the run.

    A page may still go by the ends of a moment ago, so values beyond them are let through; whoever
    reads this slider keeps them within.
    """

    def __init__(self, slider: gui.GuiSliderHandle[int]) -> None:
        super().__init__(slider._impl)  # noqa: SLF001  # viser has no slider of other kinds


class TabButtons(gui.GuiButtonGroupHandle):
    """Buttons in the place of others, which do something to the tab alone that presses them."""

    def __init__(self, buttons: gui.GuiButtonGroupHandle) -> None:
        super().__init__(buttons._impl)  # noqa: SLF001  # viser has no buttons of other kinds


Finite = Annotated[float, msgspec.Meta(ge=-1e300, le=1e300)]  # NaN fails both comparisons
Natural = Annotated[int, msgspec.Meta(ge=0, lt=2**31)]
Vec2 = tuple[Finite, Finite]
Vec3 = tuple[Finite, Finite, Finite]


class FromPage(msgspec.Struct, tag_field="type", tag=True):
    """A message that our page sends, by viser's name; fields not named are dropped on the way."""


class ViewerCameraMessage(FromPage):  # viser counts a client as connected from its first one
    wxyz: tuple[Finite, Finite, Finite, Finite]
    position: Vec3
    fov: Finite
    near: Finite
    far: Finite
    image_height: Natural
    image_width: Natural
    look_at: Vec3
    up_direction: Vec3


class SceneNodeClickMessage(FromPage):
    name: str
    instance_index: Natural | None
    ray_origin: Vec3
    ray_direction: Vec3
    screen_pos: Vec2
    modifier: viser_messages.KeyModifier | None
    owner: str = ""


class GuiUpdateMessage(FromPage):
    uuid: str
    updates: dict[str, Any]


class GuiButtonHoldMessage(FromPage):
    uuid: str
    frequency: Finite


class GuiFormSubmitMessage(FromPage):
    uuid: str


class GuiFormDirtyMessage(FromPage):
    uuid: str


class CommandTriggerMessage(FromPage):
    uuid: str


class _Envelope(msgspec.Struct):
    type: str


_ENVELOPE = msgspec.msgpack.Decoder(_Envelope)
_DECODERS = {
    message.__name__: msgspec.msgpack.Decoder(message) for message in FromPage.__subclasses__()
}
encode = msgspec.msgpack.Encoder().encode


def decode(raw: bytes) -> FromPage:
    """The message, if it is of a kind that our page sends and has the right form."""
    try:
        kind = _ENVELOPE.decode(raw).type
    except (ValueError, RecursionError):
        raise Refused("malformed", "refused a message from a page: it is garbled") from None
    if kind not in _DECODERS:
        name = kind if hasattr(viser_messages, kind) else "an unknown kind of message"
        raise Refused(name, f"refused a message from a page: {name} is not in use here")
    try:
        return _DECODERS[kind].decode(raw)
    except (ValueError, RecursionError):
        line = f"refused a message from a page: a {kind} with unfit contents"
        raise Refused(f"unfit {kind}", line) from None


def check(message: FromPage, target: Any) -> None:
    """Refuse the message unless `target`, the thing it is about, is one for such a message."""
    match message:
        case GuiUpdateMessage():
            check_change(target, message.updates)
            return
        case GuiButtonHoldMessage():
            fits = isinstance(target, gui.GuiButtonHandle) and not target.disabled
        case GuiFormSubmitMessage() | GuiFormDirtyMessage():
            fits = isinstance(target, gui.GuiFormHandle)
        case _:
            fits = True
    if not fits:
        kind = type(message).__name__
        line = f"refused a message from a page: a {kind} for something else"
        raise Refused(f"misplaced {kind}", line)


def key(message: FromPage, target: Any) -> str | None:
    """Key by which a later message supersedes this one; None for presses, clicks and forms, each of
    which counts.
    """
    if isinstance(message, ViewerCameraMessage):
        return "camera"
    presses = isinstance(target, (gui.GuiButtonHandle, gui.GuiButtonGroupHandle))
    return message.uuid if isinstance(message, GuiUpdateMessage) and not presses else None


def check_change(widget: Any, updates: dict[str, Any]) -> None:
    """Refuse a page's change of a widget, unless it is a value that fits."""
    label = shown(widget.label)[1:-1]
    if set(updates) != {"value"}:  # an empty change would press a button
        line = f"only the value of {label} may be set, not {shown(sorted(updates))}"
        raise Refused("change", f"refused a change from a page: {line}", widget)
    rule, value = _RULES.get(type(widget), _closed_rule), updates["value"]
    wanted = "enabled first" if widget.disabled else rule(widget, value)
    if wanted is not None:
        raise Refused("value", f"{label} must be {wanted}, got {shown(value)}", widget)


# Which value fits which widget: each rule returns what the value must be, or None if it fits.


def _number_rule(widget: Any, value: object) -> str | None:
    low, high, whole = widget.min, widget.max, isinstance(widget.value, int)
    if (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and math.isfinite(value)
        and not (whole and isinstance(value, float))  # viser would cut 2.7 to 2
        and (low is None or value >= low)
        and (high is None or value <= high)
    ):
        return None
    kind = "a whole number" if whole else "a number"
    if low is None and high is None:
        return kind
    if low is None or high is None:
        return f"{kind}, at most {high}" if low is None else f"{kind}, at least {low}"
    return f"{kind} between {low} and {high}" if whole else f"between {low} and {high}"


def _moving_rule(_: Any, value: object) -> str | None:
    fits = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MAX_STEP
    return None if fits else f"a whole number from 0 to below {MAX_STEP}"


def _switch_rule(_: Any, value: object) -> str | None:
    return None if isinstance(value, bool) else "on or off"


def _button_rule(_: Any, value: object) -> str | None:
    return None if value is True else "pressed"


def _text_rule(_: Any, value: object) -> str | None:
    fits = isinstance(value, str) and len(value) <= MAX_TEXT
    return None if fits else f"a text of at most {MAX_TEXT} characters"


def _option_rule(widget: Any, value: object) -> str | None:
    return None if isinstance(value, str) and value in widget.options else "one of its options"


def _color_rule(widget: Any, value: object) -> str | None:
    channels = len(widget.value)
    fits = (
        isinstance(value, list)
        and len(value) == channels
        and all(type(part) is int and 0 <= part <= 255 for part in value)
    )
    return None if fits else f"{channels} whole numbers between 0 and 255"


def _closed_rule(_: Any, __: object) -> str:
    return "left alone by pages"


_RULES: dict[type, Callable[[Any, object], str | None]] = {
    gui.GuiSliderHandle: _number_rule,
    gui.GuiNumberHandle: _number_rule,
    MovingSlider: _moving_rule,
    gui.GuiCheckboxHandle: _switch_rule,
    gui.GuiButtonHandle: _button_rule,
    gui.GuiTextHandle: _text_rule,
    gui.GuiDropdownHandle: _option_rule,
    gui.GuiButtonGroupHandle: _option_rule,
    TabButtons: _option_rule,
    gui.GuiRgbHandle: _color_rule,
    gui.GuiRgbaHandle: _color_rule,
}
