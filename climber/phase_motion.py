"""One phase in motion: timed, slowed until forces and torques produce it, and chained to the phases around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from climber.dynamics import evaluate
from climber.manifold import Body
from climber.path import unwound
from climber.programs.torque import TorqueBatch, phase_torques
from climber.robot import Indices
from climber.scenario import Budget
from climber.stance import Contact, Vector
from climber.timing import PEAK, PacedPath, Samples, joined
from climber.verify_motion import drift

FEWEST = 80  # samples of a leg, so that a short one is as finely described as a long one
TELLING = 0.9  # share of the error that `verify` allows between samples


@dataclass(frozen=True)
class MotionBudget:
    """What motion planning may spend on one climb.

    Attributes:
        attempts: Pairs of postures, each from other pieces, tried for one phase before it is given up.
        iterations: Samples that RRT-Connect draws for one pair.
        pace: Share of the joint rate limits that a motion uses when nothing else slows it.
        rate: Samples per second [Hz].
        slowest: A phase is not slowed beyond this duration [s].
    """

    attempts: int = 12
    iterations: int = 100
    pace: float = 0.6
    rate: float = 100.0
    slowest: float = 30.0

    @classmethod
    def of(cls, budget: Budget, multiple: int = 1) -> MotionBudget:
        """What a scenario allows, with so many times the attempts and samples."""
        return cls(
            attempts=multiple * budget.path_attempts,
            iterations=multiple * budget.path_iterations,
            rate=budget.sample_rate_hz,
            slowest=budget.longest_phase_s,
        )


@dataclass(frozen=True)
class PhaseMotion:
    """One phase of a climb in motion.

    Attributes:
        limb: The swinging limb, or None for a shift.
        move: How many moves were complete when it began.
        contacts: The contacts that hold.
        samples: The motion.
        force: Force of each holding contact on the robot in W [N], shape (K, len(contacts), 3).
        torque: Joint torques in the order of `Robot.joint_names` [N m], shape (K, num_joints).
        moment: Moment of each holding contact on the robot about z [N m], shape (K, len(contacts)).
    """

    limb: int | None
    move: int
    contacts: tuple[Contact, ...]
    samples: Samples
    force: Vector
    torque: Vector
    moment: Vector


def timed(
    body: Body, contacts: Sequence[Contact], paced: Sequence[PacedPath], budget: MotionBudget
) -> tuple[Samples, TorqueBatch] | str:
    """A path as fast as the pace allows, or slowed until contact forces and torques produce it.

    Args:
        body: The robot.
        contacts: The contacts that hold.
        paced: The legs of the path.
        budget: How fast, how finely sampled, and how slow at the most.

    Returns:
        The samples with their forces and torques; or, if no slowing helps, why not.
    """
    holding = [contact.limb for contact in contacts]
    slowing, why = 1.0, ""
    while True:
        durations = [max(0.1, slowing * PEAK * path.length / budget.pace) for path in paced]
        if sum(durations) > budget.slowest and slowing > 1.0:
            return f"even slowed to {sum(durations):.0f} s: {why}"
        samples = _sampled(paced, durations, budget.rate)
        dynamics = evaluate(body.robot, samples.q, samples.v, holding)
        torques = phase_torques(body.robot, body.wall, list(contacts), dynamics, samples.vd)
        if torques.ok.all():
            return samples, torques
        why = torques.reason
        slowing *= 1.4


def _sampled(paced: Sequence[PacedPath], durations: Sequence[float], rate: float) -> Samples:
    """The legs one after the other, at `rate` [Hz] or so much finer that the samples tell the motion.

    The pace has more turns than a short phase has samples; between samples that miss them nobody could say how the
    robot moves, nor `verify` that it does so.
    """
    for finer in (1, 2, 4, 8, 16):
        counts = [finer * max(FEWEST, int(np.ceil(d * rate))) + 1 for d in durations]
        pieces = [path.samples(d, count) for path, d, count in zip(paced, durations, counts, strict=True)]
        samples = joined(pieces)
        rates = paced[0].chart.body.robot.rates(samples.q, samples.v, samples.vd)
        if max(float(error.max(initial=0.0)) for error in drift(samples, rates)) <= TELLING:
            break
    return samples


def chained(phases: Sequence[PhaseMotion], angle: Indices) -> list[PhaseMotion]:
    """The phases one after the other in time, the pelvis's angle continuous, and shifts on one stance made one.

    Args:
        phases: The phases, in order; each ends in the posture that the next one starts in.
        angle: Places of the pelvis's angles in the positions.
    """
    result: list[PhaseMotion] = []
    for phase in phases:
        samples = phase.samples
        if result:
            before = result[-1].samples
            q = samples.q.copy()
            q[:, angle] += unwound(q[0], before.q[-1], angle)[angle] - q[0, angle]
            samples = replace(samples, time=samples.time + before.time[-1], q=q)
        result.append(replace(phase, samples=samples))
    return [_merged(list(group)) for _, group in groupby(result, key=lambda phase: (phase.move, phase.limb))]


def _merged(phases: list[PhaseMotion]) -> PhaseMotion:
    """Phases on the same contacts, one after the other, as one; the robot rests where they meet."""
    if len(phases) == 1:
        return phases[0]

    def stacked(parts: list[Vector]) -> Vector:
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])

    samples = [phase.samples for phase in phases]
    merged = Samples(*(stacked([getattr(s, name) for s in samples]) for name in ("time", "q", "v", "vd")))
    force, torque, moment = (stacked([getattr(p, name) for p in phases]) for name in ("force", "torque", "moment"))
    return replace(phases[0], samples=merged, force=force, torque=torque, moment=moment)
