"""Metrics: frozen specs, lazily imported."""

from bench.metrics.metric import Metric, MetricInput, MetricOptions, MetricSpec, Score
from orca.registry import Registry

__all__ = ["METRICS", "ON_REQUEST", "Metric", "MetricInput", "MetricOptions", "MetricSpec", "Score"]

METRICS: Registry[type[Metric]] = Registry(
    "metric",
    {
        "tsed": "bench.metrics.tsed:Tsed",
        "tsed_median_sed": "bench.metrics.tsed:Tsed",
        "psnr": "bench.metrics.reference:TrueViewScores",
        "ssim": "bench.metrics.reference:TrueViewScores",
        "hole_psnr": "bench.metrics.reference:TrueViewScores",
        "hole_ssim": "bench.metrics.reference:TrueViewScores",
        "lpips": "bench.metrics.lpips:Lpips",
        "hole_lpips": "bench.metrics.lpips:Lpips",
        "hidden_depth": "bench.metrics.hidden:HiddenDepth",
        "input_psnr": "bench.metrics.reference:InputPsnr",
        "hole_fraction": "bench.metrics.coverage:HoleFraction",
        "visible_psnr": "bench.metrics.visible:VisiblePsnr",
        "flicker": "bench.metrics.flicker:Flicker",
        "flicker_own_depth": "bench.metrics.flicker:Flicker",
        "niqe": "bench.metrics.niqe:Niqe",
        "musiq": "bench.metrics.musiq:Musiq",
        "clipiqa": "bench.metrics.clip_iqa:ClipIqa",
        "clipiqa_openclip": "bench.metrics.clip_iqa:ClipIqaOpenClip",
        "clipiqa_photo": "bench.metrics.clip_iqa:ClipIqaOpenClip",
        "llava_noise_free": "bench.metrics.llava:Llava",
        "llava_edge": "bench.metrics.llava:Llava",
        "llava_structure": "bench.metrics.llava:Llava",
        "llava_detail": "bench.metrics.llava:Llava",
        "llava_quality": "bench.metrics.llava:Llava",
        "lpips_vgg": "bench.metrics.lpips:LpipsVgg",
        "hole_lpips_vgg": "bench.metrics.lpips:LpipsVgg",
        "epipolar_self_consistency": "bench.metrics.tsed:EpipolarSelfConsistency",
        "epipolar_self_consistency_median_sed": "bench.metrics.tsed:EpipolarSelfConsistency",
    },
)
# Not computed unless named: second opinions, and the mode of TSED that must not share a table with the other.
ON_REQUEST = frozenset(
    {
        "lpips_vgg",
        "hole_lpips_vgg",
        "epipolar_self_consistency",
        "epipolar_self_consistency_median_sed",
        "clipiqa_openclip",
        "clipiqa_photo",
    }
)
