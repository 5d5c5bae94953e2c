"""Gönen's table 5.1: figures of plans, over seeds, and the published values as they are printed."""

from __future__ import annotations

import json
import statistics
from dataclasses import replace

import pytest
from rich.console import Console
from stored import planned

from climber.cli import main
from climber.plan import plan_climb
from climber.scenario import load_scenario
from climber.table import PUBLISHED, Figures, deviation, length, mean, measure
from climber.table_command import LEAST, UNBOUNDED, rendered


def shown(*figures: Figures, width: int = UNBOUNDED) -> str:
    console = Console(width=width, color_system=None, highlight=False)
    with console.capture() as capture:
        console.print(rendered(figures, 2, width))
    return capture.get()


EXAMPLE = Figures(
    "basic", (0, 1), (), (13, 13), (0.004, 0.006), (0.1, 0.2), (3.0, 4.0), (22.5, 23.5), (8.0, 9.0), (1, 2)
)


def test_figures_are_those_of_the_plans_of_each_seed() -> None:
    scenario = load_scenario("three_limbed")
    heard: list[str] = []
    figures = measure(scenario, range(2), report=heard.append)
    plans = [planned("three_limbed", seed) for seed in range(2)]
    assert figures.seeds == (0, 1) and figures.failed == () and len(heard) == 2
    assert figures.length == tuple(length(plan) for plan in plans)
    assert figures.length[0] == pytest.approx(plans[0].robots[0].objective.value)
    assert figures.makespan == tuple(plan.robots[0].moves for plan in plans)
    assert figures.duration == tuple(plan.robots[0].duration for plan in plans)
    assert figures.replans == tuple(plan.robots[0].proofs["replans"] for plan in plans)
    assert figures.optimum == min(figures.length)
    assert all(seconds > 0.0 for seconds in (*figures.graph, *figures.task, *figures.motion))


def test_replans_are_how_often_the_task_planner_was_asked_again() -> None:
    heard: list[str] = []
    plan = plan_climb(load_scenario("double_link"), report=heard.append)
    tries = [message for message in heard if "have postures at every transition" in message]
    assert int(plan.robots[0].proofs["replans"]) >= len(tries) - 1 >= 1


def test_a_seed_without_a_plan_is_told_and_the_command_says_no(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = load_scenario("three_limbed")
    scenario = replace(scenario, budget=replace(scenario.budget, time_limit_s=1e-9))
    figures = measure(scenario, [4])
    assert figures.failed == (4,) and figures.optimum is None
    assert "three_limbed (1 failed)" in shown(figures)


def test_means_and_deviations_are_those_of_a_sample() -> None:
    values = (1.0, 2.0, 4.0)
    assert mean(values) == pytest.approx(7 / 3) and deviation(values) == pytest.approx(statistics.stdev(values))
    assert mean(()) is None and deviation((1.0,)) is None


def test_the_table_shows_ours_and_below_what_is_published_as_it_is_printed() -> None:
    ours, theirs = (line.split() for line in shown(EXAMPLE).splitlines() if line.split()[:1] in (["basic"], ["Gönen"]))
    assert ours == [
        "basic",
        "13",
        "0.005",
        "0.15",
        "3.5",
        "(0.7)",
        "22.500",
        "23.000",
        "(0.707)",
        "8.5",
        "(0.7)",
        "1.5",
    ]
    assert theirs[2:] == ["12", "0.3", "+", "0.5", "0.02", "141.5", "(66.6)", "32.205", "65.387", "(6.867)", "-", "0"]


def test_in_no_width_is_anything_cut_off() -> None:
    every = [replace(EXAMPLE, scenario=name, failed=(2,)) for name in (*PUBLISHED, "random_1000")]

    def words(text: str) -> list[str]:
        return sorted(word for word in text.split() if "─" not in word)

    for width in range(LEAST, 141, 10):
        lines = [line.rstrip() for line in shown(*every, width=width).splitlines()]
        assert max(map(len, lines)) <= width
        assert words(" ".join(lines)) == words(shown(*every))


def test_published_optimum_lengths_are_those_of_scenarios_one_to_three() -> None:
    assert [PUBLISHED[name].optimum for name in ("basic", "higher", "wider")] == ["32.205", "30.330", "49.187"]
    assert [row.number for row in PUBLISHED.values()] == [1, 2, 3, 4, 5]


def test_a_scenario_of_ones_own_stands_alone() -> None:
    assert "Gönen" not in shown(replace(EXAMPLE, scenario="my wall"))


def test_the_command_prints_figures_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "three_limbed", "--seeds", "2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    (scenario,) = facts["scenarios"]
    assert scenario["seeds"] == [0, 1] and scenario["published"] is None
    assert scenario["mean_length"] == pytest.approx(sum(scenario["length"]) / 2)


@pytest.mark.parametrize("arguments", [["--seeds", "0"], ["--improve", "-1"], ["no-such-scenario"]])
def test_what_makes_no_sense_is_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", *arguments]) == 2
    assert "error:" in capsys.readouterr().err
