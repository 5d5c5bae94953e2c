"""Margins that are asked for: plans have them, and where there is no plan it is said what was short."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from climbs import short
from plans import edited, step_plan, with_margins
from rich.console import Console

from climber.cli import main
from climber.exceptions import NoPlanFound, ScenarioError
from climber.least_margins import least_by_kind
from climber.margin_table import margin_table
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import load_scenario, scenario_from_text
from climber.verify import verify

ASKED = "min_margin: {push: 0.6}\n"


@pytest.fixture(scope="module")
def asked() -> Plan:
    scenario = scenario_from_text(short().source + ASKED, "short.yaml")
    return plan_climb(scenario, min_margin={"friction": 0.04})


def test_a_plan_has_the_margins_that_were_asked_for(asked: Plan) -> None:
    for phase in asked.robots[0].phases:
        assert phase.margins["push"].value >= 0.6
        assert phase.margins["friction"].value >= 0.04
    verdict = verify(asked)
    assert verdict.ok, str(verdict)
    assert verdict["asked margins"].ok


def test_without_being_asked_the_same_climb_has_less() -> None:
    """Or the test above would show nothing; the first swing goes as near to falling as it may."""
    plan = plan_climb(short())
    assert min(phase.margins["push"].value for phase in plan.robots[0].phases) < 0.6


def test_a_margin_below_what_the_scenario_asks_for_is_found() -> None:
    text = step_plan().scenario_text
    demanding = with_margins(Plan.from_json(edited(step_plan(), "scenario/text", text + "min_margin: {push: 6.6}\n")))
    assert verify(demanding).ok
    more = edited(demanding, "scenario/text", lambda old: old.replace("push: 6.6", "push: 7.2"))
    assert {check.name for check in verify(Plan.from_json(more)).failures} == {"asked margins"}


def test_a_plan_tells_what_was_asked_for_besides_the_scenario(asked: Plan) -> None:
    assert Plan.from_json(asked.to_json()).min_margin == {"friction": 0.04}
    more = edited(asked, "min_margin/friction", 1.01 * min(p.margins["friction"].value for p in asked.robots[0].phases))
    assert {check.name for check in verify(Plan.from_json(more)).failures} == {"asked margins"}


@pytest.mark.parametrize("name", ["double_link", "three_limbed"])
def test_an_answer_that_there_is_no_plan_says_what_was_asked_for(name: str) -> None:
    with pytest.raises((NoPlanFound, ScenarioError), match="push 200 N"):
        plan_climb(load_scenario(name), min_margin={"push": 200.0})


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        ("pull=1", "min_margin.pull: given 1.0; allowed: "),
        ("friction=1.5", "min_margin.friction: given 1.5; allowed: a finite number >= 0 and <= 0.9"),
        ("push=nan", "min_margin.push: given nan; allowed: a finite number >= 0 and <= 900"),
    ],
)
def test_margins_that_there_are_not_are_bad_input(
    asked: str, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["solve", "basic", "--out", str(tmp_path), "--min-margin", asked]) == 2
    assert complaint in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["solve", "basic", "--out", str(tmp_path), "--min-margin", "push"])


def test_the_least_margins_are_shown(asked: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.json"
    asked.save(path)
    assert main(["margins", str(path), "--json"]) == 0
    (facts,) = json.loads(capsys.readouterr().out)["robots"]
    least = {margin["kind"]: margin["value"] for margin in facts["margins"]}
    assert least["push"] == min(phase.margins["push"].value for phase in asked.robots[0].phases)
    assert main(["margins", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "quadruped survives at least" in shown
    assert f"{least['push']:.3g} N" in shown


@pytest.mark.parametrize("width", [80, 160])
def test_the_table_of_margins_fits_a_terminal(asked: Plan, width: int) -> None:
    console = Console(file=io.StringIO(), width=width)
    console.print(margin_table(asked.robots[0], width))
    file = console.file
    assert isinstance(file, io.StringIO)
    lines = file.getvalue().splitlines()
    assert len(lines) == 2 + 6 * (2 if width == 80 else 1) - 2 * (width == 80)  # two without a direction
    for least in least_by_kind(asked.robots[0]):
        assert any(least.way in line and (least.limb or "") in line for line in lines)
