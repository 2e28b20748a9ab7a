"""The pendulum for many lanes at once: the equations of the pymunk world, without the engine.

The same ten numbers, the same Runge-Kutta steps, the same bounce. Where pymunk finds that the disc
overlaps a wall, here its centre is compared with how far it may come; the two agree to rounding.
Common steps are computed several lanes at once, those near a wall or of a spinning rod one by one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hebbviz.numerics.compile import called, compiled, inlined, row
from hebbviz.numerics.counter_rng import NEXT_EPISODE, four_uniforms
from hebbviz.sims.worlds.pendulum.physics import PLANT, fallen, is_plain, restart, rk4, walled
from hebbviz.sims.worlds.pendulum.task import SEEN, Pendulum
from hebbviz.task.base import CompiledTask
from hebbviz.task.signature import WORLD

Array = NDArray[np.float64]

_thrust, _mu, _dt = PLANT.thrust, PLANT.friction, PLANT.time_step
_THRUST_X, _THRUST_Y = 10, 11


@inlined
def _move(world, width, action, later):  # type: ignore[no-untyped-def]
    """All lanes through a plain time step, several at once.

    `later` becomes 1.0 for the lanes whose step may be another; they stay where they are.
    """
    x, y, vx, vy = (
        row(world, 0, width),
        row(world, 1, width),
        row(world, 2, width),
        row(world, 3, width),
    )
    nx, ny, nz = row(world, 4, width), row(world, 5, width), row(world, 6, width)
    wx, wy, wz = row(world, 7, width), row(world, 8, width), row(world, 9, width)
    fx, fy = row(world, _THRUST_X, width), row(world, _THRUST_Y, width)
    ux, uy = row(action, 0, width), row(action, 1, width)
    for k in range(width):
        fx[k], fy[k] = _thrust * ux[k], _thrust * uy[k]
        s = (x[k], y[k], vx[k], vy[k], nx[k], ny[k], nz[k], wx[k], wy[k], wz[k])
        end = rk4(s, fx[k], fy[k], _mu, _dt)
        plain = is_plain(s, end, _dt)
        later[k] = 0.0 if plain else 1.0
        x[k], y[k], vx[k], vy[k], nx[k], ny[k], nz[k], wx[k], wy[k], wz[k] = end if plain else s


@compiled
def _through(state):  # type: ignore[no-untyped-def]
    """One lane (numbers,) through any time step, in place."""
    end = walled(state, state[_THRUST_X], state[_THRUST_Y], _mu, _dt)
    for i in range(10):
        state[i] = end[i]


@inlined
def _step(world, width, action, later):  # type: ignore[no-untyped-def]
    _move(world, width, action, later)
    for k in range(width):
        if later[k] != 0.0:
            _through(world[:, k])


@called(WORLD)
def answer(world, action, data, keys, step, observation, reward, ended):  # type: ignore[no-untyped-def]
    """The world's step for all lanes, see `signature.WORLD`; `data` (1, 8) holds the gains."""
    lanes = world.shape[1]
    if lanes == 1:  # constants let the compiler compute several lanes at once
        _step(world, 1, action, ended)
    elif lanes == 16:
        _step(world, 16, action, ended)
    elif lanes == 64:
        _step(world, 64, action, ended)
    else:
        _step(world, lanes, action, ended)
    for k in range(lanes):  # until here `ended` held something else
        down = fallen(world[:, k])
        reward[k], ended[k] = (-1.0, 1.0) if down else (0.0, 0.0)
        if down:
            ux, uy, _, _ = four_uniforms(keys[0, k], keys[1, k], NEXT_EPISODE, step, 0)
            again = restart(ux, uy)
            for i in range(10):
                world[i, k] = again[i]
            world[_THRUST_X, k] = world[_THRUST_Y, k] = 0.0
    for j in range(len(SEEN)):
        for k in range(lanes):
            observation[j, k] = data[0, j] * world[SEEN[j], k]
    return 1


class PendulumLanes(Pendulum, CompiledTask):
    """`Pendulum`, compiled. Its state is the same; so each can go on from where the other was."""

    answer = answer

    def data(self) -> Array:
        return self._gains[None]

    def transition(self, state: Array, action: Array, draws: Callable[[int], Array]) -> Array:
        following = state.copy()
        following[10:] = PLANT.thrust * action
        _through(following)
        return following
