"""What `verify` asks of a plan, and how exactly.

A tolerance of a thousandth of a millimetre or less stands for "zero" in floating point. The others are said why.
"""

from __future__ import annotations

from typing import Final

from climber.verdict import Rule

BETWEEN: Final = 10  # points looked at between every two samples

CONTACT = 1e-4  # [m] what a point foot may stray from its contact point between samples
SAMPLING = 0.01  # [s] longest time between samples
LENGTH = 1e-6  # [m] zero for lengths that a solver or Drake's narrow phase computes
SAME = 1e-9  # [s, m, rad] zero for numbers that are copied
REST = 1e-6  # [m/s, rad/s] zero for speeds
POSTURE = 1e-3  # [rad] prescribed joint angles are rounded, and feet are not to leave their holds for that
FORCE = 1e-6  # [N] zero for contact forces
TORQUE = 1e-6  # [N m] zero for excess torque
# At samples the plan's torques and forces must be those of its motion; this much is left to a solver's accuracy and is
# five millionths of the quadruped's weight.
DYNAMICS_AT_SAMPLES = 1e-4  # [N, N m]
# Between samples everything is interpolated linearly, so terms that are linear in it cancel. What remains of a product
# like J(q)^T f is a quarter of the change of the one factor over a step times that of the other: a 0.2 m limb that
# turns at 4 rad/s has J change by 8 mm in 10 ms, and if f went from one end of its range to the other, 18 N, in that
# same step, 0.04 N m would remain. It is a quarter of a percent of the quadruped's weight.
DYNAMICS_BETWEEN = 0.05  # [N, N m]
# A timing is computed at some forty places of a motion. Between them rates may go a little beyond limits that are set
# below the model's, and what is told as active need not be so to the last digit, for forces are kept off their limits.
OVERSHOOT, OVERSHOOT_OF_JERK = 1.1, 1.5  # share of a limit
IN_USE = 0.7  # share of a limit
AT_LIMIT = 0.1  # of the weight
# A claim is made up to a millionth of it, and tried by a solver; both are far less than what these forces are known by.
MARGIN = 1e-4  # [N, N m]
VALUE = 1e-5  # [m, rad, s] sums of thousands of numbers, and supports from another program
MODEL = 1e-8  # [m, N, N m] verify's own mechanics against Drake's

RULES: Final[dict[str, Rule]] = {
    "stances": Rule("consecutive stances differ in one limb, and no hold carries two", "at most", 0, "faults"),
    "phases": Rule("shifts and swings alternate, with the contacts that the stances say", "at most", 0, "faults"),
    "start stance": Rule("the first stance is the scenario's start", "at most", 0, "faults"),
    "start posture": Rule("the joints begin where the scenario says", "at most", POSTURE, "rad"),
    "goal": Rule("the last stance is the one asked for", "at most", 0, "faults"),
    "goal pelvis": Rule("the pelvis ends within the goal region", "at most", LENGTH, "m"),
    "waypoints": Rule("every waypoint is reached, in order", "at most", 0, "missed"),
    "avoided": Rule("no avoided hold is used", "at most", 0, "faults"),
    "limb order": Rule("at each stance the feet in limb order turn left", "at least", SAME, "rad"),
    "sampling": Rule("samples are close enough together", "at most", SAMPLING + SAME, "s"),
    "time": Rule("each phase begins when the one before ended", "at most", SAME, "s"),
    "posture": Rule("each phase begins in the posture the one before ended in", "at most", SAME, "m, rad"),
    "rest": Rule("the robot is at rest where a phase begins or ends", "at most", REST, "m/s, rad/s"),
    "velocity": Rule("velocity is the derivative of position, error by what the samples allow", "at most", 1, ""),
    "acceleration": Rule("acceleration is that of velocity, error by what the samples allow", "at most", 1, ""),
    "patches": Rule("contact points lie on their holds", "at most", LENGTH, "m"),
    "anchors": Rule("the contact point of a limb that holds on stays", "at most", SAME, "m"),
    "contacts": Rule("holding feet are at their contact points", "at most", CONTACT, "m"),
    "joint limits": Rule("joint positions within their limits (excess)", "at most", SAME, "rad"),
    "speed limits": Rule("joint velocities within their limits (excess)", "at most", SAME, "rad/s"),
    "torque limits": Rule("joint torques within their limits (excess)", "at most", TORQUE, "N m"),
    "timing": Rule(
        "limits within the model's and scenario's, active ones the phase's, intervals in order",
        "at most",
        0,
        "faults",
    ),
    "timing limits": Rule("share of its phase's limits that a speed or acceleration uses", "at most", OVERSHOOT, ""),
    "timing jerk": Rule("share of its phase's limits that a jerk uses", "at most", OVERSHOOT_OF_JERK, ""),
    "active limits": Rule("share in use of a rate or torque limit told as active", "at least", IN_USE, ""),
    "active contacts": Rule("distance from a contact's limit told as active, over the weight", "at most", AT_LIMIT, ""),
    "self clearance": Rule("links and pelvis do not touch", "at least", -LENGTH, "m"),
    "obstacle clearance": Rule("no link touches rock, an obstacle or an avoided region", "at least", -LENGTH, "m"),
    "clock": Rule("all robots begin at time 0 and end together", "at most", SAME, "s"),
    "holds of one": Rule("a hold carries one robot, and the next strictly later", "at most", 0, "faults"),
    "robot clearance": Rule("robots do not touch one another", "at least", -LENGTH, "m"),
    "equilibrium": Rule("the centre of mass is over the support (margin)", "at least", -LENGTH, "m"),
    "friction": Rule("contact forces within cones and limits (excess)", "at most", FORCE, "N"),
    "moments": Rule("moments on grippers within what their pins take (excess)", "at most", FORCE, "N m"),
    "free limbs": Rule("no force on a limb that holds nothing", "at most", FORCE, "N"),
    "dynamics at samples": Rule("M vd + h = S^T tau + J^T f", "at most", DYNAMICS_AT_SAMPLES, "N, N m"),
    "dynamics between": Rule("M vd + h = S^T tau + J^T f", "at most", DYNAMICS_BETWEEN, "N, N m"),
    "margins": Rule(
        "errors of each kind are survived as claimed (force or torque lacking)", "at most", MARGIN, "N, N m"
    ),
    "asked margins": Rule(
        "every phase survives what the scenario and the plan's `min_margin` ask for (shortfall, as a share)",
        "at most",
        SAME,
        "",
    ),
    "worst instants": Rule("greater errors are not survived where the plan says so", "at most", 0, "faults"),
    "objective": Rule("the objective's value is that of the phases", "at most", VALUE, "m, rad, s"),
    "record": Rule("values on record go down to the plan's", "at most", 0, "faults"),
    "mechanics": Rule("verify's own mechanics agree with Drake's at samples", "at most", MODEL, "m, N, N m"),
}
