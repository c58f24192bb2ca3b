"""Surfaces go to Rhino and come back the same: openNURBS, through rhino3dm, is the judge of its own conventions.

usage: rhino.py SKETCH.json
"""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bindings" / "python"))

import numpy as np  # noqa: E402
import rhino3dm as rhino  # noqa: E402

import sketch2pq as s  # noqa: E402


def to_rhino(patch):
    """The patch as openNURBS keeps it: knots without the first and last, homogeneous control points."""
    net, weights = patch.control_points, patch.weights
    count_u, count_v, _ = net.shape
    surface = rhino.NurbsSurface.Create(
        3, weights is not None, patch.degrees[0] + 1, patch.degrees[1] + 1, count_u, count_v
    )
    assert not surface.IsValid, "knots are not set yet"
    for knots, values in zip((surface.KnotsU, surface.KnotsV), patch.rhino_knots):
        assert len(knots) == len(values)
        for i, value in enumerate(values):
            knots[i] = value
    for i in range(count_u):
        for j in range(count_v):
            weight = 1.0 if weights is None else weights[i, j]
            x, y, z = net[i, j] * weight
            surface.Points[i, j] = rhino.Point4d(x, y, z, weight)
    return surface


def from_rhino(surface):
    """A surface of the library, made of what a host reads out of openNURBS."""
    points = surface.Points
    homogeneous = np.array(
        [[[p.X, p.Y, p.Z, p.W] for p in (points[i, j] for j in range(points.CountV))] for i in range(points.CountU)]
    )
    weights = homogeneous[..., 3]
    net = homogeneous[..., :3] / weights[..., None]
    degrees = surface.OrderU - 1, surface.OrderV - 1
    knots = [[k[i] for i in range(len(k))] for k in (surface.KnotsU, surface.KnotsV)]
    return s.Surface.from_nurbs(degrees, knots, net, weights if surface.IsRational else None).patches[0]


def evaluates_alike(patch, surface):
    """Points and normals agree to 1e-9 of the patch's size, everywhere, the rim included."""
    domains = surface.Domain(0), surface.Domain(1)
    shares = np.linspace(0, 1, 23)
    places = [
        (domains[0].T0 + a * (domains[0].T1 - domains[0].T0), domains[1].T0 + b * (domains[1].T1 - domains[1].T0))
        for a in shares
        for b in shares
    ]
    points, normals = patch.evaluate(places)
    size = np.ptp(patch.control_points.reshape(-1, 3), axis=0).max()
    for (u, v), point, normal in zip(places, points, normals):
        there, towards = surface.PointAt(u, v), surface.NormalAt(u, v)
        assert np.abs(point - (there.X, there.Y, there.Z)).max() <= 1e-9 * size, (u, v)
        assert np.abs(normal - (towards.X, towards.Y, towards.Z)).max() <= 1e-7, (u, v)


def there_and_back(patch, folder):
    surface = to_rhino(patch)
    assert surface.IsValid, surface.IsValidWithLog()
    evaluates_alike(patch, surface)
    model = rhino.File3dm()
    model.Objects.AddSurface(surface)
    path = str(Path(folder) / "surface.3dm")
    assert model.Write(path, 8)
    (kept,) = rhino.File3dm.Read(path).Objects
    # A file keeps a lone surface as a face of a brep.
    geometry = kept.Geometry
    read = geometry.Faces[0].UnderlyingSurface().ToNurbsSurface() if hasattr(geometry, "Faces") else geometry
    assert read.IsValid
    evaluates_alike(patch, read)
    again = from_rhino(read)
    assert again.degrees == patch.degrees
    for mine, theirs in zip(patch.knots, again.knots):
        assert (mine == theirs).all(), "the outer knots are added back as they were"
    assert np.abs(again.control_points - patch.control_points).max() <= 1e-12 * np.abs(patch.control_points).max()


def hosts_patches():
    """Patches that no sketch makes: degrees up to 5, rational ones, uneven knots and domains."""
    random = np.random.default_rng(7)
    for degrees, counts, rational in [((1, 1), (2, 2), False), ((2, 5), (6, 7), True), ((5, 3), (9, 30), True)]:
        knots = []
        for degree, count in zip(degrees, counts):
            inner = np.sort(random.uniform(2.0, 5.0, count - degree - 1))
            knots.append(np.concatenate([[1.0] * degree, inner, [7.0] * degree]))
        u, v = np.meshgrid(np.arange(counts[0]), np.arange(counts[1]), indexing="ij")
        net = np.stack([u, v, np.sin(1.3 * u + 0.7 * v)], axis=2).astype(float)
        weights = random.uniform(0.5, 2.0, counts) if rational else None
        yield s.Surface.from_nurbs(degrees, knots, net, weights).patches[0]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for patch in s.Session().surface(s.Sketch.read(sys.argv[1])).patches:
            there_and_back(patch, folder)
        for patch in hosts_patches():
            there_and_back(patch, folder)
    print("surfaces survive openNURBS", rhino.__version__)
