"""The puck and the inverted pendulum: the equations of motion, compiled.

The plant is the one of Bartlett and Baxter (1999), "Controlling an inverted pendulum": a puck
slides on a level square, and a weightless rod with a weight, the bob, at its tip stands on it on
a frictionless ball joint. The paper gives the constants and no equations; these are Newton's.

With p, v the puck's position and velocity, n the unit vector from puck to bob, w = dn/dt,
h = (n_x, n_y), F the thrust and u = v / sqrt(|v|^2 + smoothing) the direction of sliding::

    T = m [F.h/M - mu g u.h + g n_z - l |w|^2] / [1 + m |h|^2/M + mu m n_z (u.h)/M]
    N = M g + T n_z
    dv/dt = (F - mu N u - T h) / M
    dw/dt = T n/(m l) - (dv/dt, 0)/l - g z/l

T is the push of the rod along n, N the force between puck and ground. Where N < 0 the rod would
lift the puck: it is held to the plane, without friction.

A state is ten numbers, in this order, as a float64 array of shape (10,) or as a tuple of ten:

    ======  ====  =======  ====================================
    0, 1    p     m        position of the puck from the centre
    2, 3    v     m/s      its velocity
    4-6     n     1        unit vector of the rod, z is up
    7-9     w     1/s      rate of change of n, across n
    ======  ====  =======  ====================================

Only + - * / and sqrt are used, each correctly rounded, and fast-math is off.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from hebbviz.numerics.compile import compiled

Vector: TypeAlias = NDArray[np.float64]
Ten: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float]
State: TypeAlias = Vector | Ten


@dataclass(frozen=True)
class Plant:
    """The physical constants. "Paper" is Bartlett and Baxter (1999)."""

    puck_mass: float = 1.0  # M, kg, paper
    bob_mass: float = 0.1  # m, kg, paper
    rod_length: float = 0.5  # l, m, paper
    gravity: float = 9.8  # g, m/s^2, paper
    friction: float = 5e-4  # mu, puck on ground, no unit, paper
    friction_smoothing: float = 1e-8  # m^2/s^2, ours: sliding friction fades below 1e-4 m/s
    thrust: float = 10.0  # N, on each axis, of either sign, paper
    time_step: float = 0.02  # s, paper
    side: float = 5.0  # of the square, m, paper
    puck_radius: float = 0.05  # m, paper
    restart_spread: float = 0.5  # m, on each axis, ours: the paper says "near the centre"


PLANT = Plant()

FARTHEST = PLANT.side / 2 - PLANT.puck_radius
"""How far the puck's centre gets on an axis, in m."""

FARTHEST_TURN = 0.2
"""How far the rod turns in one Runge-Kutta step, at most, in rad: a blow can set it spinning."""

SLOWEST_BLOW = 1e-3
"""m/s. A puck that comes to a wall more slowly meets and leaves it at this speed, which is worth
half a microjoule: pressed against a wall it would otherwise meet it without end in one time step.
"""

# Compiled code takes plain numbers in as constants.
_M = PLANT.puck_mass
_m = PLANT.bob_mass
_l = PLANT.rod_length
_g = PLANT.gravity
_mu = PLANT.friction
_smoothing = PLANT.friction_smoothing
_dt = PLANT.time_step
_spread = PLANT.restart_spread
_limit = FARTHEST
_shortest = _dt / 1024  # s, of a Runge-Kutta step: ends where the rod turns without bound
_HALVINGS = 52

_F = TypeVar("_F", bound=Callable[..., Any])
_jit: Callable[[_F], _F] = compiled


@_jit
def restart(ux: float, uy: float) -> Ten:
    """Return the state after a fall: rod upright, all at rest, puck near the centre.

    `ux`, `uy` are uniform in [0, 1) and place the puck.
    """
    x, y = (2.0 * ux - 1.0) * _spread, (2.0 * uy - 1.0) * _spread
    return x, y, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0


@_jit
def derivative(s: State, fx: float, fy: float, mu: float) -> Ten:
    """Return the time derivative of the state `s` under the thrust (fx, fy) in N.

    `mu` is the coefficient of friction, an argument so that it can be taken away.
    """
    vx, vy, nx, ny, nz, wx, wy, wz = s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9]
    speed = math.sqrt(vx * vx + vy * vy + _smoothing)
    slide = (vx * nx + vy * ny) / speed  # u.h
    drive = (fx * nx + fy * ny) / _M + _g * nz - _l * (wx * wx + wy * wy + wz * wz)
    inertia = 1.0 + _m * (nx * nx + ny * ny) / _M
    rod = _m * (drive - mu * _g * slide) / (inertia + mu * _m * nz * slide / _M)  # T
    ground = _M * _g + rod * nz  # N
    if ground < 0.0:
        rod, ground = _m * drive / inertia, 0.0
    drag = mu * ground / speed
    ax = (fx - drag * vx - rod * nx) / _M
    ay = (fy - drag * vy - rod * ny) / _M
    pull = rod / _m
    bx, by, bz = (pull * nx - ax) / _l, (pull * ny - ay) / _l, (pull * nz - _g) / _l
    return vx, vy, ax, ay, wx, wy, wz, bx, by, bz


