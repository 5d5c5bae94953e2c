"""Where the centre of mass may be in space: worked by hand, against Drake's solvers, against the plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from problems import EQUILIBRIUM_PROBLEMS, MASS_OF_20_N, EquilibriumProblem, hold, random_wall
from scipy.optimize import linprog
from test_forces import SECTIONS, holds_in_space

from climber.programs.equilibrium import RegionProgram
from climber.programs.forces import wall_forces
from climber.programs.regions import (
    contact_regions,
    hold_set_regions,
    hold_set_supports,
    hold_sets_carried,
    hold_sets_hold,
)
from climber.programs.sections import EXACT, Section
from climber.programs.support import hold_set_intervals
from climber.programs.wrenches import across
from climber.stance import Contact, Vector
from climber.wall import GRAVITY, Hold, Wall

seeds = st.integers(0, 2**32 - 1)
FINE = 1e-6
CIRCLE = np.column_stack([np.cos(np.linspace(0, 2 * np.pi, 24)), np.sin(np.linspace(0, 2 * np.pi, 24))])


def region_of_all(wall: Wall, mass: float = MASS_OF_20_N, gap: float = FINE, section: Section = EXACT):
    """The region of a robot in space that stands on every hold."""
    return hold_set_regions(wall, np.arange(len(wall.holds))[None], mass, 3, section, gap)


def climbable(rng: np.random.Generator, count: int, inclination_deg: float = 90.0) -> Wall:
    """Holds that mostly face up, in front of a wall."""
    normals = rng.normal(size=(count, 3)) * [0.5, 0.3, 0.4] + [0.0, 1.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    holds = tuple(
        Hold(tuple(p), tuple(n), rng.uniform(0.1, 0.8), min_force=rng.choice([0.0, 1.0]), max_force=rng.uniform(8, 40))
        for p, n in zip(rng.uniform(-0.4, 0.4, (count, 3)) * [1, 1, 0.3], normals, strict=True)
    )
    return Wall(holds, inclination_deg=inclination_deg)


# --- By hand ---------------------------------------------------------------------------------------------------------


def test_on_one_hold_the_centre_of_mass_is_over_it() -> None:
    region = region_of_all(Wall((replace(hold(0.3, 0.1), position=(0.3, 0.1, -0.2)),)))
    assert not region.empty[0] and region.gap[0] <= FINE
    np.testing.assert_allclose(region.corners[0], np.tile([0.3, -0.2], (region.corners.shape[1], 1)), atol=1e-6)
    np.testing.assert_allclose(region.margin(np.array([0.3, 5.0, -0.2])), [0.0], atol=1e-6)
    np.testing.assert_allclose(region.margin(np.array([0.31, 5.0, -0.2])), [-0.01], atol=1e-6)


@pytest.mark.parametrize("excess", [-1e-6, 1e-6])
def test_one_hold_carries_while_the_tangent_of_its_slope_is_less_than_its_friction(excess: float) -> None:
    slope = 0.4
    wall = Wall((Hold((0, 0, 0), (0.0, np.cos(slope), np.sin(slope)), np.tan(slope) + excess, max_force=1e3),))
    region = region_of_all(wall)
    assert region.empty[0] == (excess < 0.0)
    assert hold_sets_carried(wall, np.array([[0]]), MASS_OF_20_N, 3)[0] == (excess > 0.0)


def test_two_holds_facing_each_other_hold_what_is_between_them() -> None:
    """Pressed with N on either side and mu N >= 10 N, the weight can be anywhere on the line, and nowhere off it."""
    facing = {"friction": 0.5, "max_force": 40.0}
    left, right = hold(0.0, 0.0, -90.0, **facing), hold(0.8, 0.0, 90.0, **facing)
    region = region_of_all(Wall((left, right)))
    # Each side's upward share s mg needs N >= s mg / mu, at most half of 2 max cos(alpha), where the cones are widest.
    most = 0.5 * 2 * 40.0 * np.cos(np.arctan(0.5)) * 0.5 / 20.0  # greatest share of one side, T / mg
    np.testing.assert_allclose(region.corners[0, :, 0].min(), 0.8 * (1 - most), atol=2e-6)
    np.testing.assert_allclose(region.corners[0, :, 0].max(), 0.8 * most, atol=2e-6)
    np.testing.assert_allclose(region.corners[0, :, 1], 0.0, atol=2e-6)


@pytest.mark.parametrize("excess", [-1e-6, 1e-6])
@pytest.mark.parametrize("overhang", [0.0, 0.3, 0.7])
def test_a_chimney_is_climbed_if_friction_exceeds_the_tangent_of_an_angle(overhang: float, excess: float) -> None:
    """Walls that lean by beta over whoever is between them push down unless alpha > beta.

    Of its two edges the upper one alone pushes up, at alpha - beta: 2 F sin(alpha - beta) carries the weight W.
    """
    F = 100.0
    needed = np.tan(overhang + np.arcsin(20.0 / (2 * F)))
    c, s = np.cos(overhang), np.sin(overhang)
    walls = tuple(
        Hold((x, 0.0, 0.0), (side * c, -s, 0.0), needed + excess, max_force=F) for x, side in ((0.0, 1), (0.7, -1))
    )
    region = region_of_all(Wall(walls))
    assert region.empty[0] == (excess < 0.0)
    if excess > 0.0:
        np.testing.assert_allclose(region.corners[0], np.tile([0.35, 0.0], (region.corners.shape[1], 1)), atol=1e-3)


def test_beside_two_slippery_holds_there_is_no_support_in_line_with_them() -> None:
    """The polygon is a segment, and its ends are ends."""
    wall = Wall((hold(0, 0, friction=0), hold(1, 0.2, friction=0)))
    region = region_of_all(wall)
    margin = [region.margin(np.array(p))[0] for p in ((-0.01, 0, 0), (0.5, 0, 0), (1.01, 0, 0), (0.5, 0, 0.01))]
    np.testing.assert_allclose(margin, [-0.01, 0.0, -0.01, -0.01], atol=1e-6)


def test_without_contacts_the_whole_weight_is_missing() -> None:
    region = hold_set_regions(Wall((hold(0, 0),)), np.zeros((2, 0), dtype=int), MASS_OF_20_N, 3)
    assert region.empty.all() and not hold_sets_carried(Wall((hold(0, 0),)), np.zeros((2, 0), dtype=int), 2.0, 3).any()
    np.testing.assert_allclose(region.direction, [[0, 1, 0]] * 2)
    np.testing.assert_allclose(region.shortfall, 20.0)
    assert (region.margin(np.zeros(3)) == -np.inf).all()


def test_a_hold_of_no_force_neither_helps_nor_hinders() -> None:
    strong = replace(hold(0.3, 0.0), position=(0.3, 0.0, 0.1))
    wall = Wall((strong, hold(1.0, 1.0, 30.0, max_force=0.0)))
    np.testing.assert_allclose(region_of_all(wall).corners[0, 0], [0.3, 0.1], atol=1e-6)


def test_a_foot_in_space_turns_no_pin() -> None:
    wall = Wall((hold(0.3, 0, grip="pin", max_moment=5.0),))
    np.testing.assert_allclose(region_of_all(wall).corners[0], np.tile([0.3, 0.0], (4, 1)), atol=1e-6)


# --- The plane is a special case --------------------------------------------------------------------------------------


@pytest.mark.parametrize("problem", EQUILIBRIUM_PROBLEMS, ids=lambda p: p.name)
def test_holds_in_a_plane_support_along_it_what_they_support_within_it(problem: EquilibriumProblem) -> None:
    plane, space = (contact_regions(problem.wall, [problem.contacts], MASS_OF_20_N, d, gap=FINE) for d in (2, 3))
    assert plane.empty[0] == space.empty[0] == (problem.interval is None)
    if problem.interval is not None:
        np.testing.assert_allclose(plane.corners[0, :, 0], problem.interval, atol=1e-9)
        ends = [space.corners[0, :, 0].min(), space.corners[0, :, 0].max()]
        np.testing.assert_allclose(ends, problem.interval, atol=1e-6)


@given(seeds, st.integers(1, 5))
@settings(max_examples=40, deadline=None)
def test_planar_walls_have_the_same_supports_through_cones_in_space(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    wall = random_wall(rng, 12)
    sets = np.array([rng.choice(12, count, replace=False) for _ in range(20)])
    intervals = hold_set_intervals(wall, sets, 2.0)
    plane = hold_set_regions(wall, sets, 2.0)
    np.testing.assert_array_equal(plane.corners[..., 0], intervals)
    most, bound = hold_set_supports(wall, sets, 2.0, np.array([[-1.0, 0, 0], [1.0, 0, 0]]), 3, gap=1e-8)
    empty, narrow = np.isnan(intervals[:, 0]), intervals[:, 1] - intervals[:, 0] < 1e-6
    np.testing.assert_array_equal(np.isnan(most[:, 0])[~narrow], empty[~narrow])
    both = ~empty & ~np.isnan(most[:, 0])
    for found in (most, bound):
        np.testing.assert_allclose(found[both] * [-1, 1], intervals[both], atol=1e-6)
    in_plane, _ = hold_set_supports(wall, sets, 2.0, np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_allclose(in_plane[both] * [-1, 1], intervals[both], atol=1e-12)


def test_on_a_floor_a_planar_robot_is_supported_anywhere() -> None:
    floor = Wall((hold(0, 0, grip="pin"), hold(1, 0, grip="pin")), inclination_deg=0.0)
    region = hold_set_regions(floor, np.array([[0, 1]]), 2.0)
    assert not region.empty[0] and region.margin(np.array([7.0, 0.0, 0.0]))[0] == np.inf


# --- Against Drake's solvers ------------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 5), st.sampled_from(SECTIONS), st.sampled_from([60.0, 90.0, 130.0]))
@settings(max_examples=25, deadline=None)
def test_polygons_enclose_what_a_sweep_of_directions_finds(
    seed: int, count: int, section: Section, inclination: float
) -> None:
    rng = np.random.default_rng(seed)
    wall = replace(holds_in_space(rng, count) if seed % 2 else climbable(rng, count), inclination_deg=inclination)
    region = region_of_all(wall, 2.0, 1e-4, section)
    program = RegionProgram(wall.positions, wall_forces(wall, 3, section), 2.0 * wall.gravity)
    found = [program.solve(direction) for direction in CIRCLE]
    if region.empty[0] or any(point is None for point in found):
        assert (region.empty[0] and all(point is None for point in found)) or _nearly_empty(wall, section)
        return
    assert region.gap[0] <= 1e-4
    inner = (CIRCLE @ region.corners[0].T).max(axis=1)
    sweep = (CIRCLE * np.array(found)).sum(axis=1)
    assert (inner <= sweep + 1e-6).all() and (sweep <= inner + 1e-4 + 1e-6).all()
    outer = region.outer_A[0] @ across(wall.gravity).T  # in the plane across gravity
    assert (np.array(found) @ outer.T <= region.outer_b[0] + 1e-6).all()


def _nearly_empty(wall: Wall, section: Section) -> bool:
    """Whether a hundredth less weight, or more, changes what the answer is."""
    holds = np.arange(len(wall.holds))[None]
    return len({bool(hold_sets_carried(wall, holds, 2.0 * part, 3, section)[0]) for part in (0.9999, 1.0001)}) == 2


@given(seeds)
@settings(max_examples=25, deadline=None)
@example(47138)  # a region of a fifth of a micrometre, most of which is owed to limits that are widened
def test_what_is_inside_can_be_held_and_what_is_outside_cannot(seed: int) -> None:
    """To a micrometre either way."""
    rng = np.random.default_rng(seed)
    wall = climbable(rng, 4)
    region = region_of_all(wall, 2.0, 1e-4)
    if region.empty[0]:
        return
    program = RegionProgram(wall.positions, wall_forces(wall, 3), 2.0 * wall.gravity)
    corners = region.corners[0]
    weights = rng.dirichlet(np.ones(len(corners)), 3)
    for point in weights @ corners:
        assert region.margin(point @ region.basis)[0] >= -1e-9
        about = (point - program.origin - FINE, point - program.origin + FINE)
        there = program.prog.AddBoundingBoxConstraint(*about, program.c)
        assert program.solve(np.zeros(2)) is not None
        program.prog.RemoveConstraint(there)
    beyond = corners[0] + 2e-4 * (corners[0] - corners.mean(axis=0)) / max(np.ptp(corners), 1e-9) + 1e-3 * CIRCLE
    outside = (region.outer_A[0] @ (beyond @ region.basis).T > region.outer_b[0][:, None] + FINE).any(axis=0)
    for point in beyond[outside][:3]:
        there = program.prog.AddBoundingBoxConstraint(*(2 * [point - program.origin]), program.c)
        assert program.solve(np.zeros(2)) is None
        program.prog.RemoveConstraint(there)


@given(seeds, st.sampled_from(SECTIONS))
@settings(max_examples=25, deadline=None)
def test_what_cannot_be_held_comes_with_a_proof(seed: int, section: Section) -> None:
    """Along direction and turn the contacts' greatest is less than what the weight needs."""
    rng = np.random.default_rng(seed)
    wall = holds_in_space(rng, 12)
    sets = np.array([rng.choice(12, 3, replace=False) for _ in range(20)])
    region = hold_set_regions(wall, sets, 3.0, 3, section, 1e-2)
    forces, up = wall_forces(wall, 3, section)[sets], -3.0 * wall.gravity
    for i in np.flatnonzero(region.empty):
        arms = wall.positions[sets[i]] - wall.positions[sets[i]].mean(axis=0)
        down = wall.gravity / GRAVITY
        along = region.direction[i] + region.turning[i] * np.cross(down, arms)  # of a force at each contact
        c = np.einsum("kap,ka->kp", forces.generators[i], along)
        most = forces[i].greatest(c).sum() + (along * forces.offset[i]).sum()
        assert region.direction[i] @ up - most == pytest.approx(region.shortfall[i], abs=1e-6)
        assert region.shortfall[i] > 0.0


