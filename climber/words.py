"""Numbers and names as a person would say them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

from climber.stance import Vector

_HEADINGS = ("right", "up and right", "up", "up and left", "left", "down and left", "down", "down and right")


def spoken(name: str) -> str:
    """A limb's name in a sentence."""
    return name.replace("_", " ")


def listed(items: Sequence[str]) -> str:
    """`a, b and c`; what is said of holds one after the other shortens to `holds 1, 2 and 3`."""
    if len(items) > 1 and all(item.startswith("hold ") for item in items):
        return "holds " + listed([item.removeprefix("hold ") for item in items])
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else "nothing"


def moves_told(stances: Sequence[Mapping[str, int]], limbs: Sequence[str]) -> list[str]:
    """What each limb in turn does from one stance, hold by limb name, to the next."""
    told = []
    for limb, (before, after) in zip(limbs, pairwise(stances), strict=True):
        again = f"lets go of hold {before[limb]} and takes it again"
        moved = f"from hold {before[limb]} to hold {after[limb]}"
        told.append(f"{spoken(limb)} {again if before[limb] == after[limb] else moved}")
    return told


def length(metres: float) -> str:
    """A length to three digits, in the unit that suits it."""
    size = abs(metres)
    if size >= 1.0:
        return f"{metres:.2f} m"
    if size >= 0.01:
        return f"{100 * metres:.1f} cm"
    return f"{1000 * metres:.2g} mm" if size >= 1e-7 else "0 mm"


def force(newtons: float) -> str:
    """A force to about three digits."""
    return f"{newtons:.2f} N" if abs(newtons) >= 0.1 else f"{newtons:.2g} N"


def heading(direction: Vector) -> str:
    """Which way a vector in the wall plane points, to the nearest of eight."""
    eighth = round(math.atan2(direction[1], direction[0]) / (math.pi / 4))
    return _HEADINGS[eighth % 8]


def certificate_told(direction: Vector, asked: float, most: float) -> str:
    """What contacts lack in a direction.

    Args:
        direction: Unit vector in W, shape (3,), in the plane.
        asked: What carrying the weight takes along it [N].
        most: What the contacts can push along it at most [N], less than asked.
    """
    if asked >= 0.0:
        along = f"({direction[0]:.3f}, {direction[1]:.3f}), {heading(direction)}"
        taken = f"carrying the weight takes {force(asked)} and they push at most {force(most)}"
    else:  # the other way round it is easier to understand
        along = f"({-direction[0]:.3f}, {-direction[1]:.3f}), {heading(-direction)}"
        taken = f"they push at least {force(-most)} and the weight takes up only {force(-asked)}"
    return f"along {along}, {taken}, a difference of {force(asked - most)}"
