"""One phase in motion: timed, with the forces and torques that produce it, and chained to the phases around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Protocol

import numpy as np

from climber.active import active_intervals
from climber.dynamics import evaluate
from climber.fastest import MARGIN, SHORTEST, FastLeg, RateLimits, failure, fastest_leg, foot_load, instants_of
from climber.manifold import Body
from climber.path import unwound
from climber.plan_parts import PhaseTiming
from climber.programs.safest import safest_forces
from climber.programs.torque import TorqueBatch, phase_torques
from climber.robot import Indices, Robot
from climber.scenario import Budget
from climber.stance import Contact, Vector
from climber.timing import PEAK, PacedPath, Samples, joined
from climber.verify_motion import drift

PACE = 0.6  # share of the joint rate limits that a motion of fixed shape uses at the most
SLOWING = 1.05  # what a leg is slowed by when forces at its samples leave their limits
FEWEST = 80  # samples of a leg, so that a short one is as finely described as a long one
FINER = (1, 2, 4, 8, 16)  # times as many samples, where so many do not tell the motion
TELLING = 0.9  # share of the error that `verify` allows between samples


@dataclass(frozen=True)
class MotionBudget:
    """What motion planning may spend on one climb.

    Attributes:
        attempts: Pairs of postures, each from other pieces, tried for one phase before it is given up.
        iterations: Samples that RRT-Connect draws for one pair.
        pace: Share of the joints' speed limits that a motion uses at the most, see `RateLimits.of`.
        rate: Samples per second [Hz].
        slowest: A phase is not slowed beyond this duration [s].
        jerk: Greatest jerk of joints [rad/s^3], at full pace.
    """

    attempts: int = 12
    iterations: int = 100
    pace: float = 0.9
    rate: float = 100.0
    slowest: float = 30.0
    jerk: float = 1000.0

    @classmethod
    def of(cls, budget: Budget, multiple: int = 1) -> MotionBudget:
        """What a scenario allows, with so many times the attempts and samples."""
        return cls(
            attempts=multiple * budget.path_attempts,
            iterations=multiple * budget.path_iterations,
            rate=budget.sample_rate_hz,
            slowest=budget.longest_phase_s,
            jerk=budget.jerk_limit,
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
        timing: How the motion was timed; its times count from the begin of the phase.
    """

    limb: int | None
    move: int
    contacts: tuple[Contact, ...]
    samples: Samples
    force: Vector
    torque: Vector
    moment: Vector
    timing: PhaseTiming = field(default_factory=PhaseTiming)


def timed(
    body: Body, contacts: Sequence[Contact], paced: Sequence[PacedPath], budget: MotionBudget
) -> tuple[Samples, TorqueBatch, PhaseTiming] | str:
    """A path as fast as holds, motors and joints allow, leg by leg, each from rest to rest.

    Args:
        body: The robot.
        contacts: The contacts that hold.
        paced: The legs of the path.
        budget: How fast, how finely sampled, and how slow at the most.

    Returns:
        The samples with their forces and torques, and how they came about; or, if there is no timing, why not.
    """
    limits = RateLimits.of(body.robot, budget.pace, budget.jerk, [contact.limb for contact in contacts])
    for finer in FINER:
        legs: list[_TimedLeg] = []
        for path in paced:
            leg = _timed_leg(body, contacts, path, limits, budget, finer)
            if leg is None:
                return by_fixed_law(body, contacts, paced, budget)
            if isinstance(leg, str):
                return leg
            legs.append(leg)
        samples, timing = joined([leg.samples for leg in legs]), legs[0].timing
        # Where legs meet there is a kink that neither of them has by itself.
        if len(legs) == 1 or _told(body.robot, samples):
            break
    if samples.time[-1] > budget.slowest:
        return f"the motion takes {samples.time[-1]:.0f} s at its fastest"
    began = np.cumsum([leg.samples.time[-1] for leg in legs])
    for begin, leg in zip(began, legs[1:], strict=False):
        timing = timing.followed(float(begin), leg.timing)
    force, torque, moment = (
        _stacked([getattr(leg.forces, name) for leg in legs]) for name in ("force", "torque", "moment")
    )
    none = np.zeros(len(samples.time))
    return samples, TorqueBatch(force, torque, none, none.astype(int), moment), timing


@dataclass(frozen=True)
class _TimedLeg:
    """A leg, the forces and torques that make it, and how it was timed, from its begin."""

    samples: Samples
    forces: TorqueBatch
    timing: PhaseTiming


