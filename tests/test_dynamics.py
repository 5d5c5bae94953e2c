from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import MultibodyForces

from climber.dynamics import DynamicsBatch, evaluate, evaluate_at_rest, inverse_dynamics
from climber.robot import Robot
from climber.stance import Vector

QUADRUPED = "package://climber/quadruped/quadruped.urdf"
ALL, THREE = (0, 1, 2, 3), (2, 0, 3)
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(QUADRUPED)


def damped(robot: Robot, folder: Path, damping: float) -> Robot:
    """The same robot with viscous friction in its joints."""
    model = folder / "damped.urdf"
    model.write_text(robot.model.path.read_text().replace('damping="0.0"', f'damping="{damping}"'))
    model.with_suffix(".yaml").write_text(robot.model.path.with_suffix(".yaml").read_text())
    return Robot(model)


def random_state(robot: Robot, rng: np.random.Generator, K: int) -> tuple[Vector, Vector, Vector]:
    nv = robot.plant.num_velocities()
    return rng.uniform(-1.5, 1.5, (K, nv)), rng.normal(0.0, 2.0, (K, nv)), rng.normal(0.0, 20.0, (K, nv))


def on_contacts(dynamics: DynamicsBatch, rates: Vector) -> Vector:
    """The nearest velocities or accelerations whose feet have the acceleration -Jdot_v."""
    inverse = np.linalg.pinv(dynamics.J)
    return rates - np.einsum("kvm,km->kv", inverse, dynamics.slip(rates))


def moving_on_contacts(
    robot: Robot, rng: np.random.Generator, K: int, holding: tuple[int, ...]
) -> tuple[DynamicsBatch, Vector]:
    """Random states whose holding feet stand still, and accelerations that keep them so."""
    q, v, vd = random_state(robot, rng, K)
    J = evaluate_at_rest(robot, q, holding)[1]
    v -= np.einsum("kvm,kmu,ku->kv", np.linalg.pinv(J), J, v)
    dynamics = evaluate(robot, q, v, holding)
    return dynamics, on_contacts(dynamics, vd)


def forward(robot: Robot, q: Vector, v: Vector, torque: Vector, holding: tuple[int, ...], force: Vector) -> Vector:
    """Accelerations by Drake's own forward dynamics, with the forces (k, 2) applied to the feet."""
    plant, context = robot.plant, robot.context()
    plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    order = [plant.get_joint_actuator(i).joint().velocity_start() for i in plant.GetJointActuatorIndices()]
    at = {int(place): tau for place, tau in zip(robot.joint_v, torque, strict=True)}
    plant.get_actuation_input_port().FixValue(context, np.array([at[place] for place in order]))
    applied = []
    for limb, f in zip(holding, force, strict=True):
        foot = plant.GetFrameByName(robot.limbs[limb].foot)
        push = ExternallyAppliedSpatialForce()
        push.body_index = foot.body().index()
        push.p_BoBq_B = foot.GetFixedPoseInBodyFrame().translation()
        push.F_Bq_W = SpatialForce(np.zeros(3), np.append(f, 0.0))
        applied.append(push)
    port = plant.get_applied_spatial_force_input_port()
    port.FixValue(context, AbstractValue.Make(applied))
    return np.asarray(plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :])


def test_the_bias_and_mass_matrix_are_those_of_drakes_inverse_dynamics(robot: Robot) -> None:
    q, v, vd = random_state(robot, np.random.default_rng(1), 20)
    dynamics, context = evaluate(robot, q, v, ALL), robot.context()
    for k in range(20):
        robot.plant.SetPositionsAndVelocities(context, np.concatenate([q[k], v[k]]))
        forces = MultibodyForces(robot.plant)
        robot.plant.CalcForceElementsContribution(context, forces)
        expected = robot.plant.CalcInverseDynamics(context, vd[k], forces)
        np.testing.assert_allclose(dynamics.load(vd)[k], expected, atol=1e-12)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_drakes_forward_dynamics_answer_torques_and_contact_forces_with_the_acceleration(
    robot: Robot, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q, v, vd = random_state(robot, rng, 1)
    torque, force = rng.uniform(-4.0, 4.0, (1, 8)), rng.normal(0.0, 10.0, (1, 3, 2))  # Drake clamps at 4 N m
    dynamics = evaluate(robot, q, v, THREE)
    supplied = -dynamics.residual(np.zeros_like(vd), torque, force.reshape(1, -1))
    expected = forward(robot, q[0], v[0], torque[0], THREE, force[0])
    np.testing.assert_allclose(np.linalg.solve(dynamics.M, supplied[:, :, None])[0, :, 0], expected, rtol=1e-8)


def test_friction_in_the_joints_is_part_of_the_bias(robot: Robot, tmp_path: Path) -> None:
    rubbing = damped(robot, tmp_path, 0.3)
    q, v, _ = random_state(robot, np.random.default_rng(2), 1)
    torque, force = np.ones((1, 8)), np.ones((1, 4, 2))
    dynamics = evaluate(rubbing, q, v, ALL)
    np.testing.assert_allclose(
        (dynamics.h - evaluate(robot, q, v, ALL).h)[:, robot.joint_v], 0.3 * v[:, robot.joint_v], atol=1e-12
    )
    acceleration = forward(rubbing, q[0], v[0], torque[0], ALL, force[0])
    np.testing.assert_allclose(dynamics.residual(acceleration[None], torque, force.reshape(1, -1)), 0.0, atol=1e-9)


def test_the_contact_jacobian_is_the_derivative_of_the_feet(robot: Robot) -> None:
    q, v, vd = random_state(robot, np.random.default_rng(3), 5)
    dynamics, context, step = evaluate(robot, q, v, THREE), robot.context(), 1e-6

    def feet(q: Vector) -> Vector:
        robot.plant.SetPositions(context, q)
        return robot.foot_positions(context)[list(THREE), :2].ravel()

    for k in range(5):
        columns = [(feet(q[k] + step * e) - feet(q[k] - step * e)) / (2 * step) for e in np.eye(11)]
        np.testing.assert_allclose(dynamics.J[k], np.array(columns).T, atol=1e-8)
        path = [feet(q[k] + t * v[k] + 0.5 * t**2 * vd[k]) for t in (-1e-4, 0.0, 1e-4)]
        acceleration = (path[0] - 2 * path[1] + path[2]) / 1e-8
        np.testing.assert_allclose(dynamics.slip(vd)[k], acceleration, rtol=1e-4, atol=1e-3)


def test_at_rest_the_bias_is_gravity_alone(robot: Robot) -> None:
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (4, 11))
    h, J = evaluate_at_rest(robot, q, ALL)
    moving = evaluate(robot, q, np.zeros((4, 11)), ALL)
    np.testing.assert_array_equal(h, moving.h)
    np.testing.assert_array_equal(J, moving.J)
    np.testing.assert_allclose(h[:, 1], robot.mass * 9.81, rtol=1e-12)  # base_y carries the weight
    np.testing.assert_allclose(moving.Jdot_v, 0.0, atol=1e-14)