def test_sections_are_nested() -> None:
    rng = np.random.default_rng(11)
    wall = climbable(rng, 30)
    sets = np.array([rng.choice(30, 4, replace=False) for _ in range(60)])
    directions = np.column_stack([CIRCLE[:, 0], np.zeros(24), CIRCLE[:, 1]])
    names = ("inscribed 4", "inscribed 8", "exact", "circumscribed 8", "circumscribed 4")
    reach = [hold_set_supports(wall, sets, 2.0, directions, 3, Section.parse(name), 1e-7) for name in names]
    carried = [hold_sets_carried(wall, sets, 2.0, 3, Section.parse(name)) for name in names]
    for (inner, _), (_, outer), some, more in zip(reach, reach[1:], carried, carried[1:], strict=False):
        both = ~np.isnan(inner[:, 0])
        assert (some <= more).all() and (inner[both] <= outer[both] + 1e-6).all()
    assert np.nanmax(reach[4][0] - reach[0][0]) > 1e-3  # and they do differ


def test_a_region_shrinks_as_friction_falls() -> None:
    wall = climbable(np.random.default_rng(5), 4)
    areas = []
    for friction in (1.0, 0.6, 0.3):
        slippery = Wall(tuple(replace(h, friction=friction, max_force=60.0) for h in wall.holds))
        x, z = region_of_all(slippery, 2.0, 1e-4).corners[0].T
        areas.append(0.5 * abs((x * np.roll(z, -1) - z * np.roll(x, -1)).sum()))
    assert areas[0] > areas[1] > areas[2]


