"""Run by an installed climber, away from the checkout: what it needs must have come along in the wheel."""

import sys
from importlib.resources import files
from pathlib import Path

import climber
from climber.resources import packaged_scenarios, plants_folder, scenarios_folder
from climber.robot import Model, Robot
from climber.scenario import check_against_robot

checkout = Path(sys.argv[1]).resolve()
package = Path(climber.__file__).resolve().parent
assert package != checkout / "climber", f"{package} is the checkout's"
for name in ("plants", "scenarios"):
    inside = {p.relative_to(package / name) for p in (package / name).rglob("*") if p.is_file()}
    outside = {p.relative_to(checkout / name) for p in (checkout / name).rglob("*") if p.is_file()}
    assert inside >= outside, f"the wheel lacks {sorted(map(str, outside - inside))}"
assert plants_folder() == package / "plants" and scenarios_folder() == package / "scenarios"

for written in sorted((checkout / "climber").rglob("*")):
    if written.is_file() and "__pycache__" not in written.parts:
        relative = written.relative_to(checkout / "climber")
        assert files(climber).joinpath(str(relative)).is_file(), f"the wheel lacks climber/{relative}"

for name in packaged_scenarios():
    scenario = climber.load_scenario(name)
    gravity = scenario.build_wall().gravity
    for number, spec in enumerate(scenario.robots):
        robot = Robot(Model.load(spec.model, scenario.folder), gravity)
        check_against_robot(scenario, number, robot.limb_names, robot.joint_limits, robot.planar)
        print(f"{name}: {len(scenario.wall.holds)} holds, {spec.name} of {robot.mass:.1f} kg from {spec.model}")
