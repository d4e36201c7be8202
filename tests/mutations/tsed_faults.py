"""Faults that implementations of TSED have had, or could have without anybody noticing."""

from __future__ import annotations

from tests.mutations.fault import Fault

__all__ = ["TSED_FAULTS"]

_EPIPOLAR, _SIFT, _MATCHING = (f"bench/metrics/{name}.py" for name in ("epipolar", "sift", "matching"))
_ESTIMATED, _PAIR, _SEQUENCE = (f"bench/metrics/{name}.py" for name in ("estimated", "tsed_pair", "tsed_sequence"))
_POOLED = "bench/metrics/tsed_pooled.py"

_POINTS = ("tests/bench/test_epipolar.py", "tests/bench/test_tsed_pair.py")
_FEATURES = ("tests/bench/test_tsed_features.py",)
_MODEL = ("tests/bench/test_tsed_estimated.py",)
_WHOLE = ("tests/bench/test_tsed.py", "tests/bench/test_tsed_images.py")

_SED = "0.5 * (residual / np.hypot(*lines1[:, :2].T) + residual / np.hypot(*lines2[:, :2].T))"
_F = "np.linalg.inv(second.K).T @ cross @ R @ np.linalg.inv(first.K)"
_POSE = "second.world_to_camera @ np.linalg.inv(first.world_to_camera)"
_H = "second.K @ R @ np.linalg.inv(first.K)"
_BACK = "kept &= _passes_ratio(best, runner_up, c.ratio) & _passes_ratio(best, column_runner_up[nearest], c.ratio)"

_DISTANCE = (
    Fault(
        "squared distance",
        _EPIPOLAR,
        _SED,
        "0.5 * ((residual / np.hypot(*lines1[:, :2].T)) ** 2 + (residual / np.hypot(*lines2[:, :2].T)) ** 2)",
        _POINTS,
    ),
    Fault("summed distance", _EPIPOLAR, _SED, _SED.replace("0.5 * ", ""), _POINTS),
    Fault("one-sided distance, second view", _EPIPOLAR, _SED, "residual / np.hypot(*lines2[:, :2].T)", _POINTS),
    Fault("one-sided distance, first view", _EPIPOLAR, _SED, "residual / np.hypot(*lines1[:, :2].T)", _POINTS),
    Fault(
        "transfer one-sided",
        _EPIPOLAR,
        "_finite_or_inf(0.5 * (forward + backward))",
        "_finite_or_inf(forward)",
        _POINTS,
    ),
    Fault("transfer summed", _EPIPOLAR, "(0.5 * (forward + backward))", "(forward + backward)", _POINTS),
    Fault("F transposed", _EPIPOLAR, "h1 @ F.T, h2 @ F", "h1 @ F, h2 @ F.T", _POINTS),
    Fault("R transposed", _EPIPOLAR, _F, _F.replace("@ R @", "@ R.T @"), _POINTS),
    Fault("R transposed in the homography", _EPIPOLAR, _H, _H.replace("@ R @", "@ R.T @"), _POINTS),
    Fault("[t]x and R in the other order", _EPIPOLAR, _F, _F.replace("cross @ R", "R @ cross"), _POINTS),
    Fault("K^T E K", _EPIPOLAR, _F, "second.K.T @ cross @ R @ first.K", _POINTS),
    Fault("first K for both views", _EPIPOLAR, _F, _F.replace("second", "first"), _POINTS),
    Fault("first K for both in the homography", _EPIPOLAR, _H, _H.replace("second", "first"), _POINTS),
    Fault(
        "world-to-camera taken for camera-to-world",
        _EPIPOLAR,
        _POSE,
        "np.linalg.inv(second.world_to_camera) @ first.world_to_camera",
        _POINTS,
    ),
    Fault(
        "views swapped",
        _EPIPOLAR,
        _POSE,
        "first.world_to_camera @ np.linalg.inv(second.world_to_camera)",
        _POINTS,
    ),
    Fault("NaN kept", _EPIPOLAR, "np.where(np.isfinite(distance), distance, np.inf)", "distance", _POINTS),
    Fault(
        "no guard against a zero baseline",
        _EPIPOLAR,
        "np.linalg.norm(t) <= max(ZERO_BASELINE_SHARE * extent, ZERO_BASELINE_FLOOR)",
        "False",
        _POINTS,
    ),
    Fault(
        "zero baseline only where exact",
        _EPIPOLAR,
        "np.linalg.norm(t) <= max(ZERO_BASELINE_SHARE * extent, ZERO_BASELINE_FLOOR)",
        "np.linalg.norm(t) == 0",
        _POINTS,
    ),
    Fault("no floor under the zero baseline", _EPIPOLAR, ", ZERO_BASELINE_FLOOR)", ", 0.0)", _POINTS),
    Fault(
        "a baseline that is small counts as none",
        _EPIPOLAR,
        "ZERO_BASELINE_SHARE = 1e-6",
        "ZERO_BASELINE_SHARE = 1e-3",
        _POINTS,
    ),
)

_DETECTION = (
    Fault("no half pixel", _SIFT, ".reshape(-1, 2) + PIXEL_CENTRE", ".reshape(-1, 2)", _FEATURES),
    Fault("SIFT biased by a quarter pixel", _SIFT, "upscale=True", "upscale=False", _FEATURES),
    Fault("SIFT without the root", _SIFT, "np.sqrt(raw / total)", "raw / total", _FEATURES),
    Fault("the cap keeps small scales", _SIFT, "np.argsort(-size", "np.argsort(size", _FEATURES),
)

