"""Where models and scenarios are found."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant

from climber import resources
from climber.exceptions import ClimberError, ModelError
from climber.resources import package_map, packaged_scenarios, plants_folder, resolve_model, resolve_scenario

QUADRUPED = "package://climber/quadruped/quadruped.urdf"


def test_the_package_map_knows_climber_s_models() -> None:
    packages = package_map()
    assert Path(packages.GetPath("climber")) == plants_folder()
    assert Path(packages.ResolveUrl(QUADRUPED)) == resolve_model(QUADRUPED)


def test_the_package_file_agrees_with_the_package_map() -> None:
    packages = PackageMap.MakeEmpty()
    packages.AddPackageXml(str(plants_folder() / "package.xml"))
    assert packages.GetPackageNames() == ["climber"]


def test_every_model_that_comes_along_is_read_by_drake_under_its_url() -> None:
    models = [path for path in plants_folder().rglob("*") if path.suffix in (".urdf", ".sdf")]
    assert models
    for model in models:
        plant = MultibodyPlant(0.0)
        parser = Parser(plant)
        parser.package_map().AddMap(package_map())
        url = f"package://climber/{model.relative_to(plants_folder())}"
        assert len(parser.AddModels(url=url)) == 1
        assert resolve_model(url) == model


def test_a_relative_path_starts_in_the_folder_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert resolve_model("mine/robot.sdf", tmp_path) == tmp_path / "mine/robot.sdf"
    assert resolve_model(Path("mine/robot.sdf"), tmp_path) == tmp_path / "mine/robot.sdf"
    monkeypatch.chdir(tmp_path)
    assert resolve_model("robot.sdf") == Path.cwd() / "robot.sdf"


def test_an_absolute_path_stays(tmp_path: Path) -> None:
    assert resolve_model(tmp_path / "robot.sdf", Path("/elsewhere")) == tmp_path / "robot.sdf"


@pytest.mark.parametrize("url", ["package://other/robot.urdf", "package://", "package://climbers/robot.urdf"])
def test_other_packages_are_refused_by_name(url: str) -> None:
    with pytest.raises(ModelError, match="package://climber/"):
        resolve_model(url)


def test_scenarios_that_come_along_go_by_their_stems() -> None:
    assert {"basic", "higher"} <= set(packaged_scenarios())
    assert resolve_scenario("basic") == packaged_scenarios()["basic"]
    assert resolve_scenario("basic.yaml") == Path("basic.yaml")
    assert resolve_scenario("no-such-climb") == Path("no-such-climb")


def test_a_file_in_the_working_directory_comes_before_one_that_comes_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("basic").write_text("name: mine\n")
    assert resolve_scenario("basic") == Path("basic")
    Path("higher").mkdir()  # as `climber solve higher --out higher` leaves it
    assert resolve_scenario("higher") == packaged_scenarios()["higher"]


def test_folders_inside_an_installed_package_are_found_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site" / "climber"
    (package / "plants").mkdir(parents=True)
    (package.parent / "plants").mkdir()
    monkeypatch.setattr(resources, "__file__", str(package / "resources.py"))
    assert resources.plants_folder() == package / "plants"
    with pytest.raises(ClimberError, match="scenarios"):
        resources.scenarios_folder()
