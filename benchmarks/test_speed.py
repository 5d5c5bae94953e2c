"""Hot spots of the planner, one by one: `python -m pytest benchmarks/test_speed.py`, with pytest-benchmark.

No targets; these are to compare one version with the next (`--benchmark-autosave`, `--benchmark-compare`).
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.bench_graph import ours
from benchmarks.bench_swing import body, climb, contacts, our_swing
from benchmarks.thesis import wall_data
from climber.dynamics import evaluate
from climber.path import Search, find_path
from climber.programs.support import hold_set_intervals
from climber.programs.torque import phase_torques
from climber.programs.trajectory import refine
from climber.timing import PEAK, PacedPath
from climber.transition import find_transition

MOVE = climb()[0]


@pytest.fixture(scope="module")
def swing():
    found = our_swing(body(), MOVE, np.random.default_rng(0))
    assert found.legs is not None
    return found


def test_stance_graph_of_W3(benchmark: BenchmarkFixture):
    graph, _ = benchmark(ours, wall_data("W3"))
    assert graph.num_edges > 0


def test_support_intervals_of_all_11480_sets_of_three_holds_of_W3(benchmark: BenchmarkFixture):
    wall = body("W3").wall
    sets = np.array(list(itertools.combinations(range(len(wall.holds)), 3)))
    intervals = benchmark(hold_set_intervals, wall, sets, 2.0)
    assert len(intervals) == 11480 and np.isfinite(intervals).any()


def test_transition_postures_of_a_swing_on_W2(benchmark: BenchmarkFixture):
    rng = np.random.default_rng(0)
    found = benchmark(find_transition, body(), contacts(MOVE.start), MOVE.limb, rng)
    assert len(found)


def test_path_of_a_swing_on_W2(benchmark: BenchmarkFixture, swing):
    chart, u = swing.legs[0].chart, np.array([leg.u[-1] for leg in swing.legs])
    a, b = chart.expand(swing.legs[0].u[:1])[0][0], swing.legs[-1].chart.expand(u[-1:])[0][0]
    rng = np.random.default_rng(0)
    assert benchmark(find_path, swing.manifold, a, b, rng, Search(100)) is not None


def test_refining_the_path_of_a_swing_on_W2(benchmark: BenchmarkFixture, swing):
    leg = swing.legs[0]
    assert benchmark(refine, swing.manifold, leg.chart, leg.u) is not None


def test_forces_and_torques_of_101_samples_of_a_swing_on_W2(benchmark: BenchmarkFixture, swing):
    leg = swing.legs[0]
    paced = PacedPath(refine(swing.manifold, leg.chart, leg.u))
    samples = paced.samples(PEAK * paced.length / 0.3, 101)
    robot, wall, holding = body().robot, body().wall, list(swing.manifold.contacts)

    def torques():
        dynamics = evaluate(robot, samples.q, samples.v, [contact.limb for contact in holding])
        return phase_torques(robot, wall, holding, dynamics, samples.vd)

    assert len(benchmark(torques).torque) == 101
