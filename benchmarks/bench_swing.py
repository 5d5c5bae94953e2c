"""One swing: transition postures and path, against the thesis's planner on OMPL.

    python -m benchmarks.bench_swing [--moves 14] [--seeds 1] [--time-limit 60] [--goals 20] [--skip-peer] [--quick]

The moves are those of a climb of W2, with the contact forces the wall was calibrated with (2 to 20 N along each cone
edge). Ours looks for postures to let go in, for postures to take hold in, and for a path from one of the first to one
of the second. It keeps link, pelvis and joint clearances and margins that the peer does not ask for. The peer's time is
that of goals and RRT-Connect; its posture to let go in comes free, as if it were known from the swing before. A peer
that ends without a path counts with the time it took, so its median is a lower bound where that happens.

The two run in turn, the peer in a process of its own, and a ratio is that of medians. The exit code is 1 if ours finds
no path, or if a path of either leaves its holds or lets the centre of mass out of the support interval.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from multiprocessing.connection import Connection

import numpy as np

from benchmarks.peers.thesis_ompl import PeerSwing, ThesisSwing
from benchmarks.rows import Row
from benchmarks.thesis import wall_data, wall_of
from climber.choose import Candidates, Layer
from climber.manifold import Body, Manifold
from climber.objective import Objective
from climber.path import Leg, Search, find_path, line
from climber.phase_motion import MotionBudget
from climber.robot import Robot
from climber.stance import Contact, Move, Stance
from climber.transition import find_transition, support_of
from climber.transitions import Effort

MODEL = "package://climber/quadruped/quadruped.urdf"
TARGET_RATIO = 50.0  # times faster
# Limb and hold of each move of the first climb of W2 from start to goal that has postures at both ends of every move,
# in the order in which the task planner proposes climbs while moves without are cut.
CLIMB = (
    *((1, 12), (0, 9), (3, 5), (2, 10), (3, 8), (1, 14), (2, 17)),
    *((3, 12), (2, 19), (1, 18), (0, 15), (3, 17), (1, 20), (0, 18)),
)


@cache
def body(name: str = "W2") -> Body:
    """The thesis's robot on a wall of `walls/`."""
    return Body(Robot(MODEL), wall_of(wall_data(name)))


def climb() -> list[Move]:
    """The moves of `CLIMB`."""
    moves = [Move(Stance(tuple(wall_data("W2")["start"])), *CLIMB[0])]
    for limb, hold in CLIMB[1:]:
        moves.append(Move(moves[-1].end, limb, hold))
    return moves


@dataclass(frozen=True)
class Swing:
    """What ours found, and the time it took.

    Attributes:
        legs: The path, None if there was no posture or no path.
        manifold: The manifold it runs on.
        leave_seconds: Time for the postures to let go in [s].
        arrive_seconds: Time for the postures to take hold in [s].
        path_seconds: Time to choose a pair of them and find the path [s].
    """

    legs: list[Leg] | None
    manifold: Manifold | None
    leave_seconds: float
    arrive_seconds: float
    path_seconds: float

    @property
    def seconds(self) -> float:
        """All of it [s]."""
        return self.leave_seconds + self.arrive_seconds + self.path_seconds


def contacts(stance: Stance) -> list[Contact]:
    return [Contact(limb, hold) for limb, hold in enumerate(stance.holds)]


def our_swing(body: Body, move: Move, rng: np.random.Generator) -> Swing:
    """Plans one swing as `MotionPlanner` does, with its budget, remembering nothing from before."""
    budget, effort = MotionBudget(), Effort()
    began = time.perf_counter()
    leave = find_transition(body, contacts(move.start), move.limb, rng, None, effort.rounds, effort.postures)
    left = time.perf_counter()
    arrive = find_transition(body, contacts(move.end), move.limb, rng, None, effort.rounds, effort.postures)
    arrived = time.perf_counter()
    legs, manifold = None, None
    if len(leave) and len(arrive):
        support = [contact for contact in leave.contacts if contact.limb != move.limb]
        interval = support_of(body, support)
        assert interval is not None  # its transitions were found
        manifold = Manifold(body, support, interval)
        holding = tuple(contact.limb for contact in support)
        layers = [
            Layer(leave.contacts, leave.q, leave.branches, tuple(range(len(body.robot.limbs)))),
            Layer(arrive.contacts, arrive.q, arrive.branches, holding),
        ]
        candidates = Candidates(layers, body.robot.angle_q, Objective.of("length", body))
        for _ in range(budget.attempts):
            pair = candidates.best()
            if pair is None:
                break
            legs = find_path(manifold, leave.q[pair[0]], arrive.q[pair[1]], rng, Search(budget.iterations))
            if legs is not None:
                break
            candidates.barred.add((0, pair[0], pair[1]))
    return Swing(legs, manifold, left - began, arrived - left, time.perf_counter() - arrived)


def sound(swing: Swing) -> bool:
    """Whether ours found a path that keeps contacts and balance, looked at five times as finely as when planned."""
    if swing.legs is None or swing.manifold is None:
        return False
    manifold = swing.manifold
    kinematics, holding = manifold.body.kinematics, sorted(manifold.points)
    points = np.array([manifold.points[limb] for limb in holding])
    lower, upper = manifold.support.abscissas
    for leg in swing.legs:
        fine = [line(leg.chart, a, b, Search().step / 5) for a, b in zip(leg.u[:-1], leg.u[1:], strict=True)]
        q, _ = leg.chart.expand(np.concatenate(fine))
        abscissa = kinematics.center_of_mass(q)[:, 0]
        if (
            np.abs(kinematics.feet(q)[:, holding] - points).max() > 1e-6
            or not ((abscissa >= lower) & (abscissa <= upper)).all()
        ):
            return False
    return True


