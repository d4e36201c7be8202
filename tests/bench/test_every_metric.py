"""What every metric owes: evidence that it is right, and a typed answer to any input.

`EVIDENCE` names, for each column, the test that holds it against a hand-worked value or an independent reference, and
the ladder test (blur, noise, holes) or the reason why there is none. A new metric fails here until it has both.
"""

from __future__ import annotations

import ast
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase, TrueView
from bench.metrics import METRICS
from bench.metrics.metric import MetricInput, Score
from orca.errors import OrcaError, Unavailable
from tests.bench.all_weights import write_all_weights
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, shifted_pose, smooth_image

HERE = Path(__file__).parent
H, W, N = 40, 48, 3


@dataclass(frozen=True)
class Evidence:
    """Where a metric is proven: "file::test"; a ladder may be a sentence that says why there is none."""

    reference: str
    ladder: str


_TRUE_VIEW_LADDER = "test_reference_metrics::test_more_noise_blur_and_holes_are_worse"
_TSED_LADDER = "test_tsed_ladder::test_more_damage_moves_points_further"
_SELF = Evidence(
    "test_tsed_estimated::test_a_plane_a_rotation_and_a_frozen_pair_are_homographies",
    "No ladder of its own: the matches, which damage moves, are those of TSED; only the judge differs.",
)
_LLAVA = Evidence(
    "test_llava::*", "No ladder: an answer of yes or no by a language model promises no order; the paper states none."
)
EVIDENCE = {
    "tsed": Evidence("test_epipolar::test_hand_value_lateral", _TSED_LADDER),
    "tsed_median_sed": Evidence("test_epipolar::test_distance_equals_the_oracle_that_draws_the_lines", _TSED_LADDER),
    "epipolar_self_consistency": _SELF,
    "epipolar_self_consistency_median_sed": _SELF,
    "psnr": Evidence("test_reference_metrics::test_scores_equal_scikit_image", _TRUE_VIEW_LADDER),
    "ssim": Evidence("test_reference_metrics::test_ssim_equals_the_formula_written_out", _TRUE_VIEW_LADDER),
    "hole_psnr": Evidence("test_reference_metrics::test_scores_equal_scikit_image", _TRUE_VIEW_LADDER),
    "hole_ssim": Evidence(
        "test_reference_metrics::test_masked_ssim_is_the_mean_of_the_windows_around_masked_pixels", _TRUE_VIEW_LADDER
    ),
    "lpips": Evidence(
        "test_lpips::test_equals_an_independent_forward", "test_lpips::test_more_blur_noise_and_holes_are_farther"
    ),
    "hole_lpips": Evidence(
        "test_lpips::test_equals_an_independent_forward", "test_lpips::test_more_blur_noise_and_holes_are_farther"
    ),
    "lpips_vgg": Evidence(
        "test_lpips::test_vgg_equals_an_independent_forward",
        "No ladder of its own: the same code as lpips with another trunk, held to an independent forward.",
    ),
    "hole_lpips_vgg": Evidence(
        "test_lpips::test_vgg_equals_an_independent_forward",
        "No ladder of its own: the same code as lpips with another trunk, held to an independent forward.",
    ),
    "hidden_depth": Evidence(
        "test_every_metric::test_hidden_depth_by_hand",
        "No ladder: it looks at depth, which blur and noise of colours leave.",
    ),
    "input_psnr": Evidence(
        "test_every_metric::test_input_psnr_by_hand", "test_every_metric::test_input_psnr_falls_with_damage"
    ),
    "hole_fraction": Evidence(
        "test_coverage::test_share_of_pixels_below_one_half", "test_every_metric::test_more_holes_are_more_holes"
    ),
    "visible_psnr": Evidence(
        "test_visible::test_a_known_error_on_the_visible_part_is_the_score",
        "test_visible::test_worse_frames_score_lower",
    ),
    "flicker": Evidence(
        "test_flicker::test_hand_value_of_a_brightness_that_pumps",
        "test_flicker::test_more_injected_flicker_scores_higher",
    ),
    "flicker_own_depth": Evidence(
        "test_flicker::test_hand_value_of_a_brightness_that_pumps",
        "test_flicker::test_more_injected_flicker_scores_higher",
    ),
    "niqe": Evidence("test_niqe::test_equals_pyiqa", "test_niqe::test_ladder_on_a_real_image"),
    "musiq": Evidence("test_musiq::*", "No ladder without the published weights: random ones promise no order."),
    "clipiqa": Evidence("test_clip_iqa::*", "No ladder without the published weights: random ones promise no order."),
    "clipiqa_photo": Evidence(
        "test_clip_iqa::*", "No ladder without the published weights: random ones promise no order."
    ),
    "clipiqa_openclip": Evidence(
        "test_clip_iqa::*", "No ladder without the published weights: random ones promise no order."
    ),
    **dict.fromkeys([f"llava_{c}" for c in ("noise_free", "edge", "structure", "detail", "quality")], _LLAVA),
}


