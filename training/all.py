"""Trains all four networks in sequence and exports them: `python training/all.py --hours 8`.

Data are made by `sketch2pq generate` where they are missing (seeds below VALIDATION are for training, the rest held out).
Everything resumes: shards that exist are kept, a network continues from its checkpoint.
"""

import argparse
import pathlib
import subprocess
import sys

import tasks

ROOT = pathlib.Path(__file__).parent.parent
WORK = ROOT / "work"
# Share of the time for each network; VD-Net carries the shape.
SHARES = {"vd_net": 0.5, "od_net": 0.2, "bsr_net": 0.12, "cdf_net": 0.18}
VALIDATION = 9_000_000


def run(*command):
    print("+", *command, flush=True)
    subprocess.run([str(part) for part in command], check=True, cwd=ROOT)


def generate(first, count, folder):
    run("cargo", "run", "--release", "--", "generate", "--seeds", f"{first}..{first + count}", "--out", folder)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, required=True)
    parser.add_argument("--samples", type=int, default=60_000)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    generate(0, arguments.samples, WORK / "train")
    generate(VALIDATION, 2_048, WORK / "validation")
    for name, share in SHARES.items():
        extra = [part for needed in tasks.TASKS[name].needs for part in ("--helper", f"{needed}={WORK / 'runs' / needed / 'weights.pt'}")]
        run(
            sys.executable, "training/train.py", name, "--data", WORK / "train", "--validation", WORK / "validation",
            "--minutes", arguments.hours * 60 * share, "--threads", arguments.threads, *extra,
        )
        run(sys.executable, "training/export.py", name, WORK / "runs" / name / "weights.pt", "--validation", WORK / "validation")
    run(sys.executable, "training/score.py", "--validation", WORK / "validation", "--threads", arguments.threads)
    records = [part for name in SHARES for part in ("--record", f"{name}={WORK / 'runs' / name / 'record.json'}")]
    run(sys.executable, "training/manifest.py", *records)


if __name__ == "__main__":
    main()
