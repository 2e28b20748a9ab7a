"""Reward baseline: every synapse receives the reward minus its running mean.

    m_t = r_t − b_{t−1}                      (sent in place of r_t)
    b_t = b_{t−1} + (r_t − b_{t−1}) / T      (mean reward over about the last T steps)

starting from b = 0; a step uses the baseline from before its reward. A constant added to all
rewards has no effect once b has adapted to it. T should be much longer than a trace lasts,
1/(1 − β): then b hardly depends on the spikes in a trace, and the mean direction of learning stays
the same, with less noise.
"""

from dataclasses import dataclass

from hebbviz.rules import Rule, parameter
from hebbviz.task import Reading


@dataclass(frozen=True)
class Baseline(Rule):
    """Sends the reward minus its running mean over `time` steps, T.

    With T = 1 the baseline is the reward of the previous step.
    """

    name = "baseline"
    summary = "the reward minus its running mean, the reward baseline"
    memory = (Reading("baseline", "reward per step"),)
    time: float = parameter(
        1000.0, least=1.0, most=1e12, unit="steps", hint="T, averaging time of the mean"
    )

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):  # type: ignore[no-untyped-def]
        time = constants[0]
        for lane in range(len(reward)):
            sent[lane] = reward[lane] - memory[0, lane]
            memory[0, lane] += sent[lane] / time
