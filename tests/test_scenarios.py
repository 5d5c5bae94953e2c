"""Every scenario that comes with climber solves from its file, its plan verifies, and is climbed in simulation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from plans import just_within
from stored import planned

from climber.exceptions import NoPlanFound
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.resources import packaged_scenarios
from climber.scenario import load_scenario
from climber.simulate import SAME, simulate, simulate_starts
from climber.simulation import SLIP_LIMIT, Perturbation
from climber.simulation_loop import Setting
from climber.verify import verify

ELSEWHERE = {
    "random_1000": "a thousand holds; `make bench` runs it",
}
SEEDS = 5  # each another plan, and another start to climb it from; `make bench` takes 20
# Up to a minute for one plan: planned once, and climbed from as many starts.
DEAR = ("team", "waypoint", "wider", "random_100", "obstacle")
# Likewise up to a minute for one plan, and a quarter of one for each climb.
SPACE = ("board", "lemur_chimney", "lemur_corner", "lemur_overhang", "lemur_slab", "lemur_vertical")
PLANAR = [name for name in packaged_scenarios() if name not in (*ELSEWHERE, *DEAR, *SPACE)]
ERRORS = ("normals", "worst push", "heavier", "lighter", "worst center")
START_ERROR = 0.001  # [m]


def sound(plan: Plan, in_space: bool) -> Setting:
    """What to simulate of a plan that verifies and is timed as it should be."""
    verdict = verify(plan)
    assert verdict.ok, str(verdict)
    # Every phase is timed by the conic program, and if it leads anywhere, a limit keeps it from being faster.
    phases = [phase for robot in plan.robots for phase in robot.phases]
    assert {phase.timing.method for phase in phases} == {"conic"}
    moving = [phase for phase in phases if np.ptp(phase.q, axis=0).max() > 0.1]
    # (A leg that was slowed because its samples showed more than the program saw is at no limit; in space more are.)
    assert moving and sum(not phase.timing.active for phase in moving) <= (0.2 if in_space else 0.1) * len(moving)
    return Setting(plan)


def climbed(setting: Setting, perturbation: Perturbation) -> None:
    """Nobody falls, and no foot that holds slips by more than a millimetre."""
    climb = simulate(setting, perturbation)
    told = [(robot.name, robot.fell, robot.slipped) for robot in climb.robots]
    assert climb.ok, (perturbation.seed, climb.slip, told)


def climbed_from_elsewhere(setting: Setting, starts: int) -> None:
    """Nobody falls, and no foot that holds slips by more than a millimetre, wherever the robots start."""
    places = [Perturbation(start_error=START_ERROR, seed=seed) for seed in range(starts)]
    for climb in simulate_starts(setting, places):
        told = [(robot.fell, robot.slip, robot.slipped) for robot in climb.robots]
        # That it is not quite the same state that others go on from may add to a slip.
        assert not climb.fell and climb.slip < SLIP_LIMIT - SAME, (climb.perturbation.seed, told)


@pytest.mark.parametrize("name", (*DEAR, *SPACE))
def test_it_solves_and_the_plan_verifies_and_is_climbed_from_wherever_it_starts(name: str) -> None:
    climbed_from_elsewhere(sound(planned(name), in_space=name in SPACE), SEEDS)


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("name", PLANAR)
def test_it_solves_and_the_plan_verifies_and_is_climbed_whatever_the_seed(name: str, seed: int) -> None:
    setting = sound(planned(name, seed), in_space=False)
    climbed(setting, Perturbation(start_error=START_ERROR, seed=seed))
    if name == "basic":  # and what its margins certify is survived, one kind with each plan
        climbed(setting, just_within(planned(name, seed), ERRORS[seed], seed))


@pytest.mark.parametrize("error", ["friction", "normals", "worst push", "lighter"])
@pytest.mark.parametrize("name", ["higher", "wider"])
def test_stretches_of_a_climb_survive_what_just_their_phases_certify(name: str, error: str) -> None:
    (robot,) = planned(name).robots
    for first in range(2, len(robot.phases) - 3, 10):
        part = replace(planned(name), robots=(replace(robot, phases=robot.phases[first : first + 3]),))
        climbed(Setting(part), just_within(part, error, first))


def test_another_seed_gives_another_motion_and_the_cost_is_proved_least_with_each() -> None:
    plans = [planned("higher", seed) for seed in range(2)]
    assert [plan.seed for plan in plans] == [0, 1]
    assert all(plan.robots[0].proofs["cost"] is True for plan in plans)
    one, other = (np.vstack([phase.q for phase in plan.robots[0].phases]) for plan in plans)
    assert one.shape != other.shape or np.abs(one - other).max() > 0.1


def test_on_the_obstacle_wall_the_first_plan_has_postures_but_no_motion() -> None:
    robot = planned("obstacle").robots[0]
    failed = {(cut.limb, cut.hold) for cut in robot.cuts if cut.stage == "motion"}
    assert failed
    # Without the ledge, those are moves to make.
    scenario = load_scenario("obstacle")
    scenario.wall.obstacles.clear()
    (free,) = plan_climb(scenario).robots
    made = {(limb, b[limb]) for a, b in pairwise(free.stances) for limb in a if a[limb] != b[limb]}
    assert failed & made
    assert free.moves < robot.moves


def test_who_need_not_keep_off_steps_on_the_hold_and_enters_the_region() -> None:
    scenario = load_scenario("avoid")
    avoid = scenario.robots[0].avoid
    assert avoid.holds
    assert avoid.regions
    avoid.holds, avoid.regions = [], []
    free = plan_climb(scenario)
    assert free.robots[0].moves < planned("avoid").robots[0].moves
    # The same motion, judged by what the scenario asks for.
    verdict = verify(replace(free, scenario_text=load_scenario("avoid").source))
    assert {check.name for check in verdict.checks if not check.ok} == {"avoided", "obstacle clearance"}


def test_the_double_link_comes_back_only_if_failures_refine_the_graph() -> None:
    robot = planned("double_link").robots[0]
    stances = [tuple(stance.values()) for stance in robot.stances]
    assert len(stances) > len(set(stances))
    scenario = load_scenario("double_link")
    scenario.on_failure = "cut"
    with pytest.raises(NoPlanFound):
        plan_climb(scenario)