@_jit
def _along(s: State, k: Ten, h: float) -> Ten:
    """Return s + h k."""
    return (
        s[0] + h * k[0],
        s[1] + h * k[1],
        s[2] + h * k[2],
        s[3] + h * k[3],
        s[4] + h * k[4],
        s[5] + h * k[5],
        s[6] + h * k[6],
        s[7] + h * k[7],
        s[8] + h * k[8],
        s[9] + h * k[9],
    )


@_jit
def _on_sphere(s: State) -> Ten:
    """Return `s` with n of length one and w across it, which rounding and truncation disturb."""
    nx, ny, nz, wx, wy, wz = s[4], s[5], s[6], s[7], s[8], s[9]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    radial = wx * nx + wy * ny + wz * nz
    wx, wy, wz = wx - radial * nx, wy - radial * ny, wz - radial * nz
    return s[0], s[1], s[2], s[3], nx, ny, nz, wx, wy, wz


@_jit
def rk4(s: State, fx: float, fy: float, mu: float, dt: float) -> Ten:
    """Return the state `dt` seconds after `s`, there being no walls.

    One classical Runge-Kutta step under the constant thrust (fx, fy) in N; `mu` as in
    `derivative`.
    """
    k1 = derivative(s, fx, fy, mu)
    k2 = derivative(_along(s, k1, dt / 2), fx, fy, mu)
    k3 = derivative(_along(s, k2, dt / 2), fx, fy, mu)
    k4 = derivative(_along(s, k3, dt), fx, fy, mu)
    end = _along(_along(_along(_along(s, k1, dt / 6), k2, dt / 3), k3, dt / 3), k4, dt / 6)
    return _on_sphere(end)


@_jit
def _to_the_turn(s: State, end: State, h: float) -> float:
    """Return the seconds, up to `h`, until the puck turns back beside a wall it may reach first.

    `end` is the state `h` seconds after `s`. Else a blow between the two would not be seen.
    """
    until = h
    for axis in range(2):
        v, v_end = s[2 + axis], end[2 + axis]
        if abs(v) > SLOWEST_BLOW and v * v_end < 0.0 < v * s[axis]:
            turn = h * v / (v - v_end)
            if abs(s[axis] + v * turn) > _limit:
                until = min(until, turn)
    return until


@_jit
def piece(s: State, fx: float, fy: float, mu: float, left: float) -> tuple[float, Ten]:
    """Return how long one Runge-Kutta step from `s` may be, in s, and where it ends: (h, state).

    It is all that is `left` of a time step, unless the rod turns by more than `FARTHEST_TURN` in
    that time or the puck comes near a wall and turns back. There are no walls here.
    """
    turning = math.sqrt(s[7] * s[7] + s[8] * s[8] + s[9] * s[9])
    h = min(left, max(FARTHEST_TURN / turning, _shortest))
    end = rk4(s, fx, fy, mu, h)
    until = _to_the_turn(s, end, h)
    if until < h:
        return until, rk4(s, fx, fy, mu, until)
    return h, end


@_jit
def advance(
    state: Vector, fx: float, fy: float, left: float, out: Vector
) -> tuple[float, float, float, float, float]:
    """Write to `out` the state at the end of the next piece of a time step, there being no walls.

    Both are of shape (10,); the thrust (fx, fy) is in N, and `left` is what is left of the step,
    in s. Returns (h, x, y, mean_vx, mean_vy): the seconds that the piece takes, see `piece`, where
    the puck was, in m, and the velocity, in m/s, that takes it along a straight line to where it
    is. That is what a collision engine has to be given.
    """
    x, y = state[0], state[1]
    h, end = piece(state, fx, fy, _mu, left)
    for i in range(10):
        out[i] = end[i]
    return h, x, y, (end[0] - x) / h, (end[1] - y) / h


@_jit
def bounce(s: State, ex: float, ey: float) -> Ten:
    """Return the state just after the puck meets a wall of inward unit normal e = (ex, ey).

    An elastic blow along e on puck and rod together; the rod passes on its part at once::

        A e = e - m (e.h) h / (M + m |h|^2)
        dv = -2 (v.e) A e / (e.A e),   dw = [(dv.h) n - (dv, 0)] / l

    A puck that is leaving the wall already is left alone.
    """
    vx, vy, nx, ny, nz = s[2], s[3], s[4], s[5], s[6]
    share = _m * (ex * nx + ey * ny) / (_M + _m * (nx * nx + ny * ny))
    ax, ay = ex - share * nx, ey - share * ny
    blow = -2.0 * min(vx * ex + vy * ey, 0.0) / (ex * ax + ey * ay)
    dx, dy = blow * ax, blow * ay
    along = dx * nx + dy * ny
    wx = s[7] + (along * nx - dx) / _l
    wy = s[8] + (along * ny - dy) / _l
    wz = s[9] + along * nz / _l
    return s[0], s[1], vx + dx, vy + dy, nx, ny, nz, wx, wy, wz


