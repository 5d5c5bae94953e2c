"""Random walls: holds scattered like those of a real wall, neither on a grid nor in heaps.

Darts are thrown at the wall one after the other, and one that comes too close to an earlier one is thrown again (random
sequential adsorption). It fills a wall with discs of the spacing's diameter up to 55 % of its area and no further.
All random numbers are drawn from one generator, so a recipe and its seed are the wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from climber.exceptions import ClimberError
from climber.scenario_fields import HoldDefaults, HoldSpec
from climber.stance import Vector

DIGITS = 4  # positions are surveyed to a tenth of a millimetre
NORMAL_DIGITS = 6
FULL = 0.547  # of the area, where random sequential adsorption of discs comes to an end
PATIENCE = 2_000  # volleys of darts without a single hit before the wall counts as full


@dataclass(frozen=True)
class Spread:
    """A normal distribution, clipped.

    Attributes:
        mean: Mean before clipping.
        deviation: Standard deviation before clipping.
        lower: Least value.
        upper: Greatest value.
    """

    mean: float
    deviation: float
    lower: float
    upper: float

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """That many values, shape (count,)."""
        return np.clip(rng.normal(self.mean, self.deviation, count), self.lower, self.upper)


@dataclass(frozen=True)
class Recipe:
    """What a random wall is made by. The defaults are those of scenario 3 of Gönen 2021.

    Attributes:
        holds: Number of holds.
        seed: Of all random numbers.
        density: Holds per area [1/m^2].
        spacing: No two holds are closer than this [m], but in a chimney and on a board, where they are even anyway.
        aspect: Height of the wall over its width.
        friction: Coulomb coefficients.
        slope: Angles of the normals from straight up, counter-clockwise [degrees].
        half_width: Half the width of every patch [m].
        min_force: Least force along each edge of the friction cone [N].
        max_force: Greatest force along each edge of the friction cone [N].
        inclination_deg: 90 is vertical, less is a slab [degrees].
        kind: "plane" is a wall of planar robots; the others, walls in space, are those of `climber.wall_kinds`.
        incut: How far holds are turned into the wall from facing straight against gravity [degrees]; in space only.
        standoff: How far holds stick out of the surface of a wall in space [m].
        angle_deg: Between the two sides of a corner, on its outer side 360 less that [degrees].
        gap: Between the holds on the two sides of a chimney [m].
        problem: How many holds of each row of a board belong to the problem set on it.
    """

    holds: int = 100
    seed: int = 0
    density: float = 35.0
    spacing: float = 0.12
    aspect: float = 1.0
    friction: Spread = Spread(0.6, 0.1, 0.3, 0.9)
    slope: Spread = Spread(0.0, 25.0, -40.0, 40.0)
    half_width: float = 0.01
    min_force: float = 0.5
    max_force: float = 20.0
    inclination_deg: float = 90.0
    kind: str = "plane"
    incut: Spread = Spread(0.0, 0.0, -90.0, 90.0)
    standoff: float = 0.04
    angle_deg: float = 140.0
    gap: float = 0.7
    problem: int = 4

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the wall, both sides of a corner together [m]; a chimney is as wide as its gap."""
        area = self.holds / self.density
        if self.kind == "chimney":
            return self.gap, area / self.gap
        return math.sqrt(area / self.aspect), math.sqrt(area * self.aspect)

    def check(self) -> None:
        """Raises a `ClimberError` that names the first number no wall can be made with."""
        above = {"holds": self.holds, "density": self.density, "aspect": self.aspect, "max_force": self.max_force}
        for name, value in above.items():
            if not 0 < value < math.inf:
                raise ClimberError(f"{name} is {value}; allowed: greater than 0")
        at_least = {"seed": self.seed, "spacing": self.spacing, "half_width": self.half_width}
        at_least |= {"min_force": self.min_force, "friction deviation": self.friction.deviation}
        at_least |= {"incut deviation": self.incut.deviation}
        at_least |= {"slope deviation": self.slope.deviation, "least friction": self.friction.lower}
        for name, value in at_least.items():
            if not 0 <= value < math.inf:
                raise ClimberError(f"{name} is {value}; allowed: 0 or greater")
        if self.min_force > self.max_force:
            raise ClimberError(f"min_force is {self.min_force:g} N; allowed: at most max_force, {self.max_force:g} N")
        for name, spread in (("friction", self.friction), ("slope", self.slope), ("incut", self.incut)):
            if not math.isfinite(spread.mean) or not -math.inf < spread.lower <= spread.upper < math.inf:
                raise ClimberError(
                    f"{name} is clipped to {spread.lower:g} ... {spread.upper:g}; allowed: low, then high"
                )
        if max(-self.slope.lower, self.slope.upper) > 180.0:
            raise ClimberError(f"slopes reach {self.slope.upper:g} degrees; allowed: at most half a turn")
        if not 0.0 < self.inclination_deg < 180.0:
            raise ClimberError(f"inclination is {self.inclination_deg:g} degrees; allowed: between 0 and 180")
        self._check_room()

    def _check_room(self) -> None:
        """Refuses more holds than fit, by the Groemer-Oler bound on points no closer than d in a convex region:

        N <= (2 / sqrt 3) A / d^2 + P / (2 d) + 1     with its area A and perimeter P.
        """  # noqa: D415 - ends with the formula
        width, height = self.size
        if self.spacing == 0.0 or self.kind in ("board", "chimney"):  # these are even anyway
            return
        across, up = width / self.spacing, height / self.spacing
        most = 2.0 / math.sqrt(3.0) * across * up + across + up + 1.0
        if self.holds > most:
            raise ClimberError(
                f"{self.holds} holds of density {self.density:g} per m^2 cannot be {self.spacing:g} m apart: at most "
                f"{int(most)} fit on {width:.3g} m x {height:.3g} m; take a smaller density or spacing"
            )


