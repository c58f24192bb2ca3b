"""Writes models/manifest.json from the networks' ONNX files.

    python training/manifest.py [--models models] [--commit HASH] [--record vd_net=run/record.json ...]

A record is a JSON object with `commit`, `samples_seen` and `scores` (numbers by name), as training writes it. A network whose
file did not change keeps what the manifest says about its training; one that changed without a record is written as
untrained.
"""

import argparse
import hashlib
import json
import math
from pathlib import Path

import onnx

STROKES = (
    "0-3 proximity 8 / (8 + d) to visible boundary, occluded boundary, contour, feature strokes, d in pixels of the 256 canvas; "
    "4-7 coverage of visible-front, visible-back, occluded-front, occluded-back regions; "
    "8-9 feature proximity times (cos 2t, sin 2t) of the feature direction, x right, y up"
)
VIEW = "{} cot(elevation of the view) - 1, constant"
LAYER = (
    "0 g_front, 1 g_back, 2-4 n_front, 5-7 n_back; h = base + std * g in canonical units; normals outward, camera frame, not normalized"
)
NETWORKS = {
    "vd_net": (
        f"{STROKES}; 10 base, 11 std of the visible depth offset given the visible samples, 12, 13 the same of the occluded one given the occluded samples, "
        f"canonical units; {VIEW.format(14)}",
        LAYER,
    ),
    "od_net": (
        f"{STROKES}; 10 base, 11 std of the difference between occluded and visible depth offset, canonical units; "
        f"12 visible depth offset, canonical units; 13-15 visible normal; both 0 where nothing is visible; {VIEW.format(16)}",
        f"{LAYER}; h relative to the visible depth offset",
    ),
    "bsr_net": (
        "one pixel per control point, row u, column v: 0-2 Coons point x, y, h, canonical units; at its (x, y), bilinear: "
        "3 visible coverage, 4 visible coverage times (h_visible - h), 5 visible-front, 6 visible-back coverage, "
        "7-9 visible normal times coverage, 10 occluded coverage, 11 occluded coverage times (h_occluded - h), "
        "12-14 occluded normal times coverage, 15 proximity to contours; 16 one on the border of the net",
        "offset of x, y, h to add to the Coons net, canonical units",
    ),
    "cdf_net": (
        f"{STROKES}; 10-12 visible normal times coverage, 13-15 occluded normal times coverage",
        "PolyVector coefficients in the canvas plane, visible then occluded: Re s, Im s, Re p, Im p; s = u^2 + v^2, p = u^2 v^2, |u| = |v| = 1",
    ),
}


# Input and output shape of each network, NCHW, as `src/infer/models.rs` expects them.
SHAPES = {
    "vd_net": ([1, 15, 64, 64], [1, 8, 64, 64]),
    "od_net": ([1, 17, 64, 64], [1, 8, 64, 64]),
    "bsr_net": ([1, 17, 30, 30], [1, 3, 30, 30]),
    "cdf_net": ([1, 16, 64, 64], [1, 8, 64, 64]),
}


def tensor(values, units, expected):
    """Name and shape of the only graph input or output. Exporters leave some output dimensions open: they are as expected."""
    if len(values) != 1:
        raise SystemExit(f"expected one tensor, found {[value.name for value in values]}")
    kind = values[0].type.tensor_type
    if kind.elem_type != onnx.TensorProto.FLOAT:
        raise SystemExit(f"{values[0].name} is not float32")
    shape = [dimension.dim_value or size for dimension, size in zip(kind.shape.dim, expected)]
    if shape != expected or len(kind.shape.dim) != len(expected):
        raise SystemExit(f"{values[0].name} has shape {shape}, expected {expected}")
    return {"name": values[0].name, "shape": shape, "units": units}


def entry(path, units, shapes, training):
    data = path.read_bytes()
    graph = onnx.load_model_from_string(data).graph
    weights = {weight.name for weight in graph.initializer}
    return {
        "file": path.name,
        "sha256": hashlib.sha256(data).hexdigest(),
        "parameters": sum(math.prod(weight.dims) for weight in graph.initializer),
        "input": tensor([value for value in graph.input if value.name not in weights], units[0], shapes[0]),
        "output": tensor(graph.output, units[1], shapes[1]),
        "training": training,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, default=Path(__file__).resolve().parent.parent / "models")
    parser.add_argument("--commit", default="", help="commit of the training program, for records that do not name it")
    parser.add_argument("--record", action="append", default=[], metavar="NETWORK=FILE")
    options = parser.parse_args()
    target = options.models / "manifest.json"
    before = json.loads(target.read_text())["models"] if target.exists() else {}
    records = {}
    for record in options.record:
        name, _, file = record.partition("=")
        if name not in NETWORKS:
            parser.error(f"{name} is none of {', '.join(NETWORKS)}")
        records[name] = json.loads(Path(file).read_text())
    models = {}
    for name, units in NETWORKS.items():
        record = records.get(name, {})
        training = {
            "commit": record.get("commit", options.commit),
            "samples_seen": int(record.get("samples_seen", 0)),
            "scores": {key: float(value) for key, value in sorted(record.get("scores", {}).items())},
        }
        models[name] = entry(options.models / f"{name}.onnx", units, SHAPES[name], training)
        old = before.get(name)
        if name not in records and old and old["sha256"] == models[name]["sha256"]:
            models[name]["training"] = old["training"]
    target.write_text(json.dumps({"format": 1, "models": models}, indent=2) + "\n")


if __name__ == "__main__":
    main()
