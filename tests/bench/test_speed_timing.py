"""Timing in turns, medians, ratios, exponents, plans and tables of the speed bench: no clock is trusted here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.speed.case import CASES, full_plan, quick_plan
from bench.speed.initialisation import _without_evaluations
from bench.speed.measure import Ratio, SpeedRow
from bench.speed.scaling import scaling_exponents
from bench.speed.table import exponent_lines, machine_line, ratio_lines, speed_table
from bench.speed.timing import Patience, Sample, Timing, alternate, paired_ratio, stopwatch

ROW = SpeedRow("frame", "fast", "layered", 65_536, 512, 2, 80.0, 150.0, 700.0, 31.5, 78.0, 85.0, 9, {"anchors": 65_530})


def test_works_take_turns_on_the_same_round_and_the_order_alternates() -> None:
    heard: list[tuple[str, int]] = []

    def work(name: str) -> object:
        def run(number: int) -> Sample:
            heard.append((name, number))
            return Sample(number, 2 * number)

        return run

    samples = alternate({name: work(name) for name in "ab"}, Patience(2, 3, 1, 1e9))  # type: ignore[misc]
    assert heard == [(n, i) for i in range(5) for n in ("ab" if i % 2 == 0 else "ba")]
    assert [s.wall_s for s in samples["a"]] == [2, 3, 4]  # the two rounds of warm-up are thrown away
    assert samples["a"] == samples["b"]


@pytest.mark.parametrize(("least", "expected"), [(1, 3), (5, 5), (20, 9)])
def test_patience_ends_between_least_and_repeats(least: int, expected: int) -> None:
    """Rounds of one second and 2.5 seconds of patience: a third round begins, a fourth does not."""
    now = [0.0]

    def run(number: int) -> Sample:
        now[0] += 1.0
        return Sample(1.0, 1.0)

    samples = alternate({"a": run}, Patience(1, 9, least, 2.5), clock=lambda: now[0])
    assert len(samples["a"]) == expected


def test_medians_and_quartiles_by_hand() -> None:
    timing = Timing.of(
        [Sample(wall, cpu) for wall, cpu in ((0.1, 0.5), (0.2, 0.3), (0.3, 0.4), (0.4, 0.1), (9.0, 0.2))]
    )
    assert timing == Timing(pytest.approx(300), pytest.approx(200), pytest.approx(400), pytest.approx(300), 5)


def test_a_ratio_pairs_rounds_and_a_slow_minute_cancels() -> None:
    fast = [Sample(0.1, 0.1), Sample(1.0, 0.1), Sample(0.1, 0.2)]
    slow = [Sample(0.8, 0.6), Sample(8.0, 0.6), Sample(0.9, 0.6)]
    assert paired_ratio(slow, fast) == pytest.approx((8.0, 8.0, 9.0, 6.0))


def test_the_stopwatch_reads_both_clocks_around_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two clocks that only the work moves on: 3 s on the wall, 2 s of the process."""
    wall, cpu = [10.0], [100.0]

    def work() -> None:
        wall[0] += 3
        cpu[0] += 2

    monkeypatch.setattr("bench.speed.timing.time.perf_counter", lambda: wall[0])
    monkeypatch.setattr("bench.speed.timing.time.process_time", lambda: cpu[0])
    assert stopwatch(work) == Sample(wall_s=3, cpu_s=2)


def test_exponents_of_exact_powers() -> None:
    """wall = pixels^1.5 * anchors^0.5, on a grid of two by three, and one row alone."""
    rows = [
        replace(ROW, width=width, anchors=anchors, wall_ms=width**3 * anchors**0.5, facts={"anchors": anchors})
        for width in (256, 512, 1024)
        for anchors in (100, 400)
    ]
    lone = replace(ROW, backend="reference")
    found = scaling_exponents([*rows, lone])
    assert {e.backend for e in found} == {"fast"}
    along = {(e.along, e.fixed): e for e in found}
    assert set(along) == {("pixels", 100), ("pixels", 400), ("anchors", 256), ("anchors", 512), ("anchors", 1024)}
    assert all(e.value == pytest.approx(1.5 if e.along == "pixels" else 0.5) for e in found)
    assert along["pixels", 100].sizes == (256**2, 512**2, 1024**2)