@cache
def names_in(file: str) -> frozenset[str]:
    """Names of the test functions of a test file."""
    tree = ast.parse((HERE / f"{file}.py").read_text(encoding="utf-8"))
    return frozenset(n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name.startswith("test_"))


def test_every_metric_has_evidence_and_nothing_else_has() -> None:
    assert set(EVIDENCE) == set(METRICS)


@pytest.mark.parametrize("name", EVIDENCE)
def test_the_evidence_exists(name: str) -> None:
    for where in (EVIDENCE[name].reference, EVIDENCE[name].ladder):
        if where.startswith("No ladder"):
            assert len(where) > 40
            continue
        file, _, test = where.partition("::")
        assert names_in(file), where
        assert test == "*" or test in names_in(file), where


def test_input_psnr_by_hand() -> None:
    image = np.full((H, W, 3), 100, np.uint8)
    score = score_of("input_psnr", case_of(image), MethodOutput(np.stack([image] * N), input_view=image + 5))
    assert score.value == pytest.approx(20 * math.log10(255 / 5))


def test_input_psnr_falls_with_damage() -> None:
    image = smooth_image(H, W)
    noise = np.random.default_rng(0).normal(size=image.shape)
    ladder = [np.clip(image + s * noise, 0, 255).astype(np.uint8) for s in (2, 8, 32)]
    values = [
        score_of("input_psnr", case_of(image), MethodOutput(np.stack([image] * N), input_view=view)).value
        for view in ladder
    ]
    assert values[0] > values[1] + 6 > values[2] + 12  # type: ignore[operator]


def test_hidden_depth_by_hand() -> None:
    """Four hidden pixels at depth 4 behind an object at 2: 3.9 and 3.1 are right, 2.9 is wrong, one is not filled."""
    image, hidden = noise_image(H, W), np.zeros((H, W), np.bool_)
    hidden[0, :4] = True
    depth, alpha = plane(H, W, 9.0), np.ones((H, W), np.float32)
    depth[0, :4], alpha[0, 3] = (3.9, 3.1, 2.9, 4.0), 0.2
    view = TrueView(camera_of(H, W), image, hidden, plane(H, W, 4.0), plane(H, W, 2.0))
    case = make_case(image, plane(H, W), [np.eye(4)], (view,))
    output = MethodOutput(image[None], true_views=(image,), true_view_coverage=(alpha,), true_view_depth=(depth,))
    score = score_of("hidden_depth", case, output)
    assert score.value == pytest.approx(2 / 3)
    assert score.detail == {"judged": 4, "filled": 3, "right": 2}


def test_more_holes_are_more_holes() -> None:
    where = np.random.default_rng(0).random((N, H, W))
    values = [
        score_of("hole_fraction", case_of(), replace(good_output(), coverage=(where >= s).astype(np.float32))).value
        for s in (0.0, 0.1, 0.3, 0.9)
    ]
    assert values == sorted(values)  # type: ignore[type-var]
    assert values[0] == 0.0
    assert values[-1] > 0.8  # type: ignore[operator]


