"""The lamps with the truth beside them: a network so small that its exact gradient is known.

The page shows ∇η, the rule's running estimate of it, and the angle between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.worlds.lamps import SMALL_EXAMPLE, Lamps
from hebbviz.task.presets import Preset

Array = NDArray[np.float64]

STANDS_STILL = 1e-10
"""A step size at which 10⁹ steps move no weight by more than 0.003.

It leaves the mean of r z six digits: a change of r z γ is rounded by half of 10⁻¹⁶ where |w| < 1.
"""


class Gradient(Lamps):
    """The 2-3-1 network begins where every synapse has a slope, others anywhere in ±1."""

    name = "gradient"
    summary = "watch the rule's estimate of the gradient go to the true one"
    weight_range = 1.0
    presets = {
        "still": Preset(
            0.8,
            STANDS_STILL,
            "not in the paper; γ so small that the weights stand still",
            {"speed": 10_000.0},
        ),
        "learning": Preset(
            0.8, 2e-5, "not in the paper; γ so small that the estimate keeps up with the weights"
        ),
    }

    def __init__(self, preset: str | None = None) -> None:
        super().__init__(preset)
        self.natural_speed = self.preset.options.get("speed")

    def initial_weights(self, draws: Array) -> Array:
        if draws.shape == (len(SMALL_EXAMPLE),):
            return np.array(SMALL_EXAMPLE)
        return super().initial_weights(draws)
