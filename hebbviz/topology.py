"""Topologies: named groups of units and the projections between them.

Input groups carry values that the world sets; all other groups consist of spiking neurons. A
projection connects each unit of one group to each neuron of another group or of the same one, so
recurrent networks are no special case.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

Activity = tuple[float, float]
"""The values of u for a silent and for a firing neuron: (0, 1) or (-1, 1)."""

BINARY: Activity = (0.0, 1.0)
SYMMETRIC: Activity = (-1.0, 1.0)

LARGEST_GROUP = 4096
MOST_SYNAPSES = 4_000_000


@dataclass(frozen=True)
class Group:
    """A named population of `size` units; the world sets the values of an input group."""

    name: str
    size: int
    is_input: bool = False


@dataclass(frozen=True)
class Projection:
    """All-to-all synapses from the group named `pre` to the group named `post`."""

    pre: str
    post: str

    @property
    def name(self) -> str:
        """Name of the projection: presynaptic → postsynaptic group."""
        return f"{self.pre} → {self.post}"


@dataclass(frozen=True)
class Topology:
    """Groups, projections and the pair of activity values.

    Units are numbered in the order of `groups`, input groups first, then neurons. Synapses are
    numbered projection by projection, each of shape (post, pre), row by row.

    Raises
    ------
    ValueError
        If names repeat or are unknown, a size is out of range, a projection targets an input
        group, or the output is not a group of neurons.
    """

    groups: tuple[Group, ...]
    projections: tuple[Projection, ...]
    output: str
    activity: Activity = SYMMETRIC

    def __post_init__(self) -> None:
        _check_groups(self.groups)
        by_name = {g.name: g for g in self.groups}
        for p in self.projections:
            for name in (p.pre, p.post):
                if name not in by_name:
                    raise ValueError(f"projection {p.name}: there is no group {name!r}")
            if by_name[p.post].is_input:
                raise ValueError(f"projection {p.name}: an input group cannot be a target")
        if len(set(self.projections)) < len(self.projections):
            raise ValueError("projections must differ: two connect the same pair of groups")
        if not self.projections:
            raise ValueError("a network needs at least one projection")
        if self.output not in by_name or by_name[self.output].is_input:
            raise ValueError(f"output must name a group of neurons, got {self.output!r}")
        if self.activity not in (BINARY, SYMMETRIC):
            raise ValueError(f"activity must be (0, 1) or (-1, 1), got {self.activity}")
        if self.synapses > MOST_SYNAPSES:
            raise ValueError(f"a network has at most {MOST_SYNAPSES} synapses, got {self.synapses}")

    @property
    def input_groups(self) -> tuple[Group, ...]:
        """Groups of inputs."""
        return tuple(g for g in self.groups if g.is_input)

    @property
    def neuron_groups(self) -> tuple[Group, ...]:
        """Groups of neurons."""
        return tuple(g for g in self.groups if not g.is_input)

    @cached_property
    def inputs(self) -> int:
        """Number of input units."""
        return sum(g.size for g in self.input_groups)

    @cached_property
    def neurons(self) -> int:
        """Number of spiking neurons."""
        return sum(g.size for g in self.neuron_groups)

    @property
    def units(self) -> int:
        """Inputs and neurons together."""
        return self.inputs + self.neurons

    @property
    def synapses(self) -> int:
        """Number of synapses."""
        return sum(self.shape(p)[0] * self.shape(p)[1] for p in self.projections)

    def fits_in(self, rows: int) -> bool:
        """Whether a state with this many rows can belong to this network.

        Ask before making a network whose sizes come from a file.
        """
        return self.synapses + sum(group.size for group in self.groups) <= rows

    def group(self, name: str) -> Group:
        """The group called `name`."""
        return next(g for g in self.groups if g.name == name)

    def first_unit(self, name: str) -> int:
        """Return the number of a group's first unit, counting inputs, then neurons."""
        start = 0
        for g in (*self.input_groups, *self.neuron_groups):
            if g.name == name:
                return start
            start += g.size
        raise KeyError(name)

    def units_of(self, name: str) -> slice:
        """Slice of the units of a group; inputs come before neurons."""
        start = self.first_unit(name)
        return slice(start, start + self.group(name).size)

    def neurons_of(self, name: str) -> slice:
        """Slice of the neurons of a group."""
        start = self.first_unit(name) - self.inputs
        return slice(start, start + self.group(name).size)

    def shape(self, projection: Projection) -> tuple[int, int]:
        """Return the sizes (post, pre) of a projection."""
        return self.group(projection.post).size, self.group(projection.pre).size

    def synapses_of(self, index: int) -> slice:
        """Return the numbers of the synapses of projection `index`, as a slice."""
        sizes = [a * b for a, b in map(self.shape, self.projections)]
        start = sum(sizes[:index])
        return slice(start, start + sizes[index])

    def is_held(self, projection: Projection) -> bool:
        """Whether the presynaptic values come from the world (held input)."""
        return self.group(projection.pre).is_input

    def with_inputs(self, size: int) -> Topology:
        """Return the same network with `size` input units.

        Raises ValueError if it has several input groups.
        """
        if size == self.inputs:
            return self
        if len(self.input_groups) != 1:
            raise ValueError(
                f"{size} inputs cannot be shared among {len(self.input_groups)} groups"
            )
        return replace(
            self, groups=tuple(replace(g, size=size) if g.is_input else g for g in self.groups)
        )

    def describe(self) -> str:
        """Return the sizes of the groups, as in '8-4-2'."""
        return "-".join(str(g.size) for g in self.groups)

    def to_json(self) -> dict[str, Any]:
        """The topology as values for JSON."""
        return {
            "groups": [[g.name, g.size, g.is_input] for g in self.groups],
            "projections": [[p.pre, p.post] for p in self.projections],
            "output": self.output,
            "activity": list(self.activity),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Topology:
        """Return the topology that `to_json` wrote.

        Raises ValueError, TypeError or KeyError for any other data.
        """
        low, high = data["activity"]
        return cls(
            groups=tuple(Group(str(n), int(s), bool(i)) for n, s, i in data["groups"]),
            projections=tuple(Projection(str(a), str(b)) for a, b in data["projections"]),
            output=str(data["output"]),
            activity=(float(low), float(high)),
        )


def feedforward(
    inputs: int, hidden: Iterable[int], outputs: int, *, activity: Activity = SYMMETRIC
) -> Topology:
    """Make a layered network, as in the paper's simulations."""
    sizes = list(hidden)
    names = ["hidden"] if len(sizes) == 1 else [f"hidden {k + 1}" for k in range(len(sizes))]
    groups = (
        Group("input", inputs, is_input=True),
        *(Group(n, s) for n, s in zip(names, sizes, strict=True)),
        Group("output", outputs),
    )
    projections = tuple(Projection(a.name, b.name) for a, b in pairwise(groups))
    return Topology(groups, projections, "output", activity)


def parse_hidden(text: str) -> tuple[int, ...]:
    """Parse the sizes of the hidden layers from a command line: '16', '8,8' or 'none'.

    Raises ValueError for any other text.
    """
    if text.strip().lower() == "none":
        return ()
    if not re.fullmatch(r"\d{1,9}(,\d{1,9}){0,7}", text.strip()):
        raise ValueError(
            f"hidden must be sizes such as 16 or 8,8 (at most 8, from 1 to {LARGEST_GROUP} each), "
            f"or none, got {text!r}"
        )
    return tuple(int(part) for part in text.split(","))


def _check_groups(groups: tuple[Group, ...]) -> None:
    names = [g.name for g in groups]
    if len(set(names)) < len(names):
        raise ValueError(f"groups must have different names, got {', '.join(names)}")
    for g in groups:
        if not 1 <= g.size <= LARGEST_GROUP:
            raise ValueError(f"group {g.name!r} must have 1 to {LARGEST_GROUP} units, got {g.size}")
    if not any(not g.is_input for g in groups):
        raise ValueError("a network needs at least one group of neurons")
