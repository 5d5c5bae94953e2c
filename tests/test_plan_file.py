"""Plan files: what is written reads back the same, and whatever cannot be understood is said where and why."""

from __future__ import annotations

import json
import random
import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import REMOVED, edited, entry, step_plan
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from climber.exceptions import PlanFileError
from climber.plan_file import Plan
from climber.verify_rules import RULES


def assert_same(a: Any, b: Any) -> None:
    """Equal to the last bit, arrays and nested dataclasses included."""
    assert type(a) is type(b)
    if is_dataclass(a):
        for part in fields(a):
            assert_same(getattr(a, part.name), getattr(b, part.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


def test_a_saved_plan_loads_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    step_plan().save(path)
    assert_same(Plan.load(path), step_plan())


def test_the_scenario_is_kept_verbatim(tmp_path: Path) -> None:
    text = 'name: "Gönen\'s \\ wall"\n\n# a comment\twith a tab\r\n'
    replace(step_plan(), scenario_text=text).save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json").scenario_text == text


def test_saving_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    step_plan().save(tmp_path / "a.json")
    Plan.load(tmp_path / "a.json").save(tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_plan_with_a_number_that_is_not_finite_is_not_written_and_spares_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    step_plan().save(path)
    before = path.read_bytes()
    robot = step_plan().robots[0]
    phase = replace(robot.phases[0], torque=np.full_like(robot.phases[0].torque, np.nan))
    bad = replace(step_plan(), robots=(replace(robot, phases=(phase, *robot.phases[1:])),))
    with pytest.raises(PlanFileError, match="cannot be written"):
        bad.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]


def test_each_sample_has_a_line_of_its_own() -> None:
    phase = step_plan().robots[0].phases[0]
    row = json.dumps(phase.q[7].tolist())
    assert any(line.strip().rstrip(",") == row for line in step_plan().to_json().splitlines())


def test_a_duration_runs_from_the_first_sample_to_the_last() -> None:
    assert step_plan().robots[0].duration == pytest.approx(2.4)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "not a JSON file"),
        (b"climber", "not a JSON file"),
        (b'{"format": "climber-plan", "version": 1', "not a JSON file"),
        (b"\xff\xfe", "cannot be read"),
        (b"[]", "an object is expected"),
        (b"null", "an object is expected"),
        (b"{}", "'format' is missing"),
        (b'{"format": "climber-plan", "format": "climber-plan", "version": 4}', "given twice"),
        (b'{"format": "climber-plan", "version": NaN}', "numbers are finite"),
        (b'{"format": "climber-plan", "version": Infinity}', "numbers are finite"),
        (b'{"format": "climber-plan", "version": 3}', "reads version 4"),
        (b'{"format": "climber-plan", "version": true}', "reads version 4"),
        (b'{"format": "a-plan", "version": 4}', "not a plan file"),
        (b'{"format": "climber-plan", "version": 4}', "'scenario' is missing"),
        (b"[" * 100_000, "not a JSON file"),
    ],
)
def test_what_is_not_a_plan_file_is_refused(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "plan.json"
    path.write_bytes(content)
    with pytest.raises(PlanFileError, match=complaint) as caught:
        Plan.load(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there_or_is_a_folder_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(PlanFileError, match="cannot be read"):
            Plan.load(path)


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        ("extra", 1, r"top level: there is no field 'extra'"),
        ("scenario/text", None, r"scenario\.text: a string is expected \(given: null\)"),
        ("scenario/path", REMOVED, r"scenario: the field 'path' is missing"),
        ("software/drake", 1.51, r"software\.drake: a string is expected"),
        ("seed", 1.5, r"seed: a whole number is expected \(given: 1\.5\)"),
        ("seed", True, r"seed: a whole number is expected"),
        ("timings/total", "fast", r"timings\.total: a number is expected"),
        ("robots", [], r"robots: 1 or more are expected"),
        ("robots", {}, r"robots: a list is expected"),
        ("robots/0/limbs", ["right_front"] * 4, r"robots\[0\]\.limbs: each name is expected once"),
        ("robots/0/joints/3", 4, r"robots\[0\]\.joints\[3\]: a string is expected"),
        ("robots/0/moves", -1, r"robots\[0\]\.moves: a whole number, 0 or more"),
        ("robots/0/cost", False, r"robots\[0\]\.cost: a number is expected"),
        ("robots/0/counts/stances", 2.0, r"counts\.stances: a whole number is expected"),
        ("robots/0/proofs/moves", [True], r"proofs\.moves: a number is expected"),
        ("robots/0/cuts/0/kind", "guessed", r"cuts\[0\]\.kind: one of proved, budget"),
        ("robots/0/cuts/0/stage", "graph", r"cuts\[0\]\.stage: one of transition, motion, torque"),
        ("robots/0/cuts/0/limb", "tail", r"cuts\[0\]\.limb: one of right_front"),
        ("robots/0/cuts/0/stance/tail", 3, r"cuts\[0\]\.stance: there is no field 'tail'"),
        ("robots/0/stances", [], r"stances: 1 or more are expected"),
        ("robots/0/stances/1/left_rear", REMOVED, r"stances\[1\]: the field 'left_rear' is missing"),
        ("robots/0/stances/1/left_rear", "2", r"stances\[1\]\.left_rear: a whole number"),
        ("robots/0/stances/1/left_rear", -2, r"stances\[1\]\.left_rear: a whole number, 0 or more"),
        ("robots/0/phases", [], r"phases: 1 or more"),
        ("robots/0/phases/0/kind", "rest", r"phases\[0\]\.kind: one of shift, swing"),
        ("robots/0/phases/1/limb", "tail", r"phases\[1\]\.limb: one of right_front"),
        ("robots/0/phases/1/stance", 2, r"phases\[1\]\.stance: there are 2 stances"),
        ("robots/0/phases/0/contacts", [], r"contacts: 1 or more are expected \(given: a list of 0\)"),
        ("robots/0/phases/0/contacts/0/limb", None, r"contacts\[0\]\.limb: one of"),
        ("robots/0/phases/0/contacts/0/limb", "left_front", r"contacts: a limb is named twice"),
        ("robots/0/phases/0/contacts/0/point", [0.1, 0.2], r"contacts\[0\]\.point: 3 entries are expected, not 2"),
        ("robots/0/phases/0/time", [0.0], r"time: two instants or more"),
        ("robots/0/phases/0/time/5", 0.04, r"time: two instants or more are expected, each later"),
        ("robots/0/phases/0/time/5", "0.05", r"time\[5\]: a number is expected"),
        ("robots/0/phases/0/q", REMOVED, r"phases\[0\]: the field 'q' is missing"),
        ("robots/0/phases/0/q/80", REMOVED, r"q: 81 entries are expected, not 80"),
        ("robots/0/phases/0/q/7", [0.0] * 12, r"q\[7\]: 11 entries are expected, not 12"),
        ("robots/0/phases/0/q/7/3", None, r"q\[7\]\[3\]: a number is expected \(given: null\)"),
        ("robots/0/phases/0/q/7/3", True, r"q\[7\]\[3\]: a number is expected"),
        ("robots/0/phases/0/q/7/3", [1.0], r"q\[7\]\[3\]: a number is expected"),
        ("robots/0/phases/0/vd/7/3", 10**400, r"vd\[7\]\[3\]: a finite number is expected"),
        ("robots/0/phases/0/vd/7/3", 1e200, r"vd\[7\]\[3\]: a number between -1e\+12 and 1e\+12 is expected"),
        ("robots/0/phases/0/torque/7", 1.0, r"torque\[7\]: a list is expected"),
        ("robots/0/phases/0/force/tail", [], r"force\.tail: the limbs are"),
        ("robots/0/phases/0/force/left_rear", REMOVED, r"force: left_rear is in contact, so its force is expected"),
        ("robots/0/phases/0/force/left_rear/9", [0.0, 0.0], r"force\.left_rear\[9\]: 3 entries"),
    ],
)
def test_a_malformed_field_is_named_with_what_stands_there(path: str, value: object, complaint: str) -> None:
    with pytest.raises(PlanFileError, match=complaint) as caught:
        Plan.from_json(edited(step_plan(), path, value), "climb.json")
    assert str(caught.value).startswith("climb.json: ")


