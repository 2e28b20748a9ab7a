"""Images of arrays: heat maps of synapses and the spike raster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Block
from hebbviz.rules.base import Rule
from hebbviz.rules.paper import PAPER
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Pixels, Rgb, Theme
from hebbviz.topology import Topology

Array = NDArray[np.float64]

WIDTH = 320
RASTER_STEPS = 160
RASTER_ROW = 9
LARGEST_MAP = 120


def heat_map(values: Array, full: float, positive: Rgb, negative: Rgb, theme: Theme) -> Pixels:
    """An image of a (post, pre) matrix, zero in the theme's neutral colour, `full` at full hue."""
    colors = palette.signed(values / full, positive, negative, theme.zero)
    rows, columns = values.shape
    across = max(1, WIDTH // columns)
    down = max(1, min(22, LARGEST_MAP // rows))
    pixels = np.repeat(np.repeat(colors, down, axis=0), across, axis=1)
    if across > 4 and down > 4:
        pixels[::down] = pixels[:, ::across] = theme.background
    return pixels


def raster(
    block: Block | None,
    topology: Topology,
    theme: Theme,
    changes: Sequence[int] = (),
    rule: Rule = PAPER,
) -> Pixels:
    """The spikes of the latest steps, one row a neuron, newest at the right; (height, WIDTH, 3).

    Groups differ in colour; a row above shows the rewards, the brighter the more, and the steps of
    `changes`. The signal that `rule` sends is shown only if it is the reward, see `Block.events`.
    """
    rows = topology.neurons
    row = max(2, min(RASTER_ROW, 150 // rows))
    cells = np.empty((rows + 1, RASTER_STEPS, 3), dtype=np.uint8)
    cells[:] = theme.zero
    if block is not None:
        block = block.tail(RASTER_STEPS)
        seen = slice(RASTER_STEPS - len(block.fired), RASTER_STEPS)
        cells[1:, seen] = np.where(
            block.fired.T[..., None] > 0, _group_colors(topology)[:, None], theme.zero
        )
        changed = np.isin(block.start + np.arange(len(block.fired)), changes)
        cells[0, seen][changed] = theme.ink
        came = block.events(rule) / max(np.abs(block.events(rule)).max(initial=0.0), 1e-300)
        shades = palette.signed(came, palette.REWARD, palette.PUNISHMENT, theme.zero)
        cells[0, seen][came != 0.0] = shades[came != 0.0]
    pixels = np.repeat(np.repeat(cells, row, axis=0), WIDTH // RASTER_STEPS, axis=1)
    pixels[row::row] = theme.background
    return pixels


def _group_colors(topology: Topology) -> Pixels:
    """The colour of each neuron's group, (neurons, 3)."""
    groups = topology.neuron_groups
    of = np.repeat(np.arange(len(groups)), [g.size for g in groups])
    return np.array(palette.SERIES, dtype=np.uint8)[of % len(palette.SERIES)]
