"""A network in a finite world as one exact Markov chain: η(w), ∇η(w) and E[r z] of every synapse.

In section 4 of the paper the neurons are independent agents, and everything outside a neuron,
including the activities of the previous step, is its world. A network of N neurons in a finite
world is therefore again a finite POMDP, with

    state         (a, x, y)   spikes of all neurons, 2^N; the world's state; its observation
    observation   (a, y)      all that neurons can observe: activities of the previous step
    control       a'          the new spikes, by Pr(u_i = 1) = σ(v_i), v = Σ_j w_j u^j
    next state    (a', x', y')  with x' ~ P(outputs of a'), y' ~ ν(x')
    reward        r(x')

The order of events is the engine's: respond, let the world answer, reinforce with r and the trace
that includes this step's term, set the input. The policy's score is the eligibility term of
equation (neuron-zupdate), so `Chain.biased_gradient` is the long-run mean of r z in the learner,
in the order of the topology's synapses.

Delays. A spike of a neuron d steps away from the outputs affects the reward d steps later, so
E[r z] of its synapses starts at order β^d: at β = 0 it is zero for all neurons but the outputs,
whatever ∇η is. If the pattern is constant, the reward depends only on the outputs of the step and
the network is layered, only delay d contributes: E[r z] = β^d ∇η, the right direction at all β > 0.

The best β then depends on noise. With a reward of mean m and variance v, a hidden synapse has its
largest signal-to-noise ratio near the maximum of β²/(m²/(1−β)² + v/(1−β²)). This is 0.5, as the
paper says, if the reward hardly varies about a nonzero mean: the noise is then that of the whole
trace, 1/(1−β), of which the share (1−β) β carries the signal. For the paper's sonar rewards, 0 or
1, it is 0.54 at chance level and 0.506 at 10 % error; for ±1 at chance level it is 1/√2 = 0.707.
For synapses d steps away it is d/(d + 1) instead of 1/2. `Chain.best_beta` finds it exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.reference import sigma
from hebbviz.theory.markov_chain import Chain
from hebbviz.theory.policies import mixed_digits
from hebbviz.theory.pomdp import POMDP
from hebbviz.topology import Topology

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

MOST_NUMBERS = 2**24
"""The largest transition table, controls × states × states, that is built."""


class NetworkPolicy:
    """All neurons as one agent: μ_a(o, w) is the product of σ(v) or σ(−v), by the spikes in a.

    `seen` (O, units) holds the activities of all units in each of the O observations, inputs
    first; the parameters are the synapses, in the topology's order. `fired` (N, 2^N) holds the
    spikes of each control, to which neuron i adds 2^i; `post` and `pre` (K,) are each synapse's
    neuron and presynaptic unit.
    """

    def __init__(self, topology: Topology, vectors: Array) -> None:
        low, high = topology.activity
        self.fired = mixed_digits([2] * topology.neurons)
        before = np.repeat((low + (high - low) * self.fired).T, len(vectors), axis=0)
        self.seen = np.hstack([np.tile(vectors, (self.fired.shape[1], 1)), before])
        self.post, self.pre = _ends(topology)

    @property
    def parameters(self) -> int:
        return len(self.post)

    def potentials(self, weights: Array) -> Array:
        """Return v of every neuron, (O, N): equation (potential)."""
        matrix = np.zeros((len(self.fired), self.seen.shape[1]))
        matrix[self.post, self.pre] = weights
        return self.seen @ matrix.T

    def probabilities(self, weights: Array) -> Array:
        v = self.potentials(weights)[:, :, None]
        mu: Array = np.prod(np.where(self.fired, sigma(v), sigma(-v)), axis=1)
        return mu

    def score(self, weights: Array) -> Array:
        """Return the eligibility terms (fired − σ(v)) u^j, (O, 2^N, K)."""
        surprise = self.fired.T - sigma(self.potentials(weights))[:, None, :]
        return np.array(surprise[:, :, self.post] * self.seen[:, None, self.pre])


class ExactNetwork:
    """A network in a finite world: `at` gives the chain for any weights.

    `vectors` (Y, inputs) gives the inputs of each observation of the `world`; the control is the
    outputs' joint activity, to which output i adds 2^i. `pomdp` is the world that the neurons act
    in together, `policy` their joint policy. Its state number is a·M + m, where m counts the M
    possible `pairs` (x, y).

    Raises
    ------
    ValueError
        If the topology does not fit the world, or if the chain would have too many states.
    """

    def __init__(self, world: POMDP, vectors: Array, topology: Topology) -> None:
        self.world, self.vectors, self.topology = world, vectors, topology
        t = topology
        inputs, outputs = vectors.shape[1], t.neurons_of(t.output)
        commands = 2 ** (outputs.stop - outputs.start)
        if (t.inputs, commands) != (inputs, world.controls):
            raise ValueError(
                f"the world has {inputs} inputs and {world.controls} controls, "
                f"the network {t.inputs} inputs and outputs for {commands} controls"
            )
        self.pairs: Whole = np.argwhere(world.observations > 0.0)
        if 2 ** (3 * t.neurons) * len(self.pairs) ** 2 > MOST_NUMBERS:
            raise ValueError(
                f"{t.neurons} neurons and {len(self.pairs)} states of the world make a table of "
                f"2^{3 * t.neurons} × {len(self.pairs)}² numbers, at most {MOST_NUMBERS:,} are "
                "allowed; take fewer neurons"
            )
        self.policy = NetworkPolicy(t, vectors)
        self.pomdp = self._pomdp()

    def at(self, weights: Array) -> Chain:
        """Return the chain for `weights` (synapses,), in the topology's order.

        Raises ValueError if the weights have another shape or are not finite.
        """
        if weights.shape != (self.topology.synapses,) or not np.isfinite(weights).all():
            raise ValueError(
                f"weights must be finite and of shape ({self.topology.synapses},), "
                f"got {weights.shape}"
            )
        return self.pomdp.under(self.policy, weights)

    def synapses_onto(self, group: str) -> Whole:
        """Return the numbers of all synapses onto the neurons of a group."""
        neurons = self.topology.neurons_of(group)
        post = self.policy.post
        return np.flatnonzero((neurons.start <= post) & (post < neurons.stop))

    def _pomdp(self) -> POMDP:
        world, (x, y) = self.world, self.pairs.T
        outputs = self.topology.neurons_of(self.topology.output)
        fired = self.policy.fired
        commands = (2 ** np.arange(outputs.stop - outputs.start)) @ fired[outputs]
        many, m = fired.shape[1], len(self.pairs)
        moves = np.zeros((many, many, m, many, m))
        for a, command in enumerate(commands):
            moves[a, :, :, a] = world.transitions[command][np.ix_(x, x)] * world.observations[x, y]
        sees = np.zeros((many, m, many, world.sights))
        sees[np.arange(many)[:, None], np.arange(m), np.arange(many)[:, None], y] = 1.0
        return POMDP(
            moves.reshape(many, many * m, many * m),
            sees.reshape(many * m, many * world.sights),
            np.tile(world.rewards[x], many),
        )


def _ends(topology: Topology) -> tuple[Whole, Whole]:
    """Return the neuron and the presynaptic unit of every synapse, in the topology's order."""
    ends = []
    for p in topology.projections:
        first = np.array([[topology.neurons_of(p.post).start], [topology.first_unit(p.pre)]])
        ends.append(first + np.indices(topology.shape(p)).reshape(2, -1))
    post, pre = np.hstack(ends)
    return post, pre
