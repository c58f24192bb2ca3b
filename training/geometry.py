"""Frames, the Gaussian-process base of depth samples, and the augmentations; the contract with `src/sketch/raster.rs` and `sample_base.rs`.

All tensors are float32, NCHW; positions are canonical (x right, y up).
"""

import math

import torch
from torch.nn import functional as F

MAP = 64
HALF_WIDTH = 4.0 * 256 / 232
PIXEL = 2 * HALF_WIDTH / MAP

# Prior of the depth offset h: constant, slope, a smooth bump, and ripples, rougher, which keep two samples on either side of a
# step from tilting all the rest; noise of a depth sample (canonical units).
CONSTANT_SD, SLOPE_SD, BUMP_SD, BUMP_LENGTH, RIPPLE_SD, RIPPLE_LENGTH, NOISE_SD = 1.0, 0.35, 0.8, 2.0, 0.4, 0.6, 0.02


def map_positions():
    """Centres of the map pixels, (64 * 64, 2)."""
    axis = (torch.arange(MAP) + 0.5) * PIXEL - HALF_WIDTH
    return torch.stack([axis[None, :].expand(MAP, MAP), -axis[:, None].expand(MAP, MAP)], -1).reshape(-1, 2)


POSITIONS = map_positions()


def kernel(p, q):
    """Prior covariance of h between points p (..., n, 2) and q (..., m, 2); of ripples, that of Matern with 3/2."""
    # By coordinate: a sum over a last axis of two would take most of the time here.
    square = sum((p[..., :, None, axis] - q[..., None, :, axis]).square() for axis in (0, 1))
    apart = (square * (3 / RIPPLE_LENGTH**2)).sqrt()
    bump = BUMP_SD**2 * torch.exp(square * (-0.5 / BUMP_LENGTH**2))
    ripple = RIPPLE_SD**2 * (1 + apart) * torch.exp(-apart)
    return CONSTANT_SD**2 + SLOPE_SD**2 * p @ q.transpose(-1, -2) + bump + ripple


def sample_base(points, values, given):
    """Posterior mean and standard deviation of h on the map.

    points (B, n, 2), values (B, n), given (B, n) bool: which of the n slots hold a sample. Returns two (B, 1, 64, 64).
    """
    pair = given[:, :, None] & given[:, None, :]
    system = torch.where(pair, kernel(points, points), torch.zeros(()))
    system = system + torch.diag_embed(torch.where(given, torch.full((), NOISE_SD**2), torch.ones(())))
    cross = kernel(points, POSITIONS.expand(len(points), -1, -1)) * given[..., None]
    # With the system L L^T: cross^T (L L^T)^-1 values and cross^T (L L^T)^-1 cross.
    root = torch.linalg.cholesky(system)
    white = torch.linalg.solve_triangular(root, torch.eye(root.shape[1]).expand_as(root), upper=False)
    seen = white @ cross
    base = (white @ (values * given)[..., None]).transpose(1, 2) @ seen
    own = CONSTANT_SD**2 + SLOPE_SD**2 * POSITIONS.square().sum(-1) + BUMP_SD**2 + RIPPLE_SD**2
    variance = own - seen.square().sum(1)
    shape = (len(points), 1, MAP, MAP)
    return base.reshape(shape), variance.clamp_min(0).sqrt().reshape(shape)


def lookup(maps, points):
    """Bilinear values of maps (B, C, 64, 64) at canonical points (B, n, 2): (B, C, n)."""
    grid = torch.stack([points[..., 0], -points[..., 1]], -1) / HALF_WIDTH
    return F.grid_sample(maps, grid[:, None], align_corners=False, padding_mode="border")[:, :, 0]


def mirror(batch):
    """Mirrors the canvas left to right, a true symmetry of the problem."""
    flip = lambda name: batch[name].flip(-1)
    strokes, normal, cdf = flip("strokes"), flip("normal"), flip("cdf")
    strokes[:, 9] = -strokes[:, 9]
    normal[:, :, 0] = -normal[:, :, 0]
    cdf[:, :, 0::2] = -cdf[:, :, 0::2]
    control = batch["control"].flip(1) * torch.tensor([-1.0, 1.0, 1.0])
    return {
        "strokes": strokes, "valid": flip("valid"), "depth": flip("depth"), "normal": normal, "cdf": cdf, "control": control,
        "slope": batch["slope"],
    }


