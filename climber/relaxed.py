"""The relaxed checks of the stance graph, one stance or move at a time, each with the amount it fails by.

`climber.graph` makes the same checks on thousands of stances at once and keeps yes or no. Here each becomes a `Check`,
with a sentence and the numbers that anyone can recompute. A check that fails is a proof for feet at the middle of their
patches; `Check.anywhere` says whether it also fails wherever on the patches the feet stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

import numpy as np

from climber.balls import balls_meet, balls_meet_region, shared_points
from climber.geometry import TOUCH, Mask
from climber.graph import GraphRobot
from climber.moves import OVERLAP
from climber.polygon import crossing_sides, in_order, out_of_order_anywhere, swaps, worst_corner
from climber.programs.equilibrium import SupportProgram
from climber.programs.forces import weight_in_plane
from climber.programs.regions import contact_regions
from climber.programs.support import contact_intervals
from climber.solids import Region
from climber.stance import Contact, Move, Stance, Vector
from climber.wall import Wall
from climber.words import certificate_told, force, length, listed, spoken

CheckName = Literal["reach", "region", "order", "support", "balance", "avoid"]


@dataclass(frozen=True)
class Check:
    """One relaxed check and how it went.

    Attributes:
        name: Which check: "reach" (balls meet, eqs. 4.2 and 4.7), "region" (balls meet a region), "order" (feet around
            a strictly convex polygon in limb order, 4.6), "support" (forces balance gravity at all), "balance" (the
            centre of mass can be over two sets of contacts at once, 4.17), "avoid" (a hold that is barred).
        subject: What was checked, as a phrase.
        ok: Whether it passes.
        amount: By how much it fails, in `unit`; 0 if it passes.
        unit: "m", "N" or "N m"; empty where the check is yes or no.
        sentence: In words, without a full stop.
        anywhere: It fails wherever on their patches the feet stand, not only at their middles.
        numbers: What the sentence was made of.
    """

    name: CheckName
    subject: str
    ok: bool
    amount: float
    unit: str
    sentence: str
    anywhere: bool = False
    numbers: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        facts: dict[str, Any] = {"check": self.name, "subject": self.subject, "ok": self.ok, "sentence": self.sentence}
        if self.unit:
            facts |= {"fails_by": None if self.ok else self.amount, "unit": self.unit}
        if not self.ok:
            facts["proved_for"] = "any point of the patches" if self.anywhere else "the middles of the patches"
        return facts | self.numbers


def reach_lacking(centers: Vector, radii: Vector, region: Region | None = None) -> tuple[float, Vector | None]:
    """By how much all radii must grow for balls, or disks, to have a common point, inside a region if one is given.

    For equal radii and no region that is the radius of the smallest ball around the centres less the balls' own.
    Monotone in the growth, so bisection over the test finds it.

    Args:
        centers: Shape (k, 3), or (k, 2) in the wall plane [m].
        radii: Shape (k,) [m].
        region: Where the common point is to be, see `balls_meet_region`.

    Returns:
        The growth [m], negative if the balls overlap to spare, and the common point at that growth, shape (3,) or (2,),
        where there is one to tell (not with a region).
    """
    low, high = -float(radii.min()), 1.0
    while not _meet(centers, radii, np.array([high]), region)[0]:
        high *= 2.0
    for _ in range(14 if region is None else 60):
        steps = np.linspace(low, high, 18 if region is None else 3)[1:-1]
        met = np.append(_meet(centers, radii, steps, region), True)
        first = int(met.argmax())
        low, high = [low, *steps][first], [*steps, high][first]
    point = None if region is not None else shared_points(centers[None], radii + high + TOUCH)[0]
    return float(high), point


def _meet(centers: Vector, radii: Vector, growths: Vector, region: Region | None) -> Mask:
    """Whether balls grown by each of several amounts have a common point, in the region if there is one."""
    if region is None:
        grown = radii + growths[:, None]
        points = shared_points(np.repeat(centers[None], len(growths), axis=0), grown)
        meet: Mask = ~np.isnan(points[:, 0]) & np.greater_equal(grown.min(axis=1), 0.0)
        return meet
    return np.array([balls_meet_region(centers[None], radii + g, region)[0] for g in growths.tolist()], dtype=bool)


class RelaxedChecks:
    """The checks for one robot on one wall.

    Attributes:
        wall: The wall.
        limbs: Names of the limbs in limb order.
        avoid: Holds that no limb may stand on.
    """

    def __init__(self, wall: Wall, robot: GraphRobot, limbs: Sequence[str], avoid: Sequence[int] = ()) -> None:
        self.wall, self.limbs, self.avoid = wall, tuple(limbs), frozenset(avoid)
        self._reach = np.asarray(robot.reach, dtype=float)
        self._mass, self._space = robot.mass, robot.dimension == 3
        self._positions = wall.positions[:, : robot.dimension]

    # --- one check each ----------------------------------------------------------------------------------------------

    def reach(self, feet: Sequence[tuple[int, int]], subject: str) -> Check:
        """Whether the pelvis can be within reach of all feet, given as (limb, hold), at once."""
        limbs, holds = (list(column) for column in zip(*feet, strict=True))
        centers, radii = self._positions[holds], self._reach[limbs]
        names = [self.limbs[i] for i in limbs]
        numbers: dict[str, Any] = {"holds": holds, "limbs": names, "reach": radii.tolist()}
        if balls_meet(centers[None], radii)[0]:
            return Check("reach", subject, True, 0.0, "m", f"{subject} is within reach", numbers=numbers)
        lacking, point = reach_lacking(centers, radii)
        assert point is not None
        numbers |= {"lacking": lacking, "nearest_pelvis": point.tolist()}
        on = listed([f"hold {hold}" for hold in dict.fromkeys(holds)])
        sentence = f"reach is short by {length(lacking)} for {subject}"
        if np.ptp(radii) <= TOUCH:
            radius = lacking + float(radii[0])
            numbers["enclosing_radius"] = radius
            ball = "ball" if self._space else "circle"
            sentence += (
                f": the smallest {ball} around {on} has a radius of {length(radius)}, the reach is {length(radii[0])}"
            )
        else:
            sentence += f": no place of the pelvis is near enough to {on} at once"
        anywhere = lacking > max(self.wall.holds[hold].half_width for hold in holds)
        return Check("reach", subject, False, lacking, "m", sentence, anywhere, numbers)

    def region(self, stance: Stance, region: Region, subject: str) -> Check:
        """Whether the pelvis can be in a region while the limbs reach their holds."""
        centers = self._positions[list(stance.holds)]
        numbers: dict[str, Any] = {"holds": list(stance.holds)}
        if balls_meet_region(centers[None], self._reach, region)[0]:
            sentence = f"on {subject} the pelvis can be in the region as far as reach goes"
            return Check("region", subject, True, 0.0, "m", sentence, numbers=numbers)
        lacking, _ = reach_lacking(centers, self._reach, region)
        sentence = f"on {subject} the limbs are {length(lacking)} too short for the pelvis to be in the region"
        anywhere = lacking > max(self.wall.holds[hold].half_width for hold in stance.holds)
        return Check("region", subject, False, lacking, "m", sentence, anywhere, numbers | {"lacking": lacking})

    def order(self, stance: Stance, subject: str) -> Check:
        """Whether the feet are in limb order around a strictly convex polygon, so that no limbs cross."""
        holds, names = stance.holds, [spoken(name) for name in self.limbs]
        points = self.wall.projected(np.array(holds)) if self._space else self._positions[list(holds)]
        numbers: dict[str, Any] = {"holds": list(holds)}
        worst = worst_corner(points)
        if worst is None or in_order(points):
            return Check("order", subject, True, 0.0, "m", f"on {subject} no limbs cross", numbers=numbers)
        amount, (a, b, c) = worst
        pairs = [[self.limbs[i], self.limbs[j]] for i, j in swaps(points)]
        sides = [[i, (i + 1) % len(holds), j, (j + 1) % len(holds)] for i, j in crossing_sides(points)]
        numbers |= {
            "corner": [self.limbs[i] for i in (a, b, c)],
            "inside_by": amount,
            "change_places": pairs,
            "crossing_sides": [[self.limbs[i] for i in side] for side in sides],
        }
        who = " or ".join(f"{spoken(one)} and {spoken(other)}" for one, other in pairs)
        sentence = (
            f"limbs would cross on {subject}{f', {who} would have to change places' if pairs else ''}: the foot of "
            f"{names[b]} on hold {holds[b]} lies {length(amount)} on the inner side of the line from {names[a]} on "
            f"hold {holds[a]} to {names[c]} on hold {holds[c]}"
        )
        widths = np.array([self.wall.holds[hold].half_width for hold in holds])
        if self._space:  # neither foot nor line comes nearer than by the width of a patch
            anywhere = bool(amount > 2.0 * widths.max())
        else:
            anywhere = out_of_order_anywhere(points, widths[:, None] * self.wall.tangents[list(holds), :2])
        return Check("order", subject, False, amount, "m", sentence, anywhere, numbers)

    def support(self, feet: Sequence[tuple[int, int]], subject: str) -> Check:
        """Whether forces of the feet, given as (limb, hold), balance gravity for some centre of mass."""
        contacts = [Contact(limb, hold) for limb, hold in feet]
        holds = [c.hold for c in contacts]
        if self._space:
            return self._support_in_space(contacts, subject)
        lower, upper = contact_intervals(self.wall, [contacts], self._mass)[0]
        if not np.isnan(lower):
            sentence = f"{subject} can carry the robot with its centre of mass at x from {lower:.4f} to {upper:.4f} m"
            numbers = {"holds": holds, "interval": [float(lower), float(upper)]}
            return Check("support", subject, True, 0.0, "N", sentence, numbers=numbers)
        weight = weight_in_plane(self.wall, self._mass)
        numbers = {"holds": holds, "weight": weight}
        certificate = self._certificate(contacts)
        if certificate is None:  # empty by rounding only: the load is on the border of what the contacts can carry
            sentence = f"the forces on {subject} cannot balance gravity, though only just"
            return Check("support", subject, False, 0.0, "N", sentence, numbers=numbers)
        direction, shortfall = certificate
        numbers |= {"direction": direction.tolist(), "shortfall": shortfall}
        if direction[2] != 0.0:
            way = "counter-clockwise" if direction[2] > 0.0 else "clockwise"
            sentence = (
                f"balanced forces on {subject} cannot cancel their moments: {shortfall:.3g} N m {way} are lacking"
            )
            return Check("support", subject, False, shortfall, "N m", sentence, numbers=numbers)
        asked = float(direction[1] * weight)
        most = asked - shortfall
        numbers |= {"asked": asked, "most": most}
        sentence = f"the forces on {subject} cannot balance gravity: {certificate_told(direction, asked, most)}"
        # Where on a patch a foot stands matters for torques only, and the certificate is about forces.
        return Check("support", subject, False, shortfall, "N", sentence, True, numbers)

    def _support_in_space(self, contacts: Sequence[Contact], subject: str) -> Check:
        """`support` of a robot in space."""
        region = contact_regions(self.wall, [contacts], self._mass, 3)
        numbers: dict[str, Any] = {"holds": [c.hold for c in contacts]}
        if not region.empty[0]:
            wide, deep = (length(size) for size in np.ptp(region.corners[0], axis=0))
            sentence = f"{subject} can carry the robot with its centre of mass in a region of {wide} by {deep}"
            numbers["polygon"] = region.corners[0].tolist()
            return Check("support", subject, True, 0.0, "N", sentence, numbers=numbers)
        direction, turning, shortfall = region.direction[0], float(region.turning[0]), float(region.shortfall[0])
        weight = self._mass * float(np.linalg.norm(self.wall.gravity))
        numbers |= {"weight": weight, "direction": direction.tolist(), "turning": turning, "shortfall": shortfall}
        along = ", ".join(f"{part + 0.0:.3f}" for part in np.round(direction, 3))
        asked = -self._mass * float(direction @ self.wall.gravity)
        sentence = f"the forces on {subject} cannot balance gravity: along ({along})"
        if abs(turning) > 1e-6:
            sentence += f", and turning about gravity by {turning:.3g} to the metre,"
        sentence += f" they come to {force(asked - shortfall)} at most and the weight takes {force(asked)}"
        # Where on a patch a foot stands matters for torques only.
        return Check("support", subject, False, shortfall, "N", sentence, abs(turning) <= 1e-6, numbers)

    def balance(self, move: Move, after: bool) -> Check:
        """Whether the centre of mass can be over the limbs that stay and over all limbs, at one end of a move.

        In space all limbs can hold it wherever those that stay can, for all that this check asks.
        """
        staying = [(i, hold) for i, hold in enumerate(move.start.holds) if i != move.limb]
        moving = (move.limb, move.hold if after else move.released)
        name = spoken(self.limbs[move.limb])
        subject = (
            f"the move's end, as {name} takes hold {move.hold}"
            if after
            else (f"the move's start, as {name} lets go of hold {move.released}")
        )
        if self._space:
            return Check("balance", subject, True, 0.0, "m", f"the support at {subject} is shared")
        (lower, upper), (lower_all, upper_all) = self._intervals(staying, moving, [0.0] * (len(staying) + 1))
        gap = max(lower, lower_all) - min(upper, upper_all)
        numbers = {
            "without": [lower, upper],
            "with": [lower_all, upper_all],
            "holds_without": [hold for _, hold in staying],
            "hold": moving[1],
        }
        if gap <= OVERLAP:
            return Check("balance", subject, True, 0.0, "m", f"the support at {subject} is shared", numbers=numbers)
        sentence = (
            f"the supports with and without {name} lie {length(gap)} apart at {subject}: the centre of mass must be at "
            f"x from {lower:.4f} to {upper:.4f} m without it and from {lower_all:.4f} to {upper_all:.4f} m with it"
        )
        # An end of an interval is the extreme, over forces, of what is linear in every foot's offset. So the gap is
        # concave in the offsets and least at a corner of the box they are in.
        widths = [self.wall.holds[hold].half_width for _, hold in [*staying, moving]]
        sign = 1.0 if lower > upper_all else -1.0
        gaps = []
        for signs in product((-1.0, 1.0), repeat=len(widths)):
            one, both = self._intervals(staying, moving, [s * w for s, w in zip(signs, widths, strict=True)])
            gaps.append(one[0] - both[1] if sign > 0 else both[0] - one[1])
        return Check("balance", subject, False, gap, "m", sentence, min(gaps) > OVERLAP, numbers)

    def allowed(self, hold: int) -> Check:
        """Whether a hold may be stood on."""
        ok = hold not in self.avoid
        sentence = f"hold {hold} {'may' if ok else 'is to be avoided and must not'} be stood on"
        return Check("avoid", f"hold {hold}", ok, 0.0, "", sentence, not ok, {"hold": hold})

    # --- in order ----------------------------------------------------------------------------------------------------

    def of_stance(self, stance: Stance, subject: str) -> Iterator[Check]:
        """All checks of a stance: holds allowed, reach, order, support."""
        for hold in stance.holds:
            yield self.allowed(hold)
        yield self.reach(list(enumerate(stance.holds)), subject)
        yield self.order(stance, subject)
        yield self.support(list(enumerate(stance.holds)), subject)

    def of_move(self, move: Move) -> Iterator[Check]:
        """The checks that decide whether the graph has a move from a stance it has, cheap ones first."""
        start, end = list(enumerate(move.start.holds)), list(enumerate(move.end.holds))
        name = spoken(self.limbs[move.limb])
        landed = f"the stance with {name} on hold {move.hold}"
        staying = [foot for foot in start if foot[0] != move.limb]
        yield self.allowed(move.hold)
        yield self.reach(end, landed)
        yield self.order(move.end, landed)
        if len(self.limbs) > 2:  # a robot of two hangs from one meanwhile, and swings round
            yield self.reach([*start, (move.limb, move.hold)], "the holds before and after the move together")
        holds = listed([f"hold {hold}" for _, hold in staying])
        yield self.support(staying, f"{holds} alone")
        yield self.support(end, landed)
        yield self.balance(move, after=True)

    def first_failure(self, checks: Iterator[Check]) -> Check | None:
        """The first check that fails, later ones not being made."""
        return next((check for check in checks if not check.ok), None)

    # --- helpers -----------------------------------------------------------------------------------------------------

    def _certificate(self, contacts: Sequence[Contact]) -> tuple[Vector, float] | None:
        """The direction in which contacts fail and by how much; None if they fail by rounding only."""
        try:
            answer = SupportProgram.of_contacts(self.wall, contacts, self._mass).solve()
        except RuntimeError:
            return None
        return None if answer.direction is None else (answer.direction, answer.shortfall)

    def _intervals(
        self, staying: Sequence[tuple[int, int]], moving: tuple[int, int], offsets: Sequence[float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        feet = [Contact(*foot, offset) for foot, offset in zip([*staying, moving], offsets, strict=True)]
        ends = [contact_intervals(self.wall, [some], self._mass)[0].tolist() for some in (feet[:-1], feet)]
        return tuple(ends[0]), tuple(ends[1])
