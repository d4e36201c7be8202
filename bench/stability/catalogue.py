"""All stability cases, in the order of the matrix."""

from __future__ import annotations

from collections.abc import Sequence

from bench.commands.names import chosen, split_names
from bench.datasets import open_dataset
from bench.stability.cameras import CAMERA_CASES
from bench.stability.case import StabilityCase
from bench.stability.depths import DEPTH_CASES
from bench.stability.ends import COMMAND_CASES, MACHINE_CASES
from bench.stability.faulty import PRIOR_CASES
from bench.stability.files import FILE_CASES
from bench.stability.images import IMAGE_CASES
from bench.stability.photographs import PHOTOGRAPH_CASES
from orca.errors import Unavailable

__all__ = ["CASES", "CASES_VERSION", "choose_cases", "find_case"]

CASES_VERSION = "2"  # raised whenever a case of the same name is another case, or is judged otherwise

CASES: tuple[StabilityCase, ...] = (
    *IMAGE_CASES,
    *FILE_CASES,
    *DEPTH_CASES,
    *CAMERA_CASES,
    *PRIOR_CASES,
    *COMMAND_CASES,
    *MACHINE_CASES,
    *PHOTOGRAPH_CASES,
)


def find_case(name: str) -> StabilityCase:
    """The case of that name; a `KeyError` is a mistake of the caller."""
    return _BY_NAME[name]


def choose_cases(given: Sequence[str] | None) -> tuple[tuple[StabilityCase, ...], tuple[str, ...]]:
    """The cases named by name or group, in their order, and the names of those left out since their data are not here.

    Raises:
        Unknown: no such case or group.
        Unavailable: a case that was asked for by its name needs data that are not here.
    """
    groups = dict.fromkeys(case.group for case in CASES)
    names = chosen("case", given, (*_BY_NAME, *groups), _BY_NAME)
    wanted = [case for case in CASES if case.name in names or case.group in names]
    asked = set(split_names(given) or ())
    missing = [case for case in wanted if not _is_here(case)]
    for case in missing:
        if case.name in asked:
            raise Unavailable(f"the data of case {case.name} ({case.needs})", "data that are here", "see README, Data")
    left_out = {case.name for case in missing}
    return tuple(case for case in wanted if case.name not in left_out), tuple(sorted(left_out))


def _is_here(case: StabilityCase) -> bool:
    if case.needs is None:
        return True
    dataset, _, scene = case.needs.partition("/")
    try:
        return scene in open_dataset(dataset).scenes()
    except Unavailable:
        return False


_BY_NAME = {case.name: case for case in CASES}