def _timed_leg(
    body: Body,
    contacts: Sequence[Contact],
    path: PacedPath,
    limits: RateLimits,
    budget: MotionBudget,
    finer: int,
) -> _TimedLeg | str | None:
    """A leg as fast as can be; why it has no timing; or None where there is no room that a timing could be found in.

    Where its samples show more than the places that the program looked at, it is asked to look at more of them, and if
    that does not help, the leg is slowed.
    """
    leg = fastest_leg(body, contacts, path, limits)
    if isinstance(leg, FastLeg):
        (samples,) = _sampled(body.robot, [leg], [leg.duration], budget.rate, finer)
        if limits.slowing(samples) > 1.0:
            leg = fastest_leg(body, contacts, path, limits, finer=2)
    if not isinstance(leg, FastLeg):
        return leg
    why = "limits of speed, acceleration and jerk"
    while leg.duration <= budget.slowest:
        (samples,) = _sampled(body.robot, [leg], [leg.duration], budget.rate, finer)
        slowing = limits.slowing(samples)
        if slowing == 1.0:
            dynamics = evaluate(body.robot, samples.q, samples.v, [contact.limb for contact in contacts])
            instants = instants_of(body, contacts, dynamics.load(samples.vd), dynamics.J)
            t, good = safest_forces(instants, leg.forces(len(samples.time)), foot_load(body, contacts))
            if good.all():
                active = active_intervals(body, contacts, leg, limits, samples, instants, t)
                none = np.zeros(len(t))
                forces = TorqueBatch(instants.force(t), instants.torque(t), none, none.astype(int), instants.moment(t))
                return _TimedLeg(samples, forces, PhaseTiming("conic", limits.by_name(body.robot), active))
            lacking = failure(body, contacts, instants[~good])
            if lacking is None:
                return None
            why, slowing = lacking[1], SLOWING
        leg = leg.slowed(1.001 * slowing)
    return f"the motion takes {leg.duration:.0f} s at its fastest: {why}"


def by_fixed_law(
    body: Body, contacts: Sequence[Contact], paced: Sequence[PacedPath], budget: MotionBudget
) -> tuple[Samples, TorqueBatch, PhaseTiming] | str:
    """The path by one law of fixed shape, slowed until forces and torques produce it.

    For paths that the robot can just be held on, with no room inside the limits that a conic program could work in.
    """
    holding = [contact.limb for contact in contacts]
    slowing, why = 1.0, ""
    while True:
        durations = [max(SHORTEST, slowing * PEAK * path.length / min(PACE, budget.pace)) for path in paced]
        if sum(durations) > budget.slowest and slowing > 1.0:
            return f"even slowed to {sum(durations):.0f} s: {why}"
        samples = joined(_sampled(body.robot, paced, durations, budget.rate))
        dynamics = evaluate(body.robot, samples.q, samples.v, holding)
        torques = phase_torques(body.robot, body.wall, list(contacts), dynamics, samples.vd, MARGIN)
        if torques.ok.all():
            return samples, torques, PhaseTiming()
        why = torques.reason
        slowing *= 1.4


class _Leg(Protocol):
    def samples(self, duration: float, count: int) -> Samples: ...


def _sampled(
    robot: Robot, legs: Sequence[_Leg], durations: Sequence[float], rate: float, least: int = 1
) -> list[Samples]:
    """The legs at `rate` [Hz] or `least` times as finely, or finer, so that the samples tell the motion.

    The pace has more turns than a short phase has samples; between samples that miss them nobody could say how the
    robot moves, nor `verify` that it does so.
    """
    for finer in FINER[FINER.index(least) :]:
        counts = [finer * max(FEWEST, int(np.ceil(d * rate))) + 1 for d in durations]
        pieces = [leg.samples(d, count) for leg, d, count in zip(legs, durations, counts, strict=True)]
        if _told(robot, joined(pieces)):
            break
    return pieces


def _told(robot: Robot, samples: Samples) -> bool:
    """Whether samples tell the motion: rates are those that their differences lead to."""
    rates = robot.rates(samples.q, samples.v, samples.vd)
    return max(float(error.max(initial=0.0)) for error in drift(samples, rates)) <= TELLING


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
    samples = [phase.samples for phase in phases]
    merged = Samples(*(_stacked([getattr(s, name) for s in samples]) for name in ("time", "q", "v", "vd")))
    force, torque, moment = (_stacked([getattr(p, name) for p in phases]) for name in ("force", "torque", "moment"))
    timing = phases[0].timing
    for before, after in zip(samples, phases[1:], strict=False):
        timing = timing.followed(float(before.time[-1] - samples[0].time[0]), after.timing)
    return replace(phases[0], samples=merged, force=force, torque=torque, moment=moment, timing=timing)


def _stacked(parts: Sequence[Vector]) -> Vector:
    """Series of which each begins where the one before it ends, as one."""
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])
