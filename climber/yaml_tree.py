"""YAML read strictly: every mistake is a `ScenarioError` that names the field by its path.

Drake's `yaml_load_typed` builds the dataclasses, but it stops at the first mistake with a message that does not say
where it is, takes a float for an integer and a quoted number for a number, and lets the last of two equal keys win. So
the tree is read and compared with the schema here first, and Drake gets a tree that is known to fit.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from climber.exceptions import ScenarioError

# The scalars of YAML 1.2's core schema. PyYAML's are those of YAML 1.1, where 010 is eight, 1:30 is ninety, 1e-3 is a
# word and `no` is a truth value.
_CORE_SCALARS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    "float": (
        r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+0123456789.",
    ),
}
_KEPT = ("tag:yaml.org,2002:null", "tag:yaml.org,2002:merge")


class _CoreLoader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalars of YAML 1.2."""


_CoreLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in _KEPT]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _kind, (_pattern, _first) in _CORE_SCALARS.items():
    _CoreLoader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(f"^(?:{_pattern})$"), list(_first))


@dataclasses.dataclass(frozen=True)
class Rule:
    """What a field of a schema accepts beyond its type.

    A rule on a list of numbers, or on a list of lists of them, is a rule on each number.

    Attributes:
        required: Must be given, although the dataclass has a default (Drake asks for one).
        at_least: Least value.
        above: Greater than this.
        at_most: Greatest value.
        below: Less than this.
        choices: The words allowed.
        lengths: How many items a (innermost) list may have.
        empty: Whether an empty list, mapping or text is allowed.
    """

    required: bool = False
    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None
    below: float | None = None
    choices: tuple[str, ...] = ()
    lengths: tuple[int, ...] = ()
    empty: bool = True

    def bounds(self) -> str:
        """The bounds in words, with a leading space if there are any."""
        limits = ((">=", self.at_least), (">", self.above), ("<=", self.at_most), ("<", self.below))
        words = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)
        return f" {words}" if words else ""

    def holds_for(self, number: float) -> bool:
        """Whether a number is within the bounds."""
        return not (
            (self.at_least is not None and number < self.at_least)
            or (self.above is not None and number <= self.above)
            or (self.at_most is not None and number > self.at_most)
            or (self.below is not None and number >= self.below)
        )


def rule(**limits: Any) -> dict[str, Rule]:
    """Metadata of a dataclass field that carries a `Rule`."""
    return {"rule": Rule(**limits)}


