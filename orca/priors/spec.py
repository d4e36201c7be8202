"""One-line specifications of a prior: ``name:path?option=value&option=value``."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, field
from pathlib import Path

from orca.errors import BadInput, Unknown
from orca.priors.hub import ModelAccess

__all__ = ["PriorSpec", "parse_spec"]


@dataclass(frozen=True)
class PriorSpec:
    """A parsed specification; the readers below check each option's type.

    Attributes:
        name: which prior.
        path: its file, or None.
        options: the rest, as text.
        access: how a learned prior gets at its weights.
    """

    name: str
    path: Path | None = None
    options: dict[str, str] = field(default_factory=dict)
    access: ModelAccess = field(default_factory=ModelAccess)

    def allow(self, *names: str) -> None:
        """Raise `Unknown` if an option is given that this prior does not have."""
        for given in self.options:
            if given not in names:
                near = difflib.get_close_matches(given, names, n=1)
                fix = f"did you mean '{near[0]}'?" if near else "leave it out"
                raise Unknown(f"unknown option '{given}' of '{self.name}'", ", ".join(names) or "no option", fix)

    def need_path(self) -> Path:
        """The file; raises `BadInput` when the specification has none."""
        if self.path is None:
            raise BadInput(f"'{self.name}' without a file", f"{self.name}:FILE?option=value", "add the file's path")
        return self.path

    def number(self, key: str, default: float) -> float:
        """A positive, finite number."""
        text = self.options.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0):
            raise BadInput(f"{key}={text} in '{self.name}'", "a positive number", f"correct {key}")
        return value

    def optional_number(self, key: str) -> float | None:
        """A positive, finite number, or None when it is not given."""
        return self.number(key, 1.0) if key in self.options else None

    def choice(self, key: str, allowed: tuple[str, ...], default: str) -> str:
        """One of several words."""
        text = self.options.get(key, default)
        if text not in allowed:
            raise BadInput(f"{key}={text} in '{self.name}'", " | ".join(allowed), f"correct {key}")
        return text

    def flag(self, key: str, default: bool) -> bool:
        """1 or 0."""
        return self.choice(key, ("0", "1"), str(int(default))) == "1"


def parse_spec(text: str) -> PriorSpec:
    """Split ``name:path?key=value&key=value``; path and options may be left out.

    The last question mark starts the options, and only if an equals sign follows it, so a path may contain one.

    Raises:
        BadInput: an empty name, or an option that is not ``key=value`` or is given twice.
    """
    head, mark, tail = text.rpartition("?")
    if not mark or "=" not in tail:
        head, tail = text, ""
    name, _, path = head.partition(":")
    if not name:
        raise BadInput(f"specification '{text}'", "NAME or NAME:FILE?option=value&option=value", "begin with a name")
    options: dict[str, str] = {}
    for item in filter(None, tail.split("&")):
        key, equals, value = item.partition("=")
        if not (key and equals and value) or key in options:
            raise BadInput(f"option '{item}' in '{text}'", "option=value, each once, joined by '&'", "correct it")
        options[key] = value
    return PriorSpec(name, Path(path) if path else None, options)