def case_of(image: np.ndarray | None = None, frames: int = N) -> SceneCase:
    """A textured plane with a true view, and ``frames`` evaluated cameras."""
    image = noise_image(H, W) if image is None else image
    hidden = np.zeros(image.shape[:2], np.bool_)
    hidden[:, :12] = True
    view = TrueView(camera_of(*image.shape[:2]), image, hidden)
    poses = [shifted_pose(x=0.01 * k) for k in range(frames)]
    return make_case(image, plane(*image.shape[:2]), poses, (view,))


def good_output(frames: int = N, height: int = H, width: int = W) -> MethodOutput:
    images = np.stack([noise_image(height, width, 5 + k) for k in range(frames)])
    view = noise_image(height, width, 50)
    return MethodOutput(
        frames=images,
        coverage=np.ones((frames, height, width), np.float32),
        input_view=view,
        true_views=(view,),
        true_view_coverage=(np.ones((height, width), np.float32),),
        true_view_depth=(plane(height, width),),
        frame_depth=np.stack([plane(height, width)] * frames),
    )


def filled(level: int) -> MethodOutput:
    grey = np.full((H, W, 3), level, np.uint8)
    return replace(good_output(), frames=np.stack([grey] * N), input_view=grey, true_views=(grey,))


def constant_everywhere() -> tuple[SceneCase, MethodOutput]:
    """The scene itself is one colour, and so is every frame: nothing to match, to structure or to tell apart."""
    return case_of(np.full((H, W, 3), 90, np.uint8)), filled(90)


def not_a_number() -> MethodOutput:
    """NaN wherever an output may hold one: coverage and depths."""
    nan = np.full((N, H, W), np.nan, np.float32)
    return replace(
        good_output(), coverage=nan, frame_depth=nan, true_view_coverage=(nan[0],), true_view_depth=(nan[0],)
    )


def float_frames() -> MethodOutput:
    """What an adapter that forgot to convert would hand over, NaN included."""
    wrong = np.full((N, H, W, 3), np.nan, np.float32)
    return replace(good_output(), frames=wrong, input_view=wrong[0], true_views=(wrong[0],))  # type: ignore[arg-type]


INPUTS: dict[str, Callable[[], tuple[SceneCase, MethodOutput]]] = {
    "good": lambda: (case_of(), good_output()),
    "one frame": lambda: (case_of(frames=1), good_output(1)),
    "grey": lambda: (case_of(), filled(128)),
    "black": lambda: (case_of(), filled(0)),
    "constant": constant_everywhere,
    "NaN": lambda: (case_of(), not_a_number()),
    "another size": lambda: (case_of(), good_output(height=32, width=40)),
}
REFUSED: dict[str, Callable[[], tuple[SceneCase, MethodOutput]]] = {
    "empty": lambda: (case_of(), replace(good_output(1), frames=np.zeros((0, H, W, 3), np.uint8))),
    "one frame too few": lambda: (case_of(), good_output(N - 1)),
    "float frames with NaN": lambda: (case_of(), float_frames()),
}
NEED_WEIGHTS = {"Niqe", "Musiq", "ClipIqa", "ClipIqaOpenClip", "Lpips", "LpipsVgg", "Llava"}
FAMILIES = {METRICS.get(name).__name__: METRICS.get(name) for name in METRICS}


def score_of(name: str, case: SceneCase, output: MethodOutput) -> Score:
    return METRICS.get(name)().compute(MetricInput(case, output))[name]


