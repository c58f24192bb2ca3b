"""Convolutions of 3 x 3 with a quarter of the products (winograd.cpp), for training on CPUs that multiply in fp32 only.

There they take half of the time of PyTorch's. Answers differ from its by 1e-6 of their norm, gradients by 6e-6.
"""

import os
import pathlib
import sys

import torch
from torch.nn import functional as F

import precision

kernels = None


def load():
    """Has the kernels used from now on, where they serve and can be compiled; says so where they cannot."""
    global kernels
    if precision.fast("cpu") == torch.bfloat16 or torch.cuda.is_available():
        return
    try:
        kernels = compiled()
    except (RuntimeError, OSError, ImportError) as error:
        print(f"winograd.cpp does not compile here, training takes half as long again: {error}", file=sys.stderr)


def compiled():
    """The kernels, compiled for this machine the first time (a minute)."""
    from torch.utils import cpp_extension

    # PyTorch calls the `ninja` that was installed beside it by its name.
    os.environ["PATH"] = os.pathsep.join([str(pathlib.Path(sys.executable).parent), os.environ["PATH"]])
    flags = ["-O3", "-fopenmp", "-march=native", "-ffast-math", "-Wno-psabi"]
    return cpp_extension.load("sketch2pq_winograd", [str(pathlib.Path(__file__).with_suffix(".cpp"))], extra_cflags=flags)


def rows(tensor):
    """(B, C, H, W) as (B, H, W, C): a view where channels are stored last."""
    return tensor.permute(0, 2, 3, 1).contiguous()


def columns(tensor):
    """(B, H, W, C) as (B, C, H, W)."""
    return tensor.permute(0, 3, 1, 2)


class Filter(torch.autograd.Function):
    """conv(relu(x), weight) + bias + rest, of tensors (B, C, H, W) that are stored channels last; `rest` may be None."""

    @staticmethod
    def forward(context, x, weight, bias, rest):
        context.save_for_backward(x, weight)
        context.with_rest = rest is not None
        return columns(kernels.forward(rows(x), rows(weight), bias, rows(rest) if context.with_rest else None))

    @staticmethod
    def backward(context, error):
        dx, dweight, dbias = kernels.backward(*map(rows, context.saved_tensors), rows(error))
        return columns(dx), columns(dweight), dbias, error if context.with_rest else None


def after_relu(layer, x, rest=None):
    """layer(relu(x)), and + `rest` where given."""
    fits = x.shape[1] % 32 == 0 and layer.out_channels % 32 == 0 and x.shape[2] % 4 == 0 and x.shape[3] % 4 == 0
    if kernels is not None and fits and x.dtype == torch.float32 and x.device.type == "cpu":
        return Filter.apply(x, layer.weight, layer.bias, rest)
    y = layer(F.relu(x))
    return y if rest is None else rest + y
