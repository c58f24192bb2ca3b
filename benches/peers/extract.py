"""Extraction of quads side by side with QuadriFlow, from the same surface to the same number of faces; see README.md."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from pyQuadriFlow.pyQuadriFlow import pyquadriflow

from planarize import planarity

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bindings" / "python"))

from sketch2pq import Session, Surface  # noqa: E402

CONTROL_POINTS = 14


def waves():
    """The wavy roof of examples/shared/waves.rs."""
    count = CONTROL_POINTS
    x, y = np.meshgrid(np.linspace(-4, 4, count), np.linspace(-4, 4, count), indexing="ij")
    z = 0.6 * np.sin(0.7 * x + 0.3 * y) + 0.5 * np.cos(0.6 * y - 0.2 * x) + 0.03 * x * y
    knots = np.concatenate([[0.0] * 3, np.linspace(0, 1, count - 2), [1.0] * 3])
    return Surface.from_nurbs((3, 3), (knots, knots), np.stack([x, y, z], -1))


def grid(surface, cells):
    """A triangulated sampling: (V, 3) vertices, (T, 3) triangles."""
    t = np.linspace(0, 1, cells + 1)
    uv = np.stack(np.meshgrid(t, t, indexing="ij"), -1).reshape(-1, 2)
    vertices = np.asarray(surface.patches[0].evaluate(uv)).reshape(len(uv), -1)[:, :3]
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def row(name, faces, ms, vertices, quads):
    """A line of the table; quads with parallel diagonals have no distance between their lines, and are left out."""
    with np.errstate(invalid="ignore"):
        values, _ = planarity(np.asarray(vertices), np.asarray(quads))
    values = values[np.isfinite(values)]
    print(f"| {name} | {faces} | {len(quads)} | {ms:.0f} | {values.max():.1e} | {values.mean():.1e} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faces", type=int, nargs="+", default=[500])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--cells", type=int, default=48, help="cells along a side of the triangulations that both get")
    arguments = parser.parse_args()
    session, surface = Session(threads=1), waves()
    vertices, triangles = grid(surface, arguments.cells)
    print("| who | faces | whole quads | ms | P_max | P_mean |\n" + "| --- " * 6 + "|")
    for faces in arguments.faces:
        extraction, whole = [], []
        for _ in range(arguments.runs):
            mesh = session.mesh(session.field(surface, resolution=arguments.cells), faces=faces)
            times = mesh.report["time_ms"]
            extraction.append(times["field"] + times["mesh"])
            whole.append(extraction[-1] + times["planarize"])
        quads = [face for face in mesh.faces if len(face) == 4]
        row("sketch2pq", len(mesh.faces), np.median(whole), mesh.vertices, quads)
        print(f"| its field, map and extraction alone | | | {np.median(extraction):.0f} | | |")
        times = []
        for _ in range(arguments.runs):
            start = time.perf_counter()
            # Seed 0, borders kept, the rest as in Blender's defaults.
            result = pyquadriflow(faces, 0, vertices.tolist(), triangles.tolist(), False, True, False, False, False)
            times.append(1e3 * (time.perf_counter() - start))
        row("QuadriFlow", len(result["faces"]), np.median(times), result["vertices"], result["faces"])


if __name__ == "__main__":
    main()
