"""Walls in space by kind: the pieces of their surface, and holds that stick out of them, from a recipe and its seed.

Holds of a single piece lie in W's x-y plane, and its surface behind it; the holds of a corner lie in two planes that
meet in the y axis, those of a chimney in the planes x = 0 and x = gap. A hold is a ledge that faces straight against
gravity, then turned about the surface's normal by the recipe's slope and into the wall by its incut; in a chimney it is
a pad on the surface that only bears what presses outward.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from climber.exceptions import ClimberError
from climber.random_wall import DIGITS, NORMAL_DIGITS, Recipe, Spread, hold_defaults, plane_holds, throw
from climber.scenario_fields import HoldSpec
from climber.scenario_shapes import FacetSpec
from climber.stance import Vector
from climber.wall import Wall

BORDER = 0.4  # the surface goes on beyond the outermost holds by so much [m]
COLUMNS, ROWS, PITCH = 11, 18, 0.2  # of a board; the pitch in metres
UNEVEN = 0.3  # by which rungs of a chimney are off, in parts of their distance
CHIMNEY_DEPTH = 0.12  # of the strips that a chimney's holds are on, along z [m]

SPACE = Recipe(
    density=12.0,
    spacing=0.14,
    aspect=1.5,
    friction=Spread(0.8, 0.1, 0.5, 1.1),
    slope=Spread(0.0, 15.0, -30.0, 30.0),
    min_force=0.0,
    max_force=100.0,
    incut=Spread(0.0, 5.0, -10.0, 10.0),
)
# What each kind of wall is made by, unless told otherwise. Their robot weighs 7 kg and spans 1 m.
KINDS: dict[str, Recipe] = {
    "plane": Recipe(),
    "slab": replace(SPACE, kind="slab", inclination_deg=60.0),
    "vertical": replace(SPACE, kind="vertical", incut=Spread(5.0, 5.0, -5.0, 15.0)),
    "overhang": replace(
        SPACE,
        kind="overhang",
        inclination_deg=110.0,
        friction=Spread(1.0, 0.05, 0.9, 1.1),
        incut=Spread(8.0, 4.0, 0.0, 16.0),
    ),
    "inside_corner": replace(SPACE, kind="inside_corner", angle_deg=140.0, incut=Spread(5.0, 5.0, -5.0, 15.0)),
    "outside_corner": replace(SPACE, kind="outside_corner", angle_deg=150.0, incut=Spread(5.0, 5.0, -5.0, 15.0)),
    "chimney": replace(
        SPACE,
        kind="chimney",
        density=22.0,
        gap=0.6,
        friction=Spread(1.2, 0.1, 1.0, 1.4),
        slope=Spread(0.0, 5.0, -10.0, 10.0),
    ),
    "board": replace(
        SPACE,
        kind="board",
        holds=COLUMNS * ROWS,
        density=1.0 / PITCH**2,
        spacing=PITCH,
        aspect=ROWS / COLUMNS,
        inclination_deg=130.0,
        incut=Spread(20.0, 8.0, 5.0, 35.0),
    ),
}


@dataclass(frozen=True)
class Panel:
    """A flat piece of a wall: the rectangle that its holds are on.

    Attributes:
        origin: Its lower left corner as seen from outside, in W [m], shape (3,).
        right: Unit vector to the right in W, shape (3,).
        up: Unit vector up, shape (3,).
        size: Width and height [m].
        borders: By how much the surface goes on beyond the left and the right edge [m].
    """

    origin: Vector
    right: Vector
    up: Vector
    size: tuple[float, float]
    borders: tuple[float, float] = (BORDER, BORDER)

    @property
    def out(self) -> Vector:
        """Unit outward normal in W, shape (3,)."""
        result: Vector = np.cross(self.right, self.up)
        return result

    def points(self, across: Vector) -> Vector:
        """Points (n, 2) to the right and up of its corner [m], in W, shape (n, 3)."""
        result: Vector = self.origin + across @ np.stack([self.right, self.up])
        return result

    def facet(self, standoff: float) -> FacetSpec:
        """The surface, `standoff` [m] behind the holds."""
        width, height = self.size
        left, right = self.borders
        corners = np.array([[-left, -BORDER], [width + right, -BORDER], [width + right, height + BORDER]])
        corners = np.vstack([corners, [[-left, height + BORDER]]])
        return FacetSpec(np.round(self.points(corners) - standoff * self.out, NORMAL_DIGITS).tolist())


def _plane(recipe: Recipe) -> list[Panel]:
    return [Panel(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), recipe.size)]


def _corner(recipe: Recipe) -> list[Panel]:
    """Two panels to the left and to the right of the y axis, which face each other inside and not outside."""
    turned = np.radians((180.0 - recipe.angle_deg) / 2) * (1.0 if recipe.kind == "inside_corner" else -1.0)
    c, s = np.cos(turned), np.sin(turned)
    width, height = recipe.size
    half, up = width / 2, np.array([0.0, 1.0, 0.0])
    inward = recipe.standoff * np.tan(turned)  # the surfaces meet straight behind the edge of the holds' planes
    left, right = np.array([c, 0.0, -s]), np.array([c, 0.0, s])
    return [
        Panel(-half * left, left, up, (half, height), (BORDER, inward)),
        Panel(np.zeros(3), right, up, (half, height), (inward, BORDER)),
    ]


def _chimney(recipe: Recipe) -> list[Panel]:
    """Two strips that face each other. The surfaces go on in front of and behind them."""
    deep, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    corner = np.array([0.0, 0.0, CHIMNEY_DEPTH / 2])
    size = CHIMNEY_DEPTH, recipe.size[1]
    return [Panel(corner, -deep, up, size), Panel(np.array([recipe.gap, 0.0, 0.0]) - corner, deep, up, size)]


PANELS: dict[str, Callable[[Recipe], list[Panel]]] = {
    "slab": _plane,
    "vertical": _plane,
    "overhang": _plane,
    "inside_corner": _corner,
    "outside_corner": _corner,
    "chimney": _chimney,
    "board": _plane,
}


def panels(recipe: Recipe) -> list[Panel]:
    """The pieces of a wall in space."""
    return PANELS[recipe.kind](recipe)


def facet_specs(recipe: Recipe) -> list[FacetSpec]:
    """The surface of a recipe's wall, as a scenario file has it; none for a wall of planar robots."""
    return [] if recipe.kind == "plane" else [panel.facet(recipe.standoff) for panel in panels(recipe)]


