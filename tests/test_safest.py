"""The forces farthest from slipping: they make the motion, nothing is farther by much, and they vary smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from robots import robot
from test_torque import ALL, FRONT, STANDING, instants_of, on, random_instant, seeds, swaying, wall_under

from climber.dynamics import evaluate, evaluate_at_rest, turning
from climber.programs import torque_blocks
from climber.programs.forces import wall_forces
from climber.programs.instants import Instants, Margin
from climber.programs.safest import STRICT, safest_forces
from climber.stance import Vector
from climber.wall import Wall

SCALE = 5.0  # [N]


def least_distance(instants: Instants, t: Vector) -> Vector:
    """How far forces and torques are inside their limits [N, N m], worked out anew, shape (K,)."""
    shape = (len(t), *instants.forces.lower.shape)
    lower, upper = (x.reshape(shape[1:]) for x in (instants.lower, instants.upper))
    forces = -instants.forces.excess(t.reshape(shape), lower, upper).max(axis=1)
    torques = (instants.limit - np.abs(instants.motor_torque(t))).min(axis=1, initial=np.inf)
    return np.minimum(forces, torques)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_forces_make_the_motion_inside_all_limits_or_none_do(seed: int) -> None:
    instants, *_ = random_instant(robot("quadruped"), seed)
    t, good = safest_forces(instants, np.zeros((1, len(instants.lower))), SCALE)
    balanced = instants.imbalance(torque_blocks.unlimited(instants))[0] < 1e-6
    room = -torque_blocks.least_violation(instants)[1][0] if balanced else -1.0
    if good[0]:
        assert instants.imbalance(t)[0] < 1e-6 and least_distance(instants, t)[0] > 0.0
        # The most room that is looked for is 1, of forces and torques alike, which here have scales of their own.
        assert least_distance(instants, t)[0] > 0.1 * min(room, 1.0)
    else:
        assert room <= STRICT + 1e-6


@settings(max_examples=30, deadline=None)
@given(seeds, seeds)
def test_they_do_not_depend_on_where_the_search_begins(seed: int, other: int) -> None:
    instants, *_ = random_instant(robot("quadruped"), seed)
    rng = np.random.default_rng(other)
    first, good = safest_forces(instants, np.zeros((1, len(instants.lower))), SCALE)
    assume(good[0])
    again, _ = safest_forces(instants, rng.uniform(instants.lower, instants.upper)[None], SCALE)
    assert again == pytest.approx(first, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_no_forces_nearby_are_better(seed: int) -> None:
    """By the objective written down as it is in the documentation."""
    instants, *_ = random_instant(robot("quadruped"), seed)
    t, good = safest_forces(instants, np.zeros((1, len(instants.lower))), SCALE)
    assume(good[0])

    def cost(t: Vector) -> float:
        forces = np.concatenate([t[0] - instants.lower, instants.upper - t[0]])
        torque = instants.motor_torque(t)[0]
        torques = np.concatenate([instants.limit - torque, instants.limit + torque]) / np.tile(instants.limit, 2)
        if min(forces.min(), torques.min(initial=np.inf)) <= 0.0:
            return float(np.inf)
        return float(((SCALE / forces) ** 3).sum() + ((0.5 / torques) ** 3).sum())

    along = np.eye(t.shape[1]) - np.linalg.pinv(instants.E[0]) @ instants.E[0]
    for step in np.random.default_rng(seed).normal(0.0, 1e-2, (20, t.shape[1])):
        assert cost(t + along @ step) >= cost(t) * (1 - 1e-6)


def test_a_symmetric_posture_has_symmetric_forces() -> None:
    """And four feet share the weight."""
    machine = robot("quadruped")
    wall = wall_under(machine, STANDING)
    instants = instants_of(machine, wall, on(ALL), *evaluate_at_rest(machine, STANDING[None], ALL))
    t, good = safest_forces(instants, torque_blocks.unlimited(instants), SCALE)
    force = instants.force(t)[0]
    assert good.all()
    assert force[[0, 3], 0] == pytest.approx(-force[[1, 2], 0], abs=1e-6)
    assert force[[0, 3], 1] == pytest.approx(force[[1, 2], 1], abs=1e-6)
    assert force.sum(axis=0) == pytest.approx([0.0, machine.mass * 9.81, 0.0], abs=1e-9)


def test_forces_are_smooth_along_a_motion() -> None:
    """The change of their change falls with the square of the step: the second derivative exists."""
    machine, bends = robot("quadruped"), []
    for K in (101, 201, 401):
        q, v, vd = swaying(machine, K, 1.0)
        wall = wall_under(machine, STANDING)
        dynamics = evaluate(machine, q, v, ALL)
        instants = instants_of(machine, wall, on(ALL), dynamics.load(vd), dynamics.J)
        t, good = safest_forces(instants, torque_blocks.unlimited(instants), SCALE)
        assert good.all()
        bends.append(np.abs(np.diff(t, n=2, axis=0)).max() * (K - 1) ** 2)
    assert bends[2] == pytest.approx(bends[1], rel=0.1) and bends[1] == pytest.approx(bends[0], rel=0.2)


def test_more_friction_leaves_more_room() -> None:
    machine, rooms = robot("quadruped"), []
    for friction in (0.3, 0.6, 1.2):
        wall = wall_under(machine, STANDING, friction=friction)
        instants = instants_of(machine, wall, on(FRONT), *evaluate_at_rest(machine, STANDING[None], FRONT))
        t, _ = safest_forces(instants, torque_blocks.unlimited(instants), SCALE)
        rooms.append(float(least_distance(instants, t)[0]))
    assert rooms == sorted(rooms)


def in_space(rng: np.random.Generator) -> Instants:
    """A mass of 2 kg held by three contacts in space; no motors, so that all six rows are balance."""
    points = rng.normal(0.0, 0.2, (3, 3))
    wall = Wall(
        tuple(
            replace(
                wall_under(robot("quadruped"), STANDING).holds[0],
                position=tuple(point),
                normal=tuple(np.array([0.0, 1.0, 0.0]) + rng.normal(0.0, 0.2, 3)),
            )
            for point in points
        )
    )
    forces = wall_forces(wall, 3)
    across = [np.cross(np.eye(3), point) for point in points]
    J = np.concatenate([np.hstack([np.eye(3), arm]) for arm in across])[None]
    wrench = np.einsum("kav,kap->vkp", J.reshape(3, 3, 6), forces.generators).reshape(1, 6, 9)
    load = np.array([[0.0, 2 * 9.81, 0.0, *np.cross(points.mean(axis=0), [0.0, 2 * 9.81, 0.0])]])
    none = np.zeros((1, 0))
    return Instants(
        E=wrench,
        b=load,
        A=np.zeros((1, 0, 9)),
        c=none,
        forces=forces,
        lower=forces.lower.ravel(),
        upper=forces.upper.ravel(),
        effort=none[0],
        limit=none[0],
        motors=np.zeros(0, dtype=np.int64),
        num_joints=0,
    )


@pytest.mark.parametrize("seed", range(8))
def test_in_space_forces_are_inside_their_cones_and_nothing_nearby_is_better(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instants = in_space(rng)
    t, good = safest_forces(instants, torque_blocks.unlimited(instants), SCALE)
    room = -torque_blocks.least_violation(instants)[1][0]
    assert good[0] == (room > STRICT)
    if not good[0]:
        return
    assert least_distance(instants, t)[0] > 0.3 * min(room, 1.0)

    def cost(t: Vector) -> float:
        """Of the cones by their product of distances, of a hold's two cones."""
        u, s = t.reshape(3, 3)[:, :2], t.reshape(3, 3)[:, 2]
        total = 0.0
        for axis in (s - instants.lower[2::3], instants.upper[2::3] - s):
            squares = axis**2 - (u**2).sum(axis=1)
            if (squares <= 0.0).any() or (axis <= 0.0).any():
                return float(np.inf)
            total += float((2.0 * (SCALE**2 / squares) ** 1.5).sum())
        return total

    along = np.eye(9) - np.linalg.pinv(instants.E[0]) @ instants.E[0]
    for step in rng.normal(0.0, 1e-2, (20, 9)):
        assert cost(t + along @ step) >= cost(t) * (1 - 1e-6)


def test_on_pins_that_grippers_turn_moments_keep_to_their_limits_too() -> None:
    machine = robot("double_link")
    pin = replace(wall_under(robot("quadruped"), STANDING, grip="pin").holds[0], max_moment=5.0)
    q = np.random.default_rng(0).normal(0.0, 0.5, (20, machine.plant.num_positions()))
    h, J = evaluate_at_rest(machine, q, [0])
    forces = wall_forces(Wall((pin,)))[np.array([0])]
    instants = Instants.of_loads(machine, forces, h, J, Margin(), turning(machine, [0]))
    t, good = safest_forces(instants, torque_blocks.unlimited(instants), SCALE)
    assert (good == (-torque_blocks.least_violation(instants)[1] > STRICT)).all() and good.any()
    assert np.abs(instants.moment(t[good])).max() < 5.0