def shear(batch, generator):
    """Applies a random change of depth that leaves strokes, visibility and conjugacy alone: h' = s h + a x + b y.

    The four free parameters of depth that a sketch leaves open (the constant is the reference). Offsets here are of h, and
    depth = h + slope y + reference.
    """
    count = len(batch["depth"])
    draw = lambda low, high: torch.rand(count, generator=generator) * (high - low) + low
    s, a, b = draw(0.75, 1.3), draw(-0.25, 0.25), draw(-0.25, 0.25)
    view = lambda t, dims: t.reshape(-1, *[1] * dims)
    x, y = POSITIONS[:, 0].reshape(MAP, MAP), POSITIONS[:, 1].reshape(MAP, MAP)
    valid = (batch["valid"] > 0).float()
    depth = (view(s, 3) * batch["depth"] + view(a, 3) * x + view(b, 3) * y) * valid
    control = batch["control"].clone()
    control[..., 2] = view(s, 2) * control[..., 2] + view(a, 2) * control[..., 0] + view(b, 2) * control[..., 1]
    # z = -(h + c y): z' = s z - a x - (b + c - s c) y. The map of points is M = [[1,0,0],[0,1,0],[-a,-(b+c-sc),s]], so
    # normals go with M^-T, up to length: n' = (s n_x + a n_z, s n_y + (b + c - s c) n_z, n_z).
    c = view(batch["slope"], 3)
    n = batch["normal"]
    z = n[:, :, 2]
    normal = torch.stack(
        [view(s, 3) * n[:, :, 0] + view(a, 3) * z, view(s, 3) * n[:, :, 1] + (view(b, 3) + c - view(s, 3) * c) * z, z], 2
    )
    return {**batch, "depth": depth, "control": control, "normal": F.normalize(normal, dim=2) * valid[:, :, None]}


def greville(count=30, degree=3):
    """Greville abscissae of the clamped uniform knot vector."""
    spans = count - degree
    knots = [min(max(i - degree, 0), spans) / spans for i in range(count + degree + 1)]
    return torch.tensor([sum(knots[i + 1 : i + degree + 1]) / degree for i in range(count)])


def coons(border):
    """Bilinearly blended Coons net of the border rows and columns of a control net (B, 30, 30, 3)."""
    t = greville()
    u, v = t[None, :, None, None], t[None, None, :, None]
    rows = (1 - u) * border[:, :1] + u * border[:, -1:]
    columns = (1 - v) * border[:, :, :1] + v * border[:, :, -1:]
    corner = lambda i, j: border[:, i, j][:, None, None]
    corners = (1 - u) * (1 - v) * corner(0, 0) + (1 - u) * v * corner(0, -1) + u * (1 - v) * corner(-1, 0) + u * v * corner(-1, -1)
    return rows + columns - corners


def basis_matrix(samples, count=30, degree=3):
    """(samples, count) values of the clamped uniform B-spline basis at evenly spaced parameters."""
    spans = count - degree
    knots = [min(max(i - degree, 0), spans) / spans for i in range(count + degree + 1)]
    result = torch.zeros(samples, count, dtype=torch.float64)
    for k in range(samples):
        t = k / (samples - 1)
        span = min(int(math.floor(t * spans)), spans - 1) + degree
        value = [0.0] * (count + degree + 1)
        value[span] = 1.0
        for d in range(1, degree + 1):
            following = list(value)
            for i in range(span - d, span + 1):
                left = (t - knots[i]) / (knots[i + d] - knots[i]) * value[i] if knots[i + d] > knots[i] else 0.0
                width = knots[i + d + 1] - knots[i + 1]
                right = (knots[i + d + 1] - t) / width * value[i + 1] if width > 0 else 0.0
                following[i] = left + right
            value = following
        result[k] = torch.tensor(value[:count], dtype=torch.float64)
    return result.float()
