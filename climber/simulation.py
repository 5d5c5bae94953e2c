"""What a simulation is of and what came of it: types only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climber.exceptions import ClimberError
from climber.plan_parts import MarginKind
from climber.stance import Vector
from climber.wall import Wall

SLIP_LIMIT = 0.001  # [m]
GREATEST = 1000.0  # [m, N, share] of perturbations: Drake aborts where numbers overflow


def check_scale(name: str, value: float) -> None:
    """Refuses a factor that is none.

    Raises:
        ClimberError: If it is not greater than 0, or so great that nothing could be reckoned with it.
    """
    if not 0.0 < value <= GREATEST:
        raise ClimberError(f"{name}: given {value:g}; allowed: a number greater than 0, at most {GREATEST:g}")


def check_size(name: str, value: float) -> None:
    """Refuses a size that is none.

    Raises:
        ClimberError: If it is less than 0, or so great that nothing could be reckoned with it.
    """
    if not 0.0 <= value <= GREATEST:
        raise ClimberError(f"{name}: given {value:g}; allowed: a number from 0 to {GREATEST:g}")


def check_count(name: str, value: int, least: int) -> None:
    """Refuses a number that is too small, or not whole.

    Raises:
        ClimberError: If it is.
    """
    if value != int(value) or value < least:
        raise ClimberError(f"{name}: given {value}; allowed: a whole number, {least} or greater")


@dataclass(frozen=True)
class Perturbation:
    """How the world differs from the one that was planned for.

    Attributes:
        friction_scale: Friction coefficients of all holds, relative to the plan's.
        mass_scale: Masses and inertias of the robots, relative to their models'.
        hold_error: Holds are displaced at random by up to this much [m].
        start_error: Pelvises start displaced at random by up to this much [m], and turned by up to ten times as many
            radians.
        push: Each robot's pelvis is pushed with this force [N] at the robot's centre of mass, always the same way.
        direction: Which way, in W, shape (3,): of the push, of the displacement of centres of mass or holds, or the
            axis that normals turn about; drawn at random if None.
        seed: Of what is random.
        normal_error: Normals of holds are turned at random by up to this much [rad].
        center_error: Robots' centres of mass are displaced by this much [m], fixed to the pelvises.
        hold: The only hold that is displaced or turned, and by just as much; all are if None, by up to as much unless
            `direction` says which way.
    """

    friction_scale: float = 1.0
    mass_scale: float = 1.0
    hold_error: float = 0.0
    start_error: float = 0.0
    push: float = 0.0
    direction: tuple[float, float, float] | None = None
    seed: int = 0
    normal_error: float = 0.0
    center_error: float = 0.0
    hold: int | None = None

    def __post_init__(self) -> None:
        """Refuses what no world can be like, and Drake might not survive."""
        for name in ("friction_scale", "mass_scale"):
            check_scale(name, getattr(self, name))
        for name in ("hold_error", "start_error", "push", "normal_error", "center_error"):
            check_size(name, getattr(self, name))
        check_count("seed", self.seed, 0)

    @classmethod
    def of(
        cls,
        kind: MarginKind,
        size: float,
        direction: tuple[float, float, float] | None = None,
        seed: int = 0,
        hold: int | None = None,
    ) -> Perturbation:
        """One error, as great as margins measure it.

        Args:
            kind: What is not as planned.
            size: By how much, in the unit of `climber.plan_parts.PhaseMargin`; robots that are lighter than their
                models are so by less than 0.
            direction: As the attribute.
            seed: As the attribute.
            hold: As the attribute.
        """
        name, none, sign = _ERRORS[kind]
        plain = cls(direction=direction, seed=seed, hold=hold)
        return replace(plain, **{name: none + sign * size})  # type: ignore[arg-type]

    @property
    def errors(self) -> dict[MarginKind, float]:
        """The errors that margins are of and that there are, as great as margins measure them."""
        sizes = {kind: sign * (getattr(self, name) - none) for kind, (name, none, sign) in _ERRORS.items()}
        sizes["mass"] = abs(sizes["mass"])
        return {kind: size for kind, size in sizes.items() if size > 0.0}

    def toward(self, rng: np.random.Generator, dimension: int) -> Vector:
        """Which way a robot that moves in as many axes is disturbed, shape (dimension,)."""
        return on_sphere(rng, dimension) if self.direction is None else np.array(self.direction[:dimension])

    def wall(self, wall: Wall, dimension: int) -> Wall:
        """The wall as it really is; holds are off in as many axes as robots move in.

        Raises:
            ClimberError: If there is no such hold as the one that is to be off.
        """
        if self.hold is not None and not 0 <= self.hold < len(wall.holds):
            raise ClimberError(f"hold: given {self.hold}; allowed: 0 to {len(wall.holds) - 1}")
        moves, turns = (np.random.default_rng([self.seed, stream]) for stream in (0, 2))
        holds = []
        for number, hold in enumerate(wall.holds):
            away, turn = self._off(moves, dimension), self._off(turns, dimension - 1)
            place, normal = np.array(hold.position), np.array(hold.normal)
            # Normals turn about axes across them, in the plane about z.
            across = np.array([np.cross(wall.tangents[number], normal), wall.tangents[number]])
            axis = turn @ across[: dimension - 1] if self.direction is None else np.array(self.direction)
            angle = self.normal_error * float(np.linalg.norm(axis))
            if self.hold in (None, number):
                place[:dimension] += self.hold_error * away
                if angle > 0.0:
                    along = np.cross(axis, normal) / np.linalg.norm(axis)
                    normal = np.cos(angle) * normal + np.sin(angle) * along
            friction = self.friction_scale * hold.friction
            position, out = tuple(place.tolist()), tuple(normal.tolist())
            holds.append(replace(hold, position=position, normal=out, friction=friction))
        return replace(wall, holds=tuple(holds))

    def _off(self, rng: np.random.Generator, dimension: int) -> Vector:
        """By how much, and which way, a hold is off, in sizes of the error, shape (dimension,)."""
        if self.direction is not None:
            return np.array(self.direction[:dimension])
        return in_ball(rng, dimension) if self.hold is None else on_sphere(rng, dimension)


# The attribute that says how great the error of a kind of margin is, its value without it, and which way it goes.
_ERRORS: dict[MarginKind, tuple[str, float, float]] = {
    "friction": ("friction_scale", 1.0, -1.0),
    "push": ("push", 0.0, 1.0),
    "mass": ("mass_scale", 1.0, 1.0),
    "center": ("center_error", 0.0, 1.0),
    "place": ("hold_error", 0.0, 1.0),
    "normal": ("normal_error", 0.0, 1.0),
}


def on_sphere(rng: np.random.Generator, dimension: int) -> Vector:
    """A unit vector at random, shape (dimension,)."""
    direction = rng.normal(size=dimension)
    result: Vector = direction / np.linalg.norm(direction)
    return result


def in_ball(rng: np.random.Generator, dimension: int) -> Vector:
    """A point of the unit ball at random, shape (dimension,)."""
    result: Vector = on_sphere(rng, dimension) * rng.uniform() ** (1.0 / dimension)
    return result


@dataclass(frozen=True)
class Track:
    """What a robot did, sampled.

    Attributes:
        time: Since the beginning [s], shape (K,).
        phase: Which phase of the plan it was in, shape (K,).
        q: Positions, shape (K, nq).
        v: Velocities, shape (K, nv).
        torque: Joint torques [N m], shape (K, num_joints).
        force: Contact forces that the controller meant to make, in W [N], shape (K, num_limbs, 3).
    """

    time: Vector
    phase: Vector
    q: Vector
    v: Vector
    torque: Vector
    force: Vector


@dataclass(frozen=True)
class RobotRun:
    """How one robot fared.

    Attributes:
        name: Its name.
        limbs: Names of its limbs, in limb order.
        positions: Names of the columns of the track's q.
        velocities: Names of the columns of its v.
        fell: Why it is said to have fallen, and when; empty if it did not.
        slip: Worst slip of a holding foot [m]: how far its contact point has moved along the hold since it took hold,
            rolling of the foot removed.
        slipped: Which foot that was, on which hold, and when.
        pelvis_error: Worst distance of the pelvis from where it should have been [m].
        joint_error: Worst error of a joint of a limb that holds nothing [rad].
        torque: Greatest torque of each joint by name [N m].
        effort: What each joint's motor can do by name [N m].
        track: What it did.
    """

    name: str
    limbs: tuple[str, ...]
    positions: tuple[str, ...]
    velocities: tuple[str, ...]
    fell: str
    slip: float
    slipped: str
    pelvis_error: float
    joint_error: float
    torque: dict[str, float]
    effort: dict[str, float]
    track: Track


@dataclass(frozen=True)
class Simulation:
    """A plan, simulated once.

    Attributes:
        robots: How each robot fared.
        perturbation: How the world differed from the plan's.
        planned: Duration of the plan [s].
        simulated: Duration of the simulation [s].
        seconds: What it took [s].
        slip_limit: What a holding foot may slip [m].
    """

    robots: tuple[RobotRun, ...]
    perturbation: Perturbation
    planned: float
    simulated: float
    seconds: float
    slip_limit: float = SLIP_LIMIT

    @property
    def fell(self) -> bool:
        """Whether a robot fell."""
        return any(robot.fell for robot in self.robots)

    @property
    def slip(self) -> float:
        """Worst slip of a holding foot [m]."""
        return max(robot.slip for robot in self.robots)

    @property
    def ok(self) -> bool:
        """Nobody fell and no foot slipped beyond the limit."""
        return not self.fell and self.slip <= self.slip_limit

    @property
    def real_time_factor(self) -> float:
        """Seconds simulated in a second."""
        return self.simulated / self.seconds
