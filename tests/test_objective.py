"""What a motion costs and what it is worth, against sums and programs written out once more."""

from __future__ import annotations

import numpy as np
import pytest
from climbs import beginning
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.objective import LITTLE, Norm, Objective
from climber.plan_parts import OBJECTIVE_KINDS
from climber.programs.equilibrium import SupportProgram

seeds = st.integers(0, 2**32 - 1)
powers = st.sampled_from([2, 4, 6])


def norm_and_differences(seed: int, power: int) -> tuple[Norm, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    norm = Norm(rng.uniform(0.2, 3.0, 5), power)
    return norm, rng.normal(size=(3, 5)), rng.normal(size=(3, 5))


@settings(max_examples=50, deadline=None)
@given(seeds, powers)
def test_gradient_of_a_norm_is_its_derivative(seed: int, power: int) -> None:
    norm, d, x = norm_and_differences(seed, power)
    gradient, _ = norm.model(d)
    change = (norm(d + 1e-6 * x) - norm(d - 1e-6 * x)) / 2e-6
    assert (gradient * x).sum(axis=1) == pytest.approx(change, abs=1e-7)


@settings(max_examples=50, deadline=None)
@given(seeds, powers)
def test_hessian_is_that_of_half_the_square_over_the_norm(seed: int, power: int) -> None:
    norm, d, x = norm_and_differences(seed, power)
    _, hessian = norm.model(d)
    h = 1e-4
    bend = (norm(d + h * x) ** 2 - 2 * norm(d) ** 2 + norm(d - h * x) ** 2) / (2 * h**2) / norm(d)
    assert np.einsum("ki,kij,kj->k", x, hessian, x) == pytest.approx(bend, rel=1e-4, abs=1e-5)
    assert np.linalg.eigvalsh(hessian).min() > -1e-9


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_quadratic_model_of_the_euclidean_norm_is_nowhere_less_than_the_norm(seed: int) -> None:
    norm, d, x = norm_and_differences(seed, 2)
    gradient, hessian = norm.model(d)
    model = norm(d) + (gradient * x).sum(axis=1) + np.einsum("ki,kij,kj->k", x, hessian, x) / 2
    assert (model >= norm(d + x) - 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_four_norm_is_the_greatest_share_or_a_little_more(seed: int) -> None:
    norm, d, _ = norm_and_differences(seed, 4)
    greatest = np.abs(norm.scale * d).max(axis=1)
    assert (norm(d) >= greatest - 1e-12).all() and (norm(d) <= 5**0.25 * greatest).all()


def test_length_is_that_of_all_eleven_positions_of_the_quadruped() -> None:
    planner, way = beginning()
    total = 0.0
    for motion in way.motions:
        assert motion.samples.q.shape[1] == 11
        for before, after in zip(motion.samples.q[:-1], motion.samples.q[1:], strict=True):
            total += float(np.sqrt(((after - before) ** 2).sum()))
    assert planner.objective.value(planner.body, way.motions) == pytest.approx(total, abs=1e-9)


def test_time_is_the_duration_of_the_climb() -> None:
    planner, way = beginning()
    objective = Objective.of("time", planner.body)
    chained = way.chained()
    value = objective.value(planner.body, chained)
    assert value == pytest.approx(chained[-1].samples.time[-1], abs=1e-9)


def test_cost_of_time_is_at_least_what_the_slowest_joint_takes() -> None:
    planner, way = beginning()
    objective = Objective.of("time", planner.body)
    robot = planner.body.robot
    fastest = np.concatenate([limb.velocity for limb in robot.limbs])
    joints = np.concatenate([limb.q for limb in robot.limbs])
    for motion in way.motions:
        d = motion.samples.q[-1] - motion.samples.q[0]
        assert objective.step(d) >= (np.abs(d[joints]) / fastest).max() - 1e-12
        # and no motion is faster than that
        assert motion.samples.time[-1] >= (np.abs(d[joints]) / fastest).max()


def test_margin_is_the_least_slack_by_the_reference_programs() -> None:
    planner, way = beginning()
    body = planner.body
    objective = Objective.of("margin", body)
    slack = [1.0]
    for i, motion in enumerate(way.motions):
        center = body.kinematics.center_of_mass(motion.samples.q)[:, 0]
        for j in (i - 1, i, i + 1):
            if 0 <= j < len(way.motions):
                program = SupportProgram.of_contacts(body.wall, way.motions[j].contacts, body.robot.mass)
                at = {-1: center[:1], 0: center, 1: center[-1:]}[j - i]
                slack.append(min(program.margin(float(x)) for x in at) / float(body.robot.reach.mean()))
        slack.append(float((1 - np.abs(motion.torque) / body.robot.effort).min()))
    value = objective.value(body, way.motions)
    assert value == pytest.approx(-min(slack), abs=1e-6)


def test_a_posture_amid_its_support_costs_least_of_those_above_it_for_the_margin_and_nothing_otherwise() -> None:
    planner, way = beginning()
    stretch = way.stretches[0]
    q = np.repeat(way.postures[0][None], 41, axis=0)
    q[:, planner.body.robot.origin_q[0]] += np.linspace(-0.02, 0.02, 41)
    cost = Objective.of("margin", planner.body).standing(stretch.manifold, q)
    lower, upper = stretch.manifold.support.abscissas
    x = planner.body.kinematics.center_of_mass(q)[:, 0]
    assert int(np.argmin(cost)) == int(np.argmin(np.abs(x - (lower + upper) / 2)))
    for kind in ("length", "time"):
        assert not Objective.of(kind, planner.body).standing(stretch.manifold, q).any()


def test_there_are_three_objectives_and_length_counts_a_little_for_the_margin() -> None:
    planner, _ = beginning()
    assert OBJECTIVE_KINDS == ("length", "time", "margin")
    d = np.ones(11)
    length, margin = (Objective.of(kind, planner.body).step(d) for kind in ("length", "margin"))
    assert margin == pytest.approx(LITTLE * length)
