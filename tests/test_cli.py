"""The command line, as a new user types it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from climbs import short
from robots import robot

from climber.cli import main
from climber.scenario import load_scenario


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("solved")
    (folder / "short.yaml").write_text(short().source)
    assert main(["solve", str(folder / "short.yaml"), "--out", str(folder)]) == 0
    return folder


def test_solve_writes_the_plan_and_its_pictures(solved: Path) -> None:
    for name in ("plan.json", "wall.svg", "climb.gif", "climb.html"):
        assert (solved / name).stat().st_size > 1000


def test_verify_says_yes_with_exit_code_zero(solved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(solved / "plan.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ok"] is True


def test_verify_says_no_with_exit_code_one(solved: Path, tmp_path: Path) -> None:
    plan = json.loads((solved / "plan.json").read_text())
    plan["robots"][0]["phases"][3]["q"][4][5] += 0.01
    (tmp_path / "bent.json").write_text(json.dumps(plan))
    assert main(["verify", str(tmp_path / "bent.json")]) == 1


def test_draw_draws_a_saved_plan_elsewhere(solved: Path, tmp_path: Path) -> None:
    assert main(["draw", str(solved / "plan.json"), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "climb.gif").exists()


def test_solve_prints_json_alone_on_standard_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["solve", "three_limbed", "--out", str(tmp_path), "--seed", "3", "--no-pictures", "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert code == 0
    assert facts["moves"] == 2
    assert [Path(name).name for name in facts["files"]] == ["plan.json"]


def test_a_climb_that_does_not_exist_is_exit_code_one_and_keeps_the_earlier_plan(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text("an earlier plan")
    text = load_scenario("basic").source.replace("[0.407017, -0.014286]", "[0.407017, -9.0]")
    (tmp_path / "wall.yaml").write_text(text)
    assert main(["solve", str(tmp_path / "wall.yaml"), "--out", str(tmp_path)]) == 1
    assert (tmp_path / "plan.json").read_text() == "an earlier plan"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plan.json", "wall.yaml"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "no-such-scenario", "--out", "x"],
        ["verify", "no-such-plan.json"],
        ["draw", "no-such-plan.json"],
        ["robot", "no-such-robot.urdf"],
        ["robot", "package://climber/no/such.urdf"],
    ],
)
def test_bad_input_is_exit_code_two_and_one_sentence(
    arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("option", "given", "allowed"),
    [
        ("--seed", "x", "a whole number, 0 or greater"),
        ("--seed", "1.5", "a whole number, 0 or greater"),
        ("--time-limit", "soon", "a number of seconds, greater than 0"),
        ("--time-limit", "0", "a number of seconds, greater than 0"),
        ("--improve", "x", "a number of seconds, 0 or greater"),
        ("--improve", "nan", "a number of seconds, 0 or greater"),
        ("--min-margin", "push=hard", "KIND=SIZE is expected"),
    ],
)
def test_what_an_option_allows_is_said(
    option: str, given: str, allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["solve", "basic", "--out", "x", option, given])
    assert raised.value.code == 2
    assert f"argument {option}: {given}: {allowed}" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["solve", "basic", "--out", "x", "--seed", "-1"], ["fly"], []])
def test_a_wrong_call_is_exit_code_two(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2


def test_robot_shows_limbs_limits_and_symmetry(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "package://climber/quadruped/quadruped.urdf", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [limb["name"] for limb in facts["limbs"]] == ["right_front", "left_front", "left_rear", "right_rear"]
    assert facts["mass"] == pytest.approx(2.0)
    assert len(facts["symmetries"]) == 2


def test_limits_that_there_are_not_are_null_to_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = robot("quadruped").model.path.read_text()
    model = tmp_path / "free.urdf"
    model.write_text(text.replace('velocity="4.0"', ""))
    model.with_suffix(".yaml").write_text(robot("quadruped").model.path.with_suffix(".yaml").read_text())
    assert main(["robot", str(model), "--json"]) == 0
    shown = capsys.readouterr().out
    assert "Infinity" not in shown
    assert all(limb["velocity"] == [None, None] for limb in json.loads(shown)["limbs"])


def test_robot_shows_limbs_without_joints(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "package://climber/double_link/double_link.urdf"]) == 0
    shown = capsys.readouterr().out
    assert "first_hand" in shown and "none" in shown and "middle" in shown
