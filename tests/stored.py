"""Climbs that come along planned once, for all tests that need one, whichever process they run in."""

from __future__ import annotations

import fcntl
import os
from functools import cache
from pathlib import Path

from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import load_scenario

VARIABLE = "CLIMBER_PLANS"  # names the folder that the processes of a run share
NO_HURRY = 3600.0  # [s] what a test plans does not depend on how fast the machine is


@cache
def planned(name: str, more: int = 0) -> Plan:
    """The plan of a scenario with its own seed, or with so many more."""
    path = Path(os.environ[VARIABLE]) / f"{name}-{more}.json"
    with open(path.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until it is closed
        if path.exists():
            return Plan.load(path)
        scenario = load_scenario(name)
        plan = plan_climb(scenario, seed=scenario.seed + more, time_limit=NO_HURRY)
        plan.save(path)
    return plan
