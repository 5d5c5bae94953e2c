"""Explanations: every claim recomputed, and every change that would help tried."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, count, islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from climbs import short
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from climber.changes import FRICTION, ChangeFinder, more_friction
from climber.cli import main
from climber.exceptions import NoPlanFound, ScenarioError
from climber.explain import explain_climb, explain_failure
from climber.explain_move import explain_move
from climber.explanation import Explanation
from climber.frontier import FrontierFinder
from climber.move_question import MoveQuestion
from climber.plan import plan_climb
from climber.plan_parts import Cut
from climber.prune import impossible_moves
from climber.reachable import RelaxedClimb
from climber.robot import Robot
from climber.scenario import CircleSpec, Place, RegionSpec, Scenario, load_scenario, scenario_from_text
from climber.stance import Move, Stance
from climber.stance_graph import StanceGraph

BASIC = load_scenario("basic").source
GAP = BASIC.replace("[0.407017, -0.014286]", "[0.407017, -9.0]")  # hold 4 out of the way
SLIPPERY = BASIC.replace("min_force: 0.5, max_force: 20.0", "min_force: 1.5, max_force: 8.0")
REGION = BASIC.replace("    holds: [6, 7, 8, 9]\n", "").replace(
    "[0.699769, 0.132026], radius: 0.06", "[1.1, 0.1], radius: 0.1"
)


def _scenario(text: str, name: str = "wall") -> Scenario:
    return scenario_from_text(text, name)


def _fewest_moves(scenario: Scenario, pruned: bool = True) -> int | None:
    """Fewest moves on the stance graph by another method, None if there is no climb."""
    climb = RelaxedClimb.of(scenario)
    graph = climb.graph()
    goals = climb.goal.vertices(graph)
    kept = np.ones(graph.num_edges, dtype=bool)
    if pruned:
        kept[impossible_moves(graph, climb.robot, climb.wall, goals)] = False
    ends = (graph.tail[kept], graph.head[kept])
    links = csr_array((np.ones(len(ends[0])), ends), shape=(graph.num_vertices, graph.num_vertices))
    moves = dijkstra(links, indices=graph.start, unweighted=True)[goals].min(initial=np.inf)
    return int(moves) if np.isfinite(moves) else None


@pytest.fixture(scope="module", autouse=True)
def trials() -> Iterator[None]:
    """Time for trying changes is counted in trials, so that as many are made on a slow machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("climber.changes.clock", SimpleNamespace(perf_counter=map(float, count()).__next__))
        yield


@pytest.fixture(scope="module")
def gap(trials: None) -> tuple[Scenario, Explanation]:
    scenario = _scenario(GAP)
    return scenario, explain_climb(scenario, seconds=90.0)


@pytest.mark.parametrize("name", ["basic", "higher"])
def test_a_climb_is_said_to_exist_with_its_number_of_moves_on_the_graph(name: str) -> None:
    scenario = load_scenario(name)
    told = explain_climb(scenario)
    assert told.answer == "climb" and not told.proved
    assert told.moves == _fewest_moves(scenario, pruned=False)
    assert told.moves_possible == _fewest_moves(scenario)
    assert f"a climb of {told.moves} moves" in told.sentences[0]


# --- what is missing -------------------------------------------------------------------------------------------------


