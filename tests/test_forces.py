"""What holds push with: planes through the normal, cones against pyramids, closed forms against programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import hold

from climber.programs.blocks import solve_blocks
from climber.programs.forces import ContactForces, wall_forces
from climber.programs.sections import EXACT, Section
from climber.stance import Vector
from climber.wall import GRIPS, Hold, Wall

SECTIONS = [EXACT, Section("inscribed", 3), Section("inscribed", 8), Section("circumscribed", 5)]
seeds = st.integers(0, 2**32 - 1)


def holds_in_space(rng: np.random.Generator, count: int, grips: tuple[str, ...] = GRIPS) -> Wall:
    """Holds anywhere with any normal and any limits."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Wall(
        tuple(
            Hold(
                tuple(rng.uniform(-0.5, 0.5, 3)),
                tuple(normal),
                friction=rng.uniform(0.0, 1.2),
                min_force=rng.choice([0.0, 2.0]),
                max_force=rng.uniform(5.0, 30.0),
                grip=str(rng.choice(grips)),
                adhesion=5.0,
            )
            for normal in normals
        )
    )


def two_cones(h: Hold, force: Vector) -> Vector:
    """How far forces (K, 3) are inside the two cones of a hold, as their definition has it [N], shape (K,)."""
    normal, cosine = np.array(h.normal), np.cos(np.arctan(h.friction))
    force = force + (h.adhesion * normal if h.grip == "magnet" else 0.0)
    along = force @ normal
    aside = np.linalg.norm(force - np.outer(along, normal), axis=1)
    lower, upper = 2 * h.min_force * cosine, 2 * h.max_force * cosine
    return np.minimum(h.friction * (along - lower), h.friction * (upper - along)) - aside


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_a_plane_through_the_normal_cuts_the_cones_in_the_planar_parallelogram(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h = hold(0, 0, rng.uniform(-180, 180), friction=rng.uniform(0.05, 1.5), min_force=1.0, max_force=9.0)
    h = replace(h, grip=str(rng.choice(["friction", "magnet"])), adhesion=3.0)
    plane, space = (wall_forces(Wall((h,)), dimension)[0] for dimension in (2, 3))
    edge = rng.uniform(-2.0, 12.0, (200, 2))  # multiples of the edges, inside and outside
    force = plane.offset + edge @ plane.generators.T
    t = np.linalg.solve(space.generators, (force - space.offset).T).T
    np.testing.assert_allclose(space.excess(t), plane.excess(edge), atol=1e-9)
    inside = two_cones(h, force)
    assert ((inside > 1e-9) <= (plane.excess(edge) < 0)).all() and ((inside < -1e-9) <= (plane.excess(edge) > 0)).all()


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_multiples_within_limits_are_forces_within_the_two_cones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = holds_in_space(rng, 1, ("friction", "magnet"))
    forces = wall_forces(wall, 3)[0]
    t = rng.uniform(-1, 1, (300, 3)) * 0.7 * (forces.upper - forces.lower) + 0.5 * (forces.upper + forces.lower)
    force = forces.offset + t @ forces.generators.T
    inside, outside = two_cones(wall.holds[0], force), forces.excess(t)
    assert ((inside > 1e-9) <= (outside < 0)).all()
    if wall.holds[0].friction > 1e-3:
        assert ((inside < -1e-9) <= (outside > 0)).all()


def test_a_pin_pulls_and_pushes_along_each_axis() -> None:
    forces = wall_forces(Wall((hold(0, 0, 40.0, grip="pin", max_force=8.0),)), 3)
    np.testing.assert_allclose(forces.generators[0], np.eye(3))
    np.testing.assert_allclose(forces.excess(np.array([[-8.0, 7.0, 0.0]])), [0.0])
    np.testing.assert_allclose(forces.excess(np.array([[1.0, 7.0, 9.0]])), [1.0])


@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: s.name)
@pytest.mark.parametrize("seed", range(3))
def test_the_greatest_multiple_in_a_direction_is_that_of_a_program(section: Section, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = holds_in_space(rng, 4)
    forces = wall_forces(wall, 3, section)
    limits, c = forces.limits(), rng.normal(size=(4, 3))
    none = np.zeros((1, 0, 12))
    found = solve_blocks(
        None, -c.reshape(1, 12), none, none[:, :, 0], limits.R[None], limits.g[None], limits.C[None], limits.d[None]
    )
    assert found is not None
    t = found.x
    np.testing.assert_allclose((c * t.reshape(4, 3)).sum(axis=1), forces.greatest(c), atol=1e-6)
    assert forces.excess(t.reshape(4, 3)).max() < 1e-7


@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: s.name)
def test_limits_say_the_same_as_excess(section: Section) -> None:
    rng = np.random.default_rng(7)
    forces: ContactForces = wall_forces(holds_in_space(rng, 3), 3, section)
    limits = forces.limits(forces.lower.ravel() + 0.1, forces.upper.ravel() - 0.1)
    for t in rng.uniform(-1, 1, (200, 3, 3)) * forces.upper:
        tops = limits.d - limits.C @ t.ravel()
        within = [limits.g - limits.R @ t.ravel(), tops[:, 0] - np.linalg.norm(tops[:, 1:], axis=1)]
        assert np.concatenate(within).min() == pytest.approx(
            -forces.excess(t, forces.lower + 0.1, forces.upper - 0.1).max(), abs=1e-9
        )


@given(seeds, st.integers(3, 20))
@settings(max_examples=20, deadline=None)
def test_inscribed_pyramids_are_conservative_and_circumscribed_ones_are_faithful(seed: int, edges: int) -> None:
    u = np.random.default_rng(seed).normal(size=(50, 2))
    inscribed, circumscribed = Section("inscribed", edges), Section("circumscribed", edges)
    assert (inscribed.size(u) >= EXACT.size(u) - 1e-12).all() and (circumscribed.size(u) <= EXACT.size(u) + 1e-12).all()
    assert (inscribed.size(u) <= EXACT.size(u) / np.cos(np.pi / edges) + 1e-12).all()
    assert [s.conservative for s in (EXACT, inscribed, circumscribed)] == [True, True, False]
    assert [s.faithful for s in (EXACT, inscribed, circumscribed)] == [True, False, True]
    np.testing.assert_allclose(inscribed.size(inscribed.corners), 1.0)
    np.testing.assert_allclose(circumscribed.size(circumscribed.corners), 1.0)


@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: s.name)
def test_sections_are_known_by_their_names(section: Section) -> None:
    assert Section.parse(section.name) == section


@pytest.mark.parametrize("name", ["round", "inscribed", "inscribed 2", "exact 4", "inscribed many", "inscribed -4"])
def test_sections_that_do_not_exist_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="section"):
        Section.parse(name)
