"""Which limits keep a motion from being faster, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climber.fastest import FastLeg, RateLimits, force_names, force_room
from climber.manifold import Body
from climber.programs.instants import Instants, Mask
from climber.stance import Contact, Vector
from climber.timing import Samples
from climber.wall import GRAVITY

# A limit is told only where the samples show it: `verify` looks for the same, a little less strictly.
USED = 0.8  # share of a limit of rates or torques that is in use
NEAR = 0.08  # of the robot's weight, the farthest that a contact force is from a limit


def active_intervals(
    body: Body,
    contacts: Sequence[Contact],
    leg: FastLeg,
    limits: RateLimits,
    samples: Samples,
    instants: Instants,
    t: Vector,
) -> tuple[tuple[float, float, str], ...]:
    """Intervals of time [s] and the limit that the program found active there, in order of time.

    Args:
        body: The robot.
        contacts: The contacts that hold.
        leg: The leg.
        limits: Those on its rates.
        samples: The motion.
        instants: Its equations of motion.
        t: The forces that make it, shape (K, n).
    """
    time, found = samples.time, []
    active = _active(leg, time)
    for name in sorted(frozenset().union(*active)):
        there = np.array([name in names for names in active])
        there &= _in_use(name, body, contacts, limits, samples, instants, t)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
        found += [(float(time[a]), float(time[b - 1]), name) for a, b in edges.reshape(-1, 2) if b - a > 1]
    return tuple(sorted(found))


def _active(leg: FastLeg, time: Vector) -> list[frozenset[str]]:
    """What the program found active nearest to each instant, shape (K,)."""
    own = leg.scaling.active
    # What is active at one place and at the next but one is so in between, whatever the solver's last digit says.
    around = [frozenset().union(*own[max(0, i - 1) : i + 2]) for i in range(len(own))]
    x, _, _ = leg.law.at(time)
    return [around[i] for i in np.abs(leg.x - x[:, None]).argmin(axis=1)]


def _in_use(
    name: str,
    body: Body,
    contacts: Sequence[Contact],
    limits: RateLimits,
    samples: Samples,
    instants: Instants,
    t: Vector,
) -> Mask:
    """At which samples a limit is in use, shape (K,)."""
    kind, _, of = name.rpartition(" ")
    if kind in ("speed", "acceleration", "jerk"):
        column = body.robot.velocity_names.index(of)
        change = np.abs(np.diff(samples.vd[:, column])) / np.diff(samples.time)
        values = {
            "speed": np.abs(samples.v[:, column]),
            "acceleration": np.abs(samples.vd[:, column]),
            "jerk": np.minimum(np.append(change, change[-1]), np.append(change[0], change)),
        }[kind]
        return np.asarray(values >= USED * getattr(limits, kind)[column])
    if kind == "torque":
        place = body.robot.joint_names.index(of)
        return np.asarray(np.abs(instants.torque(t)[:, place]) >= USED * body.robot.effort[place])
    mine = [i for i, called in enumerate(force_names(body, contacts, instants)) if called == name]
    room = force_room(instants, t)[:, mine].min(axis=1)
    return np.asarray(room <= NEAR * GRAVITY * body.robot.mass)
