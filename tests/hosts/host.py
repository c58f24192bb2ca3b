"""What a Python host may do to the library, right and wrong.

usage: host.py SKETCH.json
"""

import gc
import re
import resource
import sys
import threading
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bindings" / "python"))

import numpy as np  # noqa: E402

import native  # noqa: E402
import sketch2pq as s  # noqa: E402

SQUARE = np.array(
    [(40, 60), (90, 60), (140, 60), (200, 60), (200, 100), (200, 150), (200, 200), (150, 200), (100, 200), (40, 200)]
    + [(40, 150), (40, 100), (40, 60)],
    dtype=float,
)


def raises(error_type, body, *arguments, **named):
    """The error that `body` raises, which must be of this type and say something."""
    try:
        body(*arguments, **named)
    except error_type as error:
        assert len(error.message) > 10, error
        return error
    raise AssertionError(f"{body} raised no {error_type.__name__}")


def drawn(*strokes, kind="visible_boundary"):
    sketch = s.Sketch()
    for stroke in strokes:
        sketch.add_stroke(kind, stroke)
    return sketch


def mirrors_the_header():
    """Every function of the header is declared, with as many arguments."""
    header = (ROOT / "include" / "sketch2pq.h").read_text()
    header = re.sub(r"//[^\n]*", "", header)
    pattern = r"\b(s2pq_[a-z0-9_]+|sketch_to_surface|sketch_to_cdf|surface_to_cdf|extract_pq_mesh)\(([^)]*)\)"
    declared = {name: 0 if a.strip() == "void" else a.count(",") + 1 for name, a in re.findall(pattern, header)}
    mirrored = {name: len(arguments) for name, (_, arguments) in native.SIGNATURES.items()}
    assert declared == mirrored, {k for k in declared.keys() ^ mirrored.keys()} or (declared, mirrored)
    for struct in native.LAYOUT:
        body = re.search(rf"typedef struct S2pq{struct.__name__} {{(.*?)}}", header, re.S).group(1)
        fields = re.findall(r"(\w+);", body)
        assert fields == [name for name, _ in struct._fields_], (struct, fields)
    version = int(re.search(r"S2PQ_ABI_VERSION (\d+)u", header).group(1))
    assert version == native.ABI_VERSION


def a_live_session_begins_with_the_last_surface(path):
    session = s.Session(backend="embedded", threads=1, live=True)
    first, second = (session.surface(s.Sketch.read(path)).patches[0] for _ in range(2))
    assert first.diagnostics["warm_start"] == 0 and second.diagnostics["warm_start"] == 1
    size = np.ptp(first.control_points.reshape(-1, 3), axis=0).max()
    moved = np.linalg.norm(first.grid(20, 20)[0] - second.grid(20, 20)[0], axis=1)
    assert moved.max() < 0.05 * size, (moved.max(), size)


