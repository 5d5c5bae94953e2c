"""What keeps a plan from being faster, as people read it."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from plans import step_plan
from rich.console import Console

from climber.cli import main
from climber.limit_table import limit_table, limits_of, told_in_short
from climber.plan_file import Plan
from climber.plan_parts import PhaseTiming

ACTIVE = (  # the swing is from 0.8 to 1.6 s
    (0.8, 1.2, "speed right_front_hip"),
    (1.0, 1.2, "jerk right_front_hip"),
    (1.1, 1.4, "friction left_front"),
    (1.3, 1.4, "friction left_rear"),
)


def limited() -> Plan:
    """A plan whose swing runs at some limits."""
    plan = step_plan()
    (robot,) = plan.robots
    limits = {"speed": {"right_front_hip": 4.0}, "jerk": {"right_front_hip": 1000.0}}
    swing = replace(robot.phases[1], timing=PhaseTiming("conic", limits, ACTIVE))
    return replace(plan, robots=(replace(robot, phases=(robot.phases[0], swing, robot.phases[2])),))


def test_shares_are_of_the_time_of_a_phase_and_what_overlaps_counts_once() -> None:
    shift, swing, _ = limits_of(limited().robots[0])
    assert (shift.shares, shift.told, shift.method) == ({}, 0.0, "paced")
    assert list(swing.shares) == [ACTIVE[0][2], ACTIVE[2][2], ACTIVE[1][2], ACTIVE[3][2]]
    assert list(swing.shares.values()) == pytest.approx([0.5, 0.375, 0.25, 0.125])
    assert swing.told == pytest.approx(0.75)
    assert (swing.begin, swing.duration) == pytest.approx((0.8, 0.8))


def test_in_short_limits_of_a_kind_count_once_and_as_shares_of_the_climb() -> None:
    assert told_in_short(limited().robots[0]) == "speed 17% of the time, friction 12% of the time, jerk 8% of the time"
    assert told_in_short(step_plan().robots[0]) == ""


def test_the_table_fits_a_terminal_and_names_every_limit() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(limit_table(limited().robots[0]))
    file = console.file
    assert isinstance(file, io.StringIO)
    shown = " ".join(file.getvalue().split())
    assert "1 swing right_front 0.80 s speed right_front_hip 50%, friction left_front" in shown
    assert "law of fixed shape" in shown


def test_limits_are_shown_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.json"
    limited().save(path)
    assert main(["limits", str(path)]) == 0
    assert "in all: speed 17% of the time" in capsys.readouterr().out
    assert main(["limits", str(path), "--json"]) == 0
    (robot,) = json.loads(capsys.readouterr().out)["robots"]
    assert robot["phases"][1]["shares"]["jerk right_front_hip"] == pytest.approx(0.25)
    assert main(["limits", str(tmp_path / "none.json")]) == 2
    assert "none.json" in capsys.readouterr().err
