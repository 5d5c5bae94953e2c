"""The conditions of a feasible configuration one by one agree with feasibility as a whole, on every robot."""

from __future__ import annotations

import numpy as np
import pytest
from robots import every_star, robot, standing

from climber.manifold import Body, Manifold
from climber.programs.conditions import Conditions
from climber.wall import Wall, circle


@every_star
@pytest.mark.parametrize("seed", range(3))
def test_least_condition_is_the_slack_where_it_is_not_negative_and_negative_elsewhere(model: str, seed: int) -> None:
    here = standing(model, seed, (seed,) if seed else ())
    near = here.q[:2] + np.array([robot(model).reach.max() * 0.8, 0.0])
    body = Body(here.body.robot, Wall(here.body.wall.holds, (circle(near, 0.02), circle(here.q[:2] - 5.0, 0.02))))
    manifold = Manifold(body, here.contacts, here.manifold.support)
    for root in (None, here.contacts[0].limb):
        chart = manifold.chart(here.q, root)
        rng = np.random.default_rng(seed)
        start = chart.coordinates(here.q)
        u = start + rng.normal(scale=0.05, size=(200, len(start))) / chart.scale
        q, reach = chart.expand(u)
        slack = np.minimum(manifold.slack(q), reach - manifold.margins.reach)
        conditions = Conditions(manifold, chart)
        least = conditions.least(u)
        assert least.shape == (200, len(conditions.names)) and len(set(conditions.names)) == len(conditions.names)
        good = slack >= 0
        assert least.min(axis=1)[good] == pytest.approx(slack[good], abs=1e-12)
        assert (least.min(axis=1)[~good] <= 1e-12).all()


@every_star
def test_condition_that_fails_is_named(model: str) -> None:
    here = standing(model, 0)
    foot = here.body.wall.positions[1, :2]
    body = Body(here.body.robot, Wall(here.body.wall.holds, (circle(foot, 0.012),)))
    manifold = Manifold(body, here.contacts, here.manifold.support)
    chart = manifold.chart(here.q)
    conditions = Conditions(manifold, chart)
    least = conditions.least(chart.coordinates(here.q[None]))[0]
    failed = [name for name, value in zip(conditions.names, least, strict=True) if value < 0]
    last_link = body.robot.plant.GetJointByName(body.robot.limbs[1].joints[-1]).child_body().name()
    what = "obstacles" if body.robot.planar else "rock and obstacles"
    assert failed == [f"{last_link} clear of {what}"]