def the_pipeline(session, path):
    sketch = s.Sketch.read(path)
    surface = session.surface(sketch)
    patch = surface.patches[0]
    assert patch.degrees == (3, 3) and patch.control_points.shape == (30, 30, 3) and patch.weights is None
    assert len(patch.knots[0]) == 34 and len(patch.rhino_knots[1]) == 32
    points, normals = patch.evaluate([(0, 0), (0.3, 0.8), (1, 1)])
    assert np.allclose(points[0], patch.control_points[0, 0]) and np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert patch.diagnostics["reprojection_max_px"] > 0 and patch.diagnostics["warm_start"] == 0
    bezier = patch.bezier()
    assert bezier.shape == (27, 27, 4, 4, 3)
    ends, _ = patch.evaluate([(i / 27, j / 27) for i in range(28) for j in range(28)])
    ends = ends.reshape(28, 28, 3)
    assert np.allclose(bezier[:, :, 0, 0], ends[:-1, :-1]) and np.allclose(bezier[:, :, 3, 3], ends[1:, 1:])
    vertices, vertex_normals, quads = patch.grid(27, 27)
    assert np.allclose(vertices.reshape(28, 28, 3), ends) and quads.shape == (729, 4) and quads.max() == 783
    assert np.allclose(np.linalg.norm(vertex_normals, axis=1), 1)
    field = session.field(surface, sketch)
    assert field.directions.shape == (len(field.triangles), 2, 3)
    assert np.allclose(np.linalg.norm(field.directions, axis=2), 1)
    assert len(field.singularities[0]) == field.diagnostics["singularities"]
    mesh = session.mesh(field, faces=200)
    assert 150 < len(mesh.faces) < 260 and len(mesh.planarity) == len(mesh.faces)
    assert np.concatenate(mesh.faces).max() == len(mesh.vertices) - 1 and mesh.on_border.any()
    assert mesh.planarity.max() == mesh.measures["planarity_max"] <= 1e-3, mesh.measures
    assert mesh.report["faces"] == len(mesh.faces) and mesh.obj.count("\nf ") >= len(mesh.faces) - 1
    # Views keep what they look into.
    vertices = mesh.vertices
    kept = vertices.copy()
    del mesh, field, surface, patch
    gc.collect()
    assert (vertices == kept).all() and not vertices.flags.writeable


def svg_means_the_same(session):
    sketches = ROOT / "examples" / "sketches"
    json, svg = (session.surface(s.Sketch.read(sketches / f"dome.{kind}")).patches[0] for kind in ("json", "svg"))
    extents = [np.ptp(patch.grid(20, 20)[0], axis=0) for patch in (json, svg)]
    assert np.allclose(*extents, rtol=0.02), extents


def moves_and_scales_exactly(session):
    # Powers of two are exact in floating point, so is the answer.
    base = session.surface(drawn(SQUARE)).patches[0].control_points
    scaled = session.surface(drawn(SQUARE * 4)).patches[0].control_points
    assert np.allclose(scaled, base * 4, rtol=1e-12, atol=1e-9)


def broken_sketches(session):
    open_outline = SQUARE[:9]
    angle = np.linspace(0, 2 * np.pi, 1_000_000)
    many = np.stack([128 + 90 * np.cos(angle), 128 + 70 * np.sin(angle)], axis=1)
    raises(s.SketchError, session.surface, s.Sketch())
    raises(s.SketchError, session.surface, drawn([(3, 4)]))
    raises(s.SketchError, drawn, [(40, 60), (float("nan"), 60), (200, 200)])
    where = raises(s.SketchError, session.surface, drawn(open_outline))
    assert re.search(r"\(\d+\.\d+, \d+\.\d+\)", where.message), where.message
    try:
        session.surface(drawn([(40, 60), (200, 200), (200, 60), (40, 200), (40, 60)]))
    except s.SketchError as error:
        assert len(error.message) > 10
    raises(s.SketchError, session.surface, drawn(SQUARE, kind="feature"))
    assert len(session.surface(drawn(many)).patches) == 1
    for scale in (1e12, 1e-12):
        points = session.surface(drawn(SQUARE * scale)).patches[0].control_points
        assert np.isfinite(points).all() and np.ptp(points) > scale
    for scale in (1e300, 1e-300):
        try:
            assert np.isfinite(session.surface(drawn(SQUARE * scale)).patches[0].control_points).all()
        except (s.SketchError, s.ArgumentError, s.GeometryError) as error:
            assert len(error.message) > 10
    raises(s.ArgumentError, drawn, SQUARE, kind="scribble")
    assert len(session.surface(drawn(SQUARE, SQUARE)).patches) == 1
    raises(s.ArgumentError, drawn, [(1, 2, 3)] * 3 + [(1,)])
    for text in ("", "{", "[]", '{"strokes": 3}', '{"strokes": [{"kind": "scribble", "points": []}]}', "\0\1"):
        raises(s.ArgumentError, s.Sketch.from_json, text)
        raises(s.ArgumentError, s.Sketch.from_svg, text)


