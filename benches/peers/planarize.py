"""Planarization side by side with libigl and ShapeOp, on the same quads and at the same closeness; see README.md."""

import argparse
import sys
import time
from pathlib import Path

import igl
import numpy as np
from compas_shapeop.shapeop import Solver

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bindings" / "python"))

from sketch2pq import Session  # noqa: E402


def read(path):
    """Vertices and quads of an OBJ file."""
    lines = [line.split() for line in Path(path).read_text().splitlines()]
    vertices = np.array([line[1:4] for line in lines if line[:1] == ["v"]], dtype=float)
    faces = [[int(i.split("/")[0]) - 1 for i in line[1:]] for line in lines if line[:1] == ["f"]]
    return vertices, np.array(faces)


def planarity(vertices, quads):
    """Distance of the diagonals' lines of each quad over the mesh's mean edge length; also the mean edge length."""
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    cross = np.cross(c - a, d - b)
    distance = np.abs(((b - a) * cross).sum(1)) / np.linalg.norm(cross, axis=1)
    sides = np.sort(np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)]), axis=1)
    sides = np.unique(sides, axis=0)
    edge = np.linalg.norm(vertices[sides[:, 0]] - vertices[sides[:, 1]], axis=1).mean()
    return distance / edge, edge


def timed(work, runs):
    """The result, and the median processor time of `runs` runs, milliseconds."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        result = work()
        times.append(1e3 * (time.process_time() - start))
    return result, np.median(times)


def shapeop(vertices, quads, iterations):
    """ShapeOp's projections: each quad on a plane, each vertex a thousandth as strongly on its place."""
    solver = Solver()
    solver.points = vertices
    solver.add_closeness_constraints(list(range(len(vertices))), 1.0)
    for quad in quads.tolist():
        solver.add_plane_constraint(quad, 1e3)
    solver.init()
    solver.solve(iterations)
    return np.array(solver.points)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", nargs="+", help="OBJ file of quads, not planar")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--iterations", type=int, nargs="+", default=[100, 1000])
    arguments = parser.parse_args()
    session = Session()
    print("| mesh | quads | who | ms | P_max | mean drift, edges | max drift, edges |\n" + "| --- " * 7 + "|")
    for path in arguments.mesh:
        vertices, quads = read(path)
        before, edge = planarity(vertices, quads)
        print(f"| {Path(path).stem} | {len(quads)} | before | | {before.max():.1e} | | |")
        faces = quads.tolist()

        def ours(**weights):
            return session.planarize(vertices, faces, hold="free", **weights).vertices.copy()

        who = {"sketch2pq, at its peers' aim": lambda: ours(anchor=1, fairness=0), "sketch2pq, as it comes": ours}
        for count in arguments.iterations:
            who[f"libigl, {count} iterations"] = lambda n=count: igl.planarize_quad_mesh(vertices, quads, n, 0.0)
            who[f"ShapeOp, {count} iterations"] = lambda n=count: shapeop(vertices, quads, n)
        for name, work in who.items():
            moved, ms = timed(work, arguments.runs)
            drift = np.linalg.norm(moved - vertices, axis=1) / edge
            p = planarity(moved, quads)[0].max()
            print(f"| | | {name} | {ms:.0f} | {p:.1e} | {drift.mean():.3f} | {drift.max():.3f} |")


if __name__ == "__main__":
    main()
