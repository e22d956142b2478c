"""Reads a two-level YAML file into dataclasses, strictly: each fault is told with file, line, key, remedy.

The dataclasses are the table of options: a field's type, default and `Rule` drive the reading, the messages
and the commented example that `reference` writes.
"""

from __future__ import annotations

import dataclasses
import math
import re
import textwrap
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import yaml

T = TypeVar("T")

_FIRST_LINE = yaml.Mark("", 0, 0, 0, None, 0)


class ConfigError(Exception):
    """A configuration that can't be used; `problems` has a line for each: file:line: key: what was wrong."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


@dataclass(frozen=True, slots=True)
class Rule:
    """What an option accepts beside its type; `example` is for the printed file where there is no default."""

    doc: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    pattern: str = ""  # of a text's beginning, and in words:
    words: str = "text"
    max_length: int = 4096  # PATH_MAX: no option is longer than a path
    relative: bool = False  # a path that counts from the configuration file, unless it is a URL
    example: str = ""
    # Defaults, and whether there is one at all, where another option of the same section has a certain value.
    by: str = ""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    needed_for: Mapping[str, str] = field(default_factory=dict)  # that option's value: why

    def expected(self, kind: str) -> str:
        """What would have been right, in words."""
        if self.choices:
            return " or ".join(self.choices)
        return f"{kind} {self.bounds()}".rstrip()

    def bounds(self) -> str:
        """The range with its unit, in words; empty where there is none."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"from {self.low:.7g} to {self.high:.7g}{unit}" if math.isfinite(self.high) else ""


def option(doc: str, default: Any = dataclasses.MISSING, **rule: Any) -> Any:
    """A field of a section; without `default` the file must give it."""
    return field(default=default, metadata={"rule": Rule(doc, **rule)})


def read(path: Path, root: type[T]) -> T:
    """The file `path` as a `root`, a dataclass of sections; raises ConfigError with every fault found."""
    return typing.cast(T, _Reader(path, root).read())


def reference(root: type[Any]) -> str:
    """Every option with its meaning, range and default, as a commented file that `read` accepts."""
    lines = [
        "# Configuration of omnibotd. Commented lines show the default, or an example where there is none.",
        "# `omnibotd --config FILE --check` validates the file and says what hardware it would open.",
    ]
    for name, kind in typing.get_type_hints(root).items():
        lines += ["", f"# {kind.__doc__}", f"{name}:"]
        hints = typing.get_type_hints(kind)
        for item in dataclasses.fields(kind):
            lines += _described(item, hints[item.name])
    return "\n".join(lines) + "\n"


def _described(item: dataclasses.Field[Any], kind: Any) -> list[str]:
    rule: Rule = item.metadata["rule"]
    bounds = rule.bounds() if kind is not str else ""
    text = f"{rule.doc} {bounds[0].upper()}{bounds[1:]}." if bounds else rule.doc
    for other, default in rule.defaults.items():
        text += f" With {rule.by} {other}: {default}."
    for other, reason in rule.needed_for.items():
        text += f" Needed with {rule.by} {other}: {reason}."
    required = item.default is dataclasses.MISSING
    value = rule.example or (f"{list(item.default)}" if isinstance(item.default, tuple) else f"{item.default}")
    comment = textwrap.wrap(text, 110, initial_indent="  # ", subsequent_indent="  # ", break_on_hyphens=False)
    return [*comment, f"  {'' if required else '# '}{item.name}: {value}"]


class _Unfit(Exception):
    """A value of the wrong type, or out of its range."""


