"""Shared by all figures: their look, and their files with all that is needed to make them again.

A figure is three files of one name, PNG, SVG and the CSV behind them. Each says inside by which
command, version and seed it was made. They hold no date and nothing of the machine, so that the
same command writes the same bytes.
"""

from __future__ import annotations

import contextlib
import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from hebbviz import __version__
from hebbviz.sims.figures.palette import LIGHT, Rgb
from hebbviz.sims.program.terminal import InputError, writing
from hebbviz.sims.program.whole_folder import whole_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Color = tuple[float, float, float]
Table = Mapping[str, Sequence[float | int | str]]

WIDTH = 7.2
"""Inches: across both columns of a paper."""
SMALL, TINY = 7.5, 6.0
"""Points."""
_MARGIN, _TITLE, _FOOT, _PITCH = 0.12, 0.24, 0.46, 0.12
"""Inches: around the drawing, for a title above its panels, for the lines at its foot, and for one
of them.
"""
_PAD = 7.0
"""Points between a drawing and its title."""
_ROWS = 3
"""Lines that the foot has room for; with more of them the figure is so much higher."""
_LETTERS = 150
"""Letters in a line of the small print."""
_MOST_ROWS = 8
"""Lines of a command; all of a longer one is inside the files."""


def color(rgb: Rgb) -> Color:
    """A colour of the page's palette, as matplotlib wants it."""
    r, g, b = rgb
    return r / 255.0, g / 255.0, b / 255.0


def dark(shade: Color) -> Color:
    """A shade of it for small letters and for thin lines on its own colour."""
    r, g, b = shade
    return 0.62 * r, 0.62 * g, 0.62 * b


INK, FAINT, IDLE = color(LIGHT.ink), color(LIGHT.world), color(LIGHT.world_strong)

_LOOK: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "mathtext.fontset": "dejavusans",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": IDLE,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": _PAD,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": IDLE,
    "ytick.color": IDLE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.minor.size": 0.0,
    "ytick.minor.size": 0.0,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": SMALL,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "savefig.dpi": 220,
    "svg.hashsalt": "hebbviz",
    "svg.fonttype": "path",
    "path.simplify": True,
}


@dataclass(frozen=True)
class Origin:
    """By what a figure was made: the command that makes it again, the program, and the seed."""

    command: str
    seed: int
    version: str = __version__

    def items(self) -> dict[str, str]:
        return {"command": self.command, "version": self.version, "seed": str(self.seed)}


@dataclass(frozen=True)
class Sheet:
    """A finished figure.

    `table` holds the columns of its CSV, of one length; `numbers` what it comes to, fit for
    strict JSON; `note` what else must be said, above the small print that says its origin; `quick`
    what is less than the whole figure has, which all of its files say.
    """

    drawing: Figure
    table: Table
    numbers: dict[str, Any]
    note: str = ""
    quick: str = ""


@contextlib.contextmanager
def look() -> Iterator[None]:
    """The look of all figures, whatever the user's own matplotlibrc says."""
    plain: dict[Any, Any] = dict(mpl.rcParamsDefault)
    with mpl.rc_context({k: v for k, v in (plain | _LOOK).items() if not k.startswith("backend")}):
        yield


def blank(height: float, *, width: float = WIDTH) -> Figure:
    """An empty drawing, in inches; to be filled and saved within `look`."""
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine())
    _leave_foot(figure, _FOOT)
    return figure


def _leave_foot(figure: Figure, foot: float) -> None:
    """Keep this many inches free below the drawing, and room for a common title above it."""
    width, height = figure.get_size_inches()
    top = _MARGIN + (_TITLE if figure.texts else 0.0)
    edges = (_MARGIN / width, foot / height, 1 - 2 * _MARGIN / width, 1 - (foot + top) / height)
    engine = figure.get_layout_engine()
    assert isinstance(engine, ConstrainedLayoutEngine)
    engine.set(rect=edges)


def save(sheet: Sheet, folder: Path, name: str, origin: Origin) -> list[Path]:
    """Write PNG, SVG and CSV; returns the three paths. Raises InputError.

    They get their names when all of them are done, in place of older ones.
    """
    about = origin.items() | ({"quick": sheet.quick} if sheet.quick else {})
    note = f"quick: {sheet.quick}\n{sheet.note}" if sheet.quick else sheet.note
    with look():
        said = [row for line in note.splitlines() for row in wrap(line, _LETTERS)]
        made_by = _made_by(origin)
        _make_room(sheet.drawing, len(said) + len(made_by))
        _settle(sheet.drawing)
        _small_print(sheet.drawing, made_by, said)
        png, svg = io.BytesIO(), io.BytesIO()
        title = {"Title": f"hebbviz figure {name}"}
        software = {"Software": f"hebbviz {origin.version}"}
        sheet.drawing.savefig(
            png, format="png", metadata=title | software | {k.title(): v for k, v in about.items()}
        )
        sheet.drawing.savefig(
            svg,
            format="svg",
            metadata=title
            | {
                "Date": None,
                "Creator": software["Software"],
                "Source": origin.command,
                "Description": "; ".join(f"{k}: {v}" for k, v in about.items()),
            },
        )
    made = {"png": png.getvalue(), "svg": svg.getvalue(), "csv": _csv(sheet.table, about)}
    with writing(folder / f"{name}.png"), whole_folder(folder) as part:
        for kind, data in made.items():
            (part / f"{name}.{kind}").write_bytes(data)
    return [folder / f"{name}.{kind}" for kind in made]


