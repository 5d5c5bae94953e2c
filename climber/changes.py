"""What little change would make a climb of a wall that has none: a better grip, or one hold more.

Every change told of was tried: the stance graph of the changed wall was built anew and has the climb, without the moves
that are proved impossible. Like all that the graph says, that is relaxed; `planned` tells of those whose climb the
planner then really found.
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import shapely
from scipy.stats import qmc
from shapely.geometry import MultiPoint, Point

from climber.blocked import Frontier
from climber.exceptions import ClimberError
from climber.reachable import RelaxedClimb, Target
from climber.scenario import Scenario
from climber.scenario_fields import HoldSpec
from climber.stance import Vector
from climber.wall import Hold, Wall
from climber.words import listed

FRICTION = 0.05  # by how much a coefficient is raised
PLACES = 400  # for one hold more, tried at most
STRONG = 1e4  # a pin of this many times the robot's weight pushes and pulls as one likes


@dataclass(frozen=True)
class Change:
    """A change of the wall that makes a climb on the stance graph.

    Attributes:
        kind: "friction" if the friction of `holds` is raised, "hold" if `added` joins the wall.
        moves: Fewest moves of the climb on the changed wall's stance graph, less those proved impossible.
        holds: Whose friction is raised; the number of the hold that is added.
        added: The hold that is added.
        planned: Whether the planner then found the whole climb; None if it was not asked.
    """

    kind: Literal["friction", "hold"]
    moves: int
    holds: tuple[int, ...]
    added: Hold | None = None
    planned: bool | None = None

    def on(self, wall: Wall) -> Wall:
        """The changed wall."""
        if self.added is not None:
            return replace(wall, holds=(*wall.holds, self.added))
        return more_friction(wall, self.holds)

    def on_scenario(self, scenario: Scenario) -> Scenario:
        """The scenario with the changed wall."""
        common, specs = scenario.wall.hold_defaults, list(scenario.wall.holds)
        if self.added is not None:
            position, normal = list(self.added.position), list(self.added.normal)
            specs.append(HoldSpec(position=position, normal=normal))  # the rest as `hold_defaults` has it
        for number in self.holds if self.added is None else ():
            own = specs[number].friction
            specs[number] = replace(specs[number], friction=(common.friction if own is None else own) + FRICTION)
        return replace(scenario, wall=replace(scenario.wall, holds=specs))

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        facts: dict[str, Any] = {"kind": self.kind, "moves": self.moves, "planned": self.planned}
        if self.added is None:
            return facts | {"holds": list(self.holds), "friction_added": FRICTION}
        fields = ("position", "normal", "friction", "half_width", "min_force", "max_force", "grip", "adhesion")
        return facts | {"hold": {name: getattr(self.added, name) for name in fields}, "number": self.holds[0]}


@dataclass(frozen=True)
class Changes:
    """The changes that were tried.

    Attributes:
        friction: Those of friction that make a climb: of single holds, and of all holds together.
        forces_matter: False if it is proved that no friction would make a climb: geometry alone rules it out.
        friction_tried: Walls with more friction that were tried, all or as many as there was time for.
        friction_all_tried: Whether that was every hold alone and all together.
        hold: One hold more, of the fewest moves among those found.
        places_good: Places for one hold more that make a climb.
        places_tried: Places that were tried.
    """

    friction: tuple[Change, ...] = ()
    forces_matter: bool = True
    friction_tried: int = 0
    friction_all_tried: bool = True
    hold: Change | None = None
    places_good: int = 0
    places_tried: int = 0

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "friction": {
                "changes": [change.to_dict() for change in self.friction],
                "ruled_out": not self.forces_matter,
                "tried": self.friction_tried,
                "all_tried": self.friction_all_tried,
            },
            "hold": {
                "change": None if self.hold is None else self.hold.to_dict(),
                "places_good": self.places_good,
                "places_tried": self.places_tried,
            },
        }


def more_friction(wall: Wall, holds: tuple[int, ...]) -> Wall:
    """The wall with the friction of some holds raised by `FRICTION`."""
    better = list(wall.holds)
    for hold in holds:
        better[hold] = replace(better[hold], friction=better[hold].friction + FRICTION)
    return replace(wall, holds=tuple(better))


@dataclass
class ChangeFinder:
    """Tries changes for as long as there is time.

    Attributes:
        climb: The climb that does not exist.
        new_hold: What a new hold is like, apart from its place.
        rng: Source of random numbers.
        seconds: Time to spend [s].
    """

    climb: RelaxedClimb
    new_hold: Hold
    rng: np.random.Generator
    seconds: float
    _until: float = field(init=False)

    def find(self, frontier: Frontier, target: Target, places: bool = True) -> Changes:
        """Changes that make a climb, looked for between a frontier and the target it falls short of.

        Args:
            frontier: How far one gets.
            target: What is not reached.
            places: Whether to look for places for one hold more.
        """
        began = clock.perf_counter()
        self._until = began + self.seconds / 2
        friction = self._friction(frontier)
        if not places:
            return friction
        self._until = began + self.seconds
        best, good, tried = self._one_hold(frontier, target)
        return replace(friction, hold=best, places_good=good, places_tried=tried)

    def _moves(self, wall: Wall) -> int | None:
        """Fewest moves on a changed wall; None if there is no climb, or what is proved impossible leaves none."""
        climb = self.climb.on(wall)
        try:
            graph = climb.graph()
        except ClimberError:  # the start itself fails
            return None
        if climb.reached(graph).moves is None:
            return None
        return climb.reached(graph, climb.impossible(graph)).moves

    def _late(self) -> bool:
        return clock.perf_counter() > self._until

    # --- friction ----------------------------------------------------------------------------------------------------

    def _friction(self, frontier: Frontier) -> Changes:
        wall = self.climb.wall
        # A pin that is strong enough can do whatever any friction can, and more.
        strong = STRONG * self.climb.robot.mass * 9.81
        pins = tuple(replace(hold, grip="pin", max_force=strong, max_moment=strong) for hold in wall.holds)
        if self._moves(replace(wall, holds=pins)) is None:
            return Changes(forces_matter=False)
        useful = tuple(number for number, hold in enumerate(wall.holds) if hold.grip != "pin")
        tests = [useful, *((hold,) for hold in self._by_nearness(useful, frontier))] if useful else []
        found, tried = [], 0
        for holds in tests:
            if self._late():
                break
            tried += 1
            moves = self._moves(more_friction(wall, holds))
            if moves is not None:
                found.append(Change("friction", moves, holds))
        return Changes(friction=tuple(found), friction_tried=tried, friction_all_tried=tried == len(tests))

    def _by_nearness(self, holds: tuple[int, ...], frontier: Frontier) -> list[int]:
        positions = self.climb.wall.positions[:, :2]
        middle = positions[list(frontier.stances[0].holds)].mean(axis=0)
        return sorted(holds, key=lambda hold: (float(np.linalg.norm(positions[hold] - middle)), hold))

    # --- one hold more -----------------------------------------------------------------------------------------------

    def _one_hold(self, frontier: Frontier, target: Target) -> tuple[Change | None, int, int]:
        wall, number = self.climb.wall, len(self.climb.wall.holds)
        best: Change | None = None
        good = tried = 0
        for place in self._places(frontier, target):
            if self._late():
                break
            tried += 1
            hold = replace(self.new_hold, position=(float(place[0]), float(place[1]), 0.0))
            moves = self._moves(replace(wall, holds=(*wall.holds, hold)))
            if moves is not None:
                good += 1
                if best is None or moves < best.moves:
                    best = Change("hold", moves, (number,), hold)
        return best, good, tried

    def _places(self, frontier: Frontier, target: Target) -> Iterator[Vector]:
        """Places spread evenly over the gap from the frontier to the target, on no other hold and in no obstacle."""
        wall, reach = self.climb.wall, float(np.mean(self.climb.robot.reach))
        holds = [*frontier.stances[0].holds, *target.demanded]
        gap = MultiPoint(wall.positions[holds, :2])
        if target.region is not None:
            gap = gap.union(target.region)
        area = gap.convex_hull.buffer(reach / 2)
        x0, y0, x1, y1 = area.bounds
        halton = qmc.Halton(2, rng=self.rng)
        given = 0
        for _ in range(8 * PLACES):
            place = np.array([x0, y0]) + halton.random(1)[0] * np.array([x1 - x0, y1 - y0])
            apart = np.linalg.norm(wall.positions[:, :2] - place, axis=1)
            widths = np.array([hold.half_width for hold in wall.holds]) + self.new_hold.half_width
            free = (apart > np.maximum(widths, 1e-3)).all() and shapely.contains_xy(area, *place)
            if free and not any(obstacle.intersects(Point(*place)) for obstacle in wall.obstacles):
                yield np.round(place, 4)
                given += 1
                if given == PLACES:
                    return


def told(changes: Changes) -> list[str]:
    """The changes in sentences."""
    lines = []
    all_holds = [change for change in changes.friction if len(change.holds) > 1]
    single = [change for change in changes.friction if len(change.holds) == 1]
    if not changes.forces_matter:
        lines.append(
            "No friction would make a climb: even if every hold could push and pull in every direction there is none."
        )
    if single:
        holds = listed([f"hold {change.holds[0]}" for change in sorted(single, key=lambda change: change.holds)])
        alone = " alone" if len(single) == 1 else " (any one of them)"
        lines.append(
            f"A friction coefficient {FRICTION} higher on {holds}{alone} would make a climb of "
            f"{min(change.moves for change in single)} moves on the stance graph.{_planned(single)}"
        )
    elif all_holds:
        lines.append(
            f"A friction coefficient {FRICTION} higher on all holds together would make a climb of "
            f"{all_holds[0].moves} moves on the stance graph{', none alone' if changes.friction_all_tried else ''}."
            f"{_planned(all_holds)}"
        )
    elif changes.friction_tried:
        every = "on one hold, or on all" if changes.friction_all_tried else "as far as there was time to try"
        lines.append(f"A friction coefficient {FRICTION} higher, {every}, would not make a climb.")
    if changes.hold is not None and (hold := changes.hold.added) is not None:
        lines.append(
            f"One hold more, at ({hold.position[0]:.3f}, {hold.position[1]:.3f}) m, facing straight up with friction "
            f"{hold.friction:g}, would make a climb of {changes.hold.moves} moves on the stance graph "
            f"({changes.places_good} of {changes.places_tried} places tried do).{_planned([changes.hold])}"
        )
    elif changes.places_tried:
        lines.append(
            f"No one hold more among {changes.places_tried} places tried would make a climb, which does not prove that "
            "none would."
        )
    return lines


def _planned(changes: list[Change]) -> str:
    asked = [change for change in changes if change.planned is not None]
    if not asked:
        return ""
    if any(change.planned for change in asked):
        return " The planner finds the whole climb."
    return " The planner, asked as well, found no motion for it in the time given."
