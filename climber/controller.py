"""The controller: what a robot's motors do at an instant, given what it is to do and where it is.

Joint tracking with feed-forward compensation is tau = tau_ff + K_P e + K_D de/dt (Gönen 2021, 4.34). On a closed chain
joint errors that cannot be undone, because feet do not stand exactly where the plan has them, would make the feet push
against one another until one slides. So the gains act on accelerations, and forces are chosen before torques:

    (1) vd* = vd_ref + k_P e + k_D (v_ref - v), e = q_ref - q
    (2) vd  = the acceleration nearest to vd* at which holding feet come to rest: J_c vd + Jdot_c v = -k_F J_c v
    (3) d   = what else pushes the robot, by how its velocities differ from those expected (`climber.disturbance`)
    (4) lambda = the contact forces near the plan's, within friction and torques, that carry the robot in the rows u
        without a motor, J_u^T lambda = (M vd + h)_u - d_u (`climber.force_control`)
    (5) tau = (M vd + h - d)_a - J_a^T lambda in the rows a with one

(3) takes the place of an integral of errors: what pushes the robot, or makes it heavier, is found out in some 20 ms,
and carried by forces within friction from then on. (4) is the force control. If no forces carry the robot, vd in (5) is
what those found make it do: accelerations give way, friction and torques do not. Of friction it leaves unused what the
plan's margins say can be spared, since the controller is not told of holds that have less.

A trajectory generator (Bretl 2006) runs the plan's clock: it slows as the tracking error grows, and stops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import Context

from climber.definite import solved
from climber.disturbance import Disturbance
from climber.dynamics import Sampler, passive, turning
from climber.force_control import Demand
from climber.phase_stance import PhaseStance
from climber.reference import Desired, Reference
from climber.robot import Indices
from climber.stance import Vector
from climber.wall import Wall

# A limb that moves its foot less than so much a radian is nearly straight [m]: one with links of 0.1 m that is bent by
# less than 0.3. With a third of it, a limb whose foot was 0.8 mm off bent back where it was to go through straight.
DAMPING = 0.015
PRESS = 0.15  # share of a disturbance's force that every foot presses with at least
GIVING = 3e-5  # how readily the pelvis gives way to joints [m^2]


@dataclass(frozen=True)
class Gains:
    """How firmly the controller tracks.

    Attributes:
        pelvis: Natural frequency of the pelvis's errors [1/s]; they are critically damped.
        joint: Natural frequency of a free limb's joint errors [1/s]; critically damped.
        foot: How fast a holding foot that moves is brought to rest [1/s].
        approach: A foot that ends its swing off its hold goes on towards it this fast [m/s].
        settle: A robot that starts elsewhere than planned, or the joints of a limb that lets go so, are led back to the
            plan in about this time [s].
        pelvis_error: The clock slows when the pelvis is this far off [m], and stops at twice of it.
        pelvis_angle: Likewise for its orientation [rad].
        joint_error: Likewise for the joints of free limbs [rad].
    """

    pelvis: float = 40.0
    joint: float = 80.0
    foot: float = 40.0
    approach: float = 0.03
    settle: float = 0.1
    pelvis_error: float = 0.004
    pelvis_angle: float = 0.04
    joint_error: float = 0.05


@dataclass(frozen=True)
class Command:
    """What the motors do.

    Attributes:
        torque: Joint torques within the limits [N m], in the order of `Robot.joint_names`, shape (num_joints,).
        moment: Moments between grippers and pins about z [N m], shape (num_limbs,).
        force: Contact forces that are to come of it, in W [N], shape (num_limbs, 3).
        applied: Torques and moments as generalised forces [N, N m], shape (nv,).
    """

    torque: Vector
    moment: Vector
    force: Vector
    applied: Vector


class Controller:
    """Makes one robot follow its plan.

    Attributes:
        reference: The plan.
        phase: Number of the phase that it is in.
        weight: The robot's weight as generalised forces [N, N m], shape (nv,), in the state of the last command.
    """

    def __init__(self, reference: Reference, wall: Wall, time_step: float, gains: Gains | None = None) -> None:
        """Puts the controller before the first phase.

        Args:
            reference: The plan.
            wall: The wall as the plan knows it.
            time_step: Between commands [s].
            gains: How firmly it tracks.
        """
        self.reference, self.robot, self.wall = reference, reference.robot, wall
        self.time_step, self.gains = time_step, gains or Gains()
        robot = self.robot
        self._axes, self._feet = robot.dimension, Sampler(robot, range(len(robot.limbs)))
        self._turning = turning(robot, range(len(robot.limbs)))
        nv = len(robot.velocity_names)
        motors = np.flatnonzero(robot.effort > 0.0)
        driven, self._limits = robot.joint_v[motors], robot.effort[motors]
        self._motors, self._driven = _places(motors), _places(driven)
        self._loose = _places(np.setdiff1d(np.arange(nv), driven))
        self._limbs, self._giving = np.ones(nv), np.ones(nv)
        self._limbs[robot.base_v], self._giving[robot.base_v] = 0.0, GIVING
        omega = np.full(nv, self.gains.joint)
        omega[robot.base_v] = self.gains.pelvis
        self._kp, self._kd = omega**2, 2.0 * omega
        self._tolerance = np.full(nv, self.gains.joint_error)
        self._tolerance[robot.base_v] = self.gains.pelvis_error
        self._tolerance[robot.angle_q] = self.gains.pelvis_angle
        self._aside, self.error, self.weight = np.zeros(nv), np.zeros(nv), np.zeros(nv)
        self._at_center = np.zeros((self._axes, nv))
        self._disturbance = Disturbance(robot, time_step)
        self._damping, self._rotors = passive(robot)
        self.phase, self.landing = 0, False
        self._stance = PhaseStance.of(reference, 0, wall)

    # --- the plan's clock ---------------------------------------------------------------------------------------------

    @property
    def end(self) -> float:
        """The time of the plan that the clock may not pass before the next phase begins [s]."""
        return self.reference.end(self.phase)

    @property
    def begin(self) -> float:
        """When the plan begins [s]."""
        return float(self.reference.phase(0).time[0])

    @property
    def last(self) -> float:
        """When the plan ends [s]."""
        return self.reference.end(self.reference.num_phases - 1)

    @property
    def free_joints(self) -> Indices:
        """Places in the velocities of the joints of limbs that hold nothing."""
        return self._stance.free[len(self.robot.base_v) :]

    @property
    def waiting(self) -> str:
        """What the clock may be waiting for, in words."""
        if self.landing and self.arriving is not None:
            limb, hold = self.arriving
            return f"{self.robot.limb_names[limb]} does not reach hold {hold}"
        return f"tracking errors of up to {float(np.abs(self.error[self._stance.free]).max()):.3f} m or rad"

    @property
    def done(self) -> bool:
        """Whether it is in the last phase."""
        return self.phase + 1 == self.reference.num_phases

    @property
    def touches(self) -> dict[int, tuple[int, Vector]]:
        """By limb that holds: its hold, and where the plan has the foot in W [m]."""
        return self._stance.touches

    @property
    def arriving(self) -> tuple[int, int] | None:
        """The limb that takes hold when the phase ends, and its hold."""
        return self._stance.arriving

    def start(self, q: Vector) -> None:
        """The robot is at q [m, rad], shape (nq,), at rest: it is led to where the plan begins, not torn."""
        self._aside = self.robot.v_of(q, self.reference.at(0, self.begin).q - q)

    def advance(self) -> None:
        """Goes on to the next phase."""
        before = self._stance.touches
        self.phase, self.landing = self.phase + 1, False
        self._stance = PhaseStance.of(self.reference, self.phase, self.wall)
        for limb, its in enumerate(self.robot.limbs):
            if limb in before or limb in self._stance.touches:
                self._aside[its.v] = 0.0
                self._disturbance.forget(its.v)
            if limb in before and limb not in self._stance.touches:
                self._aside[its.v] = self.error[its.v]

    @property
    def pace(self) -> float:
        """How fast the clock may run, between 0 and 1, by the tracking error of the last command."""
        free = self._stance.free
        worst: float = max((np.abs(self.error[free]) / self._tolerance[free]).tolist())
        return min(max(2.0 - worst, 0.0), 1.0)

    # --- forces and torques -------------------------------------------------------------------------------------------

    def command(
        self, time: float, rate: float, quicker: float, q: Vector, v: Vector, toward: Vector | None = None
    ) -> Command:
        """What the motors do.

        Args:
            time: The plan's clock [s], within the phase.
            rate: How fast it runs.
            quicker: How fast that changes [1/s].
            q: Measured positions [m, rad], shape (nq,).
            v: Measured velocities [m/s, rad/s], shape (nv,).
            toward: If the limb that arrives is to go on towards its hold, which way in W, and how fast beside
                `Gains.approach`, shape (3,).
        """
        stance, gains, robot = self._stance, self.gains, self.robot
        desired = self.reference.at(self.phase, time)
        sampler = stance.sampler
        plant, context = sampler.plant, sampler.context
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        J, Jdot_v = stance.J, stance.Jdot_v
        sampler.J(J)
        sampler.Jdot_v(Jdot_v)
        # (1)
        self.error = plant.MapQDotToVelocity(context, desired.q - q)
        following = self._following(J)
        followed = following @ J
        motions = stance.alone - followed[:, stance.free]
        if toward is not None:
            self._approach(toward, q, motions)
        else:
            self._aside *= 1.0 - self.time_step / gains.settle
        # Errors that the feet's places do not permit to undo are none.
        error = self.error - self._aside
        error -= followed @ error
        wanted = rate**2 * desired.vd + quicker * desired.v + self._kp * error + self._kd * (rate * desired.v - v)
        # (2)
        vd = wanted - followed @ wanted - following @ (gains.foot * (J @ v) + Jdot_v)
        # (3)
        M = plant.CalcMassMatrix(context)
        moved = M @ motions
        self.weight = np.asarray(plant.CalcGravityGeneralizedForces(context))
        self._at_center = self._motion_at_center(context)
        disturbance = self._disturbance
        disturbance.observe(v[stance.free], stance.free, motions.T @ moved)
        load = sampler.load(vd)
        masses = load - self._damping * v - self._rotors * vd
        disturbance.weigh(masses, self._at_center, stance.free, motions)
        more, rest = disturbance.parts(masses, stance.free)
        load = load - more - rest
        # (4)
        base = slice(len(robot.base_v))
        gives = _inverse(moved[self._loose, base])
        demand = self._demand(desired, J, load, moved[self._driven, base] @ gives, disturbance.size(rest))
        forces = stance.control.forces(demand)
        # (5)
        torque = np.zeros(len(robot.joint_v))
        torque[self._motors] = np.minimum(np.maximum(demand.c - demand.A @ forces, -self._limits), self._limits)
        vd = vd + motions[:, base] @ (gives @ (demand.E @ forces - demand.load))
        disturbance.expect((v + self.time_step * vd)[stance.free])
        return self._act(torque, forces)

    def _demand(self, desired: Desired, J: Vector, load: Vector, gives: Vector, push: float) -> Demand:
        """What is asked of the contact forces.

        Args:
            desired: What the plan has.
            J: Jacobian of the feet that hold, shape (m, nv).
            load: M vd + h less disturbances [N, N m], shape (nv,).
            gives: How the motors' rows of M vd change with those without a motor, if the pelvis gives way to these,
                shape (motors, u).
            push: Of the disturbances [N].
        """
        stance = self._stance
        wished = desired.force.reshape(-1)[stance.places]
        if stance.gripping:
            J = np.concatenate([J, self._turning[stance.gripping]])
            wished = np.concatenate([wished, desired.moment[stance.gripping]])
        E = J[:, self._loose].T
        return Demand(
            wished=wished,
            E=E,
            load=load[self._loose],
            A=J[:, self._driven].T - gives @ E,
            c=load[self._driven] - gives @ load[self._loose],
            most=self._limits,
            drop=desired.drop,
            press=PRESS * push,
            turn=desired.turn,
        )

    def pushed(self, force: Vector) -> Vector:
        """A push of the pelvis at the robot's centre of mass [N], shape (axes,), as generalised forces, shape (nv,).

        The state is that of the last command.
        """
        result: Vector = self._at_center.T @ force
        return result

    def _motion_at_center(self, context: Context) -> Vector:
        """How the pelvis moves where the centre of mass is, by velocities, shape (axes, nv)."""
        plant, pelvis = self.robot.plant, self.robot.pelvis
        world = plant.world_frame()
        center = plant.CalcPointsPositions(context, world, self.robot.center_of_mass(context), pelvis.body_frame())
        J = plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, pelvis.body_frame(), center, world, world
        )
        return np.asarray(J[: self._axes])

    def _following(self, J: Vector) -> Vector:
        """How joints and pelvis are moved for holding feet to move as they must, shape (nv, m).

        Limbs follow the pelvis. But near a straight limb joints would have to be ever faster for it, so that there the
        joints keep to the plan, which may lead them through the straight on purpose, and the pelvis follows them. With
        L the limbs' columns of J, W how readily joints and pelvis give way, and the damping D, that is first
        L^T (L L^T + D^2)^-1, and for the share D^2 (L L^T + D^2)^-1 of the feet's motion that this leaves undone
        W J^T (J W J^T)^-1.
        """
        limbs, eased, few = J * self._limbs, J * self._giving, self._stance.few
        pelvis = solved(eased @ J.T + 1e-12 * few, eased)
        return solved(limbs @ limbs.T + DAMPING**2 * few, limbs + DAMPING**2 * pelvis).T

    def _approach(self, toward: Vector, q: Vector, motions: Vector) -> None:
        """Moves the place that the arriving limb's foot is led to, by what it goes in a time step.

        Its joints move it, and what they cannot do the pelvis does, as holding feet permit.

        Args:
            toward: As in `command`.
            q: Positions [m, rad], shape (nq,).
            motions: How everything moves with the pelvis and the free joints, shape (nv, n).
        """
        if self.arriving is None:
            return
        limb, _ = self.arriving
        joints, axes = self.robot.limbs[limb].v, self._axes
        feet, J = self._feet, np.empty((self._feet.num_rows, len(self.error)))
        feet.plant.SetPositions(feet.context, q)
        feet.J(J)
        J = J[axes * limb : axes * limb + axes]
        mine, every = J[:, joints], J @ motions
        share = solved(mine @ mine.T + DAMPING**2 * np.eye(axes), self.gains.approach * toward[:axes])
        eased = self._giving[self._stance.free, None] * every.T
        quick = motions @ (eased @ solved(every @ eased + 1e-12 * np.eye(axes), DAMPING**2 * share))
        quick[joints] += mine.T @ share
        self._aside -= self.time_step * quick

    def _act(self, torque: Vector, forces: Vector) -> Command:
        """The command that goes with torques and contact forces."""
        stance, robot, held = self._stance, self.robot, len(self._stance.places)
        force, moment = np.zeros(3 * len(robot.limbs)), np.zeros(len(robot.limbs))
        force[stance.places] = forces[:held]
        applied = np.zeros(len(robot.velocity_names))
        applied[robot.joint_v] = torque
        if stance.gripping:
            moment[stance.gripping] = forces[held:].clip(-stance.most, stance.most)
            applied += moment @ self._turning
        return Command(torque, moment, force.reshape(-1, 3), applied)


def _places(indices: Indices) -> Indices | slice:
    """The same places as a slice, which is quicker, if they follow one another."""
    if not len(indices) or (np.diff(indices) != 1).any():
        return indices
    return slice(int(indices[0]), int(indices[-1]) + 1)


def _inverse(A: Vector) -> Vector:
    """The pseudo-inverse of a matrix of full column rank."""
    return solved(A.T @ A + 1e-12 * np.eye(A.shape[1]), A.T)
