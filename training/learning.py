"""Draws held-out scores over the samples seen, of all runs so far: `python training/learning.py`.

Reads models/records/NAME.jsonl, writes docs/scores/learning.png and prints the power law through the ends of the runs, where the
learning rate has fallen to zero: score = score_0 (samples / samples_0)^-b.
"""

import json
import math
import pathlib

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

ROOT = pathlib.Path(__file__).parent.parent
# Network: its score, the one to compare with, and what both are.
SCORES = {
    "vd_net": ("d_shear", "d_plane", "VD-Net: squared error, free parameters removed"),
    "od_net": ("d_shear", "d_plane", "OD-Net: squared error, free parameters removed"),
    "cdf_net": ("angle_deg", "constant_deg", "CDF-Net: angle, degrees"),
}


def law(points, score):
    """Exponent b of the line through the logarithms of the points (samples, score)."""
    x = [math.log(point["seen"]) for point in points]
    y = [math.log(point[score]) for point in points]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    return -sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y)) / sum((a - mean_x) ** 2 for a in x)


def main():
    histories = {name: ROOT / "models" / "records" / f"{name}.jsonl" for name in SCORES}
    histories = {name: path for name, path in histories.items() if path.exists()}
    figure, axes = pyplot.subplots(1, len(histories), figsize=(5 * len(histories), 4), squeeze=False)
    for axis, (name, path) in zip(axes[0], histories.items()):
        score, reference, title = SCORES[name]
        entries = [json.loads(line) for line in path.read_text().splitlines()]
        axis.plot([e["seen"] for e in entries], [e[score] for e in entries], label=score)
        axis.plot([e["seen"] for e in entries], [e[reference] for e in entries], "--", label=reference)
        runs = [entry for entry in entries if entry["end"]]
        axis.plot([e["seen"] for e in runs], [e[score] for e in runs], "o", label="ends of runs")
        if len(runs) > 1:
            exponent = law(runs, score)
            print(f"{name}: {score} {runs[-1][score]:.4f} after {runs[-1]['seen']} samples, exponent {exponent:.2f}")
            reach = [runs[-1]["seen"], 10 * runs[-1]["seen"]]
            axis.plot(reach, [runs[-1][score] * (n / reach[0]) ** -exponent for n in reach], ":", label=f"power {-exponent:.2f}")
        axis.set(title=title, xlabel="samples seen", xscale="log", yscale="log")
        axis.legend()
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "scores" / "learning.png", dpi=80)


if __name__ == "__main__":
    main()
