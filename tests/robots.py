"""Robot models for the tests, and walls that fit them: unlike each other in limbs, joints, axes and frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from climber.kinematics import Kinematics
from climber.manifold import Body, Manifold, Margins
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.transition import PostureSampler, support_of
from climber.wall import Hold, Wall

FOLDER = Path(__file__).parent / "models"
MODELS = {
    "quadruped": "package://climber/quadruped/quadruped.urdf",
    "three_limbed": str(FOLDER / "three_limbed.urdf"),
    "long_limbed": str(FOLDER / "long_limbed.urdf"),
}
every_model = pytest.mark.parametrize("model", MODELS)
# Every limb has inverse kinematics; the last of them climbs in space.
STARS = MODELS | {"lemur": "package://climber/lemur/lemur.urdf"}
every_star = pytest.mark.parametrize("model", STARS)
# Limbs of one joint, and of none: kinematics like any other, but no inverse kinematics.
EVERYTHING = STARS | {"double_link": "package://climber/double_link/double_link.urdf"}
every_robot = pytest.mark.parametrize("model", EVERYTHING)


@cache
def robot(model: str) -> Robot:
    """The robot of one of `EVERYTHING`."""
    return Robot(EVERYTHING[model])


@cache
def body(model: str) -> Body:
    """The robot on a wall without holds or obstacles."""
    return Body(robot(model), Wall(()))


@cache
def kinematics(model: str) -> Kinematics:
    """The kinematics of one of `EVERYTHING`."""
    return body(model).kinematics


def configurations(model: str, rng: np.random.Generator, count: int) -> Vector:
    """Configurations anywhere within a metre, joints within their limits, shape (count, nq)."""
    machine = robot(model)
    q = np.zeros((count, machine.plant.num_positions()))
    q[:, machine.origin_q] = rng.uniform(-1, 1, (count, machine.dimension))
    # The attitude of a robot in space is singular where its second angle is a right angle.
    most = [np.pi, 1.4, np.pi][: len(machine.angle_q)]
    q[:, machine.angle_q] = rng.uniform(np.negative(most), most, (count, len(most)))
    for limb in machine.limbs:
        lower, upper = limb.one_turn
        q[:, limb.q] = rng.uniform(lower, upper, (count, len(limb.q)))
    return q


@cache
def _clear_joints(model: str) -> Vector:
    """A hundred configurations that are clear, shape (100, nq)."""
    rng, machine, ours = np.random.default_rng(0), robot(model), kinematics(model)
    found = np.zeros((0, machine.plant.num_positions()))
    for _ in range(400):
        q = configurations(model, rng, 2000)
        q = q[ours.within_limits(q) > 0.1]
        for limb, inverse, chain in zip(machine.limbs, body(model).inverse, ours.chains, strict=True):
            assert inverse is not None
            pelvis = ours.pelvis(q[:, machine.base_q])
            links = chain.links(pelvis, q[:, limb.q])
            carrier = links[inverse.leading - 1] if inverse.leading else pelvis
            q = q[inverse.room(carrier, chain.foot_position(pelvis, links), 0).min(axis=1) > 0.01]
        found = np.concatenate([found, q[body(model).clearance(ours.poses(q)) > 0.005]])
        if len(found) >= 100:
            return found[:100]
    raise AssertionError(f"{model} is hardly ever clear of itself")


def clear_configurations(model: str, rng: np.random.Generator, count: int) -> Vector:
    """Configurations in which no link is within 5 mm of another, and no limb nearly straight or at a limit."""
    q = configurations(model, rng, count)
    joints = kinematics(model).joint_q
    q[:, joints] = _clear_joints(model)[rng.integers(100, size=count)][:, joints]
    if not robot(model).planar:  # along the wall, as climbers are
        q[:, robot(model).angle_q[1:]] *= 0.1
    return q


@dataclass(frozen=True)
class Standing:
    """A robot on pins, one under each foot of a configuration.

    Attributes:
        body: The robot on that wall.
        contacts: The contacts of the limbs that hold.
        q: The configuration, shape (nq,).
        manifold: All configurations on the contacts.
    """

    body: Body
    contacts: tuple[Contact, ...]
    q: Vector
    manifold: Manifold

    def postures(self, rng: np.random.Generator, count: int) -> Vector:
        """Feasible configurations on the contacts, about the first `count` found, shape (M, nq)."""
        sampler = PostureSampler(self.body, self.manifold)
        q = np.concatenate([sampler.draw(rng, 2000)[0] for _ in range(5)])
        return q[:count]


def standing(model: str, seed: int, air: tuple[int, ...] = (), margins: Margins | None = None) -> Standing:
    """The robot in a random clear configuration with its feet on pins, but for the limbs in the air."""
    rng = np.random.default_rng(seed)
    machine = robot(model)
    for _ in range(200):
        (q,) = clear_configurations(model, rng, 1)
        feet = kinematics(model).feet(q[None])[0]
        holds = tuple(Hold(tuple(foot), (0.0, 1.0, 0.0), 0.6, max_force=200.0, grip="pin") for foot in feet)
        here = Body(machine, Wall(holds))
        contacts = tuple(Contact(i, i) for i in range(len(feet)) if i not in air)
        support = support_of(here, contacts)
        if support is None:
            continue
        manifold = Manifold(here, contacts, support, margins)
        if manifold.slack(q[None])[0] > 0:
            return Standing(here, contacts, q, manifold)
    raise AssertionError(f"{model} hardly ever stands")
