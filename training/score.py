"""Scores exported networks on held-out sketches against the best constant answers:
`python training/score.py --validation work/validation`.

Reads models/NAME.onnx and models/records/NAME.json, writes work/scores/NAME.json for `manifest.py`, prints one line each.
For the depth networks `d_plane` is the best plane of each case, which knows the answer; `d_constant` the one plane that is
best for all cases together.
"""

import argparse
import json
import pathlib
import subprocess

import torch

import data
import nets
import tasks
import train

HERE = pathlib.Path(__file__).parent


def common_plane_error(prepared, layer):
    """Mean over cases of the squared error of the one plane a x + b y + c that fits all cases best."""
    positions = torch.cat([tasks.POSITIONS, torch.ones(len(tasks.POSITIONS), 1)], 1).double()
    system, right = torch.zeros(3, 3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    pairs = []
    for batch in prepared:
        for truth, valid in zip(batch["depth"][:, layer].flatten(1), batch["valid"][:, layer].flatten(1) > 0):
            if valid.sum() < 12:
                continue
            rows, values = positions[valid], truth[valid].double()
            system += rows.T @ rows / len(rows)
            right += rows.T @ values / len(rows)
            pairs.append((rows, values))
    plane = torch.linalg.solve(system, right)
    return train.average([(values - rows @ plane).square().mean().item() for rows, values in pairs])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--validation", required=True)
    parser.add_argument("--models", type=pathlib.Path, default=HERE.parent / "models")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("work/scores"))
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    held_out = data.Shards(arguments.validation)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True).stdout.strip()
    networks = {}
    for name in nets.SHAPES:
        task = tasks.TASKS[name]
        networks[name] = train.exported(arguments.models / f"{name}.onnx", name)
        chosen = (held_out.occluded if task.occluded_only else list(range(len(held_out))))[: arguments.count]
        generator = torch.Generator().manual_seed(7)
        prepared = [task.prepare(held_out.batch(chosen[i : i + 50]), generator, networks, training=False) for i in range(0, len(chosen), 50)]
        merged = {}
        for batch in prepared:
            for key, values in task.scores(tasks.predict(networks[name], batch["input"]), batch).items():
                merged.setdefault(key, []).extend(values)
        scores = {key: train.average(values) for key, values in merged.items()}
        if "samples" in merged:
            many = [i for i, n in enumerate(merged["samples"]) if n >= 3]
            for key in ("d", "d_plane"):
                scores[f"{key}_3_and_more_samples"] = train.average([merged[key][i] for i in many])
            scores["d_constant"] = common_plane_error(prepared, 1 if task.occluded_only else 0)
        scores["cases"] = len(chosen)
        seen = json.loads((arguments.models / "records" / f"{name}.json").read_text())["samples_seen"]
        record = {"commit": commit, "samples_seen": seen, "scores": scores}
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / f"{name}.json").write_text(json.dumps(record, indent=2) + "\n")
        print(name, seen, {key: round(value, 4) for key, value in scores.items()}, flush=True)


if __name__ == "__main__":
    main()
