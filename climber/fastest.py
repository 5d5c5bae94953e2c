"""The fastest motion along a leg of a path that holds, motors and joints allow.

The leg is run along a parameter x whose minimum-jerk law takes it from rest to rest: at either end q' and q'' vanish,
so that any positive speed along x begins and ends with neither speed nor acceleration, and contact forces do not jump
where one phase follows another. Of all speeds `climber.programs.time_scaling` finds the fastest.

Contacts and motors must be able to make accelerations that are greater than the motion's own by a constant factor. That
is the margin: what is true at some forty places of the leg must hold between them too, and a controller needs something
to correct with. It is there wherever the robot can stand at all, it grows with the room that there is at rest, and less
friction never leaves more of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climber.dynamics import evaluate, evaluate_at_rest, turning
from climber.exceptions import ModelError
from climber.manifold import Body
from climber.programs import torque_blocks
from climber.programs.forces import wall_forces
from climber.programs.instants import Instants, Margin
from climber.programs.path_dynamics import PathDynamics
from climber.programs.safest import cone_room
from climber.programs.speed_profile import SpeedProfile, TimeLaw
from climber.programs.time_scaling import TimeScaling, TimeScalingProgram
from climber.programs.torque import solve_instants
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.timing import PEAK, PacedPath, Samples
from climber.wall import GRAVITY

PELVIS_SPEED, PELVIS_TURN = 1.0, 2.0  # [m/s, rad/s] the pelvis has no limit of its own
HOLDING = 2 / 3  # share of their speed limits that the joints of limbs in contact use
# What samples keep to: less than what postures are chosen with (`climber.programs.torque`), in forces and in torques,
# so that there is room to move in even where a posture is at the edge of what can be held.
MARGIN = Margin(force=0.002, torque=0.08)
RESERVE = 0.5  # share of the accelerations that contacts and motors could make which a motion has
INTERVALS = 15.0  # of the speed profile, per second at full joint rates
FEWEST_AND_MOST = (12, 80)  # of these intervals
NEXT_TO_ENDS = 0.4  # of the first step from place to place: the speed at an end counts for nothing at the end itself
OVERSHOOT = (1.02, 1.06, 1.4)  # times the limits of speed, acceleration and jerk that samples may have
SHORTEST = 0.1  # [s] that any leg takes


@dataclass(frozen=True)
class RateLimits:
    """How fast each of the plant's velocities, and what follows from it, may be.

    Attributes:
        speed: [m/s, rad/s], shape (nv,).
        acceleration: [m/s^2, rad/s^2], shape (nv,).
        jerk: [m/s^3, rad/s^3], shape (nv,).
    """

    speed: Vector
    acceleration: Vector
    jerk: Vector

    @classmethod
    def of(cls, robot: Robot, pace: float, most_jerk: float, holding: Iterable[int] = ()) -> RateLimits:
        """The limits of a robot's joints, and some for its pelvis, for a motion at a share `pace` of the fastest.

        Without other limits such a motion is the fastest one slowed to that share: it has that share of the speed, its
        square of the acceleration and its cube of the jerk. Joints of the limbs that hold on are slower than others:
        where such a limb passes through straight, a small error of the pelvis is a great one of the joint.
        """
        nv = robot.plant.num_velocities()
        speed, acceleration, jerk = np.empty(nv), np.empty(nv), np.full(nv, most_jerk)
        for limb in robot.limbs:
            speed[limb.v], acceleration[limb.v] = limb.velocity, limb.acceleration
        for i in holding:
            speed[robot.limbs[i].v] *= HOLDING
        turns = np.isin(robot.base_q, robot.angle_q)
        reach, fastest = float(robot.reach.mean()), np.concatenate([limb.acceleration for limb in robot.limbs])
        speed[robot.base_v] = np.where(turns, PELVIS_TURN, PELVIS_SPEED)
        acceleration[robot.base_v] = np.where(turns, 1.0, reach) * fastest.max(initial=0.0)
        jerk[robot.base_v] *= np.where(turns, 1.0, reach)
        return cls(pace * speed, pace**2 * acceleration, pace**3 * jerk)

    def slowing(self, samples: Samples) -> float:
        """By what factor a motion must be slowed so that it keeps to the limits as nearly as it should; 1 if it does.

        A timing is computed at some places of a path; in between rates may go a little further.
        """
        jerk = np.diff(samples.vd, axis=0) / np.diff(samples.time)[:, None]
        shares = [
            np.abs(rates / limits).max(initial=0.0) / allowed
            for rates, limits, allowed in zip(
                (samples.v, samples.vd, jerk), (self.speed, self.acceleration, self.jerk), OVERSHOOT, strict=True
            )
        ]
        return float(max(1.0, *(share ** (1 / (order + 1)) for order, share in enumerate(shares))))

    def by_name(self, robot: Robot) -> dict[str, dict[str, float]]:
        """The finite limits, by kind and by the name of the velocity."""
        return {
            kind: {
                name: float(limit) for name, limit in zip(robot.velocity_names, limits, strict=True) if limit < np.inf
            }
            for kind, limits in vars(self).items()
        }


@dataclass(frozen=True)
class FastLeg:
    """A leg of a path and when it is where.

    Attributes:
        path: The leg.
        law: Its timing, along x.
        scaling: The solution of the program that it comes from.
        x: The places of that program, shape (N,).
        t: Forces that make the motion there, shape (N, n).
        slowing: How much slower than the solution it is.
    """

    path: PacedPath
    law: TimeLaw
    scaling: TimeScaling
    x: Vector
    t: Vector
    slowing: float = 1.0

    @property
    def duration(self) -> float:
        """Time from its begin to its end [s]."""
        return self.law.duration

    def slowed(self, factor: float) -> FastLeg:
        """The same leg, taking `factor` times as long."""
        return replace(self, law=self.law.slowed(factor), slowing=factor * self.slowing)

    def samples(self, duration: float, count: int) -> Samples:
        """The leg at `count` even instants, both ends included; `duration` [s] is that of the leg."""
        return self.at(np.linspace(0.0, duration, count))

    def at(self, time: Vector) -> Samples:
        """The leg at instants [s], shape (K,)."""
        x, rate, acceleration = self.law.at(time)
        place, first, second = warp(x / self.law.profile.length)
        length, scale = self.path.length, self.law.profile.length
        first, second = length * first / scale, length * second / scale**2
        q, v, vd = self.path.at(length * place, first * rate, second * rate**2 + first * acceleration)
        return Samples(time, q, v, vd)

    def forces(self, count: int) -> Vector:
        """Forces at `count` even instants, shape (count, n): near to some that make the motion."""
        x, _, _ = self.law.at(np.linspace(0.0, self.duration, count))
        columns = [np.interp(x, self.x, column) for column in self.t.T]
        return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def warp(z: Vector) -> tuple[Vector, Vector, Vector]:
    """The minimum-jerk law from 0 to 1 and its first two derivatives, z from 0 to 1."""
    return z**3 * (10 - 15 * z + 6 * z**2), 30 * z**2 * (1 - z) ** 2, 60 * z * (1 - z) * (1 - 2 * z)


def fastest_leg(
    body: Body, contacts: Sequence[Contact], path: PacedPath, limits: RateLimits, finer: int = 1
) -> FastLeg | str | None:
    """The leg timed.

    Args:
        body: The robot.
        contacts: The contacts that hold.
        path: The leg.
        limits: On rates.
        finer: Times as many places are looked at.

    Returns:
        The leg; or why it has no timing, however slow; or None if Clarabel found none although there is one.

    Raises:
        ModelError: If a joint without a motor is damped.
    """
    length = max(PEAK * path.length, SHORTEST)
    intervals = finer * int(np.clip(np.ceil(INTERVALS * length), *FEWEST_AND_MOST))
    profile = SpeedProfile(length, intervals)
    x = np.linspace(0.0, length, 2 * intervals + 1)
    near = NEXT_TO_ENDS * x[1]
    x = np.concatenate([x[:1], [near], x[1:-1], [length - near], x[-1:]])
    place, first, second = warp(x / length)
    along, bent = path.length * first / length, path.length * second / length**2
    q, v, vd = path.at(path.length * place, along, bent)
    loads, J = _loads(body.robot, q, v, vd, [contact.limb for contact in contacts])
    standing = instants_of(body, contacts, loads[0], J)
    t = torque_blocks.unlimited(standing)
    tight = np.flatnonzero(~standing.inside(t) | (standing.imbalance(t) > torque_blocks.TOLERANCE))
    if len(tight):
        lacking = failure(body, contacts, standing[tight])
        if lacking is not None:
            at = tight[lacking[0]] / (len(x) - 1)
            return f"the robot cannot stand still at {at:.0%} of the way: {lacking[1]}"
        t[tight] = torque_blocks.least_violation(standing[tight])[0]
    dynamics = _dynamics(body, contacts, x, loads, standing, v, vd, limits)
    scaling = None
    if length == SHORTEST and dynamics.paced() >= 1.0:
        # It keeps to its rate limits anyway. If forces do, too, it need not be any faster.
        moving = instants_of(body, contacts, loads[0] + (loads[1] + loads[3]) / RESERVE, J)
        forces = torque_blocks.unlimited(moving)
        if moving.inside(forces).all():
            scaling = TimeScaling.steady(dynamics, profile, forces)
    if scaling is None:
        scaling = TimeScalingProgram(dynamics, profile, forces=t).solve()
    if scaling is None:
        return None
    # Forces for a motion between rest and one faster than it are between those of both.
    leg = FastLeg(path, TimeLaw(profile, scaling.coefficients), scaling, x, RESERVE * scaling.t + (1 - RESERVE) * t)
    return leg.slowed(max(1.0, SHORTEST / leg.duration))


def foot_load(body: Body, contacts: Sequence[Contact]) -> float:
    """What a foot carries in the mean [N]."""
    return GRAVITY * body.robot.mass / max(1, len(contacts))


def instants_of(body: Body, contacts: Sequence[Contact], load: Vector, J: Vector) -> Instants:
    """Instants at which contacts and motors supply `load`, (K, nv), by the Jacobians J (K, m, nv)."""
    turns = turning(body.robot, [contact.limb for contact in contacts])
    holds = np.array([contact.hold for contact in contacts], dtype=int)
    forces = wall_forces(body.wall, body.robot.dimension)[holds]
    return Instants.of_loads(body.robot, forces, load, J, MARGIN, turns)


def _loads(robot: Robot, q: Vector, v: Vector, vd: Vector, holding: Sequence[int]) -> tuple[Vector, Vector]:
    """Generalised forces that rest, b, a and sqrt(b) take, (4, N, nv), and contact Jacobians, (N, m, nv).

    Velocity v and acceleration vd are those at b = 1 and a = 0. The bias h is that at rest, what grows with the square
    of the speed (Coriolis and centripetal terms) and what grows with the speed (damping).
    """
    dynamics = evaluate(robot, q, v, holding)
    rest, _ = evaluate_at_rest(robot, q, holding)
    damped = np.zeros_like(rest)
    if any(np.any(robot.plant.get_joint(i).default_damping_vector()) for i in robot.plant.GetJointIndices()):
        damped = 0.5 * (dynamics.h - evaluate(robot, q, -v, holding).h)
    squared = np.einsum("kij,kj->ki", dynamics.M, vd) + dynamics.h - rest - damped
    return np.stack([rest, squared, np.einsum("kij,kj->ki", dynamics.M, v), damped]), dynamics.J


def _dynamics(
    body: Body,
    contacts: Sequence[Contact],
    x: Vector,
    loads: Vector,
    standing: Instants,
    v: Vector,
    vd: Vector,
    limits: RateLimits,
) -> PathDynamics:
    """The leg's dynamics, what contacts and motors must supply exaggerated by the reserve."""
    robot, loads = body.robot, np.concatenate([loads[:1], loads[1:] / RESERVE])
    driven = robot.joint_v[standing.motors]
    free = np.setdiff1d(np.arange(loads.shape[2]), driven)
    if np.abs(loads[3][:, free]).max(initial=0.0) > 0.0:
        raise ModelError(f"{robot.model.path}: a joint without a motor must not be damped; motions cannot be timed")
    (rows, *_), most = standing.force_limits()  # the same everywhere
    (cones, *_), tops = standing.force_cones()
    return PathDynamics(
        x=x,
        E=standing.E,
        e=np.concatenate([standing.b[None], loads[1:3][:, :, free]]),
        A=standing.A,
        c=np.concatenate([standing.c[None], loads[1:3][:, :, driven]]),
        first=v,
        second=vd,
        speed=limits.speed,
        acceleration=limits.acceleration,
        jerk=limits.jerk,
        torque=np.broadcast_to(standing.limit, standing.c.shape),
        rows=rows,
        most=most,
        cones=cones,
        tops=tops,
        names=(
            force_names(body, contacts, standing),
            [robot.joint_names[i] for i in standing.motors],
            robot.velocity_names,
        ),
        damping=loads[3][:, driven] if loads[3].any() else None,
    )


