"""Robots posed and moved from first principles, without the planner: the phases of the plans in `plans`.

Pelvis and feet run along straight lines by the minimum-jerk law; joints follow by Newton's method on the plant's
Jacobians, velocities and accelerations from the contacts' constraints, forces as near as possible to ones well inside
the cones, torques from the plant's inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import cvxpy
import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from climber.plan_parts import Phase, PhaseContact
from climber.robot import Robot
from climber.stance import Vector

LIMBS = ("right_front", "left_front", "left_rear", "right_rear")
RATE = 100.0  # [Hz]
TORQUE_ROOM = 0.1  # [m] times room to the limits of forces [N]: the room to those of torques
ACCURATE = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}


class Holding(Protocol):
    """Holds to be on."""

    @property
    def positions(self) -> Vector:
        """Centres of the patches [m], shape (num_holds, d)."""
        ...

    def room(self, forces: Sequence[cvxpy.Variable], holds: Sequence[int], room: cvxpy.Variable) -> list[object]:
        """Constraints: forces (d,) [N] are within the limits of `holds`, with `room` [N] to them."""
        ...


@dataclass(frozen=True)
class Line:
    """A straight line run from rest to rest by the minimum-jerk law."""

    start: Vector
    end: Vector

    def at(self, tau: float, duration: float) -> tuple[Vector, Vector, Vector]:
        """Place, velocity and acceleration at the fraction `tau` of `duration` [s]."""
        way = self.end - self.start
        return (
            self.start + way * tau**3 * (10 - 15 * tau + 6 * tau**2),
            way * 30 * tau**2 * (1 - tau) ** 2 / duration,
            way * 60 * tau * (1 - tau) * (1 - 2 * tau) / duration**2,
        )


class Climber:
    """A robot with four limbs, in the plane (d = 2) or in space (d = 3), posed and moved by its pelvis and feet.

    The pelvis is where its positions in the plant are, shape (nb,).
    """

    def __init__(self, robot: Robot, joints: Sequence[float]) -> None:
        """At rest.

        Args:
            robot: The robot, whose limbs have as many joints as there are dimensions.
            joints: Joint angles near to those that it will have [rad].
        """
        self.robot = robot
        self.context = robot.context()
        self.joints = robot.joint_v  # positions and velocities of these robots have the same places
        self.q = np.zeros(robot.plant.num_positions())
        self.q[self.joints] = joints

    def jacobian(self) -> Vector:
        """Of the feet, limb by limb, shape (d num_limbs, nv)."""
        plant, world, d = self.robot.plant, self.robot.plant.world_frame(), self.robot.dimension
        frames = [plant.GetFrameByName(limb.foot) for limb in self.robot.limbs]
        wrt = JacobianWrtVariable.kV
        return np.vstack(
            [
                plant.CalcJacobianTranslationalVelocity(self.context, wrt, frame, np.zeros(3), world, world)[:d]
                for frame in frames
            ]
        )

    def pose(self, base: Vector, feet: Vector) -> Vector:
        """Positions with the pelvis at `base` (nb,) and the feet at `feet`, shape (num_limbs, d)."""
        self.q[self.robot.base_q] = base
        for _ in range(100):
            self.robot.plant.SetPositions(self.context, self.q)
            miss = (self.robot.foot_positions(self.context)[:, : self.robot.dimension] - feet).ravel()
            if np.abs(miss).max() < 1e-13:
                break
            step = np.linalg.solve(self.jacobian()[:, self.joints], miss)
            self.q[self.joints] -= step * min(1.0, 0.3 / np.abs(step).max())
        assert np.abs(miss).max() < 1e-12
        return self.q.copy()

    def rates(self, base: tuple[Vector, Vector], feet: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        """Velocities and accelerations for the rates of pelvis (nb,) and feet (num_limbs, d), at the last pose.

        Each is a pair of first and second derivatives by time.
        """
        robot, plant, world = self.robot, self.robot.plant, self.robot.plant.world_frame()
        J, at = self.jacobian(), robot.base_v
        first, second = np.zeros((2, plant.num_velocities()))
        first[robot.base_q], second[robot.base_q] = base
        v = robot.v_of(self.q[None], first[None])[0]
        vd = robot.vd_of(self.q[None], first[None], second[None])[0]
        v[self.joints] = np.linalg.solve(J[:, self.joints], feet[0].ravel() - J[:, at] @ v[at])
        plant.SetVelocities(self.context, v)
        bias = np.concatenate(
            [
                plant.CalcBiasTranslationalAcceleration(
                    self.context, JacobianWrtVariable.kV, plant.GetFrameByName(limb.foot), np.zeros(3), world, world
                ).ravel()[: robot.dimension]
                for limb in robot.limbs
            ]
        )
        vd[self.joints] = np.linalg.solve(J[:, self.joints], feet[1].ravel() - bias - J[:, at] @ vd[at])
        return v, vd

    def _needed(self, vd: Vector, limbs: Sequence[int]) -> tuple[Vector, Vector]:
        """M vd + h (nv,), and the Jacobian of the feet that hold, shape (d len(limbs), nv)."""
        applied = MultibodyForces(self.robot.plant)
        self.robot.plant.CalcForceElementsContribution(self.context, applied)
        d = self.robot.dimension
        rows = [d * limb + axis for limb in limbs for axis in range(d)]
        return self.robot.plant.CalcInverseDynamics(self.context, vd, applied), self.jacobian()[rows]

    def forces(self, vd: Vector, limbs: Sequence[int], wish: Vector) -> tuple[Vector, Vector]:
        """Contact forces of `limbs` nearest to `wish` (len(limbs), d) that carry the motion, and the torques."""
        needed, J = self._needed(vd, limbs)
        carry = J[:, self.robot.base_v].T
        f = wish.ravel() + np.linalg.pinv(carry) @ (needed[self.robot.base_v] - carry @ wish.ravel())
        return f.reshape(wish.shape), (needed - J.T @ f)[self.joints]

    def centered(self, limbs: Sequence[int], ground: Holding, holds: Sequence[int]) -> Vector:
        """Static contact forces with as much room as can be to their limits and those of torques, (len(limbs), d).

        Args:
            limbs: The limbs that hold.
            ground: The holds.
            holds: The hold that each of them is on.
        """
        still = np.zeros(self.robot.plant.num_velocities())
        self.robot.plant.SetVelocities(self.context, still)
        needed, J = self._needed(still, limbs)
        forces, room = [cvxpy.Variable(self.robot.dimension) for _ in limbs], cvxpy.Variable()
        left = needed - J.T @ cvxpy.hstack(forces)
        inside = [left[self.robot.base_v] == 0.0, *ground.room(forces, holds, room)]
        inside.append(cvxpy.abs(left[self.joints]) <= self.robot.effort - TORQUE_ROOM * room)
        problem = cvxpy.Problem(cvxpy.Maximize(room), inside)
        problem.solve(solver=cvxpy.CLARABEL, **ACCURATE)
        assert room.value > 0.0
        return np.array([force.value for force in forces])

    def phase(
        self, ground: Holding, stance: int, holds: dict[int, int], base: Line, feet: Line, begin: float, duration: float
    ) -> Phase:
        """The phase in which pelvis and feet run along lines.

        Args:
            ground: The holds.
            stance: The stance it starts in.
            holds: The hold of each limb that holds; one that is left out swings.
            base: Where the pelvis goes, in its positions.
            feet: Where the feet go [m], shape (num_limbs, d).
            begin: When it begins [s].
            duration: How long it takes [s].
        """
        limbs = sorted(holds)
        count = int(np.ceil(duration * RATE)) + 1
        self.pose(base.at(0.5, duration)[0], feet.at(0.5, duration)[0])
        wish = self.centered(limbs, ground, [holds[limb] for limb in limbs])
        rows = []
        for tau in np.linspace(0.0, 1.0, count):
            (x, xd, xdd), (p, pd, pdd) = base.at(tau, duration), feet.at(tau, duration)
            q = self.pose(x, p)
            v, vd = self.rates((xd, xdd), (pd, pdd))
            rows.append((q, v, vd, *self.forces(vd, limbs, wish)))
        q, v, vd, force, torque = (np.array(column) for column in zip(*rows, strict=True))
        beyond = 3 - self.robot.dimension  # axes that a plan has and a plane has not
        points, force = np.pad(feet.start, ((0, 0), (0, beyond))), np.pad(force, ((0, 0), (0, 0), (0, beyond)))
        swinging = next((LIMBS[limb] for limb in range(4) if limb not in holds), None)
        return Phase(
            kind="swing" if swinging else "shift",
            limb=swinging,
            stance=stance,
            contacts=tuple(PhaseContact(LIMBS[i], holds[i], points[i]) for i in limbs),
            time=begin + np.linspace(0.0, duration, count),
            q=q,
            v=v,
            vd=vd,
            torque=torque,
            force={LIMBS[limb]: force[:, place] for place, limb in enumerate(limbs)},
        )


def step_phases(climber: Climber, ground: Holding, base: Sequence[Sequence[float]], duration: float) -> list[Phase]:
    """A shift on the first four holds, a swing of the right front limb to the fifth and a shift.

    Args:
        climber: The robot.
        ground: The holds.
        base: Where the pelvis is at the ends of the phases, in its positions, four places.
        duration: Of each phase [s].
    """
    before, after = ground.positions[[0, 1, 2, 3]], ground.positions[[4, 1, 2, 3]]
    ways = [Line(np.array(a), np.array(b)) for a, b in pairwise(base)]
    feet = [Line(before, before), Line(before, after), Line(after, after)]
    holds = [{0: 0, 1: 1, 2: 2, 3: 3}, {1: 1, 2: 2, 3: 3}, {0: 4, 1: 1, 2: 2, 3: 3}]
    return [climber.phase(ground, i // 2, holds[i], ways[i], feet[i], i * duration, duration) for i in range(3)]
