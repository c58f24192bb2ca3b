"""Exports trained weights to ONNX with fp16-stored weights: `python training/export.py vd_net work/runs/vd_net/weights.pt`.

Checks that ONNX Runtime agrees with PyTorch on random inputs before it writes models/NAME.onnx.
"""

import argparse
import io
import pathlib

import numpy
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper

import nets

MODELS = pathlib.Path(__file__).parent.parent / "models"


def store_fp16(model):
    """Stores each large float initializer as fp16 and casts it back on load."""
    casts = []
    for tensor in list(model.graph.initializer):
        if tensor.data_type != TensorProto.FLOAT or numpy.prod(tensor.dims) < 64:
            continue
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(numpy.float16), tensor.name + "_fp16")
        model.graph.initializer.remove(tensor)
        model.graph.initializer.append(half)
        casts.append(helper.make_node("Cast", [half.name], [tensor.name], to=TensorProto.FLOAT))
    for node in reversed(casts):
        model.graph.node.insert(0, node)
    return model


def export(name, weights, target):
    inputs, _, _, _, size, _ = nets.SHAPES[name]
    network = nets.make(name).eval()
    network.load_state_dict(torch.load(weights, weights_only=True))
    # What runs later has fp16 weights, so compare with those.
    for parameter in network.parameters():
        if parameter.numel() >= 64:
            parameter.data = parameter.data.half().float()
    example = torch.randn(1, inputs, size, size, generator=torch.Generator().manual_seed(3))
    buffer = io.BytesIO()
    torch.onnx.export(network, (example,), buffer, input_names=["x"], output_names=["y"], opset_version=17, dynamo=False)
    model = store_fp16(onnx.load_from_string(buffer.getvalue()))
    onnx.checker.check_model(model)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    with torch.no_grad():
        expected = network(example).numpy()
    error = float(numpy.abs(session.run(["y"], {"x": example.numpy()})[0] - expected).max())
    if error > 1e-3:
        raise SystemExit(f"{name}: ONNX Runtime differs from PyTorch by {error:.1e}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(model.SerializeToString())
    print(f"{target.name}: {target.stat().st_size / 1e6:.1f} MB, differs from PyTorch by {error:.1e}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=sorted(nets.SHAPES))
    parser.add_argument("weights", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path)
    arguments = parser.parse_args()
    export(arguments.name, arguments.weights, arguments.out or MODELS / f"{arguments.name}.onnx")