@given(seeds, st.sampled_from([ALL, THREE, (0, 2), (1,), ()]))
@settings(max_examples=40, deadline=None)
def test_orthogonal_decomposition_leaves_no_residual(robot: Robot, seed: int, holding: tuple[int, ...]) -> None:
    dynamics, vd = moving_on_contacts(robot, np.random.default_rng(seed), 5, holding)
    np.testing.assert_allclose(dynamics.slip(vd), 0.0, atol=1e-8)
    answer = inverse_dynamics(dynamics, vd)
    residual = dynamics.residual(vd, answer.torque, answer.force)
    if 2 * len(holding) >= 3:
        np.testing.assert_allclose(residual, 0.0, atol=1e-9 * (1 + np.abs(answer.force).max()))
    else:  # fewer rows of contact than the pelvis has freedoms: an arbitrary acceleration cannot be had
        assert np.abs(residual).max() > 1e-3


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_no_other_torques_that_make_the_motion_are_smaller(robot: Robot, seed: int) -> None:
    dynamics, vd = moving_on_contacts(robot, np.random.default_rng(seed), 1, ALL)
    torque = inverse_dynamics(dynamics, vd).torque[0]
    # Optimality of min |tau|^2 s.t. S^T tau + J^T lambda = load: tau is in the range of S and J S^T tau vanishes there.
    S = np.eye(11)[robot.joint_v]
    system = np.hstack([S.T, dynamics.J[0].T])
    kkt = np.block(
        [[np.diag([1.0] * 8 + [0.0] * 8), system.T], [system, np.zeros((11, 11))]],
    )
    solution = np.linalg.lstsq(kkt, np.concatenate([np.zeros(16), dynamics.load(vd)[0]]), rcond=1e-12)[0]
    np.testing.assert_allclose(torque, solution[:8], atol=1e-6 * (1 + np.abs(torque).max()))


def test_tracking_brings_a_displaced_robot_back(robot: Robot) -> None:
    rng = np.random.default_rng(5)
    q = np.array([[0, 0, 0, -0.6, 1.2, 0.6, -1.2, -0.6, 1.2, 0.6, -1.2]], dtype=float)
    v = np.zeros_like(q)
    desired, joints = q[:, robot.joint_v].copy(), robot.joint_v
    # Displace it with its feet in place, along the null space of J_c.
    feet = _feet(robot, q)
    q = _closed(robot, q + rng.normal(0.0, 0.15, q.shape), feet)
    displaced, step = np.abs(q[:, joints] - desired).max(), 1e-3
    for _ in range(500):
        dynamics = evaluate(robot, q, v, ALL)
        feedforward = inverse_dynamics(dynamics, on_contacts(dynamics, np.zeros_like(v))).torque
        torque = feedforward + 20.0 * (desired - q[:, joints]) - 0.5 * v[:, joints]  # (4.34)
        M, J = dynamics.M[0], dynamics.J[0]
        kkt = np.block([[M, -J.T], [J, np.zeros((8, 8))]])
        supplied = -dynamics.h[0]
        supplied[joints] += torque[0]
        vd = np.linalg.solve(kkt, np.concatenate([supplied, -dynamics.Jdot_v[0]]))[:11]
        v = v + step * vd
        q = q + step * v
    assert displaced > 0.03
    assert np.abs(q[:, joints] - desired).max() < 0.02 * displaced


def _feet(robot: Robot, q: Vector) -> Vector:
    context = robot.context()
    robot.plant.SetPositions(context, q[0])
    return robot.foot_positions(context)[:, :2].ravel()


def _closed(robot: Robot, q: Vector, feet: Vector) -> Vector:
    """The nearest posture with the feet where they belong, by Newton's method."""
    for _ in range(20):
        J = evaluate_at_rest(robot, q, ALL)[1][0]
        q = q - np.linalg.pinv(J) @ (_feet(robot, q) - feet)
    return q