def _peer(pipe: Connection, move: Move, seed: int, time_limit: float, goals: int) -> None:
    pipe.send(ThesisSwing(wall_data("W2"), move.start.holds, move.end.holds).plan(seed, time_limit, goals))


def peer_swing(move: Move, seed: int, time_limit: float, goals: int) -> PeerSwing:
    """The peer's swing, in a process of its own: it is foreign code."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_peer, args=(there, move, seed, time_limit, goals))
    process.start()
    there.close()
    try:
        if here.poll(3 * time_limit + 60):
            return here.recv()  # type: ignore[no-any-return]
        return PeerSwing("hung", goal_seconds=time_limit, plan_seconds=time_limit)
    except EOFError:
        return PeerSwing("crashed")
    finally:
        process.join(5)
        if process.is_alive():
            process.kill()
            process.join()


def median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def report(ours: list[Swing], theirs: list[PeerSwing], time_limit: float, goals: int, quick: bool) -> None:
    """Prints medians, how the peer fared, and the row."""
    parts = ("leave_seconds", "arrive_seconds", "path_seconds")
    names = ("to let go", "to take hold", "path")
    split = ", ".join(
        f"{n} {1e3 * median([getattr(s, p) for s in ours]):.1f}" for n, p in zip(names, parts, strict=True)
    )
    mine = median([swing.seconds for swing in ours])
    worst = max(swing.seconds for swing in ours)
    print(f"ours: median {1e3 * mine:.1f} ms ({split}), worst {1e3 * worst:.1f} ms, {len(ours)} swings")
    what = "one swing of W2, against OMPL's constrained RRT-Connect"
    ran = [swing for swing in theirs if swing.outcome in ("solved", "timeout")]
    if not ran:
        Row(what, None, "times", TARGET_RATIO, "at least", "the peer did not run").show()
        return
    outcomes = {o: sum(swing.outcome == o for swing in theirs) for o in sorted({swing.outcome for swing in theirs})}
    total = median([swing.goal_seconds + swing.plan_seconds for swing in ran])
    native = median([swing.goal_seconds + swing.plan_seconds - swing.callback_seconds for swing in ran])
    print(
        f"peer: median {total:.2f} s (goals {median([s.goal_seconds for s in ran]):.2f}, "
        f"RRT-Connect {median([s.plan_seconds for s in ran]):.2f}, {median([s.start_seconds for s in ran]):.2f} "
        f"to let go not counted), {', '.join(f'{n} {o}' for o, n in outcomes.items())}"
    )
    print(f"  if its callbacks cost nothing: median {native:.2f} s, {native / mine:.0f} times")
    one = median([s.goal_seconds / max(1, s.goals) + s.plan_seconds for s in ran])
    print(f"  if one goal were enough for it: median {one:.2f} s, {one / mine:.0f} times")
    stopped = outcomes.get("timeout", 0)
    note = f"{1e3 * mine:.0f} ms and {total:.2f} s; {len(ran)} swings, {goals} goals each"
    note += f", {stopped} stopped at {time_limit:g} s" if stopped else ""
    note += "; quick: few moves, peer limited" if quick else ""
    Row(what, total / mine, "times", TARGET_RATIO, "at least", note).show()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=len(CLIMB), help="the first so many moves of the climb")
    parser.add_argument("--seeds", type=int, default=1, help="runs of each move")
    parser.add_argument("--time-limit", type=float, default=60.0, help="of the peer's goals, and of its planner [s]")
    parser.add_argument("--goals", type=int, default=20, help="postures that the peer looks for")
    parser.add_argument("--repeat", type=int, default=3, help="runs of ours before and after each of the peer's")
    parser.add_argument("--skip-peer", action="store_true", help="only ours")
    parser.add_argument("--quick", action="store_true", help="four moves, and at most 10 s for the peer")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.moves, arguments.time_limit = min(4, arguments.moves), min(10.0, arguments.time_limit)
    skip = arguments.skip_peer
    if not skip and find_spec("ompl") is None:
        print("the peer needs the package ompl, which is not installed")
        skip = True
    our_swing(body(), climb()[0], np.random.default_rng(0))  # the first call fills caches
    ours: list[Swing] = []
    theirs: list[PeerSwing] = []
    good = True
    print(f"{'limb':>4s} {'hold':>4s} {'seed':>4s} {'ours [ms]':>10s} {'goals [s]':>10s} {'RRT-C [s]':>10s}")
    for seed in range(arguments.seeds):
        for number, move in enumerate(climb()[: arguments.moves]):
            rng = np.random.default_rng((seed, number))
            mine = [our_swing(body(), move, rng) for _ in range(arguments.repeat)]
            peer = None if skip else peer_swing(move, seed, arguments.time_limit, arguments.goals)
            if peer is not None:
                mine += [our_swing(body(), move, rng) for _ in range(arguments.repeat)]
                theirs.append(peer)
            ours += mine
            told = f"{move.limb:4d} {move.hold:4d} {seed:4d} {1e3 * median([s.seconds for s in mine]):10.1f}"
            if peer is not None:
                told += f" {peer.goal_seconds:10.2f} {peer.plan_seconds:10.2f} {peer.outcome}"
            print(told, flush=True)
            if not all(sound(swing) for swing in mine):
                print("  OURS has no sound path")
                good = False
            if peer is not None and peer.outcome == "solved" and (peer.residual > 1e-3 or peer.balanced < 1.0):
                print(f"  THEIRS leaves its contacts by {peer.residual} m, or is balanced only in {peer.balanced:.1%}")
                good = False
    report(ours, theirs, arguments.time_limit, arguments.goals, arguments.quick)
    sys.exit(not good)


if __name__ == "__main__":
    main()
