"""Paths on a stance's manifold, through straight limbs where an elbow must flip.

Two postures whose holding limbs bend the same way share a chart, and most often the straight line in it already joins
them. Where one limb bends the other way, the chart rooted at that limb contains both. Where several do, or the direct
way is blocked, a roadmap finds postures to go by.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climber.apart import why_apart
from climber.atlas import atlas_path
from climber.manifold import Manifold
from climber.roadmap import Roadmap
from climber.rrt import Leg as Leg
from climber.rrt import Search as Search
from climber.rrt import clear as clear
from climber.rrt import connect, shortened
from climber.rrt import line as line
from climber.rrt import unwound as unwound
from climber.stance import Vector

THOROUGH = 5  # times as many samples where a single chart is all that there is to look in


def find_path(
    manifold: Manifold, a: Vector, b: Vector, rng: np.random.Generator, search: Search | None = None
) -> list[Leg] | None:
    """A feasible path between two feasible configurations on a manifold, or None when the search ends without one.

    `b` may differ from the path's last configuration by whole turns of the pelvis.

    Args:
        manifold: The contacts and conditions.
        a: Where to start, shape (nq,).
        b: Where to go, shape (nq,).
        rng: Source of random numbers.
        search: How hard to look.

    Returns:
        Legs, each beginning in the configuration in which the one before it ends.
    """
    search = search or Search()
    b = unwound(b, a, manifold.body.robot.angle_q)
    if manifold.body.without_inverse(manifold.points):
        return _without_inverse(manifold, a, b, rng, search)
    turning = flips(manifold, a, b)
    if len(turning) <= 1:
        chart = manifold.chart(a, turning[0] if turning else None)
        u = connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), rng, search)
        if u is not None:
            return [shortened(manifold, Leg(chart, u), rng, search)]
    return Roadmap(manifold, rng, search).path(a, b)


def _without_inverse(
    manifold: Manifold, a: Vector, b: Vector, rng: np.random.Generator, search: Search
) -> list[Leg] | None:
    """A path where some holding limb has no inverse kinematics: in the chart rooted at it, or in an atlas."""
    alike = all(manifold.body.inverse[i] is None for i in flips(manifold, a, b))
    if not (manifold.global_charts and alike):
        return atlas_path(manifold, a, b, rng, search)
    chart = manifold.chart(a)
    u = connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), rng, replace(search, iterations=0))
    if u is None and why_apart(manifold, a, b) is None:
        # Nothing speaks against a path, and no roadmap helps to find it.
        thorough = replace(search, iterations=THOROUGH * search.iterations)
        u = connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), rng, thorough)
    return None if u is None else [shortened(manifold, Leg(chart, u), rng, search)]


def direct(manifold: Manifold, a: Vector, b: Vector) -> bool:
    """Whether the straight line in one chart joins two feasible configurations: the most that is cheap to find out."""
    b = unwound(b, a, manifold.body.robot.angle_q)
    turning = flips(manifold, a, b)
    if len(turning) > 1 or manifold.body.without_inverse(manifold.points):
        return False
    chart = manifold.chart(a, turning[0] if turning else None)
    start = chart.coordinates(a)
    return any(clear(manifold, chart, start, end) for end in chart.turns(chart.coordinates(b)))


def flips(manifold: Manifold, a: Vector, b: Vector) -> tuple[int, ...]:
    """The holding limbs that bend differently in two configurations."""
    one, two = manifold.body.branches(a), manifold.body.branches(b)
    return tuple(i for i in sorted(manifold.points) if one[i] != two[i])