def check(scores: dict[str, Score], specs: Any) -> None:
    """Every promise of `Score`: finite or a reason, inside the bounds, JSON."""
    for spec in specs:
        score = scores[spec.id]
        if score.value is None:
            assert score.reason, spec.id
        else:
            assert math.isfinite(score.value)
            low, high = spec.bounds
            assert low is None or score.value >= low
            assert high is None or score.value <= high
            assert score.n > 0
        json.dumps([score.detail, score.per_frame, score.value], allow_nan=False)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with random weights for every metric that needs some, in the form of the published files."""
    folder = tmp_path_factory.mktemp("weights")
    with pytest.MonkeyPatch.context() as patch:
        write_all_weights(folder, patch)
        yield folder


@cache
def metric_of(family: str) -> Any:
    """One for all tests: it loads its network once."""
    return FAMILIES[family]()


@pytest.mark.parametrize("what", INPUTS)
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.filterwarnings("ignore:`torch.jit:FutureWarning")  # the format of CLIP's published file
def test_any_output_that_passes_the_checks_has_a_value_or_a_reason(family: str, what: str, weights: Path) -> None:
    metric, (case, output) = metric_of(family), INPUTS[what]()
    specs = metric.specs(weights)
    scores = metric.compute(MetricInput(case, output, weights))
    assert set(scores) == {spec.id for spec in specs}
    check(scores, specs)
    if family in NEED_WEIGHTS - {"Niqe"} and what in ("good", "one frame"):  # NIQE wants larger frames: test_niqe
        assert any(score.value is not None for score in scores.values()), [score.reason for score in scores.values()]


def test_every_metric_that_needs_weights_names_the_folder_without_them() -> None:
    """... and no other does: the matrix above leaves nothing out."""
    found = set()
    for family, metric in FAMILIES.items():
        try:
            metric().compute(MetricInput(case_of(), good_output()))
        except Unavailable as error:
            assert "--weights-dir" in f"{error.allowed} {error.fix}", family  # noqa: PT017
            found.add(family)
    assert found == NEED_WEIGHTS


@pytest.mark.parametrize("what", REFUSED)
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.filterwarnings("ignore:`torch.jit:FutureWarning")
def test_impossible_output_is_a_typed_error_or_a_reason(family: str, what: str, weights: Path) -> None:
    """The bench refuses such output before it is scored (`bench.checks`); a metric called alone must not crash."""
    metric, (case, output) = metric_of(family), REFUSED[what]()
    try:
        scores = metric.compute(MetricInput(case, output, weights))
    except Unavailable as error:
        pytest.fail(f"{family} found no weights, so nothing was tried: {error}")
    except OrcaError:
        return
    check(scores, metric.specs(weights))


SCORE_ALL = """
import json, numpy as np
from bench.record import jsonable
from orca.errors import Unavailable
from tests.bench.test_every_metric import FAMILIES, MetricInput, MethodOutput, case_of, good_output, replace
from tests.bench.tsed_scenes import texture
image = texture()[100:260, 150:310]
frames = np.stack([np.roll(image, 2 * k, axis=1) for k in range(3)])
found = {}
for name in sorted(FAMILIES):
    try:
        given = replace(good_output(height=160, width=160), frames=frames)
        scores = FAMILIES[name]().compute(MetricInput(case_of(image), given))
    except Unavailable:
        continue
    found[name] = {key: jsonable([s.value, s.n, s.reason, s.per_frame, s.detail]) for key, s in scores.items()}
print(json.dumps(found))
"""


@pytest.mark.slow
def test_two_processes_score_alike() -> None:
    """Other hash seeds and other numbers of threads: the same bytes of JSON, the order of the keys included."""
    root = HERE.parents[1]
    answers = []
    for seed, threads in (("1", "1"), ("4242", "2")):
        env = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(root)}
        env |= {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run([sys.executable, "-c", SCORE_ALL], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        answers.append(done.stdout.splitlines()[-1])
    assert answers[0] == answers[1]
    scores = json.loads(answers[0])
    assert {"Tsed", "Flicker", "TrueViewScores", "VisiblePsnr"} <= set(scores)
    assert scores["Tsed"]["tsed"][0] is not None
    assert scores["EpipolarSelfConsistency"]["epipolar_self_consistency"][0] == 1.0