@_jit
def _contact(
    s: State, fx: float, fy: float, mu: float, h: float, axis: int, inward: float
) -> float:
    """Return when, in s up to `h`, the puck comes to a wall that it is beyond after `h`.

    Found by halving, to the last bit. A puck that leaves the wall at first, as after a blow, comes
    back to it after it has turned.
    """
    v, v_end = s[2 + axis], rk4(s, fx, fy, mu, h)[2 + axis]
    before, after = h * v / (v - v_end) if v * inward > 0.0 > v_end * inward else 0.0, h
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + after)
        if rk4(s, fx, fy, mu, middle)[axis] * inward < -_limit:
            after = middle
        else:
            before = middle
    return after


@_jit
def _against(s: State, axis: int, inward: float) -> Ten:
    """Return `s` with the puck at the wall and moving against it, at `SLOWEST_BLOW` at least."""
    x, y, vx, vy = s[0], s[1], s[2], s[3]
    if axis == 0:
        x, vx = -inward * _limit, inward * min(inward * vx, -SLOWEST_BLOW)
    else:
        y, vy = -inward * _limit, inward * min(inward * vy, -SLOWEST_BLOW)
    return x, y, vx, vy, s[4], s[5], s[6], s[7], s[8], s[9]


@_jit
def rebound(
    s: State, fx: float, fy: float, mu: float, h: float, inward_x: float, inward_y: float
) -> tuple[float, Ten]:
    """Return when, in s up to `h`, the puck meets a wall, and the state just after the blow.

    After `h` it would be beyond a wall: `inward_x`, 1.0 or -1.0, is the direction of that wall's
    normal, and 0.0 says that there is none on the x axis; so for y. Of two the first is met.
    """
    axis, inward, t = 0, inward_x, h
    if inward_x != 0.0:
        t = _contact(s, fx, fy, mu, h, 0, inward_x)
    if inward_y != 0.0:
        at_y = _contact(s, fx, fy, mu, h, 1, inward_y)
        if inward_x == 0.0 or at_y < t:
            axis, inward, t = 1, inward_y, at_y
    met = _against(rk4(s, fx, fy, mu, t), axis, inward)
    return t, bounce(met, inward * (1 - axis), inward * axis)


@_jit
def _inward(x: float) -> float:
    """Return the direction of the normal of the wall that `x` is beyond, or 0.0."""
    return -math.copysign(1.0, x) if abs(x) > _limit else 0.0


@_jit
def walled(s: State, fx: float, fy: float, mu: float, dt: float) -> Ten:
    """Return the state `dt` seconds after `s`, the walls found by comparing, with no engine."""
    left = dt
    s = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9]
    while left > 0.0:
        h, end = piece(s, fx, fy, mu, left)
        inward_x, inward_y = _inward(end[0]), _inward(end[1])
        if inward_x != 0.0 or inward_y != 0.0:
            h, end = rebound(s, fx, fy, mu, h, inward_x, inward_y)
        s, left = end, left - h
    return s


@_jit
def is_plain(s: State, end: State, dt: float) -> bool:
    """Return whether `end`, one Runge-Kutta step of `dt` seconds after `s`, is what `walled` gives.

    Where it says no, it may be so all the same: what takes long to tell is left to `walled`.
    """
    inside = (abs(end[0]) <= _limit) & (abs(end[1]) <= _limit)
    clear = (abs(s[0] + s[2] * dt) <= _limit) & (abs(s[1] + s[3] * dt) <= _limit)
    turn = s[7] * s[7] + s[8] * s[8] + s[9] * s[9]
    plain: bool = inside & clear & (turn * (dt * dt) < 0.999 * FARTHEST_TURN * FARTHEST_TURN)
    return plain


@_jit
def fallen(s: State) -> bool:
    """Return whether the bob has come down to the height of the puck, which is 0."""
    return s[6] <= 0.0


@_jit
def energy(s: State) -> float:
    """Return the kinetic energy and that of the bob's height above the ground, in J."""
    vx, vy = s[2], s[3]
    bx, by, bz = vx + _l * s[7], vy + _l * s[8], _l * s[9]
    moving = _M * (vx * vx + vy * vy) + _m * (bx * bx + by * by + bz * bz)
    return 0.5 * moving + _m * _g * _l * s[6]