def space_holds(recipe: Recipe) -> list[HoldSpec]:
    """The holds of a wall in space, the lowest first.

    Raises:
        ClimberError: If they do not fit.
    """
    rng = np.random.default_rng(recipe.seed)
    pieces = panels(recipe)
    counts = [recipe.holds // len(pieces) + (i < recipe.holds % len(pieces)) for i in range(len(pieces))]
    positions, normals = [], []
    for panel, count in zip(pieces, counts, strict=True):
        if recipe.kind == "board":
            column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
            across = PITCH * np.column_stack([column.ravel() + 0.5, row.ravel() + 0.5])
        elif recipe.kind == "chimney":  # thrown like darts they would leave gaps that no limb reaches across
            rungs = np.arange(count) + 0.5 + rng.uniform(-UNEVEN, UNEVEN, count)
            across = np.column_stack([rng.uniform(0.0, panel.size[0], count), panel.size[1] / max(count, 1) * rungs])
        else:
            across = throw(rng, count, panel.size, recipe.spacing)
        slope, incut = (np.radians(spread.draw(rng, count)) for spread in (recipe.slope, recipe.incut))
        if recipe.kind == "chimney":
            facing = np.cos(slope)[:, None] * panel.out + np.sin(slope)[:, None] * panel.up
        else:
            # Against gravity is up the wall turned by as much as the wall leans forward.
            into = incut + np.radians(recipe.inclination_deg - 90.0)
            along = np.cos(slope)[:, None] * panel.up - np.sin(slope)[:, None] * panel.right
            facing = np.cos(into)[:, None] * along - np.sin(into)[:, None] * panel.out
        positions.append(panel.points(across))
        normals.append(facing)
    position, normal = np.round(np.vstack(positions), DIGITS) + 0.0, np.round(np.vstack(normals), NORMAL_DIGITS) + 0.0
    friction = np.round(recipe.friction.draw(rng, len(position)), 3)
    order = np.lexsort((position[:, 0], position[:, 1]))
    return [
        HoldSpec(position=position[i].tolist(), normal=normal[i].tolist(), friction=float(friction[i])) for i in order
    ]


def off_problem(recipe: Recipe) -> list[int]:
    """The holds of a board that do not belong to the problem set on it: in each row all but a few."""
    if recipe.kind != "board" or recipe.problem >= COLUMNS:
        return []
    rng = np.random.default_rng([recipe.seed, recipe.problem])
    kept = {row * COLUMNS + int(c) for row in range(ROWS) for c in rng.permutation(COLUMNS)[: recipe.problem]}
    return [hold for hold in range(COLUMNS * ROWS) if hold not in kept]


def check_kind(recipe: Recipe) -> None:
    """Raises a `ClimberError` that names the first number no wall of its kind can be made with."""
    if recipe.kind not in KINDS:
        raise ClimberError(f"kind is {recipe.kind!r}; allowed: {', '.join(KINDS)}")
    if not 0.0 < recipe.standoff < np.inf:
        raise ClimberError(f"standoff is {recipe.standoff:g} m; allowed: greater than 0, for holds stick out")
    if recipe.kind.endswith("corner") and not 90.0 <= recipe.angle_deg < 180.0:
        raise ClimberError(f"angle is {recipe.angle_deg:g} degrees; allowed: from 90 to less than 180")
    if not 0.0 < recipe.gap < np.inf:
        raise ClimberError(f"gap is {recipe.gap:g} m; allowed: greater than 0")
    if recipe.kind == "board" and recipe.holds != COLUMNS * ROWS:
        raise ClimberError(f"holds is {recipe.holds}; allowed: {COLUMNS * ROWS}, {COLUMNS} columns by {ROWS} rows")
    if recipe.problem < 1:
        raise ClimberError(f"problem is {recipe.problem}; allowed: at least one hold to a row")


def hold_specs(recipe: Recipe) -> list[HoldSpec]:
    """The holds of a recipe's wall, in few digits, as a scenario file has them; the rest is in `hold_defaults`.

    Raises:
        ClimberError: If no wall can be made by it.
    """
    check_kind(recipe)
    recipe.check()
    return plane_holds(recipe) if recipe.kind == "plane" else space_holds(recipe)


def make_wall(recipe: Recipe) -> Wall:
    """The wall of a recipe.

    Raises:
        ClimberError: If no wall can be made by it.
    """
    defaults = hold_defaults(recipe)
    holds = tuple(spec.build(defaults) for spec in hold_specs(recipe))
    facets = tuple(spec.build() for spec in facet_specs(recipe))
    return Wall(holds, inclination_deg=recipe.inclination_deg, facets=facets)