def test_exponents_go_by_the_anchors_that_there_were() -> None:
    rows = [replace(ROW, anchors=a, wall_ms=a / 2, facts={"anchors": a // 2}) for a in (1000, 4000)]
    (found,) = scaling_exponents(rows)
    assert (found.along, found.sizes) == ("anchors", (500, 2000))


def test_the_full_plan_is_what_the_issue_asks_for() -> None:
    plan = full_plan(CASES)
    frames = [s for s in plan if s.case == "frame"]
    seen = {(s.mode, s.anchors, s.width, s.threads) for s in frames}
    assert len(seen) == len(frames) == 2 * 2 * 3 * 2
    assert {s.anchors for s in frames} == {65_536, 262_144}
    assert {s.width for s in frames} == {256, 512, 1024}
    assert all(s.backends == ("fast", "reference") for s in frames)
    assert {s.case for s in plan} == set(CASES)
    assert all(s.anchors <= s.width**2 for s in plan if s.case == "fit")
    assert {s.threads for s in full_plan(CASES, [1])} == {1}


def test_the_quick_plan_has_every_case_and_two_exponents() -> None:
    plan = quick_plan(CASES)
    assert {s.case for s in plan} == set(CASES)
    fast = [s for s in plan if s.case == "frame" and s.mode == "layered"]
    assert {s.width for s in fast if s.anchors == 65_536} == {256, 512, 1024}
    assert {s.anchors for s in fast if s.width == 512} == {65_536, 262_144}
    assert [s.case for s in quick_plan(["fit"])] == ["fit"]


def test_the_table_has_every_row_and_a_dash_for_what_was_not_measured() -> None:
    rows = [ROW, replace(ROW, backend="reference", peak_mb=None, psnr=None), replace(ROW, case="step")]
    table = speed_table(rows)
    text = table.to_text()
    assert text.count("64k") == 3
    assert "78.0-85.0" in text
    assert [cell.text for cell in table.rows[1].cells[3:5]] == ["-", "-"]
    assert [row.group_start for row in table.rows] == [True, False, True]


def test_lines_say_the_numbers() -> None:
    ratio = Ratio("frame", "layered", 65_536, 512, 2, 8.04, 7.0, 9.0, 6.5, 3e-5)
    (line,) = ratio_lines([ratio])
    assert "fast is 8.0x the reference (7.0-9.0; CPU 6.5x); frames differ by 3.0e-05 at most" in line
    rows = [replace(ROW, width=w, wall_ms=w**2.0, facts={"anchors": 65_530}) for w in (256, 1024)]
    assert exponent_lines(scaling_exponents(rows)) == [
        "frame layered fast, 2 thread(s), 64k anchors: time grows with pixels^1.00 (65536 to 1048576)"
    ]
    machine = {"cpu": "A CPU", "cores": 2, "memory_gib": 8.0, "load": {"before": 0.1, "after": 2.0}}
    assert machine_line(machine) == "A CPU, 2 cores, 8.0 GiB, load 0.1 before and 2.0 after"


def test_time_spent_on_evaluations_is_taken_out() -> None:
    """Steps of one second, the first of three (it finds the hits), and evaluations of ten after every second step."""
    durations = [3.0, 1.0, 11.0, 1.0, 11.0, 1.0]
    marks = np.cumsum([[d, 2 * d] for d in durations], axis=0)
    np.testing.assert_allclose(_without_evaluations(marks, 2)[:, 0], [3, 4, 5, 6, 7, 8])
    np.testing.assert_allclose(_without_evaluations(marks, 2)[:, 1], [6, 8, 10, 12, 14, 16])
    np.testing.assert_allclose(_without_evaluations(marks, 10)[:, 0], np.cumsum(durations))
