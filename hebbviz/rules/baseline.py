"""Reward baseline: every synapse is sent how much better the reward was than usual.

    m_t = r_t − b_{t−1}                      (sent in place of r_t)
    b_t = b_{t−1} + (r_t − b_{t−1}) / T      (the usual reward, over about the last T steps)

with b = 0 at first; the baseline of a step is the one from before its reward. A number added to
all rewards changes nothing once b has taken it in. T is to be much longer than a trace lasts,
1/(1 − β): b then hardly depends on what a trace remembers, so that the direction of learning is
the same on average, with less noise.
"""

from dataclasses import dataclass

from hebbviz.rules import Rule, parameter
from hebbviz.task import Reading


@dataclass(frozen=True)
class Baseline(Rule):
    """`time` is T, in steps: at 1 the baseline is the reward of the step before."""

    name = "baseline"
    summary = "the reward less a running mean of it, the reward baseline"
    memory = (Reading("baseline", "reward per step"),)
    time: float = parameter(
        1000.0, least=1.0, most=1e12, unit="steps", hint="T, how far back the mean goes"
    )

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):  # type: ignore[no-untyped-def]
        time = constants[0]
        for lane in range(len(reward)):
            sent[lane] = reward[lane] - memory[0, lane]
            memory[0, lane] += sent[lane] / time