def test_a_number_too_large_for_a_float_is_refused() -> None:
    text = step_plan().to_json().replace('"total": 1.5', '"total": 1e999')
    with pytest.raises(PlanFileError, match=r"timings\.total: a finite number is expected"):
        Plan.from_json(text)


def test_whole_numbers_may_stand_for_floats() -> None:
    plan = Plan.from_json(edited(step_plan(), "robots/0/phases/0/q/0", [0] * 11))
    assert plan.robots[0].phases[0].q.dtype == np.float64


def paths(data: Any, way: str = "") -> list[str]:
    """The path of every entry; of long lists only the first and the last entry."""
    if isinstance(data, dict):
        items = list(data.items())
    elif isinstance(data, list) and data:
        items = [(i, data[i]) for i in sorted({0, len(data) - 1})]
    else:
        return []
    return [p for key, item in items for p in (f"{way}{key}", *paths(item, f"{way}{key}/"))]


SHORT = json.loads(step_plan(duration=0.05).to_json())
PATHS = paths(SHORT)
JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=200, deadline=None)
@given(path=st.sampled_from(PATHS), junk=JUNK)
def test_junk_anywhere_either_still_reads_as_a_plan_or_is_a_plan_file_error(path: str, junk: Any) -> None:
    data = json.loads(json.dumps(SHORT))
    parent, last = entry(data, path)
    parent[last] = junk
    try:
        plan = Plan.from_json(json.dumps(data))
    except PlanFileError:
        return
    assert_same(Plan.from_json(plan.to_json()), plan)


