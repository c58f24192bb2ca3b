"""The paper's loss terms, by its names (Sec. 3.2); means over the valid pixels of a batch.

The paper writes `E_v,comp` with t_y = (1, 0, .), which should read (0, 1, .). Our frame is x right, y up, z towards the
viewer, so that a tangent is (1, 0, dz/dx) with z = -depth, and "up" is row - 1.
"""

import torch

from geometry import PIXEL, POSITIONS


def mean(values, mask):
    """Mean of `values` where `mask`; 0 where it is empty."""
    return (values * mask).sum() / mask.sum().clamp_min(1)


def neighbours(side):
    """Masks (B, 64, 64) of pixels whose right and upper neighbour has the same, valid orientation."""
    right = torch.zeros_like(side, dtype=torch.bool)
    right[:, :, :-1] = (side[:, :, :-1] > 0) & (side[:, :, :-1] == side[:, :, 1:])
    up = torch.zeros_like(right)
    up[:, 1:] = (side[:, 1:] > 0) & (side[:, 1:] == side[:, :-1])
    return right, up


def to_right(x):
    return torch.roll(x, -1, -1)


def to_up(x):
    return torch.roll(x, 1, -2)


def certainty(std, side):
    """How much depth samples say of a layer: 1 / (0.3 + their posterior variance), mean over its pixels (B,), 1 on average.

    With it the squared error of depth is about as large for every sketch; without, the few sketches with one sample or none,
    whose free parameters nothing decides, would make most of the gradient.
    """
    valid = (side > 0).float()
    variance = (std[:, 0].square() * valid).sum((1, 2)) / valid.sum((1, 2)).clamp_min(1)
    return 1 / (0.3 + variance) / 1.16


def layer_terms(h, normal, true_h, true_normal, side, slope, weights, trust=1.0):
    """E_dat, E_smo and E_comp of one layer.

    h (B, 64, 64), normal (B, 3, 64, 64) unit, side (B, 64, 64): 0 none, 1 front, 2 back,
    slope (B,): depth that a horizontal plane gains per unit of y; trust (B, 1, 1): weight of the error of depth itself.
    """
    valid = side > 0
    right, up = neighbours(side)
    data = mean((h - true_h).square() * trust, valid) * weights["sigma_d"]
    data = data + mean((normal - true_normal).square().sum(1), valid) * weights["sigma_n"]
    data = data + shape(h, true_h, valid) * weights["sigma_s"]
    smooth = 0.0
    compatible = 0.0
    for mask, shift, axis in ((right, to_right, 0), (up, to_up, 1)):
        step = shift(h) - h
        smooth = smooth + mean(
            weights["tau_d"] * step.square() + weights["tau_n"] * (shift(normal) - normal).square().sum(1), mask
        )
        # z = -(h + slope y + reference)
        gain = -(step / PIXEL + (slope[:, None, None] if axis == 1 else 0.0))
        compatible = compatible + mean((normal[:, axis] + gain * normal[:, 2]).square(), mask)
    return data, smooth, compatible


def shape(h, true_h, valid):
    """E_shape, ours: the part of h - true h that no change of the four free parameters of depth explains, squared.

    A sketch leaves depth' = s depth + a x + b y + t open, and most of E_dat is that freedom; this term keeps its gradient
    on what the strokes decide. The best s, a, b, t of every sample are taken as constants.
    """
    mask = valid.flatten(1).float()
    count = mask.sum(1).clamp_min(1)
    ones = torch.ones_like(POSITIONS[:, :1])
    plane = torch.cat([POSITIONS, ones], 1).expand(len(h), -1, -1)
    truth = true_h.flatten(1)
    guess = h.flatten(1)
    basis = torch.cat([plane, guess.detach()[..., None]], 2) * mask[..., None]
    normal = basis.transpose(1, 2) @ basis + 1e-3 * count[:, None, None] * torch.eye(4)
    # Relative to s = 1, so that the small weight of the diagonal draws towards the guess itself.
    change = torch.linalg.solve(normal, basis.transpose(1, 2) @ ((truth - guess.detach()) * mask)[..., None])
    corrected = guess * (1 + change[:, 3]) + (plane @ change[:, :3])[..., 0]
    return ((corrected - truth).square() * mask).sum() / mask.sum().clamp_min(1)


def contour_pairs(contour_proximity, visible, occluded):
    """Mask of the pixels within four canvas pixels of a contour where both layers exist."""
    near = contour_proximity >= 8 / (8 + 4.0)
    return near & (visible > 0) & (occluded > 0)


def consistency(pairs, first, second):
    """E_cons: |first_i - second_j|^2 over pixel pairs near the contour, j in {i, up, right, up-right}, both ways."""
    total = 0.0
    for shift in (lambda x: x, to_up, to_right, lambda x: to_up(to_right(x))):
        mask = pairs & shift(pairs)
        total = total + mean((first - shift(second)).square().sum(1), mask) + mean((second - shift(first)).square().sum(1), mask)
    return total / 4


def fairness(control):
    """E_surf,fair of the paper: squared polyline Laplacians of both families of control polygons, interior points."""
    inner = control[:, 1:-1, 1:-1]
    u = inner - (control[:, :-2, 1:-1] + control[:, 2:, 1:-1]) / 2
    v = inner - (control[:, 1:-1, :-2] + control[:, 1:-1, 2:]) / 2
    return (u.square().sum(-1) + v.square().sum(-1)).sum((1, 2)).mean()


def polyvector(directions):
    """(Re s, Im s, Re p, Im p) of directions (B, 4, ...): s = u^2 + v^2, p = u^2 v^2."""
    ur, ui, vr, vi = directions.unbind(1)
    u2r, u2i = ur * ur - ui * ui, 2 * ur * ui
    v2r, v2i = vr * vr - vi * vi, 2 * vr * vi
    return torch.stack([u2r + v2r, u2i + v2i, u2r * v2r - u2i * v2i, u2r * v2i + u2i * v2r], 1)