class _Reader:
    """One reading of one file; gathers the faults instead of stopping at the first."""

    def __init__(self, path: Path, root: type[Any]) -> None:
        self._path = path
        self._root = root
        self._sections: dict[str, Any] = typing.get_type_hints(root)
        self._problems: list[tuple[int, str]] = []

    def read(self) -> Any:
        top = self._compose() or yaml.MappingNode("", [], _FIRST_LINE)
        given = self._entries(top, "", list(self._sections))
        values = {name: self._section(name, kind, given.get(name), top) for name, kind in self._sections.items()}
        if self._problems:
            raise ConfigError(*(f"{self._path}:{line}: {message}" for line, message in sorted(self._problems)))
        return self._root(**{name: self._sections[name](**options) for name, options in values.items()})

    def _compose(self) -> yaml.Node | None:
        """The file as a tree of nodes, which unlike plain values know their lines."""
        try:
            return yaml.compose(self._path.read_text("utf-8"), yaml.SafeLoader)
        except OSError as error:
            raise ConfigError(f"{self._path}: can't be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"{self._path}: is no UTF-8 text (byte {error.start})") from error
        except RecursionError as error:
            raise ConfigError(f"{self._path}: is nested too deeply for a configuration") from error
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None) or _FIRST_LINE
            problem = getattr(error, "problem", None) or getattr(error, "reason", error)
            raise ConfigError(f"{self._path}:{mark.line + 1}: is no valid YAML: {problem}") from error

    def _section(self, name: str, kind: type[Any], node: yaml.Node | None, top: yaml.Node) -> dict[str, Any]:
        """The options of one section; absent ones are left to their defaults."""
        given = {} if node is None else self._entries(node, f"{name}.", _names(kind))
        hints = typing.get_type_hints(kind)
        values = {}
        for item in dataclasses.fields(kind):
            rule, key = item.metadata["rule"], f"{name}.{item.name}"
            if item.name in given:
                values[item.name] = self._value(given[item.name], key, hints[item.name], rule)
            elif item.default is dataclasses.MISSING:
                self._fault(node or top, f"{key}: missing, expected {rule.expected(rule.words)}")
            elif (other := values.get(rule.by)) in rule.needed_for:
                self._fault(node or top, f"{key}: missing, expected a number {rule.bounds()}: {rule.needed_for[other]}")
            elif other in rule.defaults:
                values[item.name] = rule.defaults[other]
        return values

    def _entries(self, node: yaml.Node, prefix: str, known: list[str]) -> dict[str, yaml.Node]:
        """The known keys of a mapping with their values; a key that is unknown or given twice is a fault."""
        entries: dict[str, yaml.Node] = {}
        lines: dict[str, int] = {}
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                name = str(key.value)
                if name not in known:
                    self._fault(key, f"{prefix}{name}: unknown key{self._suggestion(prefix, name, known)}")
                elif name in lines:
                    self._fault(key, f"{prefix}{name}: given twice, first on line {lines[name]}")
                else:
                    entries[name], lines[name] = value, key.start_mark.line + 1
        elif not _is_null(node):
            where = f"{prefix[:-1]}: " if prefix else ""
            self._fault(node, f"{where}found {_found(node)}, expected lines of 'key: value'")
        return entries

    def _value(self, node: yaml.Node, key: str, kind: Any, rule: Rule) -> Any:
        if isinstance(kind, types.UnionType):
            if _is_null(node):
                return None
            kind = next(k for k in typing.get_args(kind) if k is not type(None))
        try:
            return _parse(node, kind, rule, self._path.parent)
        except _Unfit as error:
            self._fault(node, f"{key}: found {_found(node)}, expected {error}")
            return None

    def _suggestion(self, prefix: str, name: str, known: list[str]) -> str:
        """What may have been meant: the same key of another section, else a like one of this."""
        elsewhere = [f"{section}.{name}" for section, kind in self._sections.items() if name in _names(kind)]
        close = elsewhere or [prefix + key for key in get_close_matches(name, known, 1)]
        return f"; did you mean {close[0]}?" if close else f", expected one of {', '.join(known)}"

    def _fault(self, node: yaml.Node, message: str) -> None:
        self._problems.append((node.start_mark.line + 1, message))


def _parse(node: yaml.Node, kind: Any, rule: Rule, folder: Path) -> Any:
    """The value of `node` as `kind`; raises _Unfit with what would have been right."""
    if typing.get_origin(kind) is tuple:
        return _pair(node, rule)
    value = _scalar(node)
    if kind in (int, float):
        return _number(value, kind, rule)
    if not isinstance(value, str) or not _fits(value, rule):
        raise _Unfit(rule.expected(rule.words))
    if rule.relative and "://" not in value:
        value = str(folder / value)
    if len(value.encode()) > rule.max_length:
        raise _Unfit(f"{rule.words} ({value} is longer)")
    return kind(value)


def _names(kind: type[Any]) -> list[str]:
    return [item.name for item in dataclasses.fields(kind)]


def _fits(value: str, rule: Rule) -> bool:
    return (
        bool(value) and "\0" not in value and value in (rule.choices or [value]) and bool(re.match(rule.pattern, value))
    )


def _pair(node: yaml.Node, rule: Rule) -> tuple[float, float]:
    if not isinstance(node, yaml.SequenceNode) or len(node.value) != 2:
        raise _Unfit(rule.expected("[a, b], two numbers"))
    try:
        first, second = (_number(_scalar(item), float, rule) for item in node.value)
    except _Unfit as error:
        raise _Unfit(rule.expected("[a, b], two numbers")) from error
    return first, second


def _number(value: object, kind: type[int | float], rule: Rule) -> int | float:
    """An int is a number too, a bool is none; NaN fails every range."""
    if isinstance(value, (int, kind)) and not isinstance(value, bool) and rule.low <= value <= rule.high:
        return kind(value)
    raise _Unfit(rule.expected("a whole number" if kind is int else "a number"))


def _scalar(node: yaml.Node) -> object:
    """The value of a scalar node, None for any other (lists are read item by item: aliases can't explode)."""
    if not isinstance(node, yaml.ScalarNode):
        return None
    try:
        return typing.cast(object, yaml.constructor.SafeConstructor().construct_object(node))
    except (yaml.YAMLError, ValueError, ArithmeticError):  # such as the date 2024-99-99 or an unknown !tag
        return None


def _is_null(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:null"


def _found(node: yaml.Node) -> str:
    if _is_null(node):
        return "nothing"
    if not isinstance(node, yaml.ScalarNode):
        return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"
    text = textwrap.shorten(node.value, 60, placeholder="...")
    return f"the text '{text}'" if isinstance(_scalar(node), str) else text