def test_every_missing_entry_of_an_object_is_noticed_unless_the_object_is_an_open_list_of_facts() -> None:
    open_lists = ("software/", "timings/", "/counts/", "/proofs/")
    generator = random.Random(0)
    for path in generator.sample(PATHS, 60):
        parent, _ = entry(SHORT, path)
        if isinstance(parent, list) or any(part in path for part in open_lists):
            continue
        with pytest.raises(PlanFileError):
            Plan.from_json(edited(step_plan(duration=0.05), path, REMOVED))


def test_the_format_is_documented_field_by_field_and_check_by_check() -> None:
    page = (Path(__file__).parents[1] / "docs" / "plan-format.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `([^`]+)` \|", page, flags=re.MULTILINE))
    robot = SHORT["robots"][0]
    fields = {*SHORT, *robot, *robot["phases"][0], *robot["cuts"][0]}
    fields |= {f"objective.{key}" for key in robot["objective"]}
    fields |= {f"scenario.{key}" for key in SHORT["scenario"]}
    fields |= {f"timing.{key}" for key in robot["phases"][0]["timing"]}
    fields |= {f"contacts[k].{key}" for key in robot["phases"][0]["contacts"][0]}
    margins = robot["phases"][0]["margins"]
    fields |= {f"margins.{kind}" for kind in margins}
    fields |= {f"margins.*.{key}" for key in margins["push"]}
    assert listed == fields
    for name, rule in RULES.items():
        limit = f"{rule.sense} {rule.limit:g} {rule.unit}".rstrip()
        assert f"| {name} | {rule.asks} | {limit} |" in page


def test_a_program_without_climber_can_follow_the_file(tmp_path: Path) -> None:
    """Feet on their contact points and torques that produce the motion, from JSON, YAML and Drake alone."""
    step_plan().save(tmp_path / "plan.json")
    robot = json.loads((tmp_path / "plan.json").read_text())["robots"][0]
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.package_map().Add("climber", str(Path(__file__).parents[1] / "plants"))
    (model,) = parser.AddModelsFromUrl(robot["model"])
    plant.mutable_gravity_field().set_gravity_vector([0.0, -9.81, 0.0])
    plant.Finalize()
    context = plant.CreateDefaultContext()
    q_columns = [robot["positions"].index(name) for name in plant.GetPositionNames(model, False, False)]
    v_names = plant.GetVelocityNames(model, False, False)
    v_columns = [robot["velocities"].index(name) for name in v_names]
    torque_rows = [v_names.index(name) for name in robot["joints"]]
    for phase in robot["phases"]:
        for k in range(0, len(phase["time"]), 10):
            plant.SetPositions(context, np.array(phase["q"][k])[q_columns])
            plant.SetVelocities(context, np.array(phase["v"][k])[v_columns])
            forces = MultibodyForces(plant)
            plant.CalcForceElementsContribution(context, forces)
            needed = plant.CalcInverseDynamics(context, np.array(phase["vd"][k])[v_columns], forces)
            for contact in phase["contacts"]:
                frame, world = plant.GetFrameByName(f"{contact['limb']}_foot"), plant.world_frame()
                foot = plant.CalcPointsPositions(context, frame, np.zeros(3), world).ravel()
                np.testing.assert_allclose(foot, contact["point"], atol=1e-9)
                J = plant.CalcJacobianTranslationalVelocity(
                    context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
                )
                needed -= J.T @ np.array(phase["force"][contact["limb"]][k])
            needed[torque_rows] -= phase["torque"][k]
            np.testing.assert_allclose(needed, 0.0, atol=1e-9)