def check_replaces(folder: Path, name: str, command: str) -> None:
    """Raise InputError if files of the name are there that another command made."""
    if _is_of_another(folder, name, command):
        raise InputError(
            f"{folder / name}.csv is of another command and is not written over: move it away, or "
            "name another folder for --out"
        )


def own_name(folder: Path, name: str, command: str) -> str:
    """The first of NAME, NAME-2, NAME-3, … that is free there, or that this command made."""
    names = (f"{name}-{k}" if k > 1 else name for k in count(1))
    return next(n for n in names if not _is_of_another(folder, n, command))


def _is_of_another(folder: Path, name: str, command: str) -> bool:
    table = folder / f"{name}.csv"
    return table.exists() and not table.read_bytes().startswith(f"# command: {command}\n".encode())


def title(figure: Figure, words: str) -> None:
    """Of a figure of several panels, below its upper margin."""
    width, height = figure.get_size_inches()
    figure.text(
        _MARGIN / width, 1 - _MARGIN / height, words, va="top", fontsize=9.5, fontweight="bold"
    )
    _leave_foot(figure, _FOOT)


def head(axes: Axes, title: str, words: str, shade: Color = INK) -> None:
    """A title, and in small letters below it what is to be read with the drawing, off its grid."""
    rows = words.count("\n") + 1
    axes.set_title(title, color=shade, pad=_PAD + 1.45 * SMALL * rows)
    axes.annotate(
        words,
        (0, 1),
        (0, _PAD - 2),
        "axes fraction",
        "offset points",
        fontsize=SMALL,
        va="bottom",
        linespacing=1.3,
        annotation_clip=False,
    )


def mark_end(
    axes: Axes, x: float, y: float, text: str, shade: Color, *, stands: str = "center"
) -> None:
    """Words beside the end of a curve, in place of a legend; they stand at it, or with 'bottom'
    above and with 'top' below it.
    """
    axes.annotate(
        text,
        (x, y),
        (5, 0),
        textcoords="offset points",
        va=stands,
        color=shade,
        fontsize=SMALL,
        annotation_clip=False,
    )


def apart(places: Sequence[float] | NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """Places (n,) moved as little as can be, all of a crowd alike, to be `gap` or more apart."""
    order = np.argsort(places, kind="stable")
    crowds: list[NDArray[np.float64]] = []
    for place in np.asarray(places, dtype=float)[order]:
        crowds.append(np.array([place]))
        while len(crowds) > 1 and crowds[-1][0] - crowds[-2][-1] < gap:
            last = np.concatenate([crowds.pop(-2), crowds.pop()])
            crowds.append(last.mean() + gap * (np.arange(len(last)) - (len(last) - 1) / 2))
    found = np.empty(len(order))
    found[order] = np.concatenate(crowds)
    return found


def _make_room(figure: Figure, rows: int) -> None:
    """Make a figure higher if its foot has no room for all lines."""
    more = _PITCH * max(0, rows - _ROWS)
    if more:
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height + more)
        _leave_foot(figure, _FOOT + more)


def _settle(figure: Figure) -> None:
    """Lay it out for good, in round numbers: the solver's last digits change from run to run."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = axes.get_position(original=True).bounds
        axes.set_position((round(left, 4), round(bottom, 4), round(width, 4), round(height, 4)))


def _made_by(origin: Origin) -> list[str]:
    """The lines of the origin; values are broken at commas as words are at spaces."""
    about = f"· hebbviz {origin.version} · seed {origin.seed}"
    rows = [""]
    for word in re.findall(r"[^ ,]*[ ,]?", f"{origin.command} {about}"):
        if len(rows[-1] + word.rstrip()) > _LETTERS:
            rows.append("")
        rows[-1] += word
    if len(rows) > _MOST_ROWS:
        rows[_MOST_ROWS - 1 :] = [f"… (all of it is inside this file) {about}"]
    return [row.rstrip() for row in rows]


def _small_print(figure: Figure, made_by: Sequence[str], said: Sequence[str]) -> None:
    width, height = figure.get_size_inches()
    for row, text in enumerate(reversed([*said, *made_by])):
        figure.text(
            _MARGIN / width,
            (0.08 + _PITCH * row) / height,
            text,
            fontsize=TINY,
            color=IDLE if row < len(made_by) else INK,
            ha="left",
            va="bottom",
            in_layout=False,
        )


def _csv(table: Table, about: Mapping[str, str]) -> bytes:
    text = io.StringIO()
    text.writelines(f"# {key}: {value}\n" for key, value in about.items())
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*table.values(), strict=True))
    return text.getvalue().encode()
