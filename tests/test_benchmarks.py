"""The benchmarks run, in a tiny version, and the peers solve the problem that ours solves."""

from __future__ import annotations

import math
import sys
from concurrent.futures import Future

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import step_plan
from rich.console import Console

from benchmarks import __main__ as everything
from benchmarks import bench_graph, bench_simulate, bench_solve, bench_swing, bench_task
from benchmarks.bench_swing import MODEL, body, climb, our_swing, peer_swing, sound
from benchmarks.peers.thesis_ompl import JOINT_LIMIT, Contacts, Geometry, ThesisSwing
from benchmarks.rows import Row, markdown, table
from benchmarks.thesis import wall_data
from climber.robot import Robot
from climber.transition import support_of

SEEDS = st.integers(0, 2**32 - 1)


def random_postures(seed: int, count: int) -> np.ndarray:
    """Joints leg by leg, then the pelvis's position and angle: the peer's order."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-JOINT_LIMIT] * 8 + [-1, -1, -2], [JOINT_LIMIT] * 8 + [1, 1, 2], (count, 11))


def in_our_order(q: np.ndarray) -> np.ndarray:
    robot = body().robot
    result = np.empty_like(q)
    result[:, robot.base_q] = q[:, 8:]
    for leg, limb in enumerate(robot.limbs):
        result[:, limb.q] = q[:, 2 * leg : 2 * leg + 2]
    return result


# --- rows and parts --------------------------------------------------------------------------------------------------


def test_a_row_survives_being_printed(capsys):
    row = Row("swing", 51.0, "times", 50.0, "at least", "both ways: ü, |")
    row.show()
    (line,) = capsys.readouterr().out.splitlines()
    assert Row.read(line) == row
    assert Row.read("swing took 51 ms") is None


def test_every_part_is_described():
    described = (everything.HERE / "README.md").read_text(encoding="utf-8")
    assert [part for part in everything.parts() if f"| `{part}` |" not in described] == []


@pytest.mark.parametrize(
    ("measured", "target", "sense", "met"),
    [
        (51.0, 50.0, "at least", True),
        (49.0, 50.0, "at least", False),
        (9.0, 10.0, "at most", True),
        (11.0, 10.0, "at most", False),
        (None, 10.0, "at most", None),
        (9.0, None, "at most", None),
    ],
)
def test_a_target_is_met_from_the_right_side(measured, target, sense, met):
    assert Row("x", measured, "s", target, sense).met is met


def test_tables_tell_what_was_not_met_and_what_was_not_measured():
    rows = [Row("slow", 11.0, "s", 10.0), Row("absent", None, "times", 50.0, "at least", "no ompl")]
    console = Console(width=120)
    with console.capture() as capture:
        console.print(table(rows, "title"))
    for text in (capture.get(), markdown(rows)):
        assert "NOT MET" in text and "not measured" in text and "at least 50 times" in text and "no ompl" in text


def test_parts_are_run_for_their_rows_and_their_exit_code(capfd):
    code = "import sys; from benchmarks.rows import Row; print('told'); Row('x', 1.0, 's').show(); sys.exit(3)"
    rows, failure = everything.stream([sys.executable, "-c", code])
    assert rows == [Row("x", 1.0, "s")]
    assert failure == "exit code 3, see above"
    assert capfd.readouterr().out == "told\n"


def test_a_part_that_takes_too_long_is_stopped_with_its_processes_and_keeps_its_rows():
    # Its child would keep the pipe open, and so the benchmarks waiting, for a minute.
    code = (
        "import subprocess, sys; from benchmarks.rows import Row; Row('x', 1.0, 's').show(); "
        "subprocess.run([sys.executable, '-c', 'import time; time.sleep(60)'])"
    )
    rows, failure = everything.stream([sys.executable, "-c", code], seconds=2.0)
    assert rows == [Row("x", 1.0, "s")]
    assert failure == "stopped after 0.0333 minutes"


def test_every_part_that_is_named_exists_and_every_file_is_a_part():
    files = {path.stem.removeprefix("bench_") for path in everything.HERE.glob("bench_*.py")}
    assert {*everything.parts()} == {*files, "speed"}
    assert len(everything.parts()) == len(files) + 1


# --- the peer on OMPL ------------------------------------------------------------------------------------------------


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_peer_moves_the_same_robot_as_ours(seed: int):
    q = random_postures(seed, 5)
    geometry, kinematics = Geometry.of(wall_data("W2")), body().kinematics
    feet, centers = kinematics.feet(in_our_order(q)), kinematics.center_of_mass(in_our_order(q))
    for i, row in enumerate(q):
        out = np.empty(8)
        Contacts(geometry, range(4), feet[i, :, :2]).residual(row, out)
        assert np.abs(out).max() < 1e-9
        assert geometry.center_of_mass(row.tolist()) == pytest.approx(centers[i, 0], abs=1e-9)


def test_joint_limits_of_peer_and_model_agree():
    for limb in Robot(MODEL).limbs:
        assert np.allclose([limb.lower, limb.upper], [[-JOINT_LIMIT] * 2, [JOINT_LIMIT] * 2], atol=1e-4)


@given(seed=SEEDS)
@settings(max_examples=10, deadline=None)
def test_the_peers_jacobian_is_that_of_its_equations(seed: int):
    (q,) = random_postures(seed, 1)
    contacts = Contacts(Geometry.of(wall_data("W2")), [0, 2, 3], np.zeros((3, 2)))
    jacobian, step = np.empty((6, 11)), 1e-6
    contacts.jacobian(q, jacobian)
    for j in range(11):
        ends = np.empty((2, 6))
        for sign, out in zip((1, -1), ends, strict=True):
            contacts.residual(q + sign * step * np.eye(11)[j], out)
        assert np.allclose((ends[0] - ends[1]) / (2 * step), jacobian[:, j], atol=1e-8)


def test_peer_and_ours_keep_the_centre_of_mass_over_the_same_interval():
    for move in climb():
        peer = ThesisSwing(wall_data("W2"), move.start.holds, move.end.holds)
        support = [contact for contact in bench_swing.contacts(move.start) if contact.limb != move.limb]
        ours = support_of(body(), support)
        assert ours is not None and peer.holding == pytest.approx(ours.abscissas, abs=1e-6)


def test_postures_of_the_peer_stand_on_all_four_holds():
    move = climb()[1]
    peer = ThesisSwing(wall_data("W2"), move.start.holds, move.end.holds)
    q = peer.posture(peer.goal, peer.arriving, np.random.default_rng(0), 2000)
    assert q is not None
    feet = body().kinematics.feet(in_our_order(q[None]))[0, :, :2]
    assert np.allclose(feet, body().wall.positions[list(move.end.holds), :2], atol=1e-5)


def test_the_benchmarked_moves_are_a_climb_from_start_to_goal():
    moves = climb()
    assert moves[0].start.holds == tuple(wall_data("W2")["start"])
    assert sorted(moves[-1].end.holds) == sorted(wall_data("W2")["goal"])
    assert all(len(set(move.end.holds)) == 4 for move in moves)


def test_our_swing_is_sound_and_a_bent_one_is_not():
    swing = our_swing(body(), climb()[1], np.random.default_rng(0))
    assert sound(swing)
    assert swing.legs is not None
    swing.legs[0].u[-1] += 0.3
    assert not sound(swing)


def test_the_peer_finds_a_swing():
    pytest.importorskip("ompl", reason="the peer is OMPL")
    swing = peer_swing(climb()[1], seed=0, time_limit=20.0, goals=5)
    assert swing.outcome == "solved"
    assert swing.goals == 5 and swing.plan_seconds > 0 and swing.length > 0
    assert swing.residual < 2e-4  # [m] OMPL was asked for 1e-4 in norm
    assert swing.balanced == 1.0


# --- the other parts -------------------------------------------------------------------------------------------------


def test_the_stance_graph_equals_the_peers(capsys):
    assert bench_graph.against_peers("W1", repeat=1, most_seconds=math.inf, skip_peer=False)
    assert "edges equal" in capsys.readouterr().out


def test_the_task_plan_equals_the_peers(capsys):
    of_poses, _ = bench_task.problems("W1")
    assert bench_task.against_peers("W1", of_poses, repeat=1)
    assert "12 moves" in capsys.readouterr().out


def test_the_length_of_a_motion_is_that_of_its_phases():
    plan = step_plan()
    lengths = [np.linalg.norm(np.diff(phase.q, axis=0), axis=1).sum() for phase in plan.robots[0].phases]
    assert bench_solve.path_length(plan) == pytest.approx(sum(lengths))
    assert len(lengths) > 1


def test_a_climb_that_breaks_off_takes_no_other_with_it(capsys):
    broken, sound = Future(), Future()
    broken.set_exception(ArithmeticError("singular"))
    sound.set_result([1, 2])
    assert bench_simulate.ended("basic", [broken, sound]) == [1, 2]
    assert capsys.readouterr().out == "basic: ArithmeticError: singular\n"
    bench_simulate.tell("basic", 20, [])
    row = Row.read(capsys.readouterr().out)
    assert row is not None and row.measured is None and "basic" in row.what


def test_a_climb_that_is_not_found_is_told():
    scenario = bench_solve.ROOT / "scenarios" / "basic.yaml"
    run = bench_solve.run(scenario, 0, "--time-limit", "0.000001")
    assert run.complaint.startswith("solve: ") and "time limit" in run.complaint
    assert math.isnan(run.verify_seconds)
