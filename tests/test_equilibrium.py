"""Support intervals: worked by hand, against cvxpy, and the batched route against the single program."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EQUILIBRIUM_PROBLEMS, MASS_OF_20_N, EquilibriumProblem, hold, random_wall

from climber.programs.equilibrium import SupportInterval, SupportProgram
from climber.programs.forces import ContactForces, wall_forces, weight_in_plane
from climber.programs.support import contact_intervals, hold_set_intervals, support_intervals
from climber.stance import Contact
from climber.wall import GRIPS, Hold, Wall

by_name = pytest.mark.parametrize("problem", EQUILIBRIUM_PROBLEMS, ids=lambda p: p.name)


@by_name
def test_program_gives_the_interval_worked_out_by_hand(problem: EquilibriumProblem) -> None:
    interval = SupportProgram.of_contacts(problem.wall, problem.contacts, MASS_OF_20_N).solve()
    assert interval.empty == (problem.interval is None)
    if problem.interval is not None:
        assert (interval.lower, interval.upper) == pytest.approx(problem.interval, abs=1e-9)
        assert interval.width == pytest.approx(problem.interval[1] - problem.interval[0], abs=1e-9)


@by_name
def test_batched_route_gives_the_interval_worked_out_by_hand(problem: EquilibriumProblem) -> None:
    (interval,) = contact_intervals(problem.wall, [problem.contacts], MASS_OF_20_N)
    expected = (np.nan, np.nan) if problem.interval is None else problem.interval
    assert tuple(interval) == pytest.approx(expected, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("problem", [p for p in EQUILIBRIUM_PROBLEMS if p.interval is None], ids=lambda p: p.name)
def test_empty_interval_says_in_which_direction_the_contacts_fail_and_by_how_much(problem: EquilibriumProblem) -> None:
    interval = SupportProgram.of_contacts(problem.wall, problem.contacts, MASS_OF_20_N).solve()
    assert interval.direction is not None and problem.direction is not None
    assert interval.direction == pytest.approx((*problem.direction, 0.0), abs=1e-6)
    assert interval.shortfall == pytest.approx(problem.shortfall, abs=1e-6)
    assert interval.margin(0.0) == -np.inf and interval.width == 0.0


def test_no_contact_carries_nothing() -> None:
    interval = SupportProgram.of_contacts(Wall((hold(0, 0),)), [], MASS_OF_20_N).solve()
    assert interval.empty and interval.shortfall == pytest.approx(20.0)
    assert np.isnan(hold_set_intervals(Wall((hold(0, 0),)), np.zeros((3, 0), dtype=int), MASS_OF_20_N)).all()


def test_margin_is_the_distance_to_the_nearer_end_and_negative_outside() -> None:
    wall = Wall((hold(0, 0, friction=0), hold(1, 0, friction=0)))
    program = SupportProgram.of_contacts(wall, [Contact(0, 0), Contact(1, 1)], MASS_OF_20_N)
    assert [program.margin(x) for x in (0.25, 0.9, 1.5)] == pytest.approx([0.25, 0.1, -0.5])


def test_program_can_be_read_before_it_is_solved() -> None:
    wall = Wall((hold(0, 0), hold(1, 0, 20.0)))
    prog = SupportProgram.of_contacts(wall, [Contact(0, 0), Contact(1, 1)], MASS_OF_20_N).prog
    names = [binding.evaluator().get_description() for binding in prog.GetAllConstraints()]
    assert names == [
        "force balance along x",
        "force balance along y",
        "torque balance",
        "force limits of contact 0",
        "force limits of contact 1",
    ]
    assert not prog.GetAllCosts() and prog.num_vars() == 5


def test_friction_cone_edges_are_at_the_friction_angle_on_either_side_of_the_normal() -> None:
    forces = wall_forces(Wall((hold(0, 0, slope_deg=30.0, friction=1.0),)))[0]
    angles = np.degrees(np.arctan2(forces.generators[1], forces.generators[0]))
    assert angles == pytest.approx([90 + 30 + 45, 90 + 30 - 45])


def test_planar_cone_of_a_normal_that_leaves_the_plane_is_refused() -> None:
    with pytest.raises(ValueError, match="normal in the wall plane"):
        wall_forces(Wall((Hold((0, 0, 0), (0.0, 0.8, 0.6), 0.5),)))


def test_an_inclined_wall_pulls_less_along_itself() -> None:
    slab = Wall((hold(0, 0, max_force=6.0, friction=0),), inclination_deg=30.0)
    assert weight_in_plane(slab, MASS_OF_20_N) == pytest.approx(10.0)
    assert not SupportProgram.of_contacts(slab, [Contact(0, 0)], MASS_OF_20_N).solve().empty
    assert not np.isnan(hold_set_intervals(slab, np.array([[0]]), MASS_OF_20_N)).any()
    upright = Wall(slab.holds)
    assert np.isnan(hold_set_intervals(upright, np.array([[0]]), MASS_OF_20_N)).all()


def on_a_floor(*holds: Hold) -> Wall:
    return Wall(holds, inclination_deg=0.0)


def both_routes(wall: Wall, mass: float = MASS_OF_20_N) -> tuple[SupportInterval, tuple[float, float]]:
    """The answers of the program and of the batched route for feet on all holds."""
    every = range(len(wall.holds))
    lower, upper = hold_set_intervals(wall, np.array([every]), mass)[0]
    return SupportProgram.of_contacts(wall, [Contact(i, i) for i in every], mass).solve(), (float(lower), float(upper))


def test_on_a_floor_pins_hold_the_robot_wherever_its_centre_of_mass_is() -> None:
    program, batched = both_routes(on_a_floor(hold(0, 0, grip="pin"), hold(1, 0, grip="pin")))
    assert (program.lower, program.upper) == batched == (-np.inf, np.inf)
    assert program.margin(3.0) == np.inf


def test_on_a_floor_least_forces_that_do_not_cancel_hold_nothing() -> None:
    program, batched = both_routes(on_a_floor(hold(0, 0, min_force=1.0), hold(1, 0, min_force=1.0)))
    assert program.empty and np.isnan(batched).all()
    assert program.direction is not None and program.direction[1] == pytest.approx(-1.0)


def test_on_a_floor_forces_that_cancel_may_still_turn_the_robot() -> None:
    facing = {"friction": 0.0, "min_force": 1.0, "max_force": 2.0}
    opposite = replace(hold(0, 1, **facing), normal=(0.0, -1.0, 0.0))
    straight = on_a_floor(hold(0, 0, **facing), opposite)
    assert not both_routes(straight)[0].empty and both_routes(straight)[1] == (-np.inf, np.inf)
    program, batched = both_routes(on_a_floor(hold(-0.1, 0, **facing), opposite))
    assert program.empty and np.isnan(batched).all()
    # A couple of at least 2 N (both cone edges coincide) with an arm of 0.1 m.
    assert program.direction == pytest.approx([0.0, 0.0, 1.0]) and program.shortfall == pytest.approx(0.2)


def test_a_gripper_that_turns_its_pin_widens_the_interval_by_moment_over_weight() -> None:
    wall = Wall((hold(0.3, 0, grip="pin", max_moment=5.0), hold(0.9, 0, min_force=0.0, max_force=0.0)))
    program, batched = both_routes(wall)
    assert (program.lower, program.upper) == pytest.approx((0.3 - 5.0 / 20.0, 0.3 + 5.0 / 20.0), abs=1e-9)
    assert batched == pytest.approx((program.lower, program.upper), abs=1e-9)


def test_batched_route_equals_the_program_where_grippers_turn_pins() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        holds = [
            hold(
                *rng.uniform(0, 1, 2),
                grip=str(rng.choice(GRIPS)),
                max_force=rng.uniform(5, 30),
                max_moment=rng.uniform(0, 3),
            )
            for _ in range(3)
        ]
        program, batched = both_routes(Wall(tuple(holds)))
        assert program.empty == bool(np.isnan(batched).any())
        if not program.empty:
            assert batched == pytest.approx((program.lower, program.upper), abs=1e-6)


def test_batched_route_equals_the_program_on_thousands_of_random_sets() -> None:
    rng = np.random.default_rng(1)
    num_empty = num_full = 0
    for grips in (("friction",), ("friction", "magnet"), GRIPS):
        wall = random_wall(rng, 40, grips)
        for k in range(1, 6):
            sets = np.array([rng.choice(40, k, replace=False) for _ in range(100)])
            offsets = rng.uniform(-0.02, 0.02, sets.shape)
            feet = [[Contact(i, int(h), o) for i, (h, o) in enumerate(row)] for row in np.dstack([sets, offsets])]
            for contacts, interval in zip(feet, contact_intervals(wall, feet, 2.0), strict=True):
                reference = SupportProgram.of_contacts(wall, contacts, 2.0).solve()
                assert tuple(interval) == pytest.approx((reference.lower, reference.upper), abs=1e-6, nan_ok=True)
                num_empty += reference.empty
                num_full += not reference.empty
    assert num_empty > 200 and num_full > 200


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_batched_route_on_parallel_generators_equals_the_program(k: int) -> None:
    """A ladder: all normals alike, so generators come in parallel families, and without friction in only one."""
    rng = np.random.default_rng(2)
    for friction in (0.0, 0.5):
        wall = Wall(
            tuple(hold(*rng.uniform(0, 1, 2), friction=friction, max_force=rng.uniform(3, 9)) for _ in range(12))
        )
        sets = np.array([rng.choice(12, k, replace=False) for _ in range(40)])
        for row, interval in zip(sets, hold_set_intervals(wall, sets, 2.0), strict=True):
            reference = SupportProgram(wall.positions[row], wall_forces(wall)[row], weight_in_plane(wall, 2.0)).solve()
            assert tuple(interval) == pytest.approx((reference.lower, reference.upper), abs=1e-6, nan_ok=True)


def test_an_answer_does_not_depend_on_the_batch_it_is_in() -> None:
    rng = np.random.default_rng(3)
    wall = random_wall(rng, 30)
    sets = np.array([rng.choice(30, 3, replace=False) for _ in range(3000)])
    together = hold_set_intervals(wall, sets, 2.0)
    alone = np.concatenate([hold_set_intervals(wall, row[None], 2.0) for row in sets[::50]])
    np.testing.assert_array_equal(together[::50], alone)


holds = st.builds(
    hold,
    st.integers(-50, 50).map(lambda i: i / 100),
    st.integers(-50, 50).map(lambda i: i / 100),
    st.integers(-180, 180),
    friction=st.integers(0, 20).map(lambda i: i / 10),
    min_force=st.sampled_from([0.0, 0.0, 2.0]),
    max_force=st.integers(2, 40).map(float),
    grip=st.sampled_from(GRIPS),
    adhesion=st.integers(0, 30).map(float),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(holds, min_size=1, max_size=5))
def test_both_routes_agree_with_cvxpy(chosen: list[Hold]) -> None:
    forces, points = wall_forces(Wall(tuple(chosen))), np.array([h.position for h in chosen])
    expected = _with_cvxpy(chosen, 19.62)
    interval = SupportProgram(points, forces, 19.62).solve()
    (batched,) = support_intervals(points[None], forces[None], 19.62)
    if not interval.empty == (expected is None) == bool(np.isnan(batched).any()):
        # On the border of what can be carried, tolerances decide; a thousandth of a newton away they must not.
        assert _with_cvxpy(chosen, 19.62, 1e-3) is not None
        assert None in (_with_cvxpy(chosen, 19.619), _with_cvxpy(chosen, 19.621)) or interval.width < 1e-6
        return
    if expected is not None:
        assert (interval.lower, interval.upper) == pytest.approx(expected, abs=1e-6)
        assert tuple(batched) == pytest.approx(expected, abs=1e-6)
    else:
        _check_certificate(forces, interval.direction, interval.shortfall)


def _check_certificate(forces: ContactForces, direction: np.ndarray | None, shortfall: float) -> None:
    assert direction is not None
    along = np.einsum("d,kdp->kp", direction, forces.generators)
    most = (forces.offset @ direction).sum() + np.maximum(forces.lower * along, forces.upper * along).sum()
    assert 19.62 * direction[1] - most == pytest.approx(shortfall, abs=1e-9) and shortfall > 0


def _with_cvxpy(chosen: list[Hold], weight: float, give: float = 0.0) -> tuple[float, float] | None:
    """The interval from the forces themselves, not from generators; `give` [N] relaxes force balance."""
    x = cp.Variable()
    total_x, total_y, torque, constraints = 0.0, 0.0, 0.0, []
    for h in chosen:
        f = cp.Variable(2)
        if h.grip == "pin":
            constraints.append(cp.abs(f) <= h.max_force)
        else:
            n = np.array(h.normal[:2])
            pressed = f + (h.adhesion if h.grip == "magnet" else 0.0) * n
            # The parts along the cone's edges: normal force (t1 + t2) cos a, tangential force (t1 - t2) sin a.
            a = np.arctan(h.friction)
            normal, tangential = n @ pressed, np.array([-n[1], n[0]]) @ pressed
            t1, t2 = cp.Variable(), cp.Variable()
            constraints += [normal == (t1 + t2) * np.cos(a), tangential == (t1 - t2) * np.sin(a)]
            constraints += [t1 >= h.min_force, t1 <= h.max_force, t2 >= h.min_force, t2 <= h.max_force]
        total_x, total_y = total_x + f[0], total_y + f[1]
        torque = torque + h.position[0] * f[1] - h.position[1] * f[0]
    constraints += [cp.abs(total_x) <= give, cp.abs(total_y - weight) <= give, torque == x * weight]
    ends = []
    for sense in (cp.Minimize, cp.Maximize):
        problem = cp.Problem(sense(x), constraints)
        problem.solve(solver=cp.SCIPY, scipy_options={"method": "highs-ds"})
        if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            return None
        ends.append(float(x.value))
    return ends[0], ends[1]
