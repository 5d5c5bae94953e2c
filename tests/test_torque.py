from dataclasses import replace
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from problems import hold, random_wall
from scipy.optimize import linprog

from climber.dynamics import DynamicsBatch, evaluate, evaluate_at_rest
from climber.programs.forces import wall_forces
from climber.programs.instants import CENTERING, MIDWAY, Instants, Margin
from climber.programs.torque import (
    REASONS,
    TorqueBatch,
    TorqueProgram,
    phase_torques,
    solve_instants,
    static_feasible,
)
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.wall import Wall

ALL, FRONT = (0, 1, 2, 3), (0, 1)
STANDING = np.array([0, 0, 0, -0.6, 1.2, 0.6, -1.2, -0.6, 1.2, 0.6, -1.2])  # mirror-symmetric about x = 0
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot("package://climber/quadruped/quadruped.urdf")


def variant(robot: Robot, folder: Path, *changes: tuple[str, str]) -> Robot:
    """The same robot with changes in its model file, each an old text and a new one."""
    text = robot.model.path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    model = folder / "variant.urdf"
    model.write_text(text)
    model.with_suffix(".yaml").write_text(robot.model.path.with_suffix(".yaml").read_text())
    return Robot(model)


def feet(robot: Robot, q: Vector) -> Vector:
    context = robot.context()
    robot.plant.SetPositions(context, q)
    return robot.foot_positions(context)


def wall_under(robot: Robot, q: Vector, **kwargs: object) -> Wall:
    """A wall with hold i under foot i of the posture q, all facing straight up."""
    return Wall(tuple(hold(x, y, **kwargs) for x, y, _ in feet(robot, q)))


def on(limbs: tuple[int, ...]) -> tuple[Contact, ...]:
    """Each limb on the hold of its own number."""
    return tuple(Contact(limb, limb) for limb in limbs)


def instants_of(
    robot: Robot, wall: Wall, contacts: tuple[Contact, ...], load: Vector, J: Vector, margin: Margin | None = None
) -> Instants:
    forces = wall_forces(wall)[np.array([contact.hold for contact in contacts], dtype=int)]
    return Instants.of_loads(robot, forces, load, J, margin or Margin())


def swaying(robot: Robot, K: int, period: float) -> tuple[Vector, Vector, Vector]:
    """The pelvis sways and bobs with its four feet in place: q, v and vd at K samples of one period [s]."""
    time = np.linspace(0.0, 1.0, K)
    phase, rate = 2 * np.pi * time, 2 * np.pi / period
    amplitude = np.array([0.03, 0.015, 0.1])
    shape = np.column_stack([np.sin(phase), np.sin(2 * phase), np.sin(phase)])
    slope = np.column_stack([np.cos(phase), 2 * np.cos(2 * phase), np.cos(phase)])
    bend = -np.column_stack([np.sin(phase), 4 * np.sin(2 * phase), np.sin(phase)])
    q, points, joints = np.tile(STANDING, (K, 1)), feet(robot, STANDING)[:, :2].ravel(), robot.joint_v
    for k in range(K):
        q[k] = q[k - 1] if k else STANDING
        q[k, :3] = amplitude * shape[k]
        for _ in range(6):
            J = evaluate_at_rest(robot, q[k : k + 1], ALL)[1][0]
            q[k, joints] -= np.linalg.solve(J[:, joints], feet(robot, q[k])[:, :2].ravel() - points)
    J = evaluate_at_rest(robot, q, ALL)[1]
    v, vd = np.zeros_like(q), np.zeros_like(q)
    v[:, :3], vd[:, :3] = amplitude * slope * rate, amplitude * bend * rate**2
    v[:, joints] = -np.linalg.solve(J[:, :, joints], J[:, :, :3] @ v[:, :3, None])[:, :, 0]
    drift = evaluate(robot, q, v, ALL).Jdot_v[:, :, None]
    vd[:, joints] = -np.linalg.solve(J[:, :, joints], J[:, :, :3] @ vd[:, :3, None] + drift)[:, :, 0]
    return q, v, vd


