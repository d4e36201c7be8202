"""MUSIQ's network for one CPU thread: pyiqa's weights and scores, in about two thirds of the time.

What is different from pyiqa's own forward pass (Ke et al. 2021, "MUSIQ: Multi-scale Image Quality Transformer"):
the convolutions' weights are standardised once and not with every frame; the ResNet stem goes over a few patches at a
time, channels last, so that what it writes stays in the cache; query, key and value are one product and attention is
torch's fused one; padding tokens are left out (pyiqa masks them: their weight in every softmax is exactly 0); and the
last layer computes the one token that is read.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from bench.metrics.group_norm import group_norm_

__all__ = ["CpuMusiq"]

PATCHES_AT_ONCE = 16  # their largest activation, 16x16x64 floats each, is 1 MiB in all: it fits a core's L2 cache
GROUPS = 32


class CpuMusiq:
    """The forward pass of pyiqa's `MUSIQ` on one image.

    Args:
        network: pyiqa's `MUSIQ` with a score of one number (KonIQ-10k), on the CPU, in evaluation mode.
    """

    def __init__(self, network: Any) -> None:
        self._network, self._stem = network, _Stem(network)
        self._layers = [_Layer(block) for block in network.transformer_encoder.transformer.values()]

    @torch.inference_mode()
    def __call__(self, image: Tensor) -> float:
        """Score of an image [1, 3, H, W] float32 in [0, 1]; may be called from several threads at once."""
        from pyiqa.data.multiscale_trans_util import get_multiscale_patches

        network, encoder = self._network, self._network.transformer_encoder
        rows = get_multiscale_patches((image - 0.5) * 2, **network.data_preprocess_opts)[0]
        rows = rows[rows[:, -1] > 0]  # [tokens, 3 * 32 * 32 + position, scale, mask]
        patches = rows[:, :-3].reshape(-1, 3, network.patch_size, network.patch_size)
        features = torch.cat([self._stem(some) for some in patches.split(PATCHES_AT_ONCE)])
        tokens = F.linear(features, network.embedding.weight, network.embedding.bias)
        tokens += encoder.posembed_input.position_emb[0][rows[:, -3].long()]
        tokens += encoder.scaleembed_input.scale_emb[rows[:, -2].long()]
        tokens = torch.cat([encoder.cls[0], tokens])
        for layer in self._layers[:-1]:
            tokens = layer(tokens, len(tokens))
        token = encoder.encoder_norm(self._layers[-1](tokens, 1))
        return float(network.head(token))


class _Stem:
    """Patches to features: weight-standardised convolutions, group norm, pooling, one bottleneck block."""

    def __init__(self, network: Any) -> None:
        block = network.block1
        self._norms = (network.gn_root, block.gn1, block.gn2, block.gn3, block.gn_proj)
        self._root = _standardised(network.conv_root.weight).contiguous(memory_format=torch.channels_last)
        self._conv2 = _standardised(block.conv2.weight).contiguous(memory_format=torch.channels_last)
        self._conv1, self._conv3, self._projection = (
            _standardised(conv.weight).flatten(1) for conv in (block.conv1, block.conv3, block.conv_proj)
        )

    def __call__(self, patches: Tensor) -> Tensor:
        """Features [n, 8 * 8 * 256] of patches [n, 3, 32, 32]."""
        root, norm1, norm2, norm3, norm_projection = self._norms
        patches = F.pad(patches.contiguous(memory_format=torch.channels_last), (2, 3, 2, 3))  # TensorFlow's "same"
        x = _normalised(F.conv2d(patches, self._root, stride=2), root)
        # A pixel beyond the border counts as 0 there, and is left out here: after a ReLU that is the same.
        x = F.max_pool2d(x, 3, 2, ceil_mode=True).relu_()
        identity = _normalised(_pointwise(x, self._projection), norm_projection)
        x = _normalised(_pointwise(x, self._conv1), norm1).relu_()
        x = _normalised(F.conv2d(x, self._conv2, padding=1), norm2).relu_()
        x = _normalised(_pointwise(x, self._conv3), norm3)
        return x.add_(identity).relu_().permute(0, 2, 3, 1).flatten(1)


class _Layer:
    """One block of the transformer on the tokens [n, dim] of one image."""

    def __init__(self, block: Any) -> None:
        self._block, attention = block, block.attention
        parts = (attention.query, attention.key, attention.value)
        self._weight = torch.cat([part.weight for part in parts])
        self._bias = torch.cat([part.bias for part in parts])

    def __call__(self, tokens: Tensor, wanted: int) -> Tensor:
        """The first ``wanted`` tokens after this block."""
        block, heads = self._block, self._block.attention.num_heads
        joint = F.linear(block.norm1(tokens), self._weight, self._bias)
        query, key, value = joint.view(len(tokens), 3, heads, -1).permute(1, 2, 0, 3)[:, None]
        mixed = F.scaled_dot_product_attention(query[:, :, :wanted], key, value)[0]
        after: Tensor = tokens[:wanted] + block.attention.out(mixed.transpose(0, 1).flatten(1))
        return after.add_(block.mlp(block.norm2(after)))


def _standardised(weight: Tensor) -> Tensor:
    """Weight standardisation as pyiqa's `StdConv` does it."""
    weight = weight.detach() - weight.detach().mean((1, 2, 3), keepdim=True)
    return weight / (weight.std((1, 2, 3), keepdim=True) + 1e-5)


def _pointwise(x: Tensor, weight: Tensor) -> Tensor:
    """A 1x1 convolution as one matrix product over the pixels; [n, c, H, W] channels last in and out."""
    return F.linear(x.permute(0, 2, 3, 1), weight).permute(0, 3, 1, 2)


def _normalised(x: Tensor, norm: Any) -> Tensor:
    """Group norm of x [n, c, H, W], channels last; overwrites it."""
    pixels = x.permute(0, 2, 3, 1).flatten(1, 2)
    group_norm_(pixels.numpy(), norm.weight.detach().numpy(), norm.bias.detach().numpy(), norm.eps, GROUPS)
    return x
