"""The numbers that convolutions compute in."""

from __future__ import annotations

import torch

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}


def convolution_dtype(precision: str, device: torch.device) -> torch.dtype:
    """What ``precision`` means on a device.

    ``auto``: bfloat16 where the processor computes in it, float32 elsewhere.

    Raises:
        ValueError: an unknown precision.
    """
    if precision == "auto":
        return torch.bfloat16 if _has_bfloat16(device) else torch.float32
    if precision not in DTYPES:
        raise ValueError(
            f"precision: {precision!r} is unknown; choose from auto, {', '.join(DTYPES)}"
        )
    return DTYPES[precision]


def _has_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.cpu._is_avx512_bf16_supported()