def sway(robot: Robot, wall: Wall, K: int, period: float) -> tuple[DynamicsBatch, Vector, TorqueBatch]:
    q, v, vd = swaying(robot, K, period)
    dynamics = evaluate(robot, q, v, ALL)
    return dynamics, vd, phase_torques(robot, wall, on(ALL), dynamics, vd)


def random_instant(robot: Robot, seed: int) -> tuple[Instants, Wall, tuple[Contact, ...], Vector, Vector]:
    """Any posture in any slow motion with any feet on any holds; only Jacobians and forces matter here."""
    rng = np.random.default_rng(seed)
    wall = random_wall(rng, 4)
    limbs = rng.permutation(4)[: rng.integers(2, 5)]
    contacts = tuple(Contact(int(limb), int(place)) for limb, place in zip(limbs, rng.permutation(4), strict=False))
    lower, upper = (np.concatenate([getattr(limb, end) for limb in robot.limbs]) for end in ("lower", "upper"))
    q = np.zeros((1, 11))
    q[0, :3], q[0, 3:] = rng.normal(0.0, 0.5, 3), rng.uniform(lower, upper)
    dynamics = evaluate(robot, q, rng.normal(0.0, 0.5, (1, 11)), [contact.limb for contact in contacts])
    load = dynamics.load(rng.normal(0.0, 1.0, (1, 11)))
    margin = Margin(rng.choice([0.0, 0.01, 0.2]), rng.choice([0.0, 0.05, 0.9]))
    return instants_of(robot, wall, contacts, load, dynamics.J, margin), wall, contacts, load, dynamics.J


def stacked(instants: list[Instants]) -> Instants:
    """Instants on the same contacts as one batch."""
    arrays = {name: np.concatenate([getattr(i, name) for i in instants]) for name in ("E", "b", "A", "c")}
    return replace(instants[0], **arrays)


# --- By hand ---------------------------------------------------------------------------------------------------------


def test_hanging_from_two_frictionless_holds_each_carries_half_and_torques_are_lever_arms(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, friction=0.0)
    result = TorqueProgram(instants_of(robot, wall, on(FRONT), *evaluate_at_rest(robot, STANDING[None], FRONT))).solve()
    assert result.ok
    half = robot.mass * 9.81 / 2
    np.testing.assert_allclose(result.force, [[0, half, 0], [0, half, 0]], atol=1e-9)

    # A joint holds up what is beyond it: the torque about its axis is that of the weights beyond it less the foot's.
    context, torque = robot.context(), {}
    robot.plant.SetPositions(context, STANDING)
    for limb, push in zip(robot.limbs, (half, half, 0.0, 0.0), strict=True):
        hip, knee = (robot.plant.GetJointByName(name).frame_on_child() for name in limb.joints)
        at = {name: frame.CalcPoseInWorld(context).translation()[0] for name, frame in (("hip", hip), ("knee", knee))}
        end = robot.plant.GetFrameByName(limb.foot).CalcPoseInWorld(context).translation()[0]
        thigh, shank = (at["hip"] + at["knee"]) / 2, (at["knee"] + end) / 2
        weight = 0.1 * 9.81
        torque[limb.joints[1]] = weight * (shank - at["knee"]) - push * (end - at["knee"])
        torque[limb.joints[0]] = weight * (thigh + shank - 2 * at["hip"]) - push * (end - at["hip"])
    np.testing.assert_allclose(result.torque, [torque[name] for name in robot.joint_names], atol=1e-7)


