"""A robot with three limbs: nothing depends on there being four."""

from __future__ import annotations

import numpy as np
import pytest

from climber.robot import Robot

THREE_LIMBED = "package://climber/three_limbed/three_limbed.urdf"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(THREE_LIMBED)


def test_turned_by_a_third_of_a_turn_it_is_the_same_robot(robot: Robot) -> None:
    assert robot.limb_names == ("top", "left", "right")
    assert robot.symmetries == ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    angles = np.arctan2(*np.array([limb.hip[1::-1] for limb in robot.limbs]).T)
    np.testing.assert_allclose(np.degrees(np.mod(np.roll(angles, -1) - angles, 2 * np.pi)), 120.0)


def test_its_six_links_are_alike_and_every_joint_has_a_motor(robot: Robot) -> None:
    links = [
        robot.plant.GetBodyByName(f"{limb}_{link}") for limb in robot.limb_names for link in ("upper_arm", "forearm")
    ]
    assert {link.default_mass() for link in links} == {0.1}
    assert robot.mass == pytest.approx(1.2)
    assert (robot.effort > 0).all()
    assert len(robot.joint_names) == 6
    assert robot.reach == pytest.approx([0.275] * 3)
