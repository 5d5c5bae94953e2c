"""From a scenario to a plan that holds."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from climbs import short
from stored import planned

from climber.exceptions import NoPlanFound, ScenarioError
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import Scenario, load_scenario, scenario_from_text
from climber.verify import verify


@pytest.fixture(scope="module")
def basic() -> Plan:
    return planned("basic")


@pytest.fixture(scope="module")
def beginning() -> Plan:
    return plan_climb(short())


def edited(name: str, *changes: tuple[str, str]) -> Scenario:
    """A scenario that comes with climber, with parts of its text replaced."""
    text = load_scenario(name).source
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return scenario_from_text(text, f"{name}, edited")


def test_the_basic_climb_holds_up(basic: Plan) -> None:
    verdict = verify(basic)
    assert verdict.ok, str(verdict)


def test_the_basic_climb_takes_thirteen_moves_proved_on_what_is_left_of_the_graph(basic: Plan) -> None:
    robot = basic.robots[0]
    assert robot.moves == 13
    assert robot.proofs["moves"] is True
    assert robot.proofs["cost"] is True


def test_plans_for_a_model_of_one_s_own_hold_wherever_they_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    comes_along = load_scenario("three_limbed")
    url, folder = comes_along.robots[0].model, tmp_path / "climbs"
    shutil.copytree(comes_along.model_path(0).parent, folder)
    (folder / "mine.yaml").write_text(comes_along.source.replace(url, url.rpartition("/")[2]))
    monkeypatch.chdir(tmp_path)
    plan_climb(load_scenario("climbs/mine.yaml")).save("plan.json")
    monkeypatch.chdir("/")
    verdict = verify(tmp_path / "plan.json")
    assert verdict.ok, str(verdict)


def test_phases_alternate_and_begin_and_end_with_a_shift(basic: Plan) -> None:
    kinds = [phase.kind for phase in basic.robots[0].phases]
    assert kinds == ["shift", "swing"] * 13 + ["shift"]


def test_every_cut_says_why(basic: Plan) -> None:
    cuts = basic.robots[0].cuts
    assert cuts
    for cut in cuts:
        assert cut.kind in ("proved", "budget")
        assert len(cut.reason) > 10


def test_the_same_seed_gives_the_same_plan(beginning: Plan) -> None:
    again = plan_climb(short())
    for one, two in zip(beginning.robots[0].phases, again.robots[0].phases, strict=True):
        np.testing.assert_array_equal(one.q, two.q)
        np.testing.assert_array_equal(one.torque, two.torque)


def test_a_wall_with_an_obstacle_in_the_way_is_climbed_around_it(beginning: Plan) -> None:
    text = short().source.replace(
        "robots:\n", "  obstacles:\n  - circle: {center: [0.30, 0.33], radius: 0.02}\nrobots:\n"
    )
    through = verify(replace(beginning, scenario_text=text))
    assert {check.name for check in through.failures} == {"obstacle clearance"}
    verdict = verify(plan_climb(scenario_from_text(text, "short, with an obstacle")))
    assert verdict.ok, str(verdict)


def test_avoided_holds_are_not_stood_on() -> None:
    free = planned("higher")
    used = {hold for stance in free.robots[0].stances for hold in stance.values()}
    spec = load_scenario("higher").robots[0]
    ends = set(spec.start.values()) | set(spec.goal.holds or ())
    avoided = min(used - ends)
    scenario = load_scenario("higher")
    scenario.robots[0].avoid.holds = [avoided]
    plan = plan_climb(scenario)
    assert avoided not in {hold for stance in plan.robots[0].stances for hold in stance.values()}


def test_a_goal_out_of_reach_of_every_stance_is_proved_impossible() -> None:
    scenario = edited("basic", ("  - {position: [0.407017, -0.014286]", "  - {position: [0.407017, -9.014286]"))
    with pytest.raises(NoPlanFound) as raised:
        plan_climb(scenario)
    assert raised.value.proved
    assert raised.value.counts


def test_two_newtons_on_every_foot_are_proved_to_leave_no_climb() -> None:
    with pytest.raises(NoPlanFound) as raised:
        plan_climb(edited("basic", ("min_force: 0.5", "min_force: 2.0")))
    assert raised.value.proved
    assert all(cut.kind == "proved" for cut in raised.value.cuts)


def test_searches_that_gave_up_are_not_called_a_proof() -> None:
    # An obstacle between the start and the goal holds, which the planar robot cannot step over.
    wall = "  obstacles:\n  - polygon: {vertices: [[0.25, -0.3], [0.35, -0.3], [0.35, 0.6], [0.25, 0.6]]}\nrobots:\n"
    scenario = scenario_from_text(short().source.replace("robots:\n", wall), "short, with an obstacle")
    scenario.budget.posture_samples = 500  # that more of them find nothing either would take a minute to see
    with pytest.raises(NoPlanFound) as raised:
        plan_climb(scenario)
    assert not raised.value.proved
    assert any(cut.kind == "budget" for cut in raised.value.cuts)


def test_a_start_that_cannot_be_held_is_an_error_in_the_scenario() -> None:
    scenario = edited("basic", ("friction: 0.6166", "friction: 0.0"), ("friction: 0.6414", "friction: 0.0"))
    scenario.wall.hold_defaults.friction = 0.0
    for hold in scenario.wall.holds:
        hold.friction, hold.normal = 0.0, [1.0, 0.0]
    with pytest.raises(ScenarioError, match=r"robots\[0\]\.start"):
        plan_climb(scenario)


def test_a_prescribed_start_posture_is_the_first_sample(beginning: Plan) -> None:
    robot = beginning.robots[0]
    q = robot.phases[2].q[0] * 0 + robot.phases[0].q[0]
    wanted = {name: float(q[robot.positions.index(name)]) for name in robot.joints}
    scenario = short()
    scenario.robots[0].start_posture = wanted
    first = plan_climb(scenario).robots[0].phases[0].q[0]
    for name, angle in wanted.items():
        assert first[robot.positions.index(name)] == pytest.approx(angle, abs=2e-3)


def test_an_impossible_start_posture_is_an_error() -> None:
    scenario = load_scenario("basic")
    scenario.robots[0].start_posture = {"right_front_knee": 2.6, "left_rear_knee": 2.6, "right_rear_knee": 2.6}
    with pytest.raises(ScenarioError, match="start_posture"):
        plan_climb(scenario)


@pytest.mark.parametrize(
    ("argument", "value", "path"),
    [
        ("seed", -1, "seed"),
        ("seed", 1.5, "seed"),
        ("objective", "speed", "objective"),
        ("time_limit", 0.0, "budget.time_limit_s"),
        ("improve", float("nan"), "budget.improve_s"),
        ("improve", -1.0, "budget.improve_s"),
        ("min_margin", {"push": "much"}, "min_margin.push"),
        ("min_margin", 0.1, "min_margin"),
    ],
)
def test_an_argument_that_is_not_what_its_field_may_be_is_refused(argument: str, value: Any, path: str) -> None:
    with pytest.raises(ScenarioError, match=f"arguments: {path}: given .*; allowed: ") as raised:
        plan_climb(load_scenario("basic"), **{argument: value})
    assert raised.value.path == path


def test_no_time_is_not_the_same_as_no_climb() -> None:
    with pytest.raises(NoPlanFound) as raised:
        plan_climb(load_scenario("higher"), time_limit=1e-3)
    assert not raised.value.proved
    assert "time limit" in str(raised.value)


def test_a_goal_that_is_only_a_region_ends_with_the_pelvis_in_it() -> None:
    scenario = load_scenario("higher")
    scenario.robots[0].goal = replace(scenario.robots[0].goal, holds=None)
    region = scenario.robots[0].goal.pelvis
    assert region is not None
    robot = plan_climb(scenario).robots[0]
    x, y = robot.phases[-1].q[-1][:2]
    assert region.distance(x, y) == 0.0
