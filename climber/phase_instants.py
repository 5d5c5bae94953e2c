"""Phases of a motion as inequalities on contact forces, with what pushes, masses and centres of mass would add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from climber.dynamics import DynamicsBatch, evaluate, passive, turning
from climber.programs.grips import Grips
from climber.programs.place_margin import Lever
from climber.programs.survival import Instants
from climber.robot import Indices, Robot
from climber.stance import Contact, Vector
from climber.timing import Samples


class Moving(Protocol):
    """A phase: the contacts that hold, and the motion."""

    @property
    def contacts(self) -> tuple[Contact, ...]: ...  # noqa: D102
    @property
    def samples(self) -> Samples: ...  # noqa: D102


@dataclass(frozen=True)
class Disturbance:
    """What an error d of D numbers adds: E x = b + B d, G x <= g + C d.

    Attributes:
        B: Shape (K, u, D).
        C: Shape (K, r, D).
    """

    B: Vector
    C: Vector


class PhaseInstants:
    """All samples of several phases of as many contacts each.

    Attributes:
        robot: The robot.
        contacts: The contacts of each phase, P tuples of k.
        limbs: The limb of each contact, shape (P, k).
        grips: What the contacts can give, leading shape (P k,).
        dynamics: The equations of motion at all K samples.
        load: Forces that the masses need, M vd + h less what joint damping and rotors take [N, N m], shape (K, nv).
        phase: Which of the phases each sample is in, shape (K,).
    """

    def __init__(self, robot: Robot, grips: Grips, phases: Sequence[Moving]) -> None:
        self.robot, self.contacts = robot, [phase.contacts for phase in phases]
        self.limbs = np.array([[contact.limb for contact in contacts] for contacts in self.contacts], dtype=int)
        self.grips = grips[np.array([contact.hold for contacts in self.contacts for contact in contacts], dtype=int)]
        parts = [
            evaluate(robot, phase.samples.q, phase.samples.v, limbs)
            for phase, limbs in zip(phases, self.limbs, strict=True)
        ]
        M, h, J, Jdot_v = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("M", "h", "J", "Jdot_v")
        )
        self.dynamics = DynamicsBatch(M, h, J, Jdot_v, robot.joint_v)
        self.q = np.concatenate([phase.samples.q for phase in phases])
        self.v = np.concatenate([phase.samples.v for phase in phases])
        self.vd = np.concatenate([phase.samples.vd for phase in phases])
        self.time = np.concatenate([phase.samples.time for phase in phases])
        self.phase: Indices = np.repeat(np.arange(len(phases)), [len(phase.samples.time) for phase in phases])
        damping, rotors = passive(robot)
        self._passive = damping * self.v + rotors * self.vd
        self.load = self.dynamics.load(self.vd) - self._passive
        motors = np.flatnonzero(robot.effort > 0.0)
        self._driven = robot.joint_v[motors]
        self._free = np.setdiff1d(np.arange(self.v.shape[1]), self._driven)
        self._effort = robot.effort[motors]
        self._limited = np.isfinite(self._effort)

    @property
    def num_contacts(self) -> int:
        """Contacts of each phase."""
        return int(self.limbs.shape[1])

    @cached_property
    def turns(self) -> Vector:
        """How fast the feet turn about z by the velocities, shape (P, k, nv)."""
        return np.array([turning(self.robot, limbs) for limbs in self.limbs])

    @cached_property
    def pelvis(self) -> Vector:
        """Velocity of the pelvis by the velocities: of turning, then of its origin, in W; constant, shape (6, nv)."""
        robot, context = self.robot, self.robot.context()
        world, frame = robot.plant.world_frame(), robot.pelvis.body_frame()
        return np.asarray(
            robot.plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world)
        )

    def columns(self, index: Indices) -> Vector:
        """Generalised force of each contact force, and moment about z if any is given, shape (len(index), nv, n)."""
        J = self.dynamics.J[index]
        wrench = np.swapaxes(J, 1, 2)
        if not self.grips.moment.any():
            return wrench
        # A moment that a hold does not give must move nothing, or forces that are otherwise free would seem to need it.
        given = (self.grips.moment > 0.0).reshape(-1, self.num_contacts)[self.phase[index]]
        turns = self.foot_turns[index][:, :, 2] * given[:, :, None]
        return np.concatenate([wrench, np.swapaxes(turns, 1, 2)], axis=2)

    @cached_property
    def instants(self) -> Instants:
        """The samples as equations and inequalities."""
        K, k = len(self.v), self.num_contacts
        columns, load = self.columns(np.arange(K)), self.load + self._passive
        n, dimension = columns.shape[2], self.robot.dimension
        rows, most = self.grips.rows()
        R = rows.shape[1]
        per_phase = np.zeros((len(self.contacts), k, R, n))
        for i in range(k):
            span = slice(i * dimension, (i + 1) * dimension)
            per_phase[:, i, :, span] = rows.reshape(-1, k, R, 3)[:, i, :, :dimension]
        blocks = [per_phase.reshape(-1, k * R, n)[self.phase]]
        right = [most.reshape(-1, k * R)[self.phase]]
        weight = [np.ones(k * R)]
        if n > k * dimension:
            moments, limit = np.eye(n)[k * dimension :], self.grips.moment.reshape(-1, k)[self.phase]
            blocks.append(np.broadcast_to(np.concatenate([moments, -moments]), (K, 2 * k, n)))
            right.append(np.concatenate([limit, limit], axis=1))
            weight.append(np.full(2 * k, 0.1))
        A = columns[:, self._driven[self._limited]]
        c, effort = load[:, self._driven[self._limited]], self._effort[self._limited]
        blocks.append(np.concatenate([-A, A], axis=1))
        right.append(np.concatenate([effort - c, effort + c], axis=1))
        weight.append(np.full(2 * len(effort), 0.1))
        E = columns[:, self._free]
        return Instants(
            E=E,
            b=load[:, self._free],
            G=np.concatenate(blocks, axis=1),
            g=np.concatenate(right, axis=1),
            weight=np.concatenate(weight),
            phase=self.phase,
            inverse=np.asarray(np.linalg.pinv(E)),
        )

    def _on_pelvis(self, wrench: Vector) -> Disturbance:
        """What wrenches on the pelvis, moment and then force in W for each of D numbers, (K, 6, D), take off the load.

        The planar robot's planar joint takes whatever acts across the wall.
        """
        needed = -np.einsum("iv,kid->kvd", self.pelvis[:, self._free], wrench)
        return Disturbance(needed, np.zeros((len(wrench), self.instants.G.shape[1], wrench.shape[2])))

    @cached_property
    def arm(self) -> Vector:
        """From the pelvis's origin to the robot's centre of mass, as far as the pelvis's motion tells, in W, (K, 3).

        The inertia of the whole robot against motions of its pelvis has m [r]x beside the inertia of turning.
        """
        inertia = np.einsum("iv,kvw,jw->kij", self.pelvis, self.dynamics.M, self.pelvis) / self.robot.mass
        in_space = self.robot.dimension == 3
        r = np.stack([inertia[:, 2, 4], -inertia[:, 2, 3], inertia[:, 1, 3] * in_space], axis=1)
        return np.asarray(r)

    @cached_property
    def push(self) -> Disturbance:
        """A push [N] on the pelvis where the robot's centre of mass is."""
        force = np.broadcast_to(np.eye(3)[:, : self.robot.dimension], (len(self.arm), 3, self.robot.dimension))
        return self._on_pelvis(np.concatenate([_crossed(self.arm) @ force, force], axis=1))

    @cached_property
    def center(self) -> Disturbance:
        """A displacement [m] of the robot's centre of mass that is fixed to the pelvis, so that p = m d.

        The pelvis's first moment is off by p and its inertia about its origin is as it was, so it takes the force
        -(wd x p + w x (w x p)) and the moment p x (g - a) of its origin's acceleration a.
        """
        w, wd = self.v @ self.pelvis[:3].T, self.vd @ self.pelvis[:3].T
        a = self.vd @ self.pelvis[3:].T
        turned = _crossed(w)
        force = -(_crossed(wd) + turned @ turned)
        moment = -_crossed(self.robot.gravity - a)
        wrench = self.robot.mass * np.concatenate([moment, force], axis=1)
        return self._on_pelvis(wrench[:, :, : self.robot.dimension])

    @cached_property
    def mass(self) -> Disturbance:
        """All masses greater by a share."""
        c = self.load[:, self._driven[self._limited], None]
        C = np.zeros((len(c), self.instants.G.shape[1], 1))
        C[:, C.shape[1] - 2 * c.shape[1] :] = np.concatenate([-c, c], axis=1)
        return Disturbance(self.load[:, self._free, None], C)

    @cached_property
    def foot_turns(self) -> Vector:
        """How fast the feet turn by the velocities, in W, shape (K, k, 3, nv)."""
        K, nv = self.v.shape
        result = np.zeros((K, self.num_contacts, 3, nv))
        if self.robot.dimension == 2:
            result[:, :, 2] = self.turns[self.phase]
            return result
        plant, context = self.robot.plant, self.robot.context()
        world = plant.world_frame()
        feet = [plant.GetFrameByName(limb.foot) for limb in self.robot.limbs]
        for row, q in enumerate(self.q):
            plant.SetPositions(context, q)
            for i, limb in enumerate(self.limbs[self.phase[row]]):
                result[row, i] = plant.CalcJacobianAngularVelocity(
                    context, JacobianWrtVariable.kV, feet[limb], world, world
                )
        return result

    @cached_property
    def lever(self) -> Lever:
        """What displacements of the contacts change, see `climber.programs.place_margin`.

        With the joints' axes z_a and the foot's velocity J_a by each, dJ_a/dq_b = z_a x J_b for a joint b farther out
        than a, and the other way round; the mass that hangs from a joint moves by p_a likewise.
        """
        K, k, dimension = len(self.v), self.num_contacts, self.robot.dimension
        turning_axes = slice(2, 3) if dimension == 2 else slice(0, 3)
        J = np.zeros((K, k, 3, self.v.shape[1]))
        J[:, :, :dimension] = self.dynamics.J.reshape(K, k, dimension, -1)
        momentum = self.pelvis[3:] @ self.dynamics.M  # [kg m] by the velocities, shape (K, 3, nv)
        gravity = self.robot.gravity
        omega, most, hard = np.zeros((K, k)), np.zeros((K, k)), np.zeros((K, k, dimension))
        hard[:, :, 0] = 1.0
        tight = np.zeros((K, k, self.instants.G.shape[1]))
        motors, rows = self._driven[self._limited], self.instants.G.shape[1] - 2 * int(self._limited.sum())
        for p, limbs in enumerate(self.limbs):
            here = np.flatnonzero(self.phase == p)
            for i, limb in enumerate(limbs):
                v = self.robot.limbs[limb].v
                if len(v) < dimension or not np.isin(v, self._driven).all():
                    continue
                out, along, z = momentum[here][:, :, v], J[here, i][:, :, v], self.foot_turns[here, i][:, :, v]
                inverse = np.linalg.pinv(along[:, :dimension])  # how the joints follow, shape (K, joints, dimension)
                ways, sizes, _ = np.linalg.svd(along[:, :dimension], full_matrices=False)
                hard[here, i] = ways[:, :, -1]
                pull = np.cross(out, gravity, axisa=1, axisc=1)[:, turning_axes]
                omega[here, i] = np.maximum(np.linalg.norm(pull @ inverse, ord=2, axis=(1, 2)), 1e-6)
                joint = np.arange(len(v))
                inner, outer = np.minimum.outer(joint, joint), np.maximum.outer(joint, joint)
                turned = np.cross(z[:, :, inner], along[:, :, outer], axis=1)  # d J / d q, (K, 3, joints, joints)
                weighed = np.einsum("c,kcab->kab", gravity, np.cross(z[:, :, inner], out[:, :, outer], axis=1))
                bent = np.sqrt((turned[:, :dimension] ** 2).sum(axis=(1, 2, 3)))
                follows = np.where(sizes[:, -1] > 1e-6, sizes[:, -1] ** 2 / np.maximum(2.0 * bent, 1e-9), 0.0)
                most[here, i] = np.minimum(follows, self.grips.width.reshape(-1, k)[p, i])
                kappa = np.einsum("kcab,kbd->kacd", turned[:, :dimension], inverse)
                kappa = np.linalg.norm(kappa, ord=2, axis=(2, 3))
                nu = np.linalg.norm(weighed @ inverse, axis=2)
                lost = np.maximum(kappa, nu / omega[here, i, None])
                for a, motor in enumerate(v):
                    for place in np.flatnonzero(motors == motor):
                        tight[here, i, rows + place] = tight[here, i, rows + len(motors) + place] = lost[:, a]
        B = self.pelvis[turning_axes][:, self._free].T
        return Lever(np.broadcast_to(B, (K, *B.shape)), omega, tight, most, hard)


def _crossed(a: Vector) -> Vector:
    """The matrices [a]x of a x b, for vectors of shape (K, 3)."""
    result = np.zeros((len(a), 3, 3))
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    result[:, 1, 0], result[:, 2, 0], result[:, 2, 1] = a[:, 2], -a[:, 1], a[:, 0]
    return result