def scatter(rng: np.random.Generator, recipe: Recipe) -> Vector:
    """Places holds on the wall, whose lower edge is from (0, 0) to (width, 0).

    Returns:
        Positions [m] to `DIGITS` decimals, the lowest first, shape (holds, 2).

    Raises:
        ClimberError: If they do not fit.
    """
    return throw(rng, recipe.holds, recipe.size, recipe.spacing)


def throw(rng: np.random.Generator, count: int, size: tuple[float, float], spacing: float) -> Vector:
    """Places points in a rectangle, whose lower edge is from (0, 0) to (width, 0).

    Darts come in volleys; of those too close to one another the earliest stays, as if they had come one by one.

    Args:
        rng: Source of random numbers.
        count: Number of points.
        size: Width and height of the rectangle [m].
        spacing: No two points are closer than this [m].

    Returns:
        Positions [m] to `DIGITS` decimals, the lowest first, shape (count, 2).

    Raises:
        ClimberError: If they do not fit.
    """
    points = np.zeros((0, 2))
    missed = 0
    while len(points) < count:
        darts = np.round(rng.uniform(0.0, size, (max(256, count), 2)), DIGITS)
        if len(points):
            darts = darts[cKDTree(points).query(darts)[0] >= spacing]
        alone = np.ones(len(darts), dtype=bool)
        if len(darts):
            close = cKDTree(darts).query_pairs(spacing, output_type="ndarray")
            apart = np.linalg.norm(darts[close[:, 0]] - darts[close[:, 1]], axis=1)
            close = np.sort(close[apart < max(spacing, 10.0**-DIGITS)], axis=1)
            for first, second in close[np.lexsort(close.T[::-1])].tolist():
                if alone[first]:
                    alone[second] = False
        missed = 0 if alone.any() else missed + 1
        if missed > PATIENCE:
            covered = len(points) * math.pi * spacing**2 / 4.0 / float(np.prod(size))
            raise ClimberError(
                f"only {len(points)} of {count} holds found a place {spacing:g} m from all others, which fills "
                f"{100 * covered:.0f} % of the wall; large random walls are full at {100 * FULL:.0f} %: "
                f"take a smaller density or spacing"
            )
        points = np.concatenate([points, darts[alone]])[:count]
    return points[np.lexsort(points.T)]


def plane_holds(recipe: Recipe) -> list[HoldSpec]:
    """The holds of a wall of planar robots, in few digits, as a scenario file has them.

    Raises:
        ClimberError: If they do not fit.
    """
    rng = np.random.default_rng(recipe.seed)
    points = scatter(rng, recipe)
    slope = np.radians(recipe.slope.draw(rng, recipe.holds))
    friction = np.round(recipe.friction.draw(rng, recipe.holds), 3)
    normals = np.round(np.stack([-np.sin(slope), np.cos(slope)], axis=1), NORMAL_DIGITS)
    return [
        HoldSpec(position=p, normal=n, friction=f)
        for p, n, f in zip(points.tolist(), normals.tolist(), friction.tolist(), strict=True)
    ]


def hold_defaults(recipe: Recipe) -> HoldDefaults:
    """What the holds of a recipe's wall have in common."""
    return HoldDefaults(half_width=recipe.half_width, min_force=recipe.min_force, max_force=recipe.max_force)