def test_a_mirror_symmetric_posture_on_mirrored_holds_has_mirrored_forces(robot: Robot) -> None:
    wall = wall_under(robot, STANDING)
    h, J = evaluate_at_rest(robot, STANDING[None], ALL)
    result = solve_instants(instants_of(robot, wall, on(ALL), h, J))[0]
    assert result.ok
    mirrored = result.force[[1, 0, 3, 2]] * [-1, 1, 1]
    np.testing.assert_allclose(result.force, mirrored, atol=1e-7)
    np.testing.assert_allclose(result.force.sum(axis=0), [0, robot.mass * 9.81, 0], atol=1e-9)


def test_without_contacts_the_whole_weight_is_missing(robot: Robot) -> None:
    h, J = evaluate_at_rest(robot, STANDING[None], ())
    instant = instants_of(robot, wall_under(robot, STANDING), (), h, J)
    for result in (TorqueProgram(instant).solve(), solve_instants(instant)[0]):
        assert result.reason == "force balance"
        assert result.violation == pytest.approx(robot.mass * 9.81)


def test_a_single_foot_beside_the_centre_of_mass_balances_nothing(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, grip="pin", max_force=1000.0)
    h, J = evaluate_at_rest(robot, STANDING[None], (0,))
    instant = instants_of(robot, wall, on((0,)), h, J)
    for result in (TorqueProgram(instant).solve(), solve_instants(instant)[0]):
        assert result.reason == "force balance"
        assert result.violation > 0.01
    assert not static_feasible(robot, wall, STANDING[None], on((0,)))[0]


def test_a_posture_can_be_held_down_to_the_last_hundredth_of_a_newton(robot: Robot) -> None:
    share = robot.mass * 9.81 / 4  # of each of the two multiples of two frictionless holds
    for extra, held in ((-0.01, False), (0.01, True)):
        wall = wall_under(robot, STANDING, friction=0.0, max_force=share + extra)
        assert static_feasible(robot, wall, STANDING[None], on(FRONT), Margin(force=0.0))[0] == held


def test_holds_too_weak_for_the_weight_are_short_by_what_is_missing(robot: Robot) -> None:
    # Two frictionless holds give at most 4 x 4 N upwards of the 19.62 N; the four multiples share the rest.
    wall = wall_under(robot, STANDING, friction=0.0, max_force=4.0)
    h, J = evaluate_at_rest(robot, STANDING[None], FRONT)
    instant = instants_of(robot, wall, on(FRONT), h, J, Margin(force=0.5))
    for result in (TorqueProgram(instant).solve(), solve_instants(instant)[0]):
        assert result.reason == "friction cone"
        assert result.violation == pytest.approx((19.62 - 4 * 3.5) / 4, abs=1e-6)


def test_motors_too_weak_are_short_by_what_the_hand_calculation_says(robot: Robot, tmp_path: Path) -> None:
    wall = wall_under(robot, STANDING, friction=0.0)
    load, J = evaluate_at_rest(robot, STANDING[None], FRONT)
    needed = np.abs(TorqueProgram(instants_of(robot, wall, on(FRONT), load, J)).solve().torque).max()
    weak = variant(robot, tmp_path, ('effort="4.0"', f'effort="{needed / 2}"'))
    instant = instants_of(weak, wall, on(FRONT), load, J, Margin(torque=0.1))
    for result in (TorqueProgram(instant).solve(), solve_instants(instant)[0]):
        assert result.reason == "torque limit"
        assert result.violation == pytest.approx(needed - 0.9 * needed / 2, abs=1e-5)
    assert not static_feasible(weak, wall, STANDING[None], on(FRONT))[0]


def test_what_fails_both_fails_for_its_forces(robot: Robot, tmp_path: Path) -> None:
    weak = variant(robot, tmp_path, ('effort="4.0"', 'effort="0.01"'))
    instant = instants_of(
        weak,
        wall_under(robot, STANDING, friction=0.0, max_force=4.0),
        on(FRONT),
        *evaluate_at_rest(robot, STANDING[None], FRONT),
    )
    assert TorqueProgram(instant).solve().reason == "friction cone"
    assert solve_instants(instant).reason == "friction cone"