def test_many_sets_are_answered_as_one_by_one() -> None:
    rng = np.random.default_rng(3)
    wall = climbable(rng, 20)
    sets = np.array([rng.choice(20, 4, replace=False) for _ in range(30)])
    together = hold_set_regions(wall, sets, 2.0, 3, gap=1e-3)
    for i in range(30):
        alone = hold_set_regions(wall, sets[[i]], 2.0, 3, gap=1e-3)
        assert alone.empty[0] == together.empty[i]
        if not alone.empty[0]:
            p = wall.positions[sets[i]].mean(axis=0)
            assert alone.margin(p)[0] == pytest.approx(together.margin(p)[i], abs=2e-3)


def test_feet_stand_where_contacts_say() -> None:
    wall = Wall((replace(hold(0.3, 0.1), half_width=0.02),))
    region = contact_regions(wall, [[Contact(0, 0, 0.01)]], MASS_OF_20_N, 3)
    np.testing.assert_allclose(region.corners[0, 0, 0], wall.point(Contact(0, 0, 0.01))[0], atol=1e-6)


def test_without_gravity_there_is_no_polygon() -> None:
    wall = Wall((hold(0, 0),))
    with pytest.raises(ValueError, match="anywhere"):
        hold_set_regions(wall, np.array([[0]]), 0.0, 3)


