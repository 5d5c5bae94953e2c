"""Every scenario that comes with climber solves from its file, and its plan verifies."""

from __future__ import annotations

import pytest

from climber.plan import plan_climb
from climber.resources import packaged_scenarios
from climber.scenario import load_scenario
from climber.verify import verify

ELSEWHERE = {"random_1000": "a thousand holds; `make bench` runs it"}
# What is not planned for as yet, by scenario.
WAITING = {"waypoint": "waypoints"}


@pytest.mark.parametrize("name", [name for name in packaged_scenarios() if name not in ELSEWHERE])
def test_it_solves_and_the_plan_verifies(name: str) -> None:
    if name in WAITING:
        pytest.skip(f"{WAITING[name]} are not planned for as yet")
    verdict = verify(plan_climb(load_scenario(name)))
    assert verdict.ok, str(verdict)
