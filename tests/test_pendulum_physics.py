"""The laws the puck, its pendulum and their walls obey."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from sims.arena import Arena
from sims.pendulum_physics import (
    PLANT,
    Vector,
    advance,
    bounce,
    derivative,
    energy,
    fallen,
    rebound,
    restart,
    rk4,
)

M, m, L, G = PLANT.puck_mass, PLANT.bob_mass, PLANT.rod_length, PLANT.gravity
MU, DT = PLANT.friction, PLANT.time_step
LIMIT = PLANT.side / 2 - PLANT.puck_radius
UP = np.array([0.0, 0.0, 1.0])


def random_states(count: int, seed: int = 0) -> NDArray[np.float64]:
    """Return states of shape (count, 10), anywhere in the square, the rod any way up.

    A third have the puck within 2 cm of a wall and moving towards it, a third in a corner.
    """
    rng = np.random.default_rng(seed)
    s = np.empty((count, 10))
    s[:, :2] = rng.uniform(-LIMIT, LIMIT, (count, 2))
    s[:, 2:4] = rng.normal(0.0, 2.0, (count, 2))
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    w = rng.normal(0.0, 4.0, (count, 3))
    s[:, 4:7], s[:, 7:] = n, w - np.sum(w * n, axis=1, keepdims=True) * n
    gap = rng.uniform(0.0, 0.02, (count, 2))
    kind = np.arange(count) % 3
    for axis, near in ((0, kind > 0), (1, kind > 1)):
        side = np.sign(s[near, axis])
        s[near, axis] = side * (LIMIT - gap[near, axis])
        s[near, 2 + axis] = side * np.abs(s[near, 2 + axis])
    return s


def random_thrusts(count: int, seed: int = 1) -> list[tuple[float, float]]:
    """Return `count` thrusts of +-10 N on each axis, by fair coins."""
    signs = np.random.default_rng(seed).choice([-PLANT.thrust, PLANT.thrust], (count, 2))
    return [(x, y) for x, y in signs.tolist()]


def bob(s: Vector) -> tuple[Vector, Vector]:
    """Return position and velocity, each of shape (3,), of the bob."""
    return np.append(s[:2], 0.0) + L * s[4:7], np.append(s[2:4], 0.0) + L * s[7:]


@njit(error_model="numpy")
def walled(s: Vector, fx: float, fy: float, mu: float, dt: float) -> Vector:
    """Return the state `dt` seconds after `s`, the walls found by comparing, with no engine."""
    end = np.array(rk4(s, fx, fy, mu, dt))
    for axis in range(2):
        if abs(end[axis]) > LIMIT:
            rebound(end, axis, -math.copysign(1.0, end[axis]))
    return end


# The equations


@pytest.mark.parametrize("thrust", [(0.0, 0.0), (10.0, -10.0)])
def test_newtons_law_holds_for_puck_and_bob(thrust: tuple[float, float]) -> None:
    for s in random_states(500):
        d = np.array(derivative(s, *thrust, MU))
        v, n, w, a = s[2:4], s[4:7], s[7:], d[2:4]
        assert np.array_equal(d[:2], v)
        assert np.array_equal(d[4:7], w)
        assert n @ d[7:] + w @ w == pytest.approx(0.0, abs=1e-12 * (1.0 + w @ w))  # |n|^2 is 1
        rod = m * (np.append(a, 0.0) + L * d[7:] + G * UP)  # all that is not weight, on the bob
        push = rod @ n
        scale = 1.0 + float(np.linalg.norm(rod))
        np.testing.assert_allclose(rod, push * n, atol=1e-13 * scale)
        ground = max(M * G + push * n[2], 0.0)
        sliding = v / math.sqrt(v @ v + PLANT.friction_smoothing)
        force = np.array(thrust) - MU * ground * sliding - rod[:2]
        np.testing.assert_allclose(M * a, force, atol=1e-13 * scale)


def test_equations_match_lagranges_with_the_rod_as_a_constraint() -> None:
    """Without friction: five coordinates of two points, held a rod apart by a multiplier."""
    mass = np.diag([M, M, m, m, m])
    for s in random_states(500, seed=2):
        n, w = s[4:7], s[7:]
        across = np.concatenate([-n[:2], n])  # gradient of the distance in the coordinates
        kkt = np.block([[mass, -across[:, None]], [across[None, :], np.zeros((1, 1))]])
        known = np.array([7.0, -3.0, 0.0, 0.0, -m * G, -L * (w @ w)])
        q = np.linalg.solve(kkt, known)
        d = np.array(derivative(s, 7.0, -3.0, 0.0))
        np.testing.assert_allclose(d[2:4], q[:2], rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(L * d[7:] + np.append(d[2:4], 0.0), q[2:5], atol=1e-11)


def test_a_puck_the_rod_would_lift_slides_without_friction() -> None:
    s = np.array([0.0, 0.0, 1.0, 0.5, 0.0, 0.6, 0.8, 30.0, 0.0, 0.0])  # 45 N up along the rod
    assert derivative(s, 0.0, 0.0, MU) == derivative(s, 0.0, 0.0, 0.0)
    s[7] = 1.0
    assert derivative(s, 0.0, 0.0, MU) != derivative(s, 0.0, 0.0, 0.0)


def test_small_tilts_grow_at_the_analytic_rate() -> None:
    rate = math.sqrt((G / L) * (1.0 + m / M))
    tilt = 1e-7
    # The growing mode: the centre of mass stays where it is, so v = -l m/(M + m) w.
    shift = -L * m / (M + m)
    s = np.array([shift * tilt, 0, rate * shift * tilt, 0, tilt, 0, 1, rate * tilt, 0, 0])
    steps = 100
    for _ in range(steps):
        s = np.array(rk4(s, 0.0, 0.0, 0.0, DT))
    assert math.log(s[4] / tilt) / (steps * DT) == pytest.approx(rate, rel=1e-5)


def test_the_rod_keeps_its_length_and_turns_across_it() -> None:
    out = np.empty(10)
    for s, thrust in zip(random_states(300), random_thrusts(300), strict=True):
        advance(s, *thrust, out)
        assert np.linalg.norm(out[4:7]) == pytest.approx(1.0, abs=1e-15)
        rate = float(np.linalg.norm(out[7:]))
        assert out[4:7] @ out[7:] == pytest.approx(0.0, abs=1e-14 * (1.0 + rate))


def test_advance_is_one_frictional_step_and_may_work_in_place() -> None:
    s, out = random_states(1)[0], np.empty(10)
    x, y, vx, vy = advance(s, 10.0, -10.0, out)
    assert out.tolist() == list(rk4(s, 10.0, -10.0, MU, DT))
    assert (x, y) == (s[0], s[1])
    np.testing.assert_allclose([x + DT * vx, y + DT * vy], out[:2], rtol=1e-15)
    advance(s, 10.0, -10.0, s)
    assert s.tolist() == out.tolist()


# Energy


def energy_drift(substeps: int) -> float:
    """Return the farthest the energy gets from its 7.5 J in 10 s and 7 to 10 bounces, in J."""
    s = np.array([0.0, 0.0, 3.0, 2.0, 0.6, 0.0, 0.8, 0.0, 0.0, 0.0])
    start, worst, hits = energy(s), 0.0, 0
    for _ in range(round(10.0 / DT) * substeps):
        end = walled(s, 0.0, 0.0, 0.0, DT / substeps)
        hits += bool(np.linalg.norm(end[2:4] - s[2:4]) > 1.0)
        worst = max(worst, abs(energy(end) - start))
        s = end
    assert hits >= 7
    return worst


def test_energy_drift_with_bounces_vanishes_with_the_step() -> None:
    assert energy_drift(1) < 0.1
    at_4, at_16 = energy_drift(4), energy_drift(16)
    assert at_4 < 1e-4
    assert at_16 < at_4 / 4**3  # bounces fall at other moments: about the order, not just so


def test_steps_converge_with_the_fourth_order() -> None:
    start = np.array([0.0, 0.0, 0.5, 0.3, 0.6, 0.0, 0.8, 0.0, 2.0, 0.0])

    def after_a_second(substeps: int) -> Vector:
        s = start
        for _ in range(round(1.0 / DT) * substeps):
            s = np.array(rk4(s, 1.0, -2.0, MU, DT / substeps))
        return s

    best = after_a_second(128)
    errors = [np.abs(after_a_second(n) - best).max() for n in (2, 4, 8)]
    assert errors[0] < 1e-4
    for coarse, fine in pairwise(errors):
        assert 3.7 < math.log2(coarse / fine) < 4.7


def test_friction_only_takes_energy() -> None:
    s = np.array([0.0, 0.0, 2.0, 1.0, 0.6, 0.0, 0.8, 0.0, 1.0, 0.0])
    start = energy(s)
    for _ in range(2000):
        end = walled(s, 0.0, 0.0, 0.1, DT / 20)
        assert energy(end) < energy(s) + 1e-9
        s = end
    assert energy(s) < start - 1.0


# Walls


@pytest.mark.parametrize("normal", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_bounce_is_elastic_and_acts_along_the_walls_normal(
    normal: tuple[float, float],
) -> None:
    e = np.array(normal)
    along = np.array([-e[1], e[0]])
    for s in random_states(300):
        s[2:4] -= e * max(2.0 * float(s[2:4] @ e), 0.0)  # towards the wall
        end = np.array(bounce(s, *normal))
        assert energy(end) == pytest.approx(energy(s), abs=1e-12 * (1.0 + abs(energy(s))))
        assert end[2:4] @ e == pytest.approx(-(s[2:4] @ e), abs=1e-13)
        assert end[4:7] @ end[7:] == pytest.approx(0.0, abs=1e-13)
        before, after = (M * q[2:4] + m * bob(q)[1][:2] for q in (s, end))
        assert after @ along == pytest.approx(before @ along, abs=1e-13)
        # The bob feels nothing but the rod.
        push = bob(end)[1] - bob(s)[1]
        np.testing.assert_allclose(np.cross(push, s[4:7]), 0.0, atol=1e-13)
        # Turned round in time, it undoes itself: back to the wall as it came.
        back = end.copy()
        back[2:4], back[7:] = -end[2:4], -end[7:]
        again = np.array(bounce(back, *normal))
        np.testing.assert_allclose(-again[[2, 3, 7, 8, 9]], s[[2, 3, 7, 8, 9]], atol=1e-12)


def test_a_puck_that_leaves_a_wall_is_left_alone() -> None:
    s = random_states(1)[0]
    s[2:4] = 1.5, -0.5
    assert list(bounce(s, 1.0, 0.0)) == s.tolist()


def test_rebound_mirrors_the_overshoot() -> None:
    s = random_states(1)[0]
    s[:4] = 0.7, LIMIT + 0.01, 0.3, 2.0
    want = list(bounce(s, 0.0, -1.0))
    want[1] = LIMIT - 0.01
    rebound(s, 1, -1.0)
    np.testing.assert_allclose(s, want, rtol=0.0, atol=1e-15)


def test_the_disc_alone_does_not_tunnel_at_50_metres_a_second() -> None:
    arena, hits = Arena(), 0
    angles = np.concatenate(
        [np.arange(8) * math.pi / 4, np.random.default_rng(3).uniform(0, 2 * math.pi, 60)]
    )
    for angle in angles:
        p, v = [0.11, -0.23], [50.0 * math.cos(angle), 50.0 * math.sin(angle)]
        for _ in range(200):
            x, y, *after = arena.slide(*p, *v)
            p = [x, y]
            for axis in range(2):
                turned = abs(after[axis] - v[axis]) > 1e-9
                assert turned == (abs(p[axis]) > LIMIT)
                if turned:
                    p[axis] = math.copysign(2 * LIMIT, p[axis]) - p[axis]
                    hits += 1
            v = after
            assert math.hypot(*v) == pytest.approx(50.0, rel=1e-12)
            assert max(abs(p[0]), abs(p[1])) <= LIMIT + 1e-12
    assert hits > 2000


# The arena


def test_arena_is_the_equations_away_from_the_walls() -> None:
    arena, out, compared = Arena(), np.empty(10), 0
    for s, thrust in zip(random_states(900), random_thrusts(900), strict=True):
        advance(s, *thrust, out)
        if np.abs(out[:2]).max() < LIMIT:
            end = arena.step(s, thrust)
            assert end[2:].tolist() == out[2:].tolist()
            np.testing.assert_allclose(end[:2], out[:2], rtol=0.0, atol=1e-15)
            compared += 1
    assert compared > 250


def test_arena_matches_walls_found_without_an_engine() -> None:
    """40 runs of 2 s from beside the walls and in the corners, on through falls."""
    arena, hits = Arena(), 0
    starts = random_states(120, seed=4)
    for i, start in enumerate(starts[np.arange(120) % 3 > 0][:40]):
        s, want = start, start
        for thrust in random_thrusts(100, seed=i):
            hits += bool(np.abs(np.array(rk4(s, *thrust, MU, DT))[:2]).max() > LIMIT)
            s, want = arena.step(s, thrust), walled(want, *thrust, MU, DT)
            np.testing.assert_allclose(s, want, rtol=0.0, atol=1e-11)
    assert hits >= 60


def test_a_step_is_a_function_of_state_and_thrust_bit_for_bit() -> None:
    """In a fresh arena, and in one that did something else, at the same walls, in between."""
    count = 3000
    states, thrusts = random_states(count, seed=5), random_thrusts(count)
    straight = Arena()
    want = [straight.step(s, f).tobytes() for s, f in zip(states, thrusts, strict=True)]
    kept = states.copy()
    busy, others = Arena(), random_states(count, seed=6)
    for i in np.random.default_rng(7).permutation(count):
        for j in range(i % 4):
            busy.step(others[(i + j) % count], thrusts[j])
        if i % 5 == 0:  # the very wall it is to meet, or has just met
            busy.step(states[i], (10.0, 10.0))
        assert busy.step(states[i], thrusts[i]).tobytes() == want[i]
        if i % 10 == 0:
            assert Arena().step(states[i], thrusts[i]).tobytes() == want[i]
    assert np.array_equal(states, kept)


def test_a_run_goes_on_from_its_ten_numbers_bit_for_bit() -> None:
    thrusts = random_thrusts(600, seed=8)
    arena, runs = Arena(), 0
    for start in random_states(60, seed=9):
        trajectory = [start]
        for thrust in thrusts[:40]:
            trajectory.append(arena.step(trajectory[-1], thrust))
        for cut in (1, 7, 20):
            restored = np.array([float(repr(x)) for x in trajectory[cut].tolist()])
            fresh = Arena()
            for i in range(cut, 40):
                restored = fresh.step(restored, thrusts[i])
                assert restored.tobytes() == trajectory[i + 1].tobytes()
            runs += 1
    assert runs == 180


# Falling


def mean_time_to_fall(thrusts: list[tuple[float, float]], seed: int) -> tuple[float, int]:
    """Return the mean time to fall in s, the falling step included, and the number of falls."""
    arena, rng = Arena(), np.random.default_rng(seed)
    s, falls, last = np.array(restart(*rng.random(2))), 0, 0
    for step, thrust in enumerate(thrusts, start=1):
        s = arena.step(s, thrust)
        if fallen(s):
            s, falls, last = np.array(restart(*rng.random(2))), falls + 1, step
    return last * DT / falls, falls


def test_a_random_policy_falls_after_0_61_s() -> None:
    mean, falls = mean_time_to_fall(random_thrusts(250_000), seed=10)
    assert falls > 8000  # a spread of about 0.2 s a fall: the mean is good to 0.5 %
    assert mean == pytest.approx(0.611, rel=0.03)


@pytest.mark.parametrize("thrust", [(10.0, 10.0), (-10.0, 10.0), (-10.0, -10.0)])
def test_a_constant_thrust_falls_after_0_34_s(thrust: tuple[float, float]) -> None:
    mean, falls = mean_time_to_fall([thrust] * 1700, seed=11)
    assert falls == 100
    assert mean == pytest.approx(0.340, abs=1e-12)


def test_a_restart_is_upright_at_rest_near_the_centre() -> None:
    assert restart(0.0, 0.0) == (-0.5, -0.5, 0, 0, 0, 0, 1, 0, 0, 0)
    assert restart(0.5, 0.75) == (0.0, 0.25, 0, 0, 0, 0, 1, 0, 0, 0)
    assert not fallen(restart(0.5, 0.5))
    assert fallen((0, 0, 0, 0, 1.0, 0, 0.0, 0, 0, 0))
