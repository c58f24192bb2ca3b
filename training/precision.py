"""Which floating-point type is fast on a device."""

import functools

import torch


@functools.cache
def fast(device_type):
    """bf16 where the hardware multiplies in it (GPUs, CPUs with such units), else fp32: emulated, bf16 takes 2.6 times as long."""
    capabilities = torch.cpu.get_capabilities()
    if device_type != "cpu" or any(capabilities.get(unit) for unit in ("amx_bf16", "avx512_bf16", "bf16")):
        return torch.bfloat16
    return torch.float32
