"""An explanation in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from climber.blocked import Frontier, on_holds
from climber.changes import FRICTION, Change, Changes
from climber.explanation import Answer, Missing
from climber.reachable import Target
from climber.words import length, listed, spoken

MOST = 3  # blocked moves that are told


def verdict(answer: Answer, missed: Sequence[Target], moves: int | None, in_order: bool) -> str:
    """The first sentence: what cannot be reached, and how sure that is.

    Args:
        answer: The answer.
        missed: Goal and waypoints that cannot be reached; none if they cannot all be visited in a row.
        moves: Of the stance graph's climb, before anything was taken from it; None if it has none.
        in_order: Whether waypoints are to be visited in their order.
    """
    if missed:
        what = f"{listed([called(target) for target in missed])} cannot be reached"
    else:
        order = " in the given order" if in_order else ""
        what = (
            f"every waypoint and the goal can be reached from the start, but no one walk visits them all{order} "
            "and ends in the goal, for not every move can be undone"
        )
    if answer == "no motion found":
        return (
            f"No motion was found for any climb, which does not prove that there is none: the stance graph has a "
            f"climb of {moves} moves, but less the moves that were given up, {what}."
        )
    if moves is None:
        return f"There is no climb: {what} on the stance graph. (Proved, for feet at the middles of their patches.)"
    return (
        f"There is no climb: the stance graph has one of {moves} moves, but less the moves that were proved "
        f"impossible {what}."
    )


def frontier_told(frontier: Frontier, target: Target, limbs: tuple[str, ...], onwards: bool = True) -> list[str]:
    """The frontier in sentences.

    Args:
        frontier: The frontier.
        target: Towards what.
        limbs: Names of the limbs.
        onwards: Whether to tell what blocks the moves that would lead on, `MOST` of them, no two to the same hold.
    """
    on = on_holds(frontier.stances[0])
    stances = f"{frontier.reached} stance{'s' if frontier.reached != 1 else ''}"
    lines = [
        f"From the start {stances} can be reached, on {len(frontier.holds)} holds; of these hold "
        f"{frontier.farthest_hold} is the nearest to {target.name}.",
        f"The reached stance nearest to {target.name} is on {on} ({listed([spoken(limb) for limb in limbs])}), its "
        f"middle {length(frontier.distances[0])} away.",
    ]
    if not onwards:
        return lines
    if not frontier.blocked:
        lines.append(f"From the stances nearest to {target.name} no hold that is left to take leads nearer.")
    seen: set[int] = set()
    for blocked in frontier.blocked:
        if blocked.move.hold not in seen and len(seen) < MOST:
            seen.add(blocked.move.hold)
            lines.append(f"Onwards from there or nearby: {blocked.sentence(limbs)}.")
    return lines


def missing_told(missing: Missing, limbs: Sequence[str]) -> list[str]:
    """What is missing of a target, in sentences."""
    target, lines = missing.target, []
    if missing.check is not None:
        lines.append(f"It could not be stood on wherever one came from: {missing.check.sentence}.")
    if missing.never_held:
        lines.append(f"No reached stance stands on {listed([f'hold {hold}' for hold in missing.never_held])}.")
    elif missing.most_held is not None:
        number, stance = missing.most_held
        on = listed([f"hold {hold}" for hold in stance.holds])
        if number == len(target.demanded):
            lines.append(f"All of its holds are reached at once, but not as asked for: on {on}.")
        else:
            lines.append(f"Every one of its holds is reached, but at most {number} at once, on {on}.")
    if missing.no_way_in is not None:
        miss = missing.no_way_in.sentence(tuple(limbs))
        lines.append(f"No move at all leads into {target.name}; the nearest miss: {miss}.")
    if missing.region_lacking is not None:
        by, stance = missing.region_lacking
        on = listed([f"hold {hold}" for hold in stance.holds])
        lines.append(
            f"Of all reached stances the one on {on} comes nearest: its limbs are {length(by)} too short for the "
            "pelvis to be in the region."
        )
    return lines


def sentence(text: str) -> str:
    """Some text with a capital letter and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def called(target: Target) -> str:
    """What to call a target, with its holds."""
    if target.demanded:
        return f"{target.name} ({listed([f'hold {hold}' for hold in sorted(target.demanded)])})"
    return f"the region of {target.name}"


def changes_told(changes: Changes) -> list[str]:
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
            f"({len(changes.holds)} of {changes.places_tried} places tried do).{_planned(changes.holds)}"
        )
    elif changes.places_tried:
        lines.append(
            f"No one hold more among {changes.places_tried} places tried would make a climb, which does not prove that "
            "none would."
        )
    return lines


def _planned(changes: Sequence[Change]) -> str:
    asked = [change for change in changes if change.planned is not None]
    if not asked:
        return ""
    found = next((change for change in asked if change.planned), None)
    if found is None:
        return f" The planner, asked about {len(asked)} of these, found no plan in the time given."
    if len(changes) > 1 and found.added is None and len(found.holds) == 1:
        return f" The planner finds the whole climb with more on hold {found.holds[0]}."
    return " The planner finds the whole climb."
