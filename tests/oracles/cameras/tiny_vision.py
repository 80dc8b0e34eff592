"""Vision models with a few thousand random weights, written as a user's are: `save_pretrained` into folders."""

from __future__ import annotations

from pathlib import Path

import torch

WORDS = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "tree", "branch", "power", "line", "cable"]
SIDE = 64  # pixels that SAM-HQ and SAM 2 take


def write_weights(folder: Path, *, video: bool = True) -> Path:
    """Write Grounding DINO, SAM-HQ and SAM 2 video, shrunken, into folders of a folder; return it."""
    import transformers as t

    torch.manual_seed(0)
    t.logging.set_verbosity_error()
    t.logging.disable_progress_bar()
    dino = folder / "grounding"
    t.BertTokenizerFast(vocab={w: k for k, w in enumerate(WORDS)}).save_pretrained(dino)
    swin = t.SwinConfig(embed_dim=8, depths=[1, 1, 1, 1], num_heads=[1, 1, 1, 1], window_size=4, image_size=SIDE,
                        out_features=["stage2", "stage3", "stage4"])  # fmt: skip
    bert = t.BertConfig(vocab_size=len(WORDS), hidden_size=16, num_hidden_layers=1, num_attention_heads=2,
                        intermediate_size=16, max_position_embeddings=64)  # fmt: skip
    config = t.GroundingDinoConfig(
        backbone_config=swin, text_config=bert, d_model=32, encoder_layers=1, decoder_layers=2,
        encoder_attention_heads=2, decoder_attention_heads=2, encoder_ffn_dim=16, decoder_ffn_dim=16, num_queries=6,
        num_feature_levels=3, max_text_len=32,
    )  # fmt: skip
    t.GroundingDinoForObjectDetection(config).save_pretrained(dino)
    t.SamHQModel(_sam_config(t)).save_pretrained(folder / "masks")
    if video:
        t.Sam2VideoModel(_video_config(t)).save_pretrained(folder / "video")
    return folder


def _sam_config(t):
    vision = {"hidden_size": 16, "output_channels": 16, "num_hidden_layers": 2, "num_attention_heads": 2,
              "image_size": SIDE, "patch_size": 8, "window_size": 4, "global_attn_indexes": [1], "num_pos_feats": 8,
              "mlp_dim": 16}  # fmt: skip
    prompt = {"hidden_size": 16, "image_size": SIDE, "patch_size": 8, "mask_input_channels": 4}
    decoder = {"hidden_size": 16, "mlp_dim": 16, "num_hidden_layers": 1, "num_attention_heads": 2,
               "iou_head_hidden_dim": 16, "vit_dim": 16}  # fmt: skip
    return t.SamHQConfig(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder)


def _video_config(t):
    backbone = {"model_type": "sam2_hiera_det_model", "hidden_size": 8, "image_size": [SIDE, SIDE],
                "blocks_per_stage": [1, 1, 1, 1], "embed_dim_per_stage": [8, 16, 32, 64],
                "num_attention_heads_per_stage": [1, 1, 1, 1], "window_size_per_stage": [4, 2, 2, 1],
                "global_attention_blocks": []}  # fmt: skip
    return t.Sam2VideoConfig(
        image_size=SIDE, memory_attention_hidden_size=128, memory_attention_feed_forward_hidden_size=16,
        memory_attention_num_layers=1, memory_attention_rope_feat_sizes=[4, 4], memory_encoder_hidden_size=128,
        memory_encoder_output_channels=64, memory_fuser_embed_dim=128, memory_fuser_intermediate_dim=16,
        memory_fuser_num_layers=1, mask_downsampler_embed_dim=128,
        prompt_encoder_config={"hidden_size": 128, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 4},
        mask_decoder_config={"hidden_size": 128, "mlp_dim": 16, "num_hidden_layers": 1, "num_attention_heads": 2,
                             "iou_head_hidden_dim": 16},
        vision_config={"backbone_channel_list": [64, 32, 16, 8], "fpn_hidden_size": 128,
                       "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]], "backbone_config": backbone},
    )  # fmt: skip
