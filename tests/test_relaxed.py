"""The relaxed checks one at a time: the same answers as the graph's, and every number they give recomputed."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import QUADRUPED, DiskRobot, random_wall, thesis_wall
from scipy.optimize import minimize
from shapely.geometry import Point, box

from climber.geometry import counter_clockwise, disks_meet
from climber.graph import build_stance_graph
from climber.moves import OVERLAP
from climber.polygon import in_order
from climber.programs.equilibrium import SupportProgram
from climber.programs.forces import wall_forces, weight_in_plane
from climber.programs.support import contact_intervals
from climber.relaxed import Check, RelaxedChecks, reach_lacking
from climber.scenario_fields import CostWeights
from climber.stance import Contact, Move, Stance, Vector
from climber.wall import GRIPS, Wall

LIMBS = ("right front", "left front", "left rear", "right rear")


def _checks(wall: Wall, robot: DiskRobot = QUADRUPED) -> RelaxedChecks:
    return RelaxedChecks(wall, robot, [f"limb {i}" for i in range(len(robot.reach))])


def _least_growth(centers: Vector, radii: Vector) -> float:
    """min over p of max_i |p - c_i| - r_i by a general solver: least s with |p - c_i| <= r_i + s."""
    start = np.append(centers.mean(axis=0), 1.0)
    constraints = [
        {"type": "ineq", "fun": lambda v, c=c, r=r: v[2] + r - np.linalg.norm(v[:2] - c)}
        for c, r in zip(centers, radii, strict=True)
    ]
    answer = minimize(lambda v: v[2], start, constraints=constraints, options={"ftol": 1e-12, "maxiter": 500})
    return float(answer.x[2])


@given(seed=st.integers(0, 10_000), k=st.integers(2, 6), equal=st.booleans())
@settings(max_examples=60, deadline=None)
def test_reach_lacks_what_a_general_solver_says(seed: int, k: int, equal: bool) -> None:
    rng = np.random.default_rng(seed)
    centers = rng.uniform(0.0, 1.0, (k, 2))
    radii = np.full(k, 0.3) if equal else rng.uniform(0.2, 0.5, k)
    lacking, point = reach_lacking(centers, radii)
    assert lacking == pytest.approx(_least_growth(centers, radii), abs=1e-6)
    assert point is not None
    assert (np.linalg.norm(point - centers, axis=1) - radii).max() == pytest.approx(lacking, abs=1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_reach_into_a_region_lacks_what_makes_it_just_possible(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centers, radii = rng.uniform(0.0, 0.4, (4, 2)), np.full(4, 0.3)
    region = box(*rng.uniform(0.5, 0.8, 2), 0.9, 0.9)
    lacking, _ = reach_lacking(centers, radii, region)
    disks = [Point(*c).buffer(r + lacking + 2e-4, quad_segs=256) for c, r in zip(centers, radii, strict=True)]
    overlap = region
    for disk in disks:
        overlap = overlap.intersection(disk)
    assert not overlap.is_empty
    disks = [Point(*c).buffer(r + lacking - 1e-6, quad_segs=256) for c, r in zip(centers, radii, strict=True)]
    overlap = region
    for disk in disks:
        overlap = overlap.intersection(disk)
    assert overlap.is_empty


@pytest.mark.parametrize("name", ["W1", "random", "unlike limbs", "two limbs", "three limbs"])
def test_a_move_passes_exactly_if_the_graph_has_it(name: str) -> None:
    robot, n = QUADRUPED, {"two limbs": 2, "three limbs": 3}.get(name, 4)
    if name == "W1":
        wall, start, _ = thesis_wall("W1")
    else:
        wall = random_wall(np.random.default_rng(5), 9, grips=("pin",) if n < 4 else GRIPS)
        if name == "unlike limbs":
            robot = DiskRobot(np.array([0.3, 0.35, 0.3, 0.35]), ((0, 1, 2, 3), (2, 3, 0, 1)))
        elif n < 4:
            robot = DiskRobot.with_limbs(n, reach=0.24)
        else:
            robot = DiskRobot.with_limbs(4, reach=0.33, fold=2)
        stances = (Stance(holds) for holds in permutations(range(9), n))
        starts = (stance for stance in stances if _stands(wall, robot, stance))
        start = next(s for s in starts if build_stance_graph(wall, robot, s, CostWeights()).num_edges > 20)
    graph, checks = build_stance_graph(wall, robot, start, CostWeights()), _checks(wall, robot)
    edges = set(zip(graph.tail.tolist(), graph.head.tolist(), strict=True))
    failures = {"reach": 0, "order": 0, "support": 0, "balance": 0}
    found = 0
    for vertex in range(0, graph.num_vertices, 1 if name == "W1" else max(1, graph.num_vertices // 12)):
        stance = Stance(tuple(graph.stances[vertex].tolist()))
        for limb, hold in product(range(n), range(len(wall.holds))):
            if hold in stance.holds:
                continue
            move = Move(stance, limb, hold)
            failure = checks.first_failure(checks.of_move(move))
            try:
                there = (vertex, graph.vertex(move.end)) in edges
            except KeyError:
                there = False
            assert (failure is None) == there, (move, failure)
            found += there
            if failure is not None:
                failures[failure.name] += 1
    assert found > 5 and failures["reach"] and (failures["order"] or n == 2)
    assert name == "W1" or n < 4 or failures["support"] + failures["balance"]


def _stands(wall: Wall, robot: DiskRobot, stance: Stance) -> bool:
    checks = _checks(wall, robot)
    return checks.first_failure(c for c in checks.of_stance(stance, "it") if c.name != "support") is None


def _random_failures(kind: str, number: int) -> list[tuple[Wall, RelaxedChecks, Move, Check]]:
    """Moves whose first failure is of one kind, on random walls."""
    rng = np.random.default_rng(7)
    found: list[tuple[Wall, RelaxedChecks, Move, Check]] = []
    while len(found) < number:
        wall = random_wall(rng, 5, grips=("friction",), size=0.4)
        wall = Wall(tuple(replace(hold, half_width=float(rng.uniform(0, 0.02))) for hold in wall.holds))
        checks = _checks(wall, DiskRobot.with_limbs(4, reach=0.21 if kind == "reach" else 0.3, fold=2))
        order, convex = counter_clockwise(wall.positions[None, :4, :2])
        if not convex[0]:
            continue
        for limb in range(4):
            move = Move(Stance(tuple(order[0].tolist())), limb, 4)
            failure = checks.first_failure(checks.of_move(move))
            if failure is not None and failure.name == kind:
                found.append((wall, checks, move, failure))
                break
    return found


def test_the_certificate_separates_the_weight_from_every_force() -> None:
    for wall, checks, _, failure in _random_failures("support", 12):
        holds, direction = failure.numbers["holds"], np.array(failure.numbers["direction"])
        forces, weight = wall_forces(wall), weight_in_plane(wall, checks._mass)
        best = 0.0
        for hold in holds:  # a linear function is greatest at a corner of the box of the generators' amounts
            corners = product(*zip(forces.lower[hold], forces.upper[hold], strict=True))
            best += max(
                float(direction @ (forces.offset[hold] + forces.generators[hold] @ np.array(t))) for t in corners
            )
        assert np.linalg.norm(direction) == pytest.approx(1.0)
        assert best < direction[1] * weight
        assert failure.amount == pytest.approx(direction[1] * weight - best, rel=1e-6, abs=1e-9)
        program = SupportProgram.of_contacts(wall, [Contact(i, hold) for i, hold in enumerate(holds)], checks._mass)
        assert program.solve().empty
        assert f"{failure.amount:.2f} N" in failure.sentence or failure.amount < 0.1


def test_supports_apart_are_as_far_apart_as_their_programs_say() -> None:
    for wall, checks, move, failure in _random_failures("balance", 6):
        staying = [Contact(i, hold) for i, hold in enumerate(move.start.holds) if i != move.limb]
        ends = [Contact(i, hold) for i, hold in enumerate(move.end.holds)]
        a, b = (SupportProgram.of_contacts(wall, contacts, checks._mass).solve() for contacts in (staying, ends))
        assert failure.amount == pytest.approx(max(a.lower, b.lower) - min(a.upper, b.upper), abs=1e-6)
        assert failure.amount > OVERLAP


def test_limbs_that_would_change_places_are_then_in_order() -> None:
    told = 0
    for wall, checks, move, failure in _random_failures("order", 25):
        holds = list(move.end.holds)
        assert not in_order(wall.positions[holds, :2])
        a, b, c = (checks.limbs.index(limb) for limb in failure.numbers["corner"])
        p, q, r = wall.positions[[holds[a], holds[b], holds[c]], :2]
        along = (r - p) / np.linalg.norm(r - p)
        assert failure.amount == pytest.approx(along[0] * (q - p)[1] - along[1] * (q - p)[0], abs=1e-9)
        assert failure.amount >= 0.0
        for one, other in failure.numbers["change_places"]:
            i, j = checks.limbs.index(one), checks.limbs.index(other)
            swapped = list(holds)
            swapped[i], swapped[j] = holds[j], holds[i]
            assert in_order(wall.positions[swapped, :2])
            told += 1
    assert told


@pytest.mark.parametrize("kind", ["reach", "order", "balance"])
def test_what_fails_anywhere_on_the_patches_fails_wherever_the_feet_stand(kind: str) -> None:
    rng = np.random.default_rng(11)
    anywhere = 0
    for wall, checks, move, failure in _random_failures(kind, 6 if kind == "balance" else 15):
        anywhere += failure.anywhere
        if not failure.anywhere:
            continue
        widths = np.array([hold.half_width for hold in wall.holds])
        for _ in range(50):
            offset = rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], len(widths)) * widths
            points = (wall.positions + offset[:, None] * wall.tangents)[:, :2]
            if kind == "reach":
                holds, reach = failure.numbers["holds"], np.array(failure.numbers["reach"])
                assert not disks_meet(points[holds][None], reach)[0]
            elif kind == "order":
                assert not in_order(points[list(move.end.holds)])
            else:
                feet = [Contact(i, hold, float(offset[hold])) for i, hold in enumerate(move.end.holds)]
                without = [contact for contact in feet if contact.limb != move.limb]
                one, both = (contact_intervals(wall, [some], checks._mass)[0] for some in (without, feet))
                assert max(one[0], both[0]) > min(one[1], both[1])
    assert 0 < anywhere


def test_a_hold_to_be_avoided_is_the_first_thing_said_of_a_move_to_it() -> None:
    wall, start, _ = thesis_wall("W1")
    checks = RelaxedChecks(wall, QUADRUPED, LIMBS, avoid=[5])
    failure = checks.first_failure(checks.of_move(Move(start, 0, 5)))
    assert failure is not None and failure.name == "avoid"