# --- Against another statement of it ----------------------------------------------------------------------------------


def by_generators(points: Vector, normals: Vector, friction: float, center: Vector, edges: int) -> bool:
    """Whether nonnegative forces along the edges of inscribed pyramids balance a weight along -z: a linear program."""
    columns = []
    for point, normal in zip(points, normals, strict=True):
        tangents = np.linalg.svd(normal[None])[2][1:]
        for angle in np.arange(edges) * 2 * np.pi / edges:
            f = normal + friction * (np.cos(angle) * tangents[0] + np.sin(angle) * tangents[1])
            columns.append([*f, *np.cross(point - center, f)])
    answer = linprog(np.zeros(len(columns)), A_eq=np.array(columns).T, b_eq=[0, 0, 1.0, 0, 0, 0])
    assert answer.status in (0, 2)
    return bool(answer.status == 0)


def test_on_a_thousand_sets_of_contacts_only_the_side_that_pyramids_err_on_tells_them_from_cones() -> None:
    """Inscribed pyramids hold no more than cones, and all that cones of so much less friction as fit in them hold."""
    rng, edges, per_wall = np.random.default_rng(1), 8, 50
    held, differ = 0, 0
    for _ in range(1000 // per_wall):
        wall = replace(climbable(rng, 40), inclination_deg=0.0)  # its gravity is along -z
        turned = np.column_stack([wall.normals[:, 0], -wall.normals[:, 2], wall.normals[:, 1]])
        friction = float(rng.uniform(0.1, 1.0))
        sets = np.array([rng.choice(40, int(rng.integers(3, 5)), replace=False)[:3] for _ in range(per_wall)])
        centers = wall.positions[sets].mean(axis=1) + rng.uniform(-0.15, 0.15, (per_wall, 3))

        def cones(friction: float, wall: Wall = wall, normals: Vector = turned) -> Wall:
            holds = zip(wall.positions.tolist(), normals.tolist(), strict=True)
            return replace(wall, holds=tuple(Hold(tuple(p), tuple(n), friction, max_force=1e4) for p, n in holds))

        fit = friction * np.cos(np.pi / edges)
        most, least = (hold_sets_hold(cones(mu), sets, 2.0, centers, 3) for mu in (friction + 1e-5, fit - 1e-5))
        assert (least <= most).all()
        for s, center, may, must in zip(sets, centers, most, least, strict=True):
            answer = by_generators(wall.positions[s], turned[s], friction, center, edges)
            assert must <= answer <= may
            held, differ = held + answer, differ + (may != must)
    assert 100 < held < 900 and differ < 100


@pytest.mark.parametrize("dimension", [2, 3])
def test_what_is_held_is_what_regions_contain(dimension: int) -> None:
    rng = np.random.default_rng(4)
    wall = random_wall(rng, 30) if dimension == 2 else climbable(rng, 30)
    sets = np.array([rng.choice(30, 4, replace=False) for _ in range(100)])
    centers = rng.uniform(-0.4, 0.8, (100, 3)) * [1.0, 1.0, 0.2]
    margin = hold_set_regions(wall, sets, 2.0, dimension, gap=1e-5).margin(centers)
    held = hold_sets_hold(wall, sets, 2.0, centers, dimension)
    clear = np.abs(margin) > 2e-5
    np.testing.assert_array_equal(held[clear], margin[clear] > 0.0)
    assert 5 < held.sum() < 95