def test_a_joint_without_a_motor_has_no_torque(robot: Robot, tmp_path: Path) -> None:
    knees = ("right_front_knee", "left_rear_knee")
    motor = """  <transmission>
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="{0}"/>
    <actuator name="{0}"/>
  </transmission>
"""
    passive = variant(robot, tmp_path, *((motor.format(knee), "") for knee in knees))
    h, J = evaluate_at_rest(passive, STANDING[None], ALL)
    instant = instants_of(passive, wall_under(robot, STANDING), on(ALL), h, J)
    result = solve_instants(instant)[0]
    assert result.ok
    assert [result.torque[robot.joint_names.index(knee)] for knee in knees] == [0.0, 0.0]
    assert np.count_nonzero(result.torque) == 6
    rest = h[0] - J[0].T @ result.force[:, :2].ravel()
    rest[passive.joint_v] -= result.torque
    np.testing.assert_allclose(rest, 0.0, atol=1e-9)
    np.testing.assert_allclose(TorqueProgram(instant).solve().torque, result.torque, atol=1e-6)


# --- Motions ---------------------------------------------------------------------------------------------------------


def test_forces_and_torques_make_the_motion_inside_all_limits(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, min_force=1.5)
    dynamics, vd, batch = sway(robot, wall, 200, 1.0)
    np.testing.assert_allclose(dynamics.slip(vd), 0.0, atol=1e-9)
    assert batch.ok.all()
    assert batch.reason == ""
    assert not batch.violation.any()
    np.testing.assert_allclose(
        dynamics.residual(vd, batch.torque, batch.force[:, :, :2].reshape(200, -1)), 0, atol=1e-9
    )
    np.testing.assert_array_equal(batch.force[:, :, 2], 0.0)
    assert (np.abs(batch.torque) < robot.effort).all()
    forces = wall_forces(wall)
    t = np.linalg.solve(forces.generators[:, :2], batch.force[:, :, :2, None])[..., 0]
    assert (t > forces.lower).all()
    assert (t < forces.upper).all()
    assert np.abs(t - forces.lower).min() < 0.05  # some of it at the border, where the solver is needed


def test_a_motion_too_fast_for_its_holds_becomes_possible_when_slowed(robot: Robot) -> None:
    wall = wall_under(robot, STANDING)
    *_, fast = sway(robot, wall, 50, 0.25)
    *_, slow = sway(robot, wall, 50, 1.0)
    assert not fast.ok.all()
    assert fast.reason == "friction cone"
    assert fast[fast.worst].violation == fast.violation.max() > 0.1
    assert slow.ok.all()


def test_on_pins_a_motion_too_fast_fails_for_its_torques(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, grip="pin", max_force=1000.0)
    *_, fast = sway(robot, wall, 50, 0.06)
    *_, slow = sway(robot, wall, 50, 1.0)
    assert fast.reason == "torque limit"
    assert slow.ok.all()


def test_a_slowed_motion_needs_the_same_less_in_proportion_of_the_square(robot: Robot) -> None:
    q, v, vd = swaying(robot, 20, 1.0)
    h, _ = evaluate_at_rest(robot, q, ALL)
    load = evaluate(robot, q, v, ALL).load(vd)
    slowed = evaluate(robot, q, 0.5 * v, ALL).load(0.25 * vd)
    np.testing.assert_allclose(slowed, h + 0.25 * (load - h), atol=1e-12)


def test_forces_and_torques_are_continuous_along_a_motion(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, min_force=1.0)
    jumps = []
    for K in (101, 201, 401):
        *_, batch = sway(robot, wall, K, 1.0)
        assert batch.ok.all()
        jumps.append([np.abs(np.diff(batch.force, axis=0)).max(), np.abs(np.diff(batch.torque, axis=0)).max()])
    ratios = np.array(jumps[:-1]) / np.array(jumps[1:])
    assert (ratios > 1.7).all()  # half the step, half the change


