"""JSON read strictly, with the path of a field in every message, and written so that people can look at it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from climber.exceptions import PlanFileError
from climber.stance import Vector

Choice = TypeVar("Choice", bound=str)
LARGEST = 1e12  # of samples, in any unit: their squares and products can still be told apart


def parse(text: str, source: str) -> Node:
    """Parses JSON, refusing what Python's reader lets through: NaN, Infinity and keys given twice.

    Args:
        text: The JSON text.
        source: What to call it in messages, such as the file's path.

    Raises:
        PlanFileError: If the text is not JSON.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)!r} is given twice")
        return found

    def not_a_number(word: str) -> float:
        raise ValueError(f"{word} is not JSON; numbers are finite")

    try:
        value = json.loads(text, object_pairs_hook=unique, parse_constant=not_a_number)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"{source}: not a JSON file: {error}") from error
    return Node(value, source, "")


@dataclass(frozen=True)
class Node:
    """A value in a JSON file and the way to it, so that whatever is wrong with it can be reported in place.

    Attributes:
        value: What stands there.
        source: The file.
        path: The way from the root, such as `robots[0].phases[2].q`.
    """

    value: Any
    source: str
    path: str

    def error(self, expected: str) -> PlanFileError:
        """The error that something else stands here than what is expected."""
        given = json.dumps(self.value) if not isinstance(self.value, list | dict) else _called(self.value)
        given = given if len(given) <= 60 else given[:57] + "..."
        return PlanFileError(f"{self.source}: {self.path or 'top level'}: {expected} (given: {given})")

    def _child(self, key: str) -> Node:
        return Node(self.value[key], self.source, f"{self.path}.{key}" if self.path else key)

    def entries(self) -> dict[str, Node]:
        """The entries of an object whose keys may be anything."""
        if not isinstance(self.value, dict):
            raise self.error("an object is expected")
        return {key: self._child(key) for key in self.value}

    def some(self, names: Sequence[str]) -> dict[str, Node]:
        """The fields `names` of an object that may have more."""
        entries = self.entries()
        for name in names:
            if name not in entries:
                raise self.error(f"the field {name!r} is missing")
        return {name: entries[name] for name in names}

    def fields(self, names: Sequence[str]) -> dict[str, Node]:
        """The fields of an object that has exactly `names`."""
        for name in self.entries():
            if name not in names:
                raise self.error(f"there is no field {name!r}; the fields are {', '.join(names)}")
        return self.some(names)

    def items(self, at_least: int = 0, exactly: int | None = None) -> list[Node]:
        """The items of a list, `exactly` so many if that is given."""
        if not isinstance(self.value, list):
            raise self.error("a list is expected")
        if len(self.value) < at_least:
            raise self.error(f"{at_least} or more are expected")
        if exactly is not None and len(self.value) != exactly:
            raise self.error(f"{exactly} entries are expected, not {len(self.value)}")
        return [Node(value, self.source, f"{self.path}[{i}]") for i, value in enumerate(self.value)]

    def text(self) -> str:
        """A string."""
        if not isinstance(self.value, str):
            raise self.error("a string is expected")
        return self.value

    def choice(self, allowed: Iterable[Choice]) -> Choice:
        """One of the strings `allowed`."""
        options = list(allowed)
        for option in options:
            if self.value == option:
                return option
        raise self.error(f"one of {', '.join(options)} is expected")

    def names(self) -> tuple[str, ...]:
        """A list of strings, each different."""
        names = tuple(item.text() for item in self.items(at_least=1))
        if len(set(names)) < len(names):
            raise self.error("each name is expected once")
        return names

    def integer(self, at_least: int | None = None) -> int:
        """A whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            raise self.error("a whole number is expected")
        if at_least is not None and self.value < at_least:
            raise self.error(f"a whole number, {at_least} or more, is expected")
        return self.value

    def number(self) -> float:
        """A finite number; a whole one stays whole."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.error("a number is expected")
        if not _is_finite(self.value):
            raise self.error("a finite number is expected")
        return self.value

    def scalar(self) -> bool | int | float | str:
        """A string, a number or a truth value."""
        return self.value if isinstance(self.value, bool | str) else self.number()

    def array(self, *shape: int | None) -> Vector:
        """A list of numbers of a size that can be reckoned with, or a list of such lists.

        Args:
            shape: Expected length along each axis; None for any.

        Returns:
            The numbers, with as many axes as `shape`.
        """
        if not isinstance(self.value, list):
            raise self.error("a list is expected")
        if shape[0] is not None and len(self.value) != shape[0]:
            raise self.error(f"{shape[0]} entries are expected, not {len(self.value)}")
        if len(shape) > 1:
            rows = [item.array(*shape[1:]) for item in self.items()]
            return np.array(rows).reshape(len(rows), *shape[1:])
        # A quick look first, since a plan has hundreds of thousands of numbers; one by one only to say what is wrong.
        if not (set(map(type, self.value)) <= {float} and all(abs(value) <= LARGEST for value in self.value)):
            for item in self.items():
                if abs(item.number()) > LARGEST:
                    raise item.error(f"a number between -{LARGEST:g} and {LARGEST:g} is expected")
        return np.array(self.value, dtype=float)


def _called(value: list[Any] | dict[str, Any]) -> str:
    """What to call a value that is too long to be shown."""
    return "an object" if isinstance(value, dict) else f"a list of {len(value)}"


def _is_finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number too large for a float
        return False


def render(value: Any) -> str:
    """JSON text with a line for each field and each row of numbers; floats are written so that they read back equal.

    Raises:
        PlanFileError: If a number is not finite or a value has no counterpart in JSON.
    """
    try:
        return _render(value, "") + "\n"
    except (ValueError, TypeError) as error:
        raise PlanFileError(f"the plan cannot be written: {error}") from error


def _render(value: Any, indent: str) -> str:
    inner = indent + " "
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, dict) and value:
        lines = (f"{inner}{json.dumps(key)}: {_render(item, inner)}" for key, item in value.items())
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple | dict | np.ndarray):
        return "[\n" + ",\n".join(inner + _render(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
