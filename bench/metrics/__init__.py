"""Metrics: frozen specs, lazily imported."""

from bench.metrics.metric import Metric, MetricInput, MetricSpec, Score
from orca.registry import Registry

__all__ = ["METRICS", "Metric", "MetricInput", "MetricSpec", "Score"]

METRICS: Registry[type[Metric]] = Registry(
    "metric",
    {
        "tsed": "bench.metrics.tsed:Tsed",
        "tsed_median_sed": "bench.metrics.tsed:Tsed",
        "psnr": "bench.metrics.reference:TrueViewScores",
        "ssim": "bench.metrics.reference:TrueViewScores",
        "hole_psnr": "bench.metrics.reference:TrueViewScores",
        "hidden_depth": "bench.metrics.hidden:HiddenDepth",
        "input_psnr": "bench.metrics.reference:InputPsnr",
        "hole_fraction": "bench.metrics.coverage:HoleFraction",
        "visible_psnr": "bench.metrics.visible:VisiblePsnr",
        "niqe": "bench.metrics.niqe:Niqe",
        "musiq": "bench.metrics.learned:Musiq",
        "clipiqa": "bench.metrics.learned:ClipIqa",
        "llava_noise_free": "bench.metrics.learned:Llava",
        "llava_edge": "bench.metrics.learned:Llava",
        "llava_structure": "bench.metrics.learned:Llava",
        "llava_detail": "bench.metrics.learned:Llava",
        "llava_quality": "bench.metrics.learned:Llava",
    },
)
