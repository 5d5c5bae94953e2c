"""Postures to start a climb in: any that can be held, or the one that the scenario prescribes."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from climber.scenario import Scenario
from climber.stance import Contact, Stance, Vector
from climber.transition import Postures
from climber.transitions import TransitionFinder

AGREEMENT = 1e-3  # [rad] a prescribed joint angle is met this closely or not at all


def start_postures(scenario: Scenario, index: int, finder: TransitionFinder, stance: Stance) -> Postures:
    """Postures on the start stance, with the joints that the scenario prescribes where it says.

    Raises:
        ScenarioError: If the robot cannot be held on the start stance, or not in that posture.
    """
    spec, path = scenario.robots[index], f"robots[{index}].start"
    found = finder.standing(tuple(Contact(limb, hold) for limb, hold in enumerate(stance.holds)))
    if found.failure is not None:
        raise scenario.error(path, spec.start, f"a stance that the robot can hold; {found.failure.reason}")
    if not spec.start_posture:
        return found
    q = _matched(finder, found, spec.start_posture)
    if q is None:
        given = {name: round(angle, 4) for name, angle in spec.start_posture.items()}
        raise scenario.error(
            f"{path}_posture",
            given,
            f"joint angles, met within {AGREEMENT:g} rad, that the robot can hold on its start stance",
        )
    branches = np.array([finder.body.branches(q)])
    return Postures(found.contacts, q[None], branches, np.zeros(1))


def _matched(finder: TransitionFinder, found: Postures, wanted: dict[str, float]) -> Vector | None:
    """A feasible posture with the wanted joint angles, or None.

    Each sampled posture is pulled there along its chart; those that bend their limbs the same way come first.
    """
    robot = finder.body.robot
    places = np.array([robot.position_names.index(name) for name in wanted])
    angles = np.array(list(wanted.values()))
    manifold = finder.manifold(found.contacts)
    assert manifold is not None  # postures were found on it
    for i in np.argsort(np.abs(found.q[:, places] - angles).max(axis=1)):
        chart = manifold.chart(found.q[i])

        def off(u: Vector, chart=chart) -> Vector:  # type: ignore[no-untyped-def]
            result: Vector = chart.expand(u[None])[0][0, places] - angles
            return result

        u = least_squares(off, chart.coordinates(found.q[i]), xtol=1e-12, ftol=1e-12).x
        q, reach = chart.expand(u[None])
        if np.abs(q[0, places] - angles).max() <= AGREEMENT and reach[0] > 0 and manifold.slack(q)[0] >= 0:
            result: Vector = q[0]
            return result
    return None
