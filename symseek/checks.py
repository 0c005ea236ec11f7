"""The border: values of a scene file are checked here, once, and the code behind may trust them."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import numpy as np


class SceneError(ValueError):
    """The input is at fault; the message names source, field, bad value, bound and remedy.

    Args:
        source: file name or what else the scene came from.
        field: dotted path of the key, "object[0].spine"; "" for the source as a whole.
        problem: what is wrong, with value and bound.
        remedy: what to do about it.
    """

    def __init__(self, source: str, field: str, problem: str, remedy: str = ""):
        self.source, self.field, self.problem, self.remedy = source, field, problem, remedy
        super().__init__(": ".join(p for p in (source, field, problem) if p) + (f"; {remedy}" if remedy else ""))


def shown(value: Any, limit: int = 60) -> str:
    """A value as a message shows it, cut to `limit` characters."""
    text = repr(value.tolist()) if isinstance(value, np.ndarray) else repr(value)
    return text if len(text) <= limit else text[: limit - 4] + " ..."


class Table:
    """One table of a scene file, whose keys are all known.

    Args:
        data: the parsed table.
        source: file name for messages.
        where: dotted path of the table, "" at the top.
        known: its keys; any other is refused, with the nearest known one.

    Raises:
        SceneError: no table, or an unknown key.
    """

    def __init__(self, data: Any, source: str, where: str, known: Iterable[str]):
        self.source, self.where = source, where
        if not isinstance(data, Mapping):
            raise SceneError(
                source,
                where,
                f"{shown(data)} is not a table of keys",
                "write key = value lines below its heading",
            )
        self.data: Mapping[str, Any] = data
        known = list(known)
        for key in data:
            if key not in known:
                self.fail(key, "is an unknown key", f"known here: {', '.join(known)}{suggest(key, known)}")

    def path(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where and key else self.where or key

    def fail(self, key: str, problem: str, remedy: str = "") -> NoReturn:
        raise SceneError(self.source, self.path(key), problem, remedy)

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def take(self, key: str, default: Any = dataclasses.MISSING, why: str = "") -> Any:
        """The raw value of `key`; an error with the remedy `why` where it is missing and has no default."""
        if key in self.data:
            return self.data[key]
        if default is dataclasses.MISSING:
            self.fail(key, "is missing", why)
        return default

    def text(self, key: str, default: Any = dataclasses.MISSING, choices: Iterable[str] = (), why: str = "") -> str:
        value = self.take(key, default, why)
        choices = list(choices)
        if not isinstance(value, str) or not value.strip():
            self.fail(key, f"{shown(value)} is not text", 'write it in quotes, like "front"')
        if choices and value not in choices:
            self.fail(
                key,
                f"{shown(value)} is unknown",
                f"choose one of {', '.join(choices)}{suggest(value, choices)}",
            )
        return value

    def name(self, key: str, default: Any = dataclasses.MISSING, why: str = "") -> str:
        """A name that also serves as a file name."""
        value = self.text(key, default, why=why)
        if not all(c.isalnum() or c in " ._-" for c in value) or value[0] in " ." or len(value) > 80:
            self.fail(
                key,
                f"{shown(value)} cannot be a file name",
                "use up to 80 letters, digits, spaces and . _ -, not a dot first",
            )
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self.take(key, default)
        if not isinstance(value, bool):
            self.fail(key, f"{shown(value)} is neither true nor false", "write one of the two, without quotes")
        return value

    def number(
        self,
        key: str,
        default: Any = dataclasses.MISSING,
        above: float = -math.inf,
        most: float = math.inf,
        why: str = "",
    ) -> float:
        """A finite number, above < value <= most."""
        value = self.take(key, default, why)
        if not is_number(value):
            self.fail(key, f"{shown(value)} is not a finite number", "write one, like 12.5")
        if not above < value <= most:
            bound = f"above {above:g}" if most == math.inf else f"above {above:g} and at most {most:g}"
            self.fail(key, f"{shown(value)} is out of bounds", f"it must be {bound}")
        return float(value)

    def array(
        self,
        key: str,
        shape: tuple[int | None, ...],
        meaning: str,
        default: Any = dataclasses.MISSING,
        why: str = "",
    ) -> np.ndarray:
        """A float64 array of finite numbers; None in `shape` leaves that length free."""
        value = self.take(key, default, why)
        try:
            a = np.asarray(value, dtype=object)
            good = a.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, a.shape, strict=True))
            good = good and all(is_number(v) for v in a.ravel())
        except ValueError:  # ragged
            good = False
        if not good:
            wanted = " x ".join("n" if s is None else str(s) for s in shape)
            self.fail(key, f"{shown(value)} is not {meaning}", f"write {wanted} finite numbers")
        return np.asarray(value, dtype=float)

    def table(self, key: str, known: Iterable[str]) -> Table:
        """The sub-table `key`, empty where it is missing."""
        return Table(self.take(key, {}), self.source, self.path(key), known)

    def tables(self, key: str, known: Iterable[str], why: str) -> list[Table]:
        """The list of tables [[key]], at least one; the remedy `why` where there is none."""
        value = self.take(key, [])
        if not isinstance(value, list) or not value:
            self.fail(key, "is missing" if value == [] else f"{shown(value)} is not a list of tables", why)
        return [Table(v, self.source, f"{self.path(key)}[{i}]", known) for i, v in enumerate(value)]

    def fields(self, key: str, default: Any, bounds: Bounds) -> Any:
        """A copy of the dataclass instance `default` with the fields that the sub-table `key` names.

        An instance of that class in the place of a table is taken as it is.

        Raises:
            SceneError: an unknown field, or a value outside its annotation or `bounds`.
        """
        if isinstance(self.data.get(key), type(default)):
            return self.data[key]
        table = self.table(key, [f.name for f in dataclasses.fields(default) if f.init])
        hints = typing.get_type_hints(type(default))
        changed = {}
        for name, value in table.data.items():
            try:
                changed[name] = _bounded(as_annotated(value, hints[name]), bounds.get(name))
            except ValueError as wanted:
                table.fail(name, f"{shown(value)} does not fit", f"it must be {wanted}")
        return dataclasses.replace(default, **changed)


Bounds = Mapping[str, tuple[float, float] | tuple[str, ...]]


def _bounded(value: Any, bound: tuple[Any, ...] | None) -> Any:
    if bound and isinstance(bound[0], str):
        if value not in bound:
            raise ValueError(f"one of {', '.join(bound)}{suggest(str(value), bound)}")
    elif bound:
        low, high = bound
        if not all(low <= v <= high for v in (value if isinstance(value, tuple) else (value,))):
            raise ValueError(f"from {low:g} to {high:g}")
    return value


def suggest(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {near[0]}?" if near else ""


def is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool) and math.isfinite(value)


def as_annotated(value: Any, hint: Any) -> Any:
    """`value` as the annotation `hint` wants it; tuples from lists, floats from whole numbers.

    Raises:
        ValueError: its text says what is wanted, "a whole number".
    """
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        wanted = []
        for choice in (a for a in args if a is not type(None)):
            try:
                return as_annotated(value, choice)
            except ValueError as problem:
                wanted.append(str(problem))
        raise ValueError(" or ".join(wanted))
    if origin is typing.Literal:
        if value not in args:
            near = suggest(value, [a for a in args if isinstance(a, str)]) if isinstance(value, str) else ""
            raise ValueError("one of " + ", ".join(map(str, args)) + near)
        return value
    if hint is tuple or origin is tuple:
        if not isinstance(value, list | tuple) or not value:
            raise ValueError("a list" + (f", each {_WANTED.get(args[0], 'fitting')}" if args else ""))
        if not args:
            return tuple(value)
        each = args[:1] * len(value) if args[-1] is Ellipsis else args
        if len(each) != len(value):
            raise ValueError(f"a list of {len(each)}")
        try:
            return tuple(as_annotated(v, h) for v, h in zip(value, each, strict=True))
        except ValueError as problem:
            raise ValueError(f"a list, each {problem}") from None
    fits = {
        float: is_number(value),
        int: isinstance(value, int) and not isinstance(value, bool),
        bool: isinstance(value, bool),
        str: isinstance(value, str),
    }
    if not fits.get(hint, True):
        raise ValueError(_WANTED[hint])
    return float(value) if hint is float else value


_WANTED = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text in quotes"}