_MATCHES = (
    Fault("no ratio test", _MATCHING, _BACK, "kept &= _passes_ratio(best, column_runner_up[nearest], 1.0)", _FEATURES),
    Fault(
        "ratio in the first view only", _MATCHING, _BACK, "kept &= _passes_ratio(best, runner_up, c.ratio)", _FEATURES
    ),
    Fault(
        "ratio in the second view only",
        _MATCHING,
        _BACK,
        "kept &= _passes_ratio(best, column_runner_up[nearest], c.ratio)",
        _FEATURES,
    ),
    Fault(
        "not mutual, ratio in both views",
        _MATCHING,
        _BACK,
        "rival = column_runner_up[nearest]\n    kept &= _passes_ratio(best, runner_up, c.ratio)\n"
        "    kept &= _passes_ratio(np.maximum(best, rival), np.minimum(best, rival), c.ratio)",
        _FEATURES,
    ),
    Fault("ties pass", _MATCHING, "(nearest < ratio * second)", "(nearest <= second)", _FEATURES),
    Fault(
        "ratio of cosines",
        _MATCHING,
        "np.arccos(np.clip(similarity.astype(np.float64), -1.0, 1.0))",
        "1.0 - np.clip(similarity.astype(np.float64), -1.0, 1.0)",
        _FEATURES,
    ),
    Fault("no largest angle", _MATCHING, "_angle(best) <= c.max_angle", "_angle(best) <= 4.0", _FEATURES),
)

_MODELS = (
    Fault("no check for a homography", _ESTIMATED, ">= c.homography_share * lines_inliers", "> len(x1)", _MODEL),
    Fault("always a homography", _ESTIMATED, ">= c.homography_share * lines_inliers", ">= 0", _MODEL),
    Fault("few matches trusted", _ESTIMATED, "min_matches: int = 20", "min_matches: int = 8", _MODEL),
    Fault("no least spread", _ESTIMATED, "min_spread: float = 1.0", "min_spread: float = -1.0", _MODEL),
    Fault("no least share of inliers", _PAIR, "model.inlier_ratio < e.min_inlier_ratio", "False", _MODEL),
    Fault(
        "estimated geometry judged by its inliers alone",
        _PAIR,
        "median=median_distance(model.distance)",
        "median=median_distance(model.distance[model.distance <= e.threshold])",
        _MODEL,
    ),
)

_VERDICT = (
    Fault("mean for median", _PAIR, "float(np.median(distance))", "float(np.mean(distance))", _POINTS),
    Fault("<= for <", _PAIR, "self.median < t_error", "self.median <= t_error", _POINTS),
    Fault("> for >=", _PAIR, "self.n < max(", "self.n <= max(", _POINTS),
    Fault("excluded pairs pass", _PAIR, "not self.excluded and self.reason", "self.reason", (*_POINTS, *_WHOLE)),
    Fault("policy 'exclude' not heeded", _PAIR, 'c.zero_baseline == "exclude"', "False", _POINTS),
    Fault("policy 'homography' not heeded", _PAIR, 'c.zero_baseline == "homography"', "False", _POINTS),
    Fault("the frozen null is not frozen", _PAIR, "PairMatches(self.x1, self.x1)", "self", (*_POINTS, *_WHOLE)),
)

_SEQUENCES = (
    Fault(
        "cameras of the next pair",
        _SEQUENCE,
        "cameras[shift:], cameras[shift + 1 :]",
        "cameras[shift + 1 :], cameras[shift + 2 :]",
        _WHOLE,
    ),
    Fault("a camera against itself", _SEQUENCE, "cameras[shift + 1 :], strict", "cameras[shift:], strict", _WHOLE),
    Fault("points of the wrong match", _SEQUENCE, "second.points[j]", "second.points[i]", _WHOLE),
    Fault("the shifted null is not shifted", _SEQUENCE, "sized, c, shift=1", "sized, c, shift=0", _WHOLE),
    Fault("cameras not brought to the frames' size", _SEQUENCE, "camera.resized(width, height)", "camera", _WHOLE),
    Fault("RANSAC before known cameras", _SEQUENCE, "not config.ransac_prefilter", "config.ransac_prefilter", _WHOLE),
    Fault("mean over pairs", _SEQUENCE, "np.median(medians)", "np.mean(medians)", _WHOLE),
    Fault(
        "width normalised the wrong way round",
        _SEQUENCE,
        "self.config.t_error * self.width / (self.config.t_error_width or self.width)",
        "self.config.t_error * (self.config.t_error_width or self.width) / self.width",
        _WHOLE,
    ),
    Fault("curve not normalised", _SEQUENCE, "t_error * self.width / width", "t_error", _WHOLE),
    Fault("excluded pairs counted", _SEQUENCE, "if not pair.excluded]\n    return sum", "]\n    return sum", _WHOLE),
    Fault("no margin around the nulls", _SEQUENCE, "null_margin + 1e-9", "null_margin * 0", _WHOLE),
    Fault(
        "pooled is the mean of scenes",
        _POOLED,
        "consistent / pairs, fmean(c",
        "fmean(c / p for c, p in kept), fmean(c",
        _WHOLE,
    ),
)

TSED_FAULTS = (*_DISTANCE, *_DETECTION, *_MATCHES, *_MODELS, *_VERDICT, *_SEQUENCES)
