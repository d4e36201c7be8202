"""Names from the command line: split, checked, in order, each once."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence

from orca.errors import BadInput, Unknown

__all__ = ["chosen", "split_names"]


def split_names(given: Sequence[str] | None) -> tuple[str, ...] | None:
    """``["a,b", "c"]`` -> ``("a", "b", "c")``, repeats dropped; None when the option was left out.

    Raises `BadInput` for an option that names nothing.
    """
    if given is None:
        return None
    names = tuple(dict.fromkeys(name.strip() for text in given for name in text.split(",") if name.strip()))
    if not names:
        raise BadInput(f"an empty list of names {given}", "one name or more: a,b,c", "leave the option out for all")
    return names


def chosen(
    kind: str,
    given: Sequence[str] | None,
    known: Iterable[str],
    default: Iterable[str],
    accept: Callable[[str], bool] = lambda name: False,
) -> tuple[str, ...]:
    """The names given, or the default ones; a name that ``accept`` takes need not be known.

    Raises:
        Unknown: a name that is not known, with the nearest one that is.
    """
    names, allowed = split_names(given), tuple(known)
    if names is None:
        return tuple(default)
    for name in names:
        if accept(name):
            continue
        if name not in allowed:
            near = difflib.get_close_matches(name, allowed, n=1, cutoff=0.5)
            fix = f"did you mean '{near[0]}'?" if near else f"choose one {kind} of the list"
            raise Unknown(f"unknown {kind} '{name}'", ", ".join(allowed), fix)
    return names