def own_surface(session):
    h = np.sqrt(0.5)
    net = np.array([[(1, 0, 0), (1, 0, 2)], [(1, 1, 0), (1, 1, 2)], [(0, 1, 0), (0, 1, 2)]], dtype=float)
    weights = [[1, 1], [h, h], [1, 1]]
    for knots in (([0, 0, 0, 1, 1, 1], [0, 0, 1, 1]), ([0, 0, 1, 1], [0, 1])):
        surface = s.Surface.from_nurbs((2, 1), knots, net, weights)
        points, _ = surface.patches[0].evaluate(np.random.default_rng(1).random((20, 2)))
        assert np.allclose(np.hypot(points[:, 0], points[:, 1]), 1)
        assert len(surface.patches[0].knots[0]) == 6
    mesh = session.mesh(session.field(surface), faces=100)
    assert abs(np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) - 1).max() < 0.05
    # A ruling and an arc of the cylinder, as curves in space: one family follows each, and no sketch is needed.
    height = np.abs(net[..., 2]).max()
    arc = [(np.cos(a), np.sin(a), 0.4 * height) for a in np.linspace(0.1, 1.4, 20)]
    ruling = [(np.cos(0.7), np.sin(0.7), z * height) for z in (0.1, 0.9)]
    for hard in (False, True, [True, False]):
        field = session.field(surface, curves=[arc, ruling], hard=hard, align_border=["u_min", "v_max"])
        assert field.diagnostics["feature_angle_deg"] < 1 and len(field.floor_triangles) == 0
        assert len(field.singularities[0]) == 0
    curved = session.mesh(field, faces=100)
    assert curved.measures["planarity_max"] < 1e-6
    fixed_singularities(session, surface, height)
    raises(s.ArgumentError, session.field, surface, curves=[[(1, 0, 0)]])
    raises(s.ArgumentError, session.field, surface, curves=[[(1, 0, 0), (1, 0, np.nan)]])
    raises(s.ArgumentError, session.field, surface, curves=[[(50, 0, 0), (60, 0, 0)]])
    raises(s.ArgumentError, session.field, surface, curves=[[(1, 0)] * 3])
    raises(s.ArgumentError, session.field, surface, align_border=["left"])
    raises(s.ArgumentError, session.field, surface, drawn(SQUARE), curves=[arc])
    raises(s.GeometryError, s.Surface.from_nurbs, (2, 1), ([0, 0, 1], [0, 1]), net)
    raises(s.GeometryError, s.Surface.from_nurbs, (2, 1), ([0, 0, 1, 1], [0, 1]), net * np.nan)
    raises(s.ArgumentError, s.Surface.from_nurbs, (2, 1), ([0, 0, 1, 1], [0, 1]), net[0])


def fixed_singularities(session, surface, height):
    """The field has singularities where the host wants them, and panels meet there in threes and fives."""
    places = [(np.cos(0.4), np.sin(0.4), 0.3 * height), (np.cos(1.1), np.sin(1.1), 0.7 * height)]
    for given in ([(places[0], 1), (places[1], -1)], [(places[1], -1)], []):
        field = session.field(surface, singularities=given)
        vertices, indices = field.singularities
        found = [tuple(row) for row in field.vertices[vertices]]
        assert sorted(indices) == sorted(index for _, index in given)
        for place, index in given:
            distances = [np.linalg.norm(np.subtract(place, p)) for p, i in zip(found, indices) if i == index]
            assert min(distances) < 0.05 * height
    parameters = session.field(surface, singularities=[((0.3, 0.4), 1, 0)], align_border=["u_min"])
    assert list(parameters.singularities[1]) == [1]
    refused = raises(s.ArgumentError, session.field, surface, singularities=[((0.3, 0.4), 1)], align_border=True)
    assert "1 quarter turns" in refused.message and "room for 0" in refused.message
    for bad in ([((50, 0, 0), 1)], [((0.3, 0.4), 2)], [((0.3, 0.4), 1, 1)], [((0.3,), 1)], [((0.3, 7), 1)], [1]):
        raises(s.ArgumentError, session.field, surface, singularities=bad)
    raises(s.ArgumentError, session.field, surface, singularities=[((0.3, 0.4), 1), ((0.3, 0.4), -1)])


