"""Where the robot models and the scenarios that come with climber are.

In a checkout `plants/` and `scenarios/` lie beside the package, so that they are easy to find and edit; in an installed
wheel they lie inside it. Everything that needs them asks here.
"""

from __future__ import annotations

from pathlib import Path

from pydrake.multibody.parsing import PackageMap

from climber.exceptions import ClimberError, ModelError

PACKAGE = "climber"
_SCHEME = "package://"


def _folder(name: str) -> Path:
    """The folder `name` of an installed climber, or of the checkout this package is imported from."""
    package = Path(__file__).resolve().parent
    for folder in (package / name, package.parent / name):
        if folder.is_dir():
            return folder
    raise ClimberError(f"this installation of climber has lost its {name}: looked in {package} and {package.parent}")


def plants_folder() -> Path:
    """The folder of robot models, `package://climber/` in model URLs."""
    return _folder("plants")


def scenarios_folder() -> Path:
    """The folder of scenarios that come with climber."""
    return _folder("scenarios")


def packaged_scenarios() -> dict[str, Path]:
    """The scenarios that come with climber, by name."""
    return {path.stem: path for path in sorted(scenarios_folder().glob("*.yaml"))}


def package_map() -> PackageMap:
    """Drake's default package map with `climber` added, for any `Parser` that is to read our models."""
    packages = PackageMap()
    packages.Add(PACKAGE, str(plants_folder()))
    return packages


def resolve_model(source: str | Path, relative_to: Path | None = None) -> Path:
    """The file that a robot model is read from.

    Args:
        source: A `package://climber/...` URL, or a path.
        relative_to: The folder that a relative path starts from; the working directory by default.

    Returns:
        The path, which need not exist.

    Raises:
        ModelError: If the URL names another package.
    """
    text = str(source)
    if text.startswith(_SCHEME):
        package, _, inside = text.removeprefix(_SCHEME).partition("/")
        if package != PACKAGE:
            raise ModelError(f"{text}: no package {package!r}; models are package://{PACKAGE}/... or a path")
        return plants_folder() / inside
    return (relative_to or Path.cwd()) / Path(text).expanduser()


def resolve_scenario(source: str | Path) -> Path:
    """The file of a scenario given as a path, or as the bare name of one that comes with climber.

    A file of that name in the working directory takes precedence over the one that comes with climber; a folder, as
    of what was planned before, does not.
    """
    path = Path(source).expanduser()
    bare = path.name == str(source) and not path.suffix
    return packaged_scenarios().get(path.name, path) if bare and not path.is_file() else path
