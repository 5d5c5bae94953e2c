"""A robot model on disk: the URDF or SDF file that Drake parses, and the description beside it.

The description is a small YAML file of the same stem, for what such a file cannot say: which body is the pelvis, which
frames are feet and in what order, and which rotations leave the robot the same.
"""

import difflib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from climber.exceptions import ModelError, ScenarioError
from climber.floating import add_floating_joint
from climber.resources import package_map, resolve_model
from climber.yaml_tree import check_tree, read_tree, rule


@dataclass
class LimbFields:
    """A limb in the description.

    Attributes:
        name: What scenarios and plans call it.
        foot: The frame whose origin is its foot.
    """

    name: str = field(default="", metadata=rule(required=True, empty=False))
    foot: str = field(default="", metadata=rule(required=True, empty=False))


@dataclass
class Description:
    """The file beside the model.

    Attributes:
        pelvis: The body that carries the limbs.
        limbs: The limbs, counter-clockwise around the pelvis as seen from its +z.
        symmetries: Rotations of the pelvis that map the robot onto itself, each as the limb that takes the place of
            each limb of `limbs`. What follows by repeating them need not be listed.
    """

    pelvis: str = field(default="", metadata=rule(required=True, empty=False))
    limbs: list[LimbFields] = field(default_factory=list, metadata=rule(required=True, empty=False))
    symmetries: list[list[str]] = field(default_factory=list)


@dataclass(frozen=True)
class Model:
    """A robot model as found on disk: the file Drake parses and the description beside it.

    Attributes:
        source: What the user wrote, a `package://` URL or a path.
        path: The model file.
        pelvis: Name of the body that carries the limbs.
        feet: Name of each limb's foot frame by limb name, in limb order.
        symmetries: Limb orders, each naming the limb that takes the place of each limb, that leave the robot the same.
    """

    source: str
    path: Path
    pelvis: str
    feet: dict[str, str]
    symmetries: tuple[tuple[str, ...], ...] = ()

    @classmethod
    def load(cls, source: str | Path, relative_to: Path | None = None) -> Self:
        """Reads the description beside a model.

        Args:
            source: A `package://climber/...` URL or a path to a URDF or SDF file.
            relative_to: The folder that a relative path starts from; the working directory by default.

        Raises:
            ModelError: If a file is missing or the description does not say what it must.
        """
        path = resolve_model(str(source), relative_to)
        beside = path.with_suffix(".yaml")
        if not path.is_file():
            raise ModelError(f"{path}: no such robot model (given as {source})")
        if not beside.is_file():
            raise ModelError(f"{beside}: missing; it must name the pelvis, the limbs and their feet of {path.name}")
        try:
            tree: dict[str, Any] = read_tree(beside.read_text(encoding="utf-8"), str(beside))
            check_tree(tree, Description, str(beside))
        except UnicodeDecodeError as error:
            raise ModelError(f"{beside}: not UTF-8 text: {error}") from error
        except ScenarioError as error:
            raise ModelError(str(error)) from error
        feet = {limb["name"]: limb["foot"] for limb in tree["limbs"]}
        symmetries = tuple(tuple(order) for order in tree.get("symmetries", ()))
        model = cls(str(source), path, tree["pelvis"], feet, symmetries)
        for name in ("name", "foot"):
            times = Counter(limb[name] for limb in tree["limbs"])
            for number, limb in enumerate(tree["limbs"]):
                if times[limb[name]] > 1:
                    raise model.error(f"limbs[{number}].{name}", limb[name], "each limb's own")
        for number, order in enumerate(symmetries):
            if sorted(order) != sorted(feet):
                allowed = f"each of {', '.join(feet)} once"
                raise model.error(f"symmetries[{number}]", list(order), allowed)
        return model

    def error(self, path: str, given: object, allowed: str) -> ModelError:
        """The error of one value of the description.

        Args:
            path: The field, such as `limbs[0].foot`.
            given: What is there.
            allowed: What would be accepted, as the end of the sentence "allowed: ...".
        """
        return ModelError(str(ScenarioError.at(self.path.with_suffix(".yaml"), path, given, allowed)))

    def unknown(self, path: str, given: str, what: str, known: Sequence[str]) -> ModelError:
        """The error of a name that the model file does not have, with the nearest that it has."""
        near = difflib.get_close_matches(given, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        return self.error(path, given, f"the name of a {what} of {self.path.name}{hint}")

    def add_to(
        self, plant: MultibodyPlant, scene_graph: SceneGraph | None = None, name: str | None = None
    ) -> ModelInstanceIndex:
        """Parses the model into a plant that is not yet finalised, under the instance name `name` if given.

        A pelvis that hangs from no joint gets one in which it floats (`climber.floating`).
        """
        parser = Parser(plant, scene_graph) if scene_graph is not None else Parser(plant)
        parser.package_map().AddMap(package_map())
        if name is not None:
            parser.SetAutoRenaming(True)
        try:
            (instance,) = parser.AddModels(str(self.path))
        except (RuntimeError, ValueError) as error:
            raise ModelError(f"{self.path}: Drake cannot read this model: {error}") from error
        if name is not None:
            plant.RenameModelInstance(instance, name)
        if plant.HasBodyNamed(self.pelvis, instance):
            pelvis = plant.GetBodyByName(self.pelvis, instance)
            joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
            if all(joint.child_body().index() != pelvis.index() for joint in joints):
                add_floating_joint(plant, pelvis)
        return instance
