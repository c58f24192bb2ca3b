"""Trains all four networks in sequence, then those of the surface jointly, and exports them: `python training/all.py --hours 8`.

Data are made by `sketch2pq generate` where they are missing (seeds below VALIDATION are for training, the rest held out).
Everything resumes: shards that exist are kept, a network continues from its checkpoint.
"""

import argparse
import pathlib
import subprocess
import sys

import nets
import tasks

ROOT = pathlib.Path(__file__).parent.parent
WORK = ROOT / "work"
# Share of the time for each network; VD-Net carries the shape.
SHARES = {"vd_net": 0.5, "od_net": 0.18, "bsr_net": 0.1, "cdf_net": 0.14, "joint": 0.08}
# Every second shard's views have any elevation in these bounds, degrees; the others 45.
ELEVATION = (25, 65)
SHARD = 1024
VALIDATION = 9_000_000


def run(*command):
    print("+", *command, flush=True)
    subprocess.run([str(part) for part in command], check=True, cwd=ROOT)


def generate(first, count, folder, *more):
    run("cargo", "run", "--release", "--", "generate", "--seeds", f"{first}..{first + count}", "--out", folder, *more)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, required=True)
    parser.add_argument("--samples", type=int, default=60_000)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    for first in range(0, arguments.samples, SHARD):
        generate(first, SHARD, WORK / "train", *(("--elevation", *ELEVATION) if first // SHARD % 2 else ()))
    generate(VALIDATION, 2_048, WORK / "validation")
    data = "--data", WORK / "train", "--validation", WORK / "validation"
    for name, share in SHARES.items():
        task = tasks.TASKS[name]
        helpers = [part for needed in task.needs for part in ("--helper", f"{needed}={WORK / 'runs' / needed / 'weights.pt'}")]
        trained = getattr(task, "networks", (name,))
        start = ("--initial", ROOT / "models") if trained != (name,) else ()
        run(
            sys.executable, "training/train.py", name, *data, "--minutes", arguments.hours * 60 * share,
            "--threads", arguments.threads, *helpers, *start,
        )
        for network in trained:
            run(sys.executable, "training/export.py", network, WORK / "runs" / name / "weights.pt", "--validation", WORK / "validation")
    run(sys.executable, "training/score.py", "--validation", WORK / "validation", "--threads", arguments.threads)
    records = [part for name in nets.SHAPES for part in ("--record", f"{name}={WORK / 'scores' / name}.json")]
    run(sys.executable, "training/manifest.py", *records)


if __name__ == "__main__":
    main()