def test_a_gap_is_proved_and_the_holds_beyond_it_are_never_held(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    assert told.answer == "no climb" and told.proved and told.moves is None
    graph = RelaxedClimb.of(scenario).graph()
    assert told.missing is not None and told.frontier is not None
    assert set(told.missing.never_held) == {6, 7, 8, 9} - set(graph.stances.ravel().tolist())
    assert told.frontier.reached == graph.num_vertices
    assert set(told.frontier.holds) == set(graph.stances.ravel().tolist())
    assert "holds 6, 7, 8 and 9" in told.sentences[0]


def test_the_frontier_is_reached_and_nothing_reached_is_nearer(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    climb = RelaxedClimb.of(scenario)
    graph, positions = climb.graph(), climb.wall.positions[:, :2]
    goal = positions[[6, 7, 8, 9]].mean(axis=0)
    assert told.frontier is not None
    away = np.linalg.norm(positions[graph.stances].mean(axis=1) - goal, axis=1)
    assert told.frontier.distances[0] == pytest.approx(away.min())
    for stance, distance in zip(told.frontier.stances, told.frontier.distances, strict=True):
        graph.vertex(stance)  # raises if it is not there
        assert distance == pytest.approx(np.linalg.norm(positions[list(stance.holds)].mean(axis=0) - goal))
    held = list(told.frontier.holds)
    nearest = held[int(np.linalg.norm(positions[held] - goal, axis=1).argmin())]
    assert told.frontier.farthest_hold == nearest


def test_moves_out_of_the_frontier_fail_the_check_that_is_told(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    graph, wall = RelaxedClimb.of(scenario).graph(), scenario.build_wall()
    assert told.frontier is not None and told.frontier.blocked
    for blocked in told.frontier.blocked:
        with pytest.raises(KeyError):
            graph.edge(graph.vertex(blocked.move.start), graph.vertex(blocked.move.end))
        assert blocked.check is not None and not blocked.check.ok
        if blocked.check.name == "reach":
            points = wall.positions[list(blocked.check.numbers["holds"]), :2]
            assert _enclosing_radius(points) == pytest.approx(0.25 + blocked.check.amount, abs=1e-6)
            assert _enclosing_radius(points) > 0.25


def _enclosing_radius(points: np.ndarray) -> float:
    """Radius of the smallest enclosing circle: the least of those through two or three points that hold all."""
    centers = [(p + q) / 2 for p, q in combinations(points, 2)]
    for p, q, r in combinations(points, 3):
        system = 2 * np.array([q - p, r - p])
        if abs(np.linalg.det(system)) > 1e-12:
            centers.append(np.linalg.solve(system, [q @ q - p @ p, r @ r - p @ p]))
    return min(float(np.linalg.norm(points - center, axis=1).max()) for center in centers)


def test_no_move_leads_into_a_goal_beyond_a_gap(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    assert told.missing is not None and told.missing.check is None and told.missing.no_way_in is not None
    climb = RelaxedClimb.of(scenario)
    from_goal = replace(climb, start=Stance((6, 8, 9, 7))).graph()  # a graph that has every move into the goal and out
    goal = from_goal.vertex(Stance((6, 8, 9, 7)))
    assert not (from_goal.head == goal).any()


def test_a_goal_too_wide_is_told_of_by_itself() -> None:
    scenario = _scenario(BASIC.replace("[0.781567, 0.262179]", "[1.081567, 0.262179]"))
    told = explain_climb(scenario, seconds=8.0)
    assert told.proved and told.missing is not None
    check = told.missing.check
    assert check is not None and check.name == "reach"
    radius = _enclosing_radius(scenario.build_wall().positions[[6, 7, 8, 9], :2])
    assert check.amount == pytest.approx(radius - 0.25, abs=1e-6)
    assert told.changes is not None and told.changes.places_tried == 0  # no other hold brings these together


def test_a_goal_stance_with_crossed_limbs_is_told_of() -> None:
    crossed = "    stance: {right_front: 6, left_front: 7, left_rear: 8, right_rear: 9}\n"
    told = explain_climb(_scenario(BASIC.replace("    holds: [6, 7, 8, 9]\n", crossed)), seconds=4.0)
    assert told.proved and told.missing is not None and told.missing.check is not None
    assert told.missing.check.name == "order"
    assert ["right_front", "left_front"] in told.missing.check.numbers["change_places"]


def test_limbs_longer_by_what_is_lacking_bring_the_pelvis_into_the_region() -> None:
    scenario = _scenario(REGION)
    told = explain_climb(scenario, seconds=4.0)
    assert told.proved and told.missing is not None and told.missing.region_lacking is not None
    lacking, nearest = told.missing.region_lacking
    climb = RelaxedClimb.of(scenario)
    graph = climb.graph()
    for growth, there in ((lacking + 1e-6, True), (lacking - 1e-6, False)):
        longer = replace(graph, _reach=np.asarray(climb.robot.reach) + growth)
        found = longer.goal_vertices(region=climb.goal.region)
        assert bool(len(found)) == there
        if there:
            assert graph.vertex(nearest) in found


def test_a_start_that_cannot_be_stood_on_is_the_explanation() -> None:
    told = explain_climb(_scenario(BASIC.replace("right_front: 3, left_front: 1", "right_front: 9, left_front: 1")))
    assert told.proved and told.start is not None and told.start.name == "reach"
    heavy = explain_climb(
        _scenario(BASIC.replace("min_force: 0.5, max_force: 20.0", "min_force: 9.0, max_force: 20.0"))
    )
    assert heavy.proved and heavy.start is not None and heavy.start.name == "support"


def test_waypoints_count_in_any_order_or_the_given_one() -> None:
    climb = RelaxedClimb.of(load_scenario("basic"))
    graph = climb.graph()
    far, near = (
        replace(climb.goal, name=name, holds=holds, region=None)
        for name, holds in (("far", (4, 5, 6, 7)), ("near", (2, 3, 4, 5)))
    )
    any_order = replace(climb, waypoints=(far, near), in_order=False).reached(graph)
    in_order = replace(climb, waypoints=(far, near), in_order=True).reached(graph)
    backwards = replace(climb, waypoints=(near, far), in_order=True).reached(graph)
    assert any_order.moves == min(_through(climb, graph, (near, far)), _through(climb, graph, (far, near)))
    assert in_order.moves == _through(climb, graph, (far, near))
    assert backwards.moves == _through(climb, graph, (near, far))
    assert in_order.moves > any_order.moves


def _through(climb: RelaxedClimb, graph: StanceGraph, places: tuple) -> int:  # type: ignore[type-arg]
    """Fewest moves by way of places in order, by plain dynamic programming over all pairs."""
    num = graph.num_vertices
    steps = np.full((num, num), np.inf)
    steps[graph.tail, graph.head] = 1
    np.fill_diagonal(steps, 0)
    for k in range(num):
        steps = np.minimum(steps, steps[:, k : k + 1] + steps[k : k + 1])
    total = steps[graph.start]
    for place in (*places, climb.goal):
        there = place.vertices(graph)
        total = (total[there][:, None] + steps[there]).min(axis=0)
    return int(total[climb.goal.vertices(graph)].min())


# --- what would make a climb -----------------------------------------------------------------------------------------


def test_one_hold_more_makes_the_climb_it_is_said_to(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    assert told.changes is not None and told.changes.hold is not None
    changed = told.changes.hold.on_scenario(scenario)
    assert len(changed.wall.holds) == len(scenario.wall.holds) + 1
    assert _fewest_moves(changed) == told.changes.hold.moves
    assert changed.build_wall().holds == told.changes.hold.on(scenario.build_wall()).holds
    assert any("One hold more" in sentence for sentence in told.sentences)
    assert 0 < len(told.changes.holds) <= told.changes.places_tried
    assert told.changes.hold.moves == min(change.moves for change in told.changes.holds)
    asked: list[int] = []

    def planner(changed: Scenario, seconds: float) -> bool:  # has a plan the third time it is asked
        asked.append(_fewest_moves(changed) or 0)
        return len(asked) == 3

    planned = told.changes.asked(planner, scenario, 60.0)
    assert asked == [change.moves for change in told.changes.holds[:3]]
    assert [change.planned for change in planned.holds[:3]] == [False, False, True]
    assert planned.hold == planned.holds[2]


def test_friction_cannot_help_across_a_gap(gap: tuple[Scenario, Explanation]) -> None:
    scenario, told = gap
    assert told.changes is not None and not told.changes.forces_matter
    climb = RelaxedClimb.of(scenario)
    for friction in (0.1, 0.5, 1.0, 2.0):
        holds = tuple(replace(hold, friction=friction, min_force=0.0) for hold in climb.wall.holds)
        assert climb.on(replace(climb.wall, holds=holds)).reached().moves is None


@pytest.mark.parametrize(("friction", "max_force", "least", "alone"), [(0.33, 20, 0.5, True), (0.3, 20, 0.5, False)])
def test_more_friction_makes_the_climb_it_is_said_to(
    friction: float, max_force: float, least: float, alone: bool
) -> None:
    text = BASIC.replace("min_force: 0.5, max_force: 20.0", f"min_force: {least}, max_force: {max_force}")
    scenario = _scenario(text)
    holds = [replace(hold, friction=friction) for hold in scenario.wall.holds]
    scenario = replace(scenario, wall=replace(scenario.wall, holds=holds))
    told = explain_climb(scenario, seconds=30.0)
    assert told.proved and told.changes is not None and told.changes.friction and told.changes.friction_all_tried
    assert any(len(change.holds) == 1 for change in told.changes.friction) == alone
    helped = {change.holds: change.moves for change in told.changes.friction}
    every = tuple(range(len(scenario.wall.holds)))
    climb = RelaxedClimb.of(scenario)
    for holds in [every, *((hold,) for hold in every)]:
        changed = climb.on(more_friction(climb.wall, holds))
        graph = changed.graph()
        assert changed.reached(graph, changed.impossible(graph)).moves == helped.get(holds)
    for change in told.changes.friction:
        better = change.on_scenario(scenario)
        assert _fewest_moves(better) == change.moves
        raised = [a.friction - b.friction for a, b in zip(better.build_wall().holds, climb.wall.holds, strict=True)]
        assert np.allclose(raised, [FRICTION if hold in change.holds else 0.0 for hold in every])
    assert any("friction coefficient 0.05 higher" in sentence for sentence in told.sentences)


def test_changes_are_the_same_for_the_same_seed() -> None:
    scenario = _scenario(GAP)
    climb = RelaxedClimb.of(scenario)
    finder = FrontierFinder(climb, climb.reached())
    frontier = finder.find(climb.goal)
    new = climb.wall.holds[0]
    places = [
        list(islice(ChangeFinder(climb, new, np.random.default_rng(3), 1.0)._places(frontier, climb.goal), 20))
        for _ in range(2)
    ]
    assert (np.array(places[0]) == np.array(places[1])).all() and len(places[0]) == 20


# --- after the planner gave moves up ---------------------------------------------------------------------------------


def _given_up(kinds: tuple[str, ...]) -> tuple[Scenario, NoPlanFound]:
    """The planner's answer had it given up every move into the goal, for reasons of several kinds."""
    scenario = load_scenario("basic")
    climb = RelaxedClimb.of(scenario)
    graph, limbs = climb.graph(), climb.robot.limb_names
    cuts, removed = [], []
    into = np.flatnonzero(np.isin(graph.head, climb.goal.vertices(graph)))
    for number, edge in enumerate(into.tolist()):
        start, end = (Stance(tuple(graph.stances[v].tolist())) for v in (graph.tail[edge], graph.head[edge]))
        end = next(e for e in graph.images(end) if sum(a != b for a, b in zip(start.holds, e.holds, strict=True)) == 1)
        limb = next(i for i in range(4) if start.holds[i] != end.holds[i])
        move = Move(start, limb, end.holds[limb])
        kind = kinds[number % len(kinds)]
        stance = dict(zip(limbs, start.holds, strict=True))
        cuts.append(
            Cut(stance=stance, limb=limbs[limb], hold=move.hold, reason=f"reason {number}", kind=kind, stage="motion")
        )  # type: ignore[arg-type]
        removed.append([move])
    return scenario, NoPlanFound("gave up", proved=False, cuts=cuts, removed=removed)


def test_moves_proved_impossible_prove_that_there_is_no_climb() -> None:
    scenario, failure = _given_up(("proved",))
    told = explain_climb(scenario, failure=failure)
    assert told.answer == "no climb" and told.proved
    assert told.moves is not None  # the stance graph by itself has a climb
    assert len(told.cuts) == len(failure.cuts)


def test_what_only_the_budget_speaks_against_is_never_called_proved() -> None:
    scenario, failure = _given_up(("proved", "budget"))
    told = explain_climb(scenario, failure=failure)
    assert told.answer == "no motion found" and not told.proved
    assert "does not prove" in told.sentences[0]
    assert told.frontier is not None
    at_frontier = {stance.holds for stance in told.frontier.stances}
    expected = {cut.kind for cut in told.cuts if tuple(cut.stance.values()) in at_frontier}
    assert expected  # the goal's neighbours are as near to it as one gets
    assert {blocked.to_dict(told.limbs)["kind"] for blocked in told.frontier.blocked if blocked.given_up} == expected
    reasons = {cut.reason for cut in told.cuts}
    for blocked in told.frontier.blocked:
        assert blocked.check is not None or (blocked.given_up is not None and blocked.given_up.reason in reasons)


def test_a_planner_that_stopped_early_leaves_a_climb_to_be_tried() -> None:
    scenario = load_scenario("basic")
    told = explain_climb(scenario, failure=NoPlanFound("the time limit of 1 s came first", proved=False))
    assert told.answer == "climb" and any("time limit" in sentence for sentence in told.sentences)


def test_what_the_planner_itself_gave_up_is_told_of_as_not_found() -> None:
    """A disk in the middle of the wall, and little effort: the planner ends without a plan, having proved nothing."""
    disk = "  obstacles:\n  - circle: {center: [0.42, 0.14], radius: 0.13}\nrobots:"
    blocked = short().source.replace("robots:", disk, 1)
    effort = "budget: {posture_samples: 200, postures: 4, path_attempts: 1, path_iterations: 10}\n"
    scenario = _scenario(f"{blocked}\n{effort}")
    with pytest.raises(NoPlanFound) as caught:
        plan_climb(scenario, time_limit=3600.0)
    failure = caught.value
    assert not failure.proved and failure.reached is not None and len(failure.removed) == len(failure.cuts)
    climb = RelaxedClimb.of(scenario)
    graph = climb.graph()
    assert not set(map(graph.vertex, failure.reached)) & set(climb.goal.vertices(graph).tolist())
    gone = climb.impossible(graph)
    for move in (move for moves in failure.removed for move in moves):
        gone[graph.edge(graph.vertex(move.start), graph.vertex(move.end))] = True
    left = climb.reached(graph, gone)  # pieces of stances told apart can only leave less
    assert all(left.has(stance) for stance in failure.reached)

    told = explain_failure(failure)
    assert told is not None and told.answer == "no motion found" and told.frontier is not None
    assert told.frontier.reached == len(failure.reached)
    reasons = {cut.reason for cut in told.cuts}
    given_up = [b.given_up for b in told.frontier.blocked if b.given_up is not None and b.given_up.kind == "budget"]
    assert given_up and {why.reason for why in given_up} <= reasons


def test_of_a_team_the_robot_without_a_climb_of_its_own_is_told_of() -> None:
    scenario = load_scenario("team")
    failure = NoPlanFound("gave up", proved=False, scenario=scenario)
    told = explain_failure(failure)
    assert told is not None and told.answer == "climb" and any("alone" in line for line in told.sentences)
    assert not any("gave up" in line for line in told.sentences)  # whoever has the failure has been told
    out_of_reach = Place(pelvis=RegionSpec(circle=CircleSpec(center=[9.0, 9.0], radius=0.1)))
    robots = [scenario.robots[0], replace(scenario.robots[1], goal=out_of_reach)]
    failure = NoPlanFound("gave up", proved=False, scenario=replace(scenario, robots=robots))
    told = explain_failure(failure)
    assert told is not None and told.proved and told.robot == robots[1].name


# --- one move --------------------------------------------------------------------------------------------------------


def test_a_possible_move_comes_with_the_postures_found_for_it() -> None:
    scenario = load_scenario("basic")
    told = explain_move(scenario, MoveQuestion("right_front", 3, 5))
    assert told.answer == "possible" and told.move is not None
    wall, robot = scenario.build_wall(), Robot(scenario.robots[0].model)
    for q, stance in ((told.letting_go, told.move.start), (told.taking_hold, told.move.end)):
        context = robot.context()
        robot.plant.SetPositions(context, np.array(q))
        gap = np.linalg.norm(robot.foot_positions(context) - wall.positions[list(stance.holds)], axis=1)
        assert gap[[0, 1, 2, 3] if stance == told.move.start else [1, 2, 3]].max() < 1e-6
        assert gap.max() <= 0.01 + 1e-6  # the foot that lands may do so anywhere on its patch


def test_a_move_out_of_reach_is_short_by_the_circle_less_the_reach() -> None:
    scenario = load_scenario("basic")
    told = explain_move(scenario, MoveQuestion("right_front", 3, 7))
    assert told.answer == "impossible" and told.where == "graph" and told.check is not None
    radius = _enclosing_radius(scenario.build_wall().positions[[7, 1, 0, 2], :2])
    assert told.check.name == "reach" and told.check.amount == pytest.approx(radius - 0.25, abs=1e-6)
    assert f"{100 * (radius - 0.25):.1f} cm" in told.sentences[0]


def test_the_first_stance_in_which_a_move_can_be_asked_about_is_the_nearest() -> None:
    scenario = load_scenario("basic")
    climb = RelaxedClimb.of(scenario)
    reached = climb.reached()
    told = explain_move(scenario, MoveQuestion("right_front", 5, 9))
    assert told.stance.holds[0] == 5 and 9 not in told.stance.holds
    fits = []
    for vertex in reached.vertices:
        for image in reached.graph.images(Stance(tuple(reached.graph.stances[vertex].tolist()))):
            if image.holds[0] == 5 and 9 not in image.holds:
                fits.append(int(reached.distance[vertex]))
    assert told.moves_to_stance == min(fits)


def test_every_answer_about_a_move_from_the_start_agrees_with_the_graph() -> None:
    scenario = _scenario(SLIPPERY)
    climb = RelaxedClimb.of(scenario)
    graph, limbs = climb.graph(), climb.robot.limb_names
    told_impossible = 0
    for limb in range(4):
        for hold in set(range(10)) - set(climb.start.holds):
            move = Move(climb.start, limb, hold)
            try:
                graph.edge(graph.start, graph.vertex(move.end))
            except KeyError:
                told = explain_move(scenario, MoveQuestion(limbs[limb], move.released, hold))
                assert told.answer == "impossible" and told.check is not None
                told_impossible += 1
    assert told_impossible > 10


@pytest.mark.parametrize(
    ("move", "stance", "path"),
    [
        ("arm:3:7", None, "--move.limb"),
        ("right_front:3", None, "--move"),
        ("right_front:3:x", None, "--move"),
        ("right_front:3:10", None, "--move.to"),
        ("right_front:10:3", None, "--move.from"),
        ("right_front:3:3", None, "--move.to"),
        ("right_front:3:1", "3,1,0,2", "--move.to"),
        ("right_front:5:4", "3,1,0,2", "--move.from"),
        (None, "3,1,0", "--stance"),
        (None, "3,1,0,0", "--stance.right_rear"),
        (None, "3,1,0,12", "--stance.right_rear"),
        (None, "3,1,0,-2", "--stance"),
        (None, "right_front=3,left_front=1,left_rear=0", "--stance.right_rear"),
        (None, "right_front=3,left_front=1,left_rear=0,tail=2", "--stance.tail"),
        (None, "right_front=3,right_front=1,left_rear=0,right_rear=2", "--stance.right_front"),
    ],
)
def test_a_question_that_names_what_is_not_there_is_refused_by_field(
    move: str | None, stance: str | None, path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = load_scenario("basic")
    with pytest.raises(ScenarioError) as caught:
        explain_move(scenario, MoveQuestion.parse(scenario, move, stance))
    assert caught.value.path == path and caught.value.allowed
    arguments = ["explain", "basic", *(["--move", move] if move else []), *(["--stance", stance] if stance else [])]
    assert main(arguments) == 2
    assert path in capsys.readouterr().err


# --- the command -----------------------------------------------------------------------------------------------------


def test_explain_tells_in_sentences_and_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "gap.yaml").write_text(GAP)
    arguments = ["explain", str(tmp_path / "gap.yaml"), "--time-limit", "4"]
    assert main(arguments) == 0
    assert "cannot be reached" in capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "no climb" and facts["missing"]["never_held"] == [6, 7, 8, 9]
    assert facts["frontier"]["blocked"][0]["why"]["fails_by"] > 0


def test_solve_tells_why_it_found_no_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "gap.yaml").write_text(GAP)
    assert main(["solve", str(tmp_path / "gap.yaml"), "--out", str(tmp_path / "out"), "--json"]) == 1
    said = capsys.readouterr()
    facts = json.loads(said.out)
    assert facts["proved"] and facts["explanation"]["missing"]["never_held"] == [6, 7, 8, 9]
    assert "cannot be reached" in said.err


def test_explain_of_a_move_takes_stances_by_limb_in_any_order(capsys: pytest.CaptureFixture[str]) -> None:
    stance = "left_rear=0,right_rear=2,right_front=3,left_front=1"
    assert main(["explain", "basic", "--move", "right_front:3:7", "--stance", stance, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (
        facts["answer"] == "impossible"
        and facts["proved"]
        and facts["check"]["fails_by"] == pytest.approx(0.07, abs=0.001)
    )
    assert main(["explain", "basic", "--robot", "nobody"]) == 2