def nearest(name: str, known: Sequence[str]) -> str:
    """A hint at the known name that looks most like `name`, with all of them; empty only if none is known."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{hint}{', '.join(known)}"


def read_tree(text: str, file: str) -> dict[str, Any]:
    """The mapping that a YAML text holds. Root keys that begin with an underscore are templates, and left out.

    Args:
        text: The YAML text.
        file: What errors call it.

    Raises:
        ScenarioError: If the text is not one YAML mapping with each key once.
    """
    try:
        loader = _CoreLoader(text)
        node = loader.get_single_node()
        if node is not None:
            _refuse_duplicates(node, "", file, set())
        tree = None if node is None else loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        said = [getattr(error, "context", None), getattr(error, "problem", None) or str(error)]
        problem = ", ".join(" ".join(part.split()) for part in said if part)
        raise ScenarioError(
            f"{file}: {where}not YAML that can be read: {problem}; allowed: one plain YAML mapping",
            file=file,
            given=problem,
            allowed="one plain YAML mapping",
        ) from error
    if not isinstance(tree, dict):
        given = "an empty file" if tree is None else tree
        raise ScenarioError.at(file, "", given, "a YAML mapping of fields")
    return {key: value for key, value in tree.items() if not str(key).startswith("_")}


def _refuse_duplicates(node: yaml.Node, path: str, file: str, seen: set[int]) -> None:
    """Goes through the nodes, where both of two equal keys are still to be seen."""
    if id(node) in seen:  # an alias, perhaps to a node that contains it
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for number, item in enumerate(node.value):
            _refuse_duplicates(item, f"{path}[{number}]", file, seen)
    elif isinstance(node, yaml.MappingNode):
        lines: dict[tuple[str, str], int] = {}
        for key, value in node.value:
            place = join(path, key.value if isinstance(key, yaml.ScalarNode) else "?")
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if (key.tag, key.value) in lines:
                    raise _duplicate(file, place, value, lines[key.tag, key.value], line)
                lines[key.tag, key.value] = line
            _refuse_duplicates(value, place, file, seen)


def _duplicate(file: str, place: str, value: yaml.Node, first: int, second: int) -> ScenarioError:
    given = value.value if isinstance(value, yaml.ScalarNode) else "a second value"
    lines = f"line {first}" if first == second else f"lines {first} and {second}"
    return ScenarioError.at(file, place, given, f"each field once; this one is there twice ({lines})")


def join(path: str, field: object) -> str:
    """The path of a field of what is at `path`."""
    return f"{path}.{field}" if path else f"{field}"


def check_tree(tree: object, schema: type, file: str) -> None:
    """Compares a tree with the dataclass it is to become.

    Args:
        tree: What `read_tree` returned.
        schema: A dataclass with `Rule`s in the metadata of its fields.
        file: What errors call the text.

    Raises:
        ScenarioError: At the first value that is unknown, missing, of another type, not finite, or out of bounds.
    """
    _Checker(file).value(tree, schema, Rule(), "")


def check_given(given: Mapping[str, object], schema: type, file: str) -> None:
    """Compares some fields with the dataclass that they are fields of; the others may be missing.

    Args:
        given: The fields by name.
        schema: As in `check_tree`.
        file: What errors call where they come from.

    Raises:
        ScenarioError: As in `check_tree`.
    """
    _Checker(file).fields(given, schema, "", whole=False)


class _Null:
    """A null in the file, which differs from nothing in the file and from the word."""

    def __repr__(self) -> str:
        return "null"


class _Checker:
    def __init__(self, file: str) -> None:
        self.file = file

    def refuse(self, path: str, given: object, allowed: str) -> typing.NoReturn:
        raise ScenarioError.at(self.file, path, _Null() if given is None else given, allowed)

    def missing(self, path: str, name: str) -> typing.NoReturn:
        raise ScenarioError.at(self.file, join(path, name), None, f"{name} must be given")

    def value(self, tree: object, schema: Any, rule: Rule, path: str) -> None:
        origin, args = typing.get_origin(schema), typing.get_args(schema)
        if origin in (typing.Union, types.UnionType):  # the schemas' only unions are with None
            if tree is not None:
                self.value(tree, args[0], rule, path)
        elif origin is list:
            self.items(tree, args[0], rule, path)
        elif origin is dict:
            self.mapping(tree, rule, path, "a mapping of names")
            for key, item in typing.cast(dict[str, object], tree).items():
                self.value(item, args[1], rule, join(path, key))
        elif dataclasses.is_dataclass(schema):
            self.fields(tree, typing.cast(type, schema), path)
        else:
            self.scalar(tree, schema, rule, path)

    def mapping(self, tree: object, rule: Rule, path: str, wanted: str) -> None:
        if not isinstance(tree, Mapping):
            self.refuse(path, tree, wanted)
        for key in tree:
            if not isinstance(key, str):
                self.refuse(join(path, key), tree[key], f"a name, not {key!r}, before the colon")
        if not tree and not rule.empty:
            self.refuse(path, tree, f"{wanted}, not an empty one")

    def fields(self, tree: object, schema: type, path: str, *, whole: bool = True) -> None:
        known = {field.name: field for field in dataclasses.fields(schema)}
        self.mapping(tree, Rule(), path, f"the fields {', '.join(known)}")
        mapping = typing.cast(dict[str, object], tree)
        for name, value in mapping.items():
            if name not in known:
                self.refuse(join(path, name), value, f"no field of this name; {nearest(name, list(known))}")
        for name, field in known.items():
            rule: Rule = field.metadata.get("rule", Rule())
            if name in mapping:
                self.value(mapping[name], field.type, rule, join(path, name))
            elif rule.required and whole:
                self.missing(path, name)

    def items(self, tree: object, schema: Any, rule: Rule, path: str) -> None:
        nested = typing.get_origin(schema) is list
        lengths = () if nested else rule.lengths
        counts = " or ".join(map(str, lengths))
        wanted = f"a list of {counts} numbers{rule.bounds()}" if lengths else "a list"
        if not isinstance(tree, list):
            self.refuse(path, tree, wanted)
        if not tree and not rule.empty:
            self.refuse(path, tree, "a list that is not empty")
        if lengths and len(tree) not in lengths:
            self.refuse(path, tree, wanted)
        for number, item in enumerate(tree):
            self.value(item, schema, rule, f"{path}[{number}]")

    def scalar(self, tree: object, schema: type, rule: Rule, path: str) -> None:
        if schema is str:
            if rule.choices and tree not in rule.choices:
                self.refuse(path, tree, f"one of {', '.join(rule.choices)}")
            if not isinstance(tree, str) or not (tree.strip() or rule.empty):
                self.refuse(path, tree, "text" if rule.empty else "text that is not empty")
            return
        kind = "a whole number" if schema is int else "a finite number"
        if isinstance(tree, bool) or not isinstance(tree, int if schema is int else int | float):
            self.refuse(path, tree, f"{kind}{rule.bounds()}")
        try:
            finite = math.isfinite(tree)
        except OverflowError:  # an integer too large for a float
            finite = False
        if not finite or not rule.holds_for(tree):
            self.refuse(path, tree, f"{kind}{rule.bounds()}")
