"""Contact forces of the controller: what is demanded, within friction and torques, and what gives way if it must.

The second method is cvxpy, which is asked for the forces nearest to the wished ones within limits that may not be
exceeded at all.
"""

from __future__ import annotations

from dataclasses import replace

import cvxpy
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from climber.force_control import FULL, LEAST, SPARED, Demand, ForceControl
from climber.wall import Grip, Hold, Wall

ORIGIN = (0.0, 0.0, 0.0)
FREE = 1e9  # no limit that matters


def holds(rng: np.random.Generator, axes: int, count: int, grip: Grip = "friction") -> Wall:
    """Holds that face upwards, more or less."""
    normals = rng.normal(0.0, 0.3, size=(count, 3)) * (1.0, 1.0, axes == 3) + (0.0, 1.0, 0.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    adhesion = 5.0 if grip == "magnet" else 0.0
    return Wall(
        tuple(
            Hold(ORIGIN, (float(x), float(y), float(z)), float(rng.uniform(0.3, 1.2)), grip=grip, adhesion=adhesion)
            for x, y, z in normals
        )
    )


def demanded(rng: np.random.Generator, wall: Wall, axes: int, drop: float) -> tuple[Demand, np.ndarray]:
    """What forces well inside the cones with the share `drop` left unused do, and those forces; others are wished."""
    count = len(wall.holds)
    inside = []
    for hold, normal, tangent, other in zip(wall.holds, wall.normals, wall.tangents, wall.binormals, strict=True):
        push, angle = rng.uniform(2.0, 8.0), rng.uniform(0.0, 2.0 * np.pi)
        slide = 0.8 * (1.0 - drop) * hold.friction * push
        across = (np.cos(angle) * tangent + np.sin(angle) * other) if axes == 3 else np.sign(np.cos(angle)) * tangent
        inside.append(((push - hold.adhesion) * normal + slide * across)[:axes])
    forces = np.concatenate(inside)
    E, A = rng.normal(size=(3 * axes - 3, axes * count)), 0.2 * rng.normal(size=(8, axes * count))
    wished = forces + rng.normal(0.0, 3.0, size=len(forces))
    c = A @ forces + rng.uniform(-1.0, 1.0, size=8)
    return Demand(wished, E, E @ forces, A, c, np.full(8, 1.5), drop, 0.0), forces


def nearest(wall: Wall, axes: int, demand: Demand) -> np.ndarray | None:
    """The solution by cvxpy; the weights are those of feet with their share of the load."""
    x = cvxpy.Variable(len(demand.wished))
    control = ForceControl(wall, range(len(wall.holds)), axes, 0)
    y, aim = control._turn @ x, control._turn @ demand.wished
    ready = np.ones(len(demand.wished))
    pushes = aim[axes - 1 :: axes] + np.array([hold.adhesion for hold in wall.holds])
    mean = max(pushes.mean(), LEAST)
    ready = np.repeat(np.clip(pushes / mean, 0.1, 1.0), axes)
    constraints = [demand.E @ x == demand.load, cvxpy.abs(demand.c - demand.A @ x) <= demand.most]
    for k, hold in enumerate(wall.holds):
        push = y[axes * k + axes - 1] + hold.adhesion
        slide = cvxpy.norm(y[axes * k : axes * k + axes - 1])
        constraints += [slide <= min(FULL, 1.0 - demand.drop) * hold.friction * push, push >= LEAST]
    cost = cvxpy.sum_squares(cvxpy.multiply(1.0 / (np.sqrt(control._ease) * ready), y - aim))
    problem = cvxpy.Problem(cvxpy.Minimize(cost), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    return None if x.value is None else np.asarray(x.value)


def excess(wall: Wall, axes: int, demand: Demand, forces: np.ndarray, share: float) -> float:
    """By how much a foot uses more than a share of its friction [N]."""
    worst = -np.inf
    for hold, normal, force in zip(wall.holds, wall.normals[:, :axes], forces.reshape(-1, axes), strict=True):
        push = float(normal @ force)
        slide = float(np.linalg.norm(force - push * normal))
        worst = max(worst, slide - share * hold.friction * (push + hold.adhesion))
    return worst


@given(
    seed=st.integers(0, 10**6),
    axes=st.sampled_from([2, 3]),
    count=st.sampled_from([3, 4]),
    drop=st.sampled_from([0.0, 0.1, 0.6]),
    grip=st.sampled_from(["friction", "magnet"]),
)
@example(seed=0, axes=3, count=4, drop=0.6, grip="friction")  # half a newton more friction than should be used
@example(seed=760224, axes=3, count=3, drop=0.6, grip="friction")  # likewise
@example(seed=999999, axes=3, count=4, drop=0.0, grip="friction")  # many steps on the way
@example(seed=489, axes=3, count=3, drop=0.0, grip="magnet")  # short steps on the way
@settings(max_examples=40, deadline=None)
def test_forces_are_the_nearest_within_friction_and_torques(seed, axes, count, drop, grip):
    rng = np.random.default_rng(seed)
    wall = holds(rng, axes, count, grip)
    demand, _ = demanded(rng, wall, axes, drop)
    best = nearest(wall, axes, demand)
    assert best is not None
    control = ForceControl(wall, range(count), axes, 0)
    forces = control.forces(demand)
    assert np.abs(demand.E @ forces - demand.load).max() < 0.02
    assert excess(wall, axes, demand, forces, FULL) < 1e-3
    assert (np.abs(demand.c - demand.A @ forces) - demand.most).max() < 1e-3
    # Of all forces the best by its own measure, and so no worse than those: they differ where much is to be gained by
    # a little more friction than should be used, which costs no more than all that is not as wished.
    own, other = (ForceControl(wall, range(count), axes, 0).cost(demand, x) for x in (forces, best))
    assert own <= other * (1.0 + 1e-6) + 1e-6
    assert excess(wall, axes, demand, forces, 1.0 - drop) <= np.sqrt(own / SPARED)


@pytest.mark.parametrize("axes", [2, 3])
def test_wished_forces_that_do_are_given(axes):
    rng = np.random.default_rng(1)
    wall = holds(rng, axes, 4)
    demand, forces = demanded(rng, wall, axes, 0.2)
    demand = replace(demand, wished=forces, most=np.full(8, 5.0))
    assert ForceControl(wall, range(4), axes, 0).forces(demand) == pytest.approx(forces, abs=1e-6)


@given(seed=st.integers(0, 10**6), axes=st.sampled_from([2, 3]))
@settings(max_examples=20, deadline=None)
def test_where_no_forces_do_the_balance_gives_way_and_not_friction_or_torques(seed, axes):
    rng = np.random.default_rng(seed)
    wall = holds(rng, axes, 3)
    demand, _ = demanded(rng, wall, axes, 0.1)
    demand = replace(demand, load=30.0 * demand.load, A=np.zeros_like(demand.A), c=np.zeros(8))
    forces = ForceControl(wall, range(3), axes, 0).forces(demand)
    assert excess(wall, axes, demand, forces, FULL) < 0.02
    pushes = (wall.normals[:, :axes] * forces.reshape(-1, axes)).sum(axis=1)
    assert pushes.min() > LEAST - 0.02


def test_friction_is_spared_by_all_feet_and_not_left_to_a_light_one():
    wall = Wall((Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6), Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6)))
    # Two feet side by side, one hardly loaded, are to push sideways with more friction than is to be used.
    E = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    wished = np.array([1.5, 1.0, 1.5, 9.0])
    demand = Demand(wished, E, np.array([3.0, 1.0, 9.0]), np.zeros((1, 4)), np.zeros(1), np.array([FREE]), 0.9, 0.0)
    light, _, heavy, _ = ForceControl(wall, (0, 1), 2, 0).forces(demand)
    assert light + heavy == pytest.approx(3.0, abs=0.03)
    assert light / (0.6 * 1.0) < heavy / (0.6 * 9.0) < 0.6


def test_a_light_foot_presses_nearly_as_hard_as_it_is_asked_to():
    wall = Wall((Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6), Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6)))
    E = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    wished = np.array([0.0, 0.05, 0.0, 8.95])
    demand = Demand(wished, E, np.array([0.0, 9.0]), np.zeros((1, 4)), np.zeros(1), np.array([FREE]), 0.0, 1.0)
    _, light, _, heavy = ForceControl(wall, (0, 1), 2, 0).forces(demand)
    assert light + heavy == pytest.approx(9.0, abs=1e-3)
    assert light > 0.85


def test_a_pin_pulls_and_turns_within_its_moment():
    wall = Wall((Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6, grip="pin", max_moment=0.5),))
    demand = Demand(
        np.zeros(3), np.eye(3), np.array([4.0, -12.0, 2.0]), np.zeros((1, 3)), np.zeros(1), np.array([FREE]), 0.5, 0.0
    )
    x, y, moment = ForceControl(wall, (0,), 2, 1).forces(demand)
    assert (x, y) == pytest.approx((4.0, -12.0), abs=1e-3)
    assert moment == pytest.approx(0.5, abs=2e-3)
