"""Two runs side by side: what moved beyond its interval, and what became worse by more than a stated threshold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.measured import COSTS, FAIL, Column, Measured
from bench.pairs import number_cells
from bench.stats import PairedTest, paired_test
from bench.tableformat import Head, Row, Table, TableCell
from orca.errors import BadInput

__all__ = ["DEFAULT_SHARE", "Comparison", "Move", "Thresholds", "compare_runs", "parse_thresholds"]

DEFAULT_SHARE = 0.01

_HEADS = (
    Head("n", "Scenes"),
    Head("a", "A"),
    Head("b", "B"),
    Head("difference", "B - A"),
    Head("low", "95 % low"),
    Head("high", "95 % high"),
    Head("p", "Wilcoxon p"),
    Head("verdict", "Verdict"),
)


@dataclass(frozen=True)
class Thresholds:
    """How much worse is a regression.

    Attributes:
        share: of the size of A's mean, for every metric that ``absolute`` does not name; costs have no such default.
        absolute: metric or cost -> amount in its own unit.
    """

    share: float = DEFAULT_SHARE
    absolute: Mapping[str, float] = field(default_factory=dict)

    def of(self, column: Column, mean: float) -> float | None:
        """The amount for one column; None where a change is shown and never counted."""
        if column.key in self.absolute:
            return self.absolute[column.key]
        if column in COSTS:
            return None
        return self.share * abs(mean)

    @property
    def stated(self) -> str:
        """In words, for the table."""
        own = "".join(f", {name} by more than {amount:g}" for name, amount in self.absolute.items())
        return f"worse beyond the interval and by more than {100 * self.share:g} % of A's mean{own}; a lost cell always"


@dataclass(frozen=True)
class Move:
    """One method and one column in both runs.

    ``verdict``: "same", "within the interval", "better", "worse" (beyond the interval, below the threshold), "changed"
    (a column without a direction), or "REGRESSION".
    """

    method: str
    column: Column
    test: PairedTest
    verdict: str


@dataclass(frozen=True)
class Comparison:
    """What moved between two runs.

    Attributes:
        moves: every method and column that both runs have.
        lost: "scene/method/metric" that had a value in A and failed or is absent in B, where B ran the cell.
        absent: methods or scenes of A that B does not have: not compared, and said so.
        thresholds: what counts as a regression.
    """

    moves: tuple[Move, ...]
    lost: tuple[str, ...]
    absent: tuple[str, ...]
    thresholds: Thresholds

    @property
    def regressions(self) -> tuple[str, ...]:
        """Everything for which the command exits with 1."""
        worse = tuple(f"{m.method} {m.column.key}" for m in self.moves if m.verdict == "REGRESSION")
        return worse + tuple(f"lost {name}" for name in self.lost)

    def table(self, every: bool = False) -> Table:
        """The moves as a table: those beyond their interval, or all of them."""
        shown = [m for m in self.moves if every or m.verdict not in ("same", "within the interval")]
        rows = []
        for i, move in enumerate(shown):
            cells = (*number_cells(move.column, move.test), TableCell(move.verdict, bold=move.verdict == "REGRESSION"))
            rows.append(Row((move.method, move.column.title), cells, i == 0 or shown[i - 1].method != move.method))
        notes = [f"Regression: {self.thresholds.stated}. {len(self.moves)} compared, {len(shown)} shown."]
        notes += [f"lost in B: {name}" for name in self.lost] + [f"not in B: {name}" for name in self.absent]
        return Table("compare", "A against B", ("Method", "Column"), _HEADS, tuple(rows), tuple(notes))

    def to_json(self) -> dict[str, Any]:
        """Plain data: every move, and what counts against B."""
        return {
            "schema_version": 1,
            "regressions": list(self.regressions),
            "lost": list(self.lost),
            "absent": list(self.absent),
            "threshold": {"share": self.thresholds.share, "absolute": dict(self.thresholds.absolute)},
            "moves": [_move_json(move) for move in self.moves],
        }


def compare_runs(a: Measured, b: Measured, thresholds: Thresholds) -> Comparison:
    """Compare run B with run A on the cells that both have.

    Raises:
        BadInput: two data sets, no method in common, other cameras, or a metric in two variants.
    """
    _check_comparable(a, b)
    methods = [method for method in a.methods if method in b.methods]
    columns = [column for column in (*a.columns, *COSTS) if any(column.key == c.key for c in (*b.columns, *COSTS))]
    moves = [move for m in methods for c in columns if (move := _move(a, b, m, c, thresholds)) is not None]
    ran = [(m, s) for m in methods for s in a.scenes if (m, s) in b.records and (m, s) in a.records]
    lost = [f"{s}/{m}/{c.key}" for m, s in ran for c in columns if c not in COSTS and _is_lost(a, b, m, s, c.key)]
    absent = [f"method {m}" for m in a.methods if m not in methods]
    absent += [f"{s}/{m}" for m in methods for s in a.scenes if (m, s) in a.records and (m, s) not in b.records]
    return Comparison(tuple(moves), tuple(lost), tuple(absent), thresholds)


def parse_thresholds(given: list[str] | None) -> Thresholds:
    """``["0.02", "psnr=0.1"]``: a share for all, amounts for some. Raises `BadInput` for anything else."""
    share, absolute = DEFAULT_SHARE, {}
    for text in (part for item in given or [] for part in item.split(",")):
        name, equals, amount = text.strip().rpartition("=")
        try:
            value = float(amount)
        except ValueError:
            value = -1.0
        if not 0 <= value < float("inf") or (equals and not name):
            raise BadInput(f"--threshold '{text}'", "a share such as 0.02, or METRIC=AMOUNT", "write psnr=0.1")
        if equals:
            absolute[name] = value
        else:
            share = value
    return Thresholds(share, absolute)


def _move(a: Measured, b: Measured, method: str, column: Column, thresholds: Thresholds) -> Move | None:
    pairs = [(a.value(method, s, column.key).number, b.value(method, s, column.key).number) for s in a.scenes]
    both = [(x, y) for x, y in pairs if x is not None and y is not None]
    if not both:
        return None
    test = paired_test([x for x, _ in both], [y for _, y in both])
    return Move(method, column, test, _verdict(column, test, thresholds))


def _verdict(column: Column, test: PairedTest, thresholds: Thresholds) -> str:
    if test.difference == 0 and not (test.low or test.high):
        return "same"
    if not test.beyond_interval:
        return "within the interval"
    if column.higher_is_better is None:
        return "changed"
    if (test.difference > 0) == column.higher_is_better:
        return "better"
    limit = thresholds.of(column, test.mean_a)
    return "worse" if limit is None or abs(test.difference) <= limit else "REGRESSION"


def _is_lost(a: Measured, b: Measured, method: str, scene: str, key: str) -> bool:
    """A value became a failure. One that B was not asked for, or has no weights for, is not lost."""
    return a.value(method, scene, key).number is not None and b.value(method, scene, key).word == FAIL


def _check_comparable(a: Measured, b: Measured) -> None:
    if a.dataset != b.dataset:
        raise BadInput(f"runs over {a.dataset} and {b.dataset}", "two runs over one data set", "compare others")
    common = [key for key in a.records if key in b.records]
    if not common:
        raise BadInput("two runs without a common cell", "a method and a scene that both ran", "compare others")
    for method, scene in common:
        x, y = a.records[method, scene], b.records[method, scene]
        if x.failure is None and y.failure is None and _cameras(x) != _cameras(y):
            raise BadInput(
                f"scene {scene}: the runs have different cameras for {method}",
                "one trajectory for a scene",
                "run again with the same trajectory",
            )
    variants = {c.key: c.variant for c in a.columns}
    for column in b.columns:
        if variants.get(column.key, column.variant) != column.variant:
            raise BadInput(
                f"metric {column.key} in two variants: {variants[column.key]}; {column.variant}",
                "one variant of a metric",
                "run one of the two again with the same version of the bench",
            )


def _cameras(record: Any) -> tuple[str | None, tuple[int, ...]]:
    return record.trajectory_sha256, tuple(frame.index for frame in record.frames)


def _move_json(move: Move) -> dict[str, Any]:
    test = move.test
    return {
        "method": move.method,
        "column": move.column.key,
        "verdict": move.verdict,
        "n": test.n,
        "a": test.mean_a,
        "b": test.mean_b,
        "difference": test.difference,
        "interval95": None if test.low is None else [test.low, test.high],
        "wilcoxon_p": test.p,
    }
