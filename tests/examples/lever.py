"""A lamp and a lever: pull when the lamp is lit, let go when it is not."""

import numpy as np

from hebbviz import Input, Output, Preset, Task


class Lever(Task):
    """State: the lamp (+1 lit, -1 dark), and whether the last answer was right (1 or 0)."""

    name = "lever"
    summary = "pull the lever when the lamp is lit"
    inputs = (Input("lamp"),)
    outputs = (Output("lever", fires="pulled", silent="let go"),)
    hidden = ()
    presets = {"quick": Preset(beta=0.5, gamma=0.01, note="not in the paper")}

    def restart(self, draws):
        return np.array([1.0, 0.0])

    def transition(self, state, action, draws):
        lamp = 1.0 if draws(1)[0] < 0.5 else -1.0
        return np.array([lamp, float(action[0] == state[0])])

    def observation(self, state):
        return state[:1]

    def reward(self, state):
        return state[1]
