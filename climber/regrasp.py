"""Moves in which a limb lets go of its hold and takes it again, to stand there in another posture.

A stance whose contacts leave the robot no freedom may have several postures (Bretl's double link: the joint bent one
way or the other), and no shift leads from one to another. Letting go and hanging from the other limbs meanwhile may.
Where contacts leave freedom, such moves are of little use, and the stance graph is without them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climber.manifold import Body
from climber.moves import Setting, Supports, Weights, overlap
from climber.stance_graph import StanceGraph


def rigid(body: Body) -> bool:
    """Whether contacts of all limbs leave the robot no freedom, but at singular postures."""
    return int(body.robot.plant.num_positions()) <= body.robot.dimension * len(body.robot.limbs)


def with_regrasps(graph: StanceGraph, body: Body, weights: Weights) -> StanceGraph:
    """The graph with an edge from each stance to itself for each limb that the others can do without.

    The edges' costs are those of any move (Gönen eq. 4.22), of no distance.
    """
    V, n = graph.stances.shape
    limb = np.tile(np.arange(n), V)
    vertex = np.repeat(np.arange(V), n)
    others = (limb[:, None] + 1 + np.arange(n - 1)) % n
    holds = graph.stances[vertex[:, None], others]
    robot = body.robot
    setting = Setting(body.wall, robot.reach, robot.mass, robot.dimension, body.wall.positions[:, : robot.dimension])
    extents, standing = setting.extents(holds), setting.extents(graph.stances)[vertex]
    good = overlap(extents, standing) if robot.dimension == 2 else ~np.isnan(extents[:, 0])
    extra = Supports(holds[good], extents[good], setting.measures(holds, others)[good])
    cost = weights.stability * extra.stability_costs + weights.robustness * extra.robustness_costs
    columns = ((getattr(graph.supports, name), getattr(extra, name)) for name in ("holds", "extents", "measures"))
    supports = Supports(*(np.concatenate(pair) for pair in columns))
    rows = len(graph.supports.holds) + np.arange(good.sum())
    tail, head = (np.concatenate([ends, vertex[good].astype(ends.dtype)]) for ends in (graph.tail, graph.head))
    order = np.lexsort((head, tail))
    return replace(
        graph,
        tail=tail[order],
        head=head[order],
        limb=np.concatenate([graph.limb, limb[good].astype(graph.limb.dtype)])[order],
        cost=np.concatenate([graph.cost, np.rint(cost).astype(graph.cost.dtype)])[order],
        support_index=np.concatenate([graph.support_index, rows.astype(graph.support_index.dtype)])[order],
        supports=supports,
        counts={**graph.counts, "regrasps": int(good.sum()), "edges": len(order)},
    )
