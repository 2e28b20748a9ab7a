"""The square of the pendulum's puck, as a pymunk space that finds and bounces its walls.

pymunk moves a single rigid disc; it does not know the rod. So each time step goes in turns:

1. The equations of motion (`physics.py`) take puck and rod through the step, in one piece where
   the rod does not spin.
2. The engine moves the disc along the straight line to the same end, and bounces it where that
   line meets a wall.
3. Where the engine turned the disc's velocity round, there was a wall on that axis: the equations
   say when, puck and rod take its elastic blow together at that moment, and what is left of the
   step begins there.

Setting a force on the disc and letting the engine integrate would be simpler, and wrong: its
semi-implicit Euler step makes the energy of the unstable rod explode at 0.02 s.
"""

import math
import weakref

import numpy as np
import pymunk

# The engine's own calls: pymunk's properties check types and build a Vec2d at each access, which
# doubles the cost of a time step (4 microseconds against 2).
from pymunk._chipmunk_cffi import lib

from hebbviz.sims.worlds.pendulum.physics import PLANT, Vector, advance, rebound

_WALL_RADIUS = 1.0  # m. A thin wall is jumped over; this one stops a puck of up to 50 m/s.
_OFFSET = PLANT.side / 2 + _WALL_RADIUS  # of the walls' axes from the centre, m
_REACH = _OFFSET + _WALL_RADIUS  # of the walls' ends from their middle, m: corners are closed
_WALLS = (
    ((-_OFFSET, -_REACH), (-_OFFSET, _REACH)),
    ((_OFFSET, -_REACH), (_OFFSET, _REACH)),
    ((-_REACH, -_OFFSET), (_REACH, -_OFFSET)),
    ((-_REACH, _OFFSET), (_REACH, _OFFSET)),
)
# m, more than any overlap: else the engine pushes discs out of walls over the following steps,
# which a restored state would not know of.
_NO_PUSHING_OUT = 10.0
_TURNED = 1e-9  # m/s: a velocity that changed by more than this met a wall; less is rounding


class Arena:
    """Takes a puck and its pendulum through time steps in the walled square.

    An arena remembers nothing: the state after a step is, bit for bit, a function of the state
    before it and the thrust, whatever the arena was used for in between.
    """

    def __init__(self) -> None:
        """Take a space that no other arena has."""
        self._space, self._puck = room = _room()
        weakref.finalize(self, _rooms.append, room).atexit = False
        self._space_pointer = self._space._space  # noqa: SLF001
        self._puck_pointer = self._puck._body  # noqa: SLF001

    def slide(
        self, x: float, y: float, vx: float, vy: float, seconds: float = PLANT.time_step
    ) -> tuple[float, float, float, float]:
        """Let the engine alone move the disc, without a rod, for some seconds.

        Takes its position in m and velocity in m/s and returns those at the end, in the same
        order: the velocity turned round on an axis that met a wall, the position beyond it.
        """
        puck = self._puck_pointer
        lib.cpBodySetPosition(puck, (x, y))
        lib.cpBodySetVelocity(puck, (vx, vy))
        lib.cpSpaceStep(self._space_pointer, seconds)
        p = lib.cpBodyGetPosition(puck)
        v = lib.cpBodyGetVelocity(puck)
        return p.x, p.y, v.x, v.y

    def step(self, state: Vector, thrust: tuple[float, float]) -> Vector:
        """Return the state one time step after `state` under `thrust`.

        States are of shape (10,), as in `physics.py`; the one returned is a new
        array. `thrust` is the force on the puck along x and y, in N.
        """
        left = PLANT.time_step
        while left > 0.0:
            end = np.empty(10)
            h, x, y, vx, vy = advance(state, thrust[0], thrust[1], left, end)
            end[0], end[1], after_x, after_y = self.slide(x, y, vx, vy, h)
            if abs(after_x - vx) > _TURNED or abs(after_y - vy) > _TURNED:
                inward = _inward(after_x - vx), _inward(after_y - vy)
                h, end[:] = rebound(state, *thrust, PLANT.friction, h, *inward)
            state, left = end, left - h
        return end


Room = tuple[pymunk.Space, pymunk.Body]

_rooms: list[Room] = []
"""Spaces that no arena has any more. None is ever freed: pymunk takes a space apart shape by shape,
and where Python's collector frees one of them in another thread meanwhile, the program crashes.
"""


def _room() -> Room:
    try:
        return _rooms.pop()
    except IndexError:
        return _new_room()


def _new_room() -> Room:
    """A space with a disc that cannot turn, and four static walls, all elastic."""
    space = pymunk.Space()
    space.collision_slop = _NO_PUSHING_OUT
    puck = pymunk.Body(PLANT.puck_mass, float("inf"))
    disc = pymunk.Circle(puck, PLANT.puck_radius)
    walls = [pymunk.Segment(space.static_body, a, b, _WALL_RADIUS) for a, b in _WALLS]
    for shape in (disc, *walls):
        shape.elasticity = 1.0
        shape.friction = 0.0
    space.add(puck, disc, *walls)
    return space, puck


def _inward(change: float) -> float:
    """The direction of the normal of the wall that changed the velocity on an axis, or 0."""
    return math.copysign(1.0, change) if abs(change) > _TURNED else 0.0
