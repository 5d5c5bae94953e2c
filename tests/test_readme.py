"""What the README shows is true."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from climber.exceptions import ScenarioError
from climber.scenario import scenario_from_text

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)
    return [body for name, body in fenced if name == language]


def test_the_python_example_plans_and_verifies_a_climb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = blocks("python")
    assert len(example.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    assert (tmp_path / "plan.json").is_file()


def test_the_yaml_example_is_a_scenario() -> None:
    (example,) = blocks("yaml")
    scenario = scenario_from_text(example, "README.md")
    assert scenario.name == "traverse"
    assert [hold.grip for hold in scenario.build_wall().holds].count("friction") == 3


def test_the_error_shown_is_the_one_given() -> None:
    (shown,) = blocks("text")
    (example,) = blocks("yaml")
    tree = yaml.safe_load(example)
    tree["wall"]["holds"][3]["frictoin"] = 0.5
    with pytest.raises(ScenarioError, match="^" + re.escape(shown.strip().removesuffix("..."))):
        scenario_from_text(yaml.safe_dump(tree), "wall.yaml")


def test_every_make_target_shown_exists() -> None:
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    shown = set(re.findall(r"\bmake ([a-z]+)\b", "\n".join(blocks("sh") + re.findall(r"`([^`\n]+)`", README))))
    assert {"demo", "test", "lint", "bench"} <= shown <= set(targets)


def test_every_file_linked_exists() -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("http")]
    assert [link for link in links if not (ROOT / link).exists()] == []