def test_one_impossible_sample_spoils_no_other(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, min_force=1.0)
    q, v, vd = swaying(robot, 30, 1.0)
    dynamics = evaluate(robot, q, v, ALL)
    alone = phase_torques(robot, wall, on(ALL), dynamics, vd)
    vd[7, 0] += 100.0
    mixed = phase_torques(robot, wall, on(ALL), dynamics, vd)
    others = np.arange(30) != 7
    np.testing.assert_array_equal(mixed.ok, others)
    assert mixed.worst == 7
    np.testing.assert_allclose(mixed.force[others], alone.force[others], atol=1e-6)
    np.testing.assert_allclose(mixed.torque[others], alone.torque[others], atol=1e-6)


def test_postures_that_can_be_held_are_those_whose_motion_at_rest_is_possible(robot: Robot) -> None:
    wall = wall_under(robot, STANDING, min_force=1.0, friction=0.3)
    q, _, _ = swaying(robot, 60, 1.0)
    q = np.concatenate([q + np.eye(11)[0] * dx for dx in (-0.2, -0.1, 0.0, 0.1)])
    for limbs in (ALL, (0, 1, 2), (1, 2)):
        dynamics = evaluate(robot, q, np.zeros_like(q), limbs)
        expected = phase_torques(robot, wall, on(limbs), dynamics, np.zeros_like(q)).ok
        np.testing.assert_array_equal(static_feasible(robot, wall, q, on(limbs)), expected)


def test_at_rest_forces_carry_the_weight_at_the_centre_of_mass(robot: Robot) -> None:
    wall = wall_under(robot, STANDING)
    q, v, _ = swaying(robot, 40, 1.0)
    batch = phase_torques(robot, wall, on(ALL), evaluate(robot, q, 0 * v, ALL), 0 * v)
    assert batch.ok.all()
    context, points, weight = robot.context(), feet(robot, STANDING), robot.mass * np.array([0, -9.81, 0])
    for posture, force in zip(q, batch.force, strict=True):
        robot.plant.SetPositions(context, posture)
        moment = np.cross(points, force).sum(axis=0) + np.cross(robot.center_of_mass(context), weight)
        np.testing.assert_allclose(force.sum(axis=0) + weight, 0.0, atol=1e-8)
        np.testing.assert_allclose(moment, 0.0, atol=1e-8)