def own_panels(session):
    """A host's own quads on a sphere, that are not planar."""
    t = np.linspace(-0.6, 0.6, 9)
    x, y = np.meshgrid(np.tan(t), np.tan(t), indexing="ij")
    points = np.stack([x, y + 0.2 * t[:, None], np.ones_like(x)], axis=-1).reshape(-1, 3)
    points *= 5 / np.linalg.norm(points, axis=1, keepdims=True)
    faces = [[9 * i + j, 9 * i + j + 9, 9 * i + j + 10, 9 * i + j + 1] for i in range(8) for j in range(8)]
    assert session.planarize(points, faces, deviation=1e-9).measures["planarity_max"] > 1e-3
    mesh = session.planarize(points, faces, pins=[0, 40])
    assert mesh.planarity.max() < 1e-9 and len(mesh.planarity) == 64 and len(mesh.deviation) == 81
    assert (mesh.vertices[[0, 40]] == points[[0, 40]]).all() and 0 < mesh.deviation.max() < 0.2
    assert [list(face) for face in mesh.faces] == faces and "border_covered" not in mesh.report
    assert (session.planarize(points, faces).vertices[mesh.on_border == 1] != points[mesh.on_border == 1]).any()
    pinned = session.planarize(points, faces, hold="pinned")
    assert (pinned.vertices[mesh.on_border == 1] == points[mesh.on_border == 1]).all()
    free = session.planarize(points, faces, hold="free")

    def angles(mesh):
        """Of each face's corners."""
        at = mesh.vertices[np.array(faces)]
        before, after = np.roll(at, 1, axis=1) - at, np.roll(at, -1, axis=1) - at
        cosines = (before * after).sum(2) / np.linalg.norm(before, axis=2) / np.linalg.norm(after, axis=2)
        return np.arccos(cosines)

    def circularity(mesh):
        """Opposite angles of a quad with a circumcircle add up to half a turn."""
        return np.abs(angles(mesh) @ [1, -1, 1, -1]).mean()

    def conicality(mesh):
        """Opposite angles at an inner vertex of a mesh with offset planes have the same sum."""
        corner = np.zeros((81, 2))
        for face in zip(faces, angles(mesh)):
            for k, (v, angle) in enumerate(zip(*face)):
                # Faces at a vertex that lie opposite each other meet it at corners 0 and 2, or at 1 and 3.
                corner[v, k % 2] += angle
        inner = [9 * i + j for i in range(1, 8) for j in range(1, 8)]
        return np.abs(corner[inner] @ [1, -1]).mean()

    for offsets, measure in [("circular", circularity), ("conical", conicality)]:
        offset = session.planarize(points, faces, offsets=offsets, hold="free")
        assert offset.planarity.max() < 1e-9 and measure(offset) < 0.5 * measure(free), (measure(offset), measure(free))

    def bends(mesh):
        """Changes of the second differences along the rows."""
        moved = (mesh.vertices - points).reshape(9, 9, 3)
        return sum(np.sum(np.diff(moved, n=2, axis=axis) ** 2) for axis in range(2))

    assert bends(session.planarize(points, faces, hold="free", fairness=50)) < 0.8 * bends(free)
    near = session.planarize(points, faces, hold="free", fairness=0, anchor=1)
    drift = [np.linalg.norm(m.vertices - points, axis=1).mean() for m in (near, free)]
    assert near.planarity.max() < 1e-9 and drift[0] < 0.9 * drift[1], drift
    # Corners stay corners, and the rest of the border stays on it.
    corners = [0, 8, 72, 80]
    assert np.linalg.norm(mesh.vertices[corners] - points[corners], axis=1).max() < 0.05
    assert mesh.measures["border_deviation_widths"] < 1e-2 and mesh.measures["deviation_over_limit"] <= 1
    triangle = [[0, 1, 10]]
    raises(s.ArgumentError, session.planarize, points, faces, pins=[81])
    raises(s.ArgumentError, session.planarize, points, triangle, hold="tight")
    raises(s.ArgumentError, session.planarize, points, [[0.5, 1, 2]])
    raises(s.ArgumentError, session.planarize, points, faces, planarity=-1.0)
    raises(s.GeometryError, session.planarize, points, [[0, 1, 99]])
    raises(s.GeometryError, session.planarize, points, [[0, 1, 1]])
    raises(s.ArgumentError, session.planarize, points * np.nan, faces)
    raises(s.NotReached, session.planarize, points, faces, pins=range(81), strict=True)


