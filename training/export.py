"""Exports trained weights to ONNX with fp16-stored weights: `python training/export.py vd_net work/runs/vd_net/weights.pt`.

Checks that ONNX Runtime agrees with PyTorch before it writes models/NAME.onnx: on random input, and with `--validation` on what
the network sees of 40 held-out sketches. The run's record and curves go to models/records/. The embedded engine
is compared with ONNX Runtime by `cargo test --test infer`.
"""

import argparse
import io
import json
import pathlib
import shutil

import numpy
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper

import data
import nets
import tasks
from train import exported

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


def held_out_inputs(name, folder, count=40):
    """What the network sees of held-out sketches; networks that others build on come from models/."""
    helpers = {needed: exported(MODELS / f"{needed}.onnx", needed) for needed in tasks.TASKS[name].needs}
    shards = data.Shards(folder)
    chosen = (shards.occluded if tasks.TASKS[name].occluded_only else list(range(len(shards))))[:count]
    generator = torch.Generator().manual_seed(7)
    return tasks.TASKS[name].prepare(shards.batch(chosen), generator, helpers, training=False)["input"]


def extend_history(history, log, seen_before):
    """Appends a run's scores, by all samples that its weights have seen, to those of the runs before it."""
    lines = history.read_text().splitlines() if history.exists() else []
    kept = [line for line in lines if json.loads(line)["seen"] <= seen_before]
    entries = [json.loads(line) for line in log.read_text().splitlines()]
    for entry in entries:
        scores = {key: round(value, 5) for key, value in entry["validation"].items()}
        kept.append(json.dumps({"seen": seen_before + entry["samples"], "end": entry is entries[-1], **scores}))
    history.write_text("\n".join(kept) + "\n")


def export(name, weights, target, validation):
    inputs, _, _, _, size, _, _ = nets.SHAPES[name]
    network = exported(weights, name)
    # What runs later has fp16 weights, so compare with those.
    for stored in [*network.parameters(), *network.buffers()]:
        if stored.numel() >= 64:
            stored.data = stored.data.half().float()
    example = torch.randn(1, inputs, size, size, generator=torch.Generator().manual_seed(3))
    buffer = io.BytesIO()
    torch.onnx.export(network, (example,), buffer, input_names=["x"], output_names=["y"], opset_version=17, dynamo=False)
    model = store_fp16(onnx.load_from_string(buffer.getvalue()))
    onnx.checker.check_model(model)
    lost = {key for key, _ in network.named_parameters()} - {tensor.name.removesuffix("_fp16") for tensor in model.graph.initializer}
    if lost:
        raise SystemExit(f"{name}: training could not go on from the file, it lacks {sorted(lost)}")
    # One thread: those of ONNX Runtime spin while they wait, which starves a training run beside it.
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    error = 0.0
    for sample in torch.cat([example, held_out_inputs(name, validation)] if validation else [example]):
        with torch.no_grad():
            expected = network(sample[None]).numpy()
        error = max(error, float(numpy.abs(session.run(["y"], {"x": sample[None].numpy()})[0] - expected).max()))
    if error > 1e-3:
        raise SystemExit(f"{name}: ONNX Runtime differs from PyTorch by {error:.1e}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(model.SerializeToString())
    records = target.parent / "records"
    records.mkdir(exist_ok=True)
    if (weights.parent / "run.json").exists():
        record = json.loads((weights.parent / "run.json").read_text())
        earlier = records / f"{name}.json"
        if record["network"] != name and earlier.exists():
            record["samples_seen"] += json.loads(earlier.read_text())["samples_seen"]
        earlier.write_text(json.dumps(record, indent=2) + "\n")
        if record["network"] == name:
            extend_history(records / f"{name}.jsonl", weights.parent / "log.jsonl", record["seen_before"])
        shutil.copyfile(weights.parent / "curves.png", records / f"{name}.png")
    print(f"{target.name}: {target.stat().st_size / 1e6:.1f} MB, differs from PyTorch by {error:.1e}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=sorted(nets.SHAPES))
    parser.add_argument("weights", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path)
    parser.add_argument("--validation", type=pathlib.Path, help="folder of held-out shards to compare on")
    arguments = parser.parse_args()
    export(arguments.name, arguments.weights, arguments.out or MODELS / f"{arguments.name}.onnx", arguments.validation)
