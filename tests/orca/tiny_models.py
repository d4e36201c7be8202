"""Real models of the classes that the learned priors use, tiny and untrained, saved as the hub's repositories are."""

from __future__ import annotations

import json
from pathlib import Path

from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, SD15_INPAINTING

__all__ = ["write_depth_anything", "write_depth_pro", "write_stable_diffusion"]


def write_depth_pro(weights_dir: Path) -> Path:
    """A `DepthProForDepthEstimation` of 16-pixel patches that works at 64x64."""
    import torch
    from transformers import DepthProConfig, DepthProForDepthEstimation, DepthProImageProcessor

    encoder = {
        "model_type": "dinov2",
        "num_hidden_layers": 2,
        "hidden_size": 16,
        "num_attention_heads": 4,
        "patch_size": 4,
        "image_size": 16,
        "mlp_ratio": 1,
    }
    config = DepthProConfig(
        patch_size=16,
        fusion_hidden_size=16,
        intermediate_hook_ids=[1, 0],
        intermediate_feature_dims=[10, 8],
        scaled_images_ratios=[0.5, 1.0],
        scaled_images_overlap_ratios=[0.0, 0.2],
        scaled_images_feature_dims=[12, 10],
        merge_padding_value=1,
        num_fov_head_layers=0,
        use_fov_model=True,
        image_model_config=dict(encoder),
        patch_model_config=dict(encoder),
        fov_model_config=dict(encoder),
    )
    torch.manual_seed(0)
    model = DepthProForDepthEstimation(config)
    # Untrained, it would say 10 km everywhere: a last layer with a positive bias says about 2 m, and 50 degrees.
    with torch.no_grad():
        model.head.layers[-2].bias.fill_(0.5)
        model.fov_model.head.layers[-1].bias.fill_(50.0)
    folder = weights_dir / DEPTH_PRO.repo
    model.save_pretrained(folder)
    DepthProImageProcessor(size={"height": 64, "width": 64}).save_pretrained(folder)
    return folder


def write_depth_anything(weights_dir: Path, kind: str = "relative") -> Path:
    """A `DepthAnythingForDepthEstimation` that works at 56 pixels; ``kind``: "relative" or "metric"."""
    import torch
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config, DPTImageProcessor

    backbone = Dinov2Config(
        hidden_size=16,
        num_hidden_layers=4,
        num_attention_heads=2,
        image_size=56,
        patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        reshape_hidden_states=False,
        apply_layernorm=True,
    )
    config = DepthAnythingConfig(
        backbone_config=backbone,
        patch_size=14,
        reassemble_hidden_size=16,
        neck_hidden_sizes=[4, 8, 8, 8],
        fusion_hidden_size=8,
        head_hidden_size=8,
        depth_estimation_type=kind,
        **({"max_depth": 20} if kind == "metric" else {}),
    )
    torch.manual_seed(0)
    model = DepthAnythingForDepthEstimation(config)
    with torch.no_grad():  # untrained, its last convolution is all but zero
        model.head.conv3.weight.normal_(0, 1)
        model.head.conv3.bias.fill_(0.3)
    folder = weights_dir / DEPTH_ANYTHING_V2_SMALL.repo
    model.save_pretrained(folder)
    DPTImageProcessor(
        size={"height": 56, "width": 56},
        keep_aspect_ratio=True,
        ensure_multiple_of=14,
        image_mean=[0.485, 0.456, 0.406],
        image_std=[0.229, 0.224, 0.225],
    ).save_pretrained(folder)
    return folder


def write_stable_diffusion(weights_dir: Path) -> Path:
    """A `StableDiffusionInpaintPipeline` with the hub's files: 9-channel U-Net, x8 autoencoder, CLIP, PNDM."""
    import torch
    from diffusers import AutoencoderKL, PNDMScheduler, StableDiffusionInpaintPipeline, UNet2DConditionModel
    from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

    folder = weights_dir / SD15_INPAINTING.repo
    characters = [chr(code) for code in range(33, 127)]
    words = ["<|startoftext|>", "<|endoftext|>", *characters, *(c + "</w>" for c in characters)]
    tokenizer_folder = folder / "tokenizer"
    tokenizer_folder.mkdir(parents=True)
    vocabulary = json.dumps({word: i for i, word in enumerate(words)})
    (tokenizer_folder / "vocab.json").write_text(vocabulary, encoding="utf-8")
    (tokenizer_folder / "merges.txt").write_text("#version: 0.2\n", encoding="utf-8")
    tokenizer = CLIPTokenizer.from_pretrained(tokenizer_folder)
    tokenizer.model_max_length = 77
    torch.manual_seed(0)
    StableDiffusionInpaintPipeline(
        vae=AutoencoderKL(
            block_out_channels=(8, 8, 8, 8),
            down_block_types=("DownEncoderBlock2D",) * 4,
            up_block_types=("UpDecoderBlock2D",) * 4,
            latent_channels=4,
            norm_num_groups=4,
        ),
        text_encoder=CLIPTextModel(
            CLIPTextConfig(
                hidden_size=8,
                intermediate_size=16,
                num_attention_heads=2,
                num_hidden_layers=2,
                vocab_size=len(words),
                bos_token_id=0,
                eos_token_id=1,
                pad_token_id=1,
            )
        ),
        tokenizer=tokenizer,
        unet=UNet2DConditionModel(
            block_out_channels=(8, 16),
            layers_per_block=1,
            sample_size=16,
            in_channels=9,
            out_channels=4,
            down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
            up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
            cross_attention_dim=8,
            norm_num_groups=4,
            attention_head_dim=4,
        ),
        scheduler=PNDMScheduler(
            beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", skip_prk_steps=True, steps_offset=1
        ),
        safety_checker=None,
        feature_extractor=None,
        requires_safety_checker=False,
    ).save_pretrained(folder)
    # The hub's repository has the two files above and no tokenizer.json.
    (tokenizer_folder / "vocab.json").write_text(vocabulary, encoding="utf-8")
    (tokenizer_folder / "merges.txt").write_text("#version: 0.2\n", encoding="utf-8")
    (tokenizer_folder / "tokenizer.json").unlink(missing_ok=True)
    return folder