def force_names(body: Body, contacts: Sequence[Contact], instants: Instants) -> list[str]:
    """What the limits of contact forces are called: the rows of `force_limits`, then the cones of `force_cones`."""
    rows, cones = instants.force_limits()[0][0], instants.force_cones()[0][0]
    moments, p = instants.forces.moments, instants.forces.lower.shape[1]
    names = []
    # A cone is told by its axis, as a row is: the force may not fall short, or not exceed.
    for row in [*rows, *cones[:, 0]]:
        place = int(np.abs(row).argmax())
        contact = contacts[place // p]
        limb, grip = body.robot.limb_names[contact.limb], body.wall.holds[contact.hold].grip
        kind = "force limit" if grip == "pin" or row[place] > 0.0 else "friction"
        if moments is not None and moments.ravel()[place]:
            kind = "moment"
        names.append(f"{kind} {limb}")
    return names


def force_room(instants: Instants, t: Vector) -> Vector:
    """How far forces t, shape (K, n), are inside the limits of `force_names` [N], (K, r + c)."""
    (rows, most), (cones, tops) = instants.force_limits(), instants.force_cones()
    room = most - np.einsum("krn,kn->kr", rows, t)
    return np.concatenate([room, cone_room(tops - np.einsum("kcan,kn->kca", cones, t))], axis=1)


def failure(body: Body, contacts: Sequence[Contact], instants: Instants) -> tuple[int, str] | None:
    """At which of some instants contacts or motors lack the most, and what and where; None if they lack nothing."""
    torques = solve_instants(instants)
    if torques.ok.all():
        return None
    k = torques.worst
    kind, by = torques[k].reason, torques.violation[k]
    if kind == "torque limit":
        excess = np.abs(torques.torque[k][instants.motors]) - instants.limit
        return k, f"{kind} of {body.robot.joint_names[instants.motors[int(excess.argmax())]]}, by {by:.3g} N m"
    if kind == "friction cone":
        instant = instants[k : k + 1]
        t, _ = torque_blocks.least_cone_violation(instant)
        worst = int(force_room(instant, t)[0].argmin())
        return k, f"{force_names(body, contacts, instant)[worst]}, by {by:.3g} N"
    return k, f"{kind}, by {by:.3g} N or N m"