# --- Against other solvers -------------------------------------------------------------------------------------------


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_the_batch_answers_as_the_program_does(robot: Robot, seed: int) -> None:
    instant, *_ = random_instant(robot, seed)
    single, batch = TorqueProgram(instant).solve(), solve_instants(instant)[0]
    assert batch.reason == single.reason
    assert batch.violation == pytest.approx(single.violation, rel=1e-6, abs=2e-6)
    if single.ok:
        np.testing.assert_allclose(batch.force, single.force, atol=1e-6)
        np.testing.assert_allclose(batch.torque, single.torque, atol=1e-6)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_cvxpy_finds_the_same_forces(robot: Robot, seed: int) -> None:
    instant, wall, contacts, load, J = random_instant(robot, seed)
    result = solve_instants(instant)[0]
    forces = wall_forces(wall)[np.array([contact.hold for contact in contacts])]
    lower, upper, k = forces.lower, forces.upper, len(contacts)
    t, tau = cp.Variable((k, 2)), cp.Variable(8)
    f = [forces.offset[i, :2] + forces.generators[i, :2] @ t[i] for i in range(k)]
    S = np.eye(11)[robot.joint_v]
    supplied = S.T @ tau + sum(J[0, 2 * i : 2 * i + 2].T @ f[i] for i in range(k))
    inward = instant.lower.reshape(k, 2) - lower
    constraints = [
        supplied == load[0],
        t >= lower + inward,
        t <= upper - inward,
        cp.abs(tau) <= instant.limit,
    ]
    aim = (1 - MIDWAY) * np.clip(0, lower, upper) + MIDWAY * (lower + upper) / 2
    cost = cp.sum_squares(tau / robot.effort) + CENTERING * cp.sum_squares(cp.multiply(t - aim, 2 / (upper - lower)))
    problem = cp.Problem(cp.Minimize(cost), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    assert result.ok == (problem.status in ("optimal", "optimal_inaccurate"))
    if result.ok:
        np.testing.assert_allclose(result.force[:, :2], [part.value for part in f], atol=1e-5)
        np.testing.assert_allclose(result.torque, tau.value, atol=1e-5)


@given(seeds)
@settings(max_examples=100, deadline=None)
def test_highs_finds_the_same_violations(robot: Robot, seed: int) -> None:
    instant, *_ = random_instant(robot, seed)
    result, n = solve_instants(instant)[0], len(instant.lower)
    E, b, A, c = instant.E[0], instant.b[0], instant.A[0], instant.c[0]
    box, balance = np.vstack([np.eye(n), -np.eye(n)]), np.hstack([E, np.zeros((3, 1))])
    cone = linprog(
        np.eye(n + 1)[n],
        np.hstack([box, -np.ones((2 * n, 1))]),
        np.concatenate([instant.upper, -instant.lower]),
        balance,
        b,
        [(None, None)] * n + [(0, None)],
    )
    assert cone.status == 0
    if cone.fun > 1e-6:
        assert result.reason == "friction cone"
        assert result.violation == pytest.approx(cone.fun, rel=1e-6, abs=1e-6)
        return
    torque = linprog(
        np.eye(n + 1)[n],
        np.hstack([np.vstack([-A, A]), -np.ones((16, 1))]),
        np.concatenate([instant.limit - c, instant.limit + c]),
        balance,
        b,
        [*zip(instant.lower, instant.upper, strict=True), (0, None)],
    )
    assert torque.status == 0
    if torque.fun > 2e-6:
        assert result.reason == "torque limit"
        assert result.violation == pytest.approx(torque.fun, rel=1e-5, abs=2e-6)
    elif torque.fun < 1e-7:
        assert result.ok


@given(seeds)
@settings(max_examples=10, deadline=None)
@example(6297458)  # alone, one of them sends Clarabel's long steps to and fro
def test_a_batch_of_many_answers_as_its_instants_do_alone(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall, contacts = random_wall(rng, 4), on(ALL)
    q = rng.uniform(-1.2, 1.2, (40, 11))
    dynamics = evaluate(robot, q, rng.normal(0.0, 1.0, (40, 11)), ALL)
    instants = instants_of(robot, wall, contacts, dynamics.load(rng.normal(0.0, 3.0, (40, 11))), dynamics.J)
    together = solve_instants(instants)
    for k in range(40):
        alone = solve_instants(instants[k : k + 1])[0]
        assert together[k].reason == alone.reason
        assert together[k].violation == pytest.approx(alone.violation, rel=1e-6, abs=2e-6)
        if alone.ok:
            np.testing.assert_allclose(together[k].force, alone.force, atol=1e-6)


def test_every_reason_occurs_among_random_instants(robot: Robot) -> None:
    reasons = {solve_instants(random_instant(robot, seed)[0]).reason for seed in range(200)}
    assert reasons == set(REASONS) - {"force balance"}


def test_constraints_of_the_program_read_as_sentences(robot: Robot) -> None:
    h, J = evaluate_at_rest(robot, STANDING[None], FRONT)
    program = TorqueProgram(instants_of(robot, wall_under(robot, STANDING), on(FRONT), h, J))
    names = {c.evaluator().get_description() for c in program.prog.GetAllConstraints()}
    assert {"balance in the rows without a motor", "torques", "least force of contact 1"} <= names
    assert "greatest torque of joint 7" in names
    assert "" not in names
