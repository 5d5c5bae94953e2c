"""Small problems with known answers, shared by the tests."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climber.stance import Contact, Stance, Vector
from climber.wall import GRAVITY, GRIPS, Hold, Wall

WALLS = Path(__file__).parents[1] / "benchmarks" / "walls"
MASS_OF_20_N = 20.0 / GRAVITY  # [kg] weighs 20 N, so that the answers below are round


def hold(x: float, y: float, slope_deg: float = 0.0, **kwargs: object) -> Hold:
    """A hold whose normal leans `slope_deg` from straight up towards -x."""
    a = math.radians(slope_deg)
    defaults: dict[str, object] = {"friction": 0.6, "min_force": 0.0, "max_force": 20.0}
    return Hold((x, y, 0.0), (-math.sin(a), math.cos(a), 0.0), **(defaults | kwargs))  # type: ignore[arg-type]


@dataclass(frozen=True)
class EquilibriumProblem:
    """Feet on holds, a robot of 20 N, and where its centre of mass may be, worked out by hand.

    Attributes:
        name: What the case shows.
        holds: The holds, all stood on.
        interval: The abscissas of the centre of mass [m], or None.
        direction: When None, the direction in which the contacts fail.
        shortfall: When None, by how much [N].
        offsets: Where on their patches the feet stand [m]; the middle by default.
    """

    name: str
    holds: tuple[Hold, ...]
    interval: tuple[float, float] | None
    direction: tuple[float, float] | None = None
    shortfall: float = 0.0
    offsets: tuple[float, ...] = ()

    @property
    def wall(self) -> Wall:
        """The wall of just these holds."""
        return Wall(self.holds)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """One foot on each hold."""
        offsets = self.offsets or (0.0,) * len(self.holds)
        return tuple(Contact(i, i, offset) for i, offset in enumerate(offsets))


R2 = math.sqrt(0.5)
EQUILIBRIUM_PROBLEMS = (
    EquilibriumProblem("a foot on a flat hold stands under the centre of mass", (hold(0.3, 0.1),), (0.3, 0.3)),
    EquilibriumProblem("an offset foot moves it", (hold(0.3, 0.1),), (0.29, 0.29), offsets=(-0.01,)),
    # Frictionless flat holds a metre apart: N1 + N2 = 20 and x = N2 / 20, each N the sum of two equal edge forces.
    EquilibriumProblem(
        "forces from zero reach over the holds", (hold(0, 0, friction=0), hold(1, 0, friction=0)), (0, 1)
    ),
    EquilibriumProblem(
        "a least force of 4 N on each hold takes a fifth off each side",
        (hold(0, 0, friction=0, min_force=2), hold(1, 0.2, friction=0, min_force=2)),
        (0.2, 0.8),
    ),
    EquilibriumProblem(
        "a greatest force of 12 N on each hold takes two fifths off each side",
        (hold(0, 0, friction=0, max_force=6), hold(1, 0.2, friction=0, max_force=6)),
        (0.4, 0.6),
    ),
    EquilibriumProblem(
        "two holds of at most 8 N do not carry 20 N",
        (hold(0, 0, friction=0, max_force=4), hold(1, 0.2, friction=0, max_force=4)),
        None,
        (0.0, 1.0),
        4.0,
    ),
    EquilibriumProblem(
        "forces that must press 12 N on each hold do not stay down to 20 N",
        (hold(0, 0, friction=0, min_force=6), hold(1, 0.2, friction=0, min_force=6)),
        None,
        (0.0, -1.0),
        4.0,
    ),
    # The load (0, 20) is nearest to the upper edge (1, 1)/sqrt(2) of the cone of a vertical face with friction 1.
    EquilibriumProblem("one vertical face", (hold(0, 0, -90, friction=1),), None, (-R2, R2), 20 * R2),
    # N on both faces, T1 + T2 = 20, x = T2 / 20; T2 <= N and (N + T2)/sqrt(2) <= 20 give T2 <= 10 sqrt(2).
    EquilibriumProblem(
        "a chimney of two vertical faces", (hold(0, 0, -90, friction=1), hold(1, 0, 90, friction=1)), (1 - R2, R2)
    ),
    EquilibriumProblem("a pin carries what hangs below it", (hold(0.2, 0, grip="pin"),), (0.2, 0.2)),
    EquilibriumProblem("a weak pin does not", (hold(0.2, 0, grip="pin", max_force=15),), None, (0.0, 1.0), 5.0),
    # A couple of 20 N over 0.5 m holds 20 N half a metre to either side.
    EquilibriumProblem("two pins pull", (hold(0, 0, grip="pin"), hold(0, 0.5, grip="pin")), (-0.5, 0.5)),
    # Pressed on with 25 N, a vertical face with friction 1 holds up to 25 N.
    EquilibriumProblem(
        "a magnet holds on a vertical face",
        (hold(0.1, 0, -90, friction=1, max_force=40, grip="magnet", adhesion=25),),
        (0.1, 0.1),
    ),
    # Pressed on with 15 N the forces are (-15, 0) + cone; (0, 20) is 5 N above, and 5/sqrt(2) from the edge.
    EquilibriumProblem(
        "a weaker magnet slips",
        (hold(0.1, 0, -90, friction=1, max_force=40, grip="magnet", adhesion=15),),
        None,
        (-R2, R2),
        5 * R2,
    ),
    # Same direction of all generators along the load: a zonogon that is a segment.
    EquilibriumProblem("a hold that is wide of no force", (hold(0, 0, max_force=0), hold(1, 0, friction=0)), (1, 1)),
    EquilibriumProblem("holds without force", (hold(0, 0, max_force=0),), None, (0.0, 1.0), 20.0),
)


def random_wall(rng: np.random.Generator, num_holds: int, grips: tuple[str, ...] = GRIPS, size: float = 0.6) -> Wall:
    """Holds of all sorts anywhere on a square of side `size` [m], leaning any way but mostly up."""
    return Wall(
        tuple(
            hold(
                *rng.uniform(0.0, size, 2),
                rng.normal(0.0, 60.0),
                friction=max(0.0, rng.normal(0.6, 0.3)),
                min_force=rng.choice([0.0, 2.0]),
                max_force=rng.uniform(5.0, 30.0),
                grip=str(rng.choice(grips)),
                adhesion=rng.uniform(0.0, 20.0),
            )
            for _ in range(num_holds)
        )
    )


@dataclass(frozen=True)
class DiskRobot:
    """What the stance graph asks of a robot, and no more.

    Attributes:
        reach: Reach of each limb from the pelvis's origin [m], shape (n,).
        symmetries: Limb permutations that leave the robot the same.
        mass: Total mass [kg].
        dimension: 2 in the wall plane, 3 in space.
    """

    reach: Vector
    symmetries: tuple[tuple[int, ...], ...]
    mass: float = 2.0
    dimension: int = 2

    @classmethod
    def with_limbs(cls, num_limbs: int, reach: float = 0.25, fold: int = 1) -> DiskRobot:
        """Limbs of one reach; the robot looks the same `fold` times in a full turn."""
        step = num_limbs // fold
        turns = tuple(tuple((i + s) % num_limbs for i in range(num_limbs)) for s in range(0, num_limbs, step))
        return cls(np.full(num_limbs, reach), turns)


QUADRUPED = DiskRobot.with_limbs(4, fold=2)


def thesis_wall(name: str) -> tuple[Wall, Stance, tuple[int, ...]]:
    """Wall W1, W2 or W3 with its start stance and its goal holds."""
    data = json.loads((WALLS / f"{name}.json").read_text())
    holds = tuple(
        Hold((h["x"], h["y"], 0.0), (*h["normal"], 0.0), h["mu"], 0.01, min_force=2.0, max_force=20.0)
        for h in data["holds"]
    )
    return Wall(holds), Stance(tuple(data["start"])), tuple(data["goal"])
