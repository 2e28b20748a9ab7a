"""Colours, one meaning each, that the colour-blind can distinguish (after Okabe and Ito, 2008)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[int, int, int]
Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Theme:
    """Colours that depend on the background."""

    name: str
    background: Rgb
    ink: Rgb
    idle: Rgb
    world: Rgb
    world_strong: Rgb
    zero: Rgb


DARK = Theme(
    "dark", (18, 20, 26), (220, 224, 232), (58, 64, 80), (30, 35, 46), (96, 104, 122), (44, 48, 58)
)
LIGHT = Theme(
    "light",
    (255, 255, 255),
    (40, 44, 52),
    (176, 182, 192),
    (226, 229, 234),
    (140, 146, 156),
    (240, 241, 243),
)
THEMES = {t.name: t for t in (DARK, LIGHT)}

SPIKE: Rgb = (255, 214, 64)
ACCENT: Rgb = (240, 120, 60)
BRAND: Rgb = (0, 114, 178)

# A sign is a hue, and the same everywhere: weights blue and orange, traces green and purple.
WEIGHT_POSITIVE: Rgb = (58, 148, 228)
WEIGHT_NEGATIVE: Rgb = (226, 104, 32)
TRACE_POSITIVE: Rgb = (38, 178, 132)
TRACE_NEGATIVE: Rgb = (206, 102, 172)
INPUT_POSITIVE: Rgb = (120, 186, 240)
INPUT_NEGATIVE: Rgb = (240, 166, 112)
REWARD: Rgb = (250, 230, 90)
PUNISHMENT: Rgb = (236, 72, 72)

SERIES: tuple[Rgb, ...] = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (213, 94, 0),
    (0, 114, 178),
    (240, 208, 66),
    (140, 140, 140),
)


def css(color: Rgb, alpha: float = 1.0) -> str:
    r, g, b = color
    return f"rgba({r},{g},{b},{alpha:g})"


def signed(
    values: NDArray[np.float64], positive: Rgb, negative: Rgb, zero: Rgb, *, floor: float = 0.0
) -> Pixels:
    """Colours (…, 3) of values in -1..1: from `zero` to a hue; `floor` is where the hue starts."""
    x = np.clip(np.nan_to_num(values), -1.0, 1.0)
    strength = (floor + (1.0 - floor) * np.abs(x))[..., None]
    hue = np.where((x >= 0)[..., None], np.array(positive), np.array(negative))
    return np.asarray(np.array(zero) * (1 - strength) + hue * strength, dtype=np.uint8)


def blend(share: NDArray[np.float64], start: Rgb, end: Rgb) -> Pixels:
    """Colours (…, 3) between two, `share` in 0..1."""
    s = np.clip(share, 0.0, 1.0)[..., None]
    return np.asarray(np.array(start) * (1 - s) + np.array(end) * s, dtype=np.uint8)


_LINEAR = np.array([round(255 * (c / 255) ** 2.2) for c in range(256)], dtype=np.uint8)


def linear(colors: Pixels) -> Pixels:
    """As instances of a mesh want them: viser reads their colours as linear light, not as sRGB."""
    made: Pixels = _LINEAR[colors]
    return made