def arguments(session):
    field = session.field(session.surface(drawn(SQUARE)))
    raises(s.ArgumentError, session.mesh, field, faces=0)
    raises(s.ArgumentError, session.mesh, field, faces=-1)
    raises(s.ArgumentError, session.mesh, field, edge_length=float("nan"))
    raises(s.ArgumentError, session.mesh, field, edge_length=1e-9)
    raises(s.ArgumentError, session.mesh, field, border="sawtooth")
    raises(s.ArgumentError, session.mesh, field, planarity=0.0)
    raises(s.ArgumentError, session.field, session.surface(drawn(SQUARE)), resolution=3)
    raises(s.ArgumentError, s.Session, backend="abacus")
    raises(s.Unavailable, s.Session, backend="ort", runtime_path="/nonexistent")
    raises(s.Unavailable, s.Session, models_folder="/nonexistent")


def progress_and_cancel(session):
    seen = []
    session.set_progress(lambda stage, fraction: seen.append((stage, fraction, threading.get_ident())))
    session.surface(drawn(SQUARE))
    # A short stage may pass between two reports.
    assert {"infer", "refine"} <= {stage for stage, _, _ in seen}, seen
    assert {thread for _, _, thread in seen} == {threading.get_ident()}

    def stop(stage, fraction):
        raise KeyError(stage)

    session.set_progress(stop)
    try:
        session.surface(drawn(SQUARE))
        raise AssertionError("the exception got lost")
    except KeyError:
        pass
    session.set_progress(None)
    thread = threading.Thread(target=session.cancel)
    thread.start()
    thread.join()
    raises(s.Cancelled, session.surface, drawn(SQUARE))
    session.surface(drawn(SQUARE))


def pen_moves_leave_no_memory(session, moves=30, rounds=6):
    """A surface for every move of the pen, some of them cancelled: the process stays as large as it was."""

    def resident():
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize()

    def move(k):
        points = SQUARE.copy()
        points[6] += (15 * np.sin(0.3 * k), 10 * np.cos(0.2 * k))
        if k % 5 == 4:
            session.cancel()
            raises(s.Cancelled, session.surface, drawn(points))
        else:
            session.surface(drawn(points))

    def grown(k):
        before = resident()
        for move_number in range(k * moves, (k + 1) * moves):
            move(move_number)
        return resident() - before

    # The allocator takes a page now and then, most in the first rounds; a leak is there in every one. A leaked surface
    # would be 60 kB a move, its maps half a megabyte.
    grown(0)
    growth = []
    for k in range(1, rounds):
        growth.append(grown(k))
        if growth[-1] < moves * 15_000:
            return
    raise AssertionError(f"every {moves} moves leave {growth} bytes")


def main():
    mirrors_the_header()
    session = s.Session(backend="embedded")
    assert "rten" in session.backend
    tests = (
        broken_sketches, svg_means_the_same, moves_and_scales_exactly, own_surface, own_panels, arguments, progress_and_cancel, pen_moves_leave_no_memory,
    )
    for test in tests:
        test(session)
    the_pipeline(session, sys.argv[1])
    a_live_session_begins_with_the_last_surface(sys.argv[1])
    pen_moves_leave_no_memory(s.Session(backend="embedded", threads=1, live=True))
    print("host.py: all checks passed")


if __name__ == "__main__":
    main()
