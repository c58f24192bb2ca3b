"""Muon for convolutions: momentum whose matrix is made orthogonal before the step (Jordan et al., 2024); AdamW for the rest.

Here a convolution is the matrix (outputs, k * k * inputs). The step has the root mean square of AdamW's, so that one learning rate
serves both.
"""

import torch
from torch import distributed

import precision


def polynomial(gram):
    """The factor of one quintic Newton-Schulz step of a matrix with this Gram matrix, less 3.4445 times the identity."""
    return torch.addmm(gram, gram, gram, beta=-4.7750, alpha=2.0315)


def orthogonal(matrix):
    """Nearly the nearest matrix with orthonormal rows or columns, by five Newton-Schulz steps."""
    wide = matrix.shape[0] <= matrix.shape[1]
    x = (matrix if wide else matrix.T).to(precision.fast(matrix.device.type))
    x = x / (x.norm() + 1e-7)
    x = by_matrix(x) if x.dtype == torch.bfloat16 else by_gram(x)
    return (x if wide else x.T).float()


def by_matrix(x):
    """Five steps on the matrix itself, which keeps small singular values in bf16."""
    for _ in range(5):
        x = torch.addmm(x, polynomial(x @ x.T), x, beta=3.4445)
    return x


def by_gram(x):
    """The same in fp32: all factors commute, and on the Gram matrix take a third of the products where kernels are nine times as wide."""
    gram, total = x @ x.T, torch.eye(len(x), device=x.device)
    for _ in range(5):
        step = polynomial(gram)
        step.diagonal().add_(3.4445)
        total = step @ total
        gram = step @ gram @ step
    return total @ x


def matrix_of(weight):
    """The matrix (outputs, k * k * inputs) of a convolution: a view of weights that are stored channels last."""
    return weight.permute(0, 2, 3, 1).flatten(1)


class Muon(torch.optim.Optimizer):
    """Weights of convolutions only. Processes that train together share the work, each its part of the matrices."""

    def __init__(self, parameters, lr, momentum=0.95, weight_decay=0.01):
        super().__init__(parameters, {"lr": lr, "momentum": momentum, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self):
        weights = [(group, weight) for group in self.param_groups for weight in group["params"]]
        ahead = []
        for group, weight in weights:
            momentum = self.state[weight].setdefault("momentum", torch.zeros_like(weight))
            momentum.lerp_(weight.grad, 1 - group["momentum"])
            ahead.append(matrix_of(weight.grad.lerp(momentum, group["momentum"])))
        for (group, weight), step in zip(weights, shared_orthogonal(ahead)):
            weight.mul_(1 - group["lr"] * group["weight_decay"])
            outputs, inputs, height, width = weight.shape
            kernels = step.view(outputs, height, width, inputs).permute(0, 3, 1, 2)
            weight.add_(kernels, alpha=-0.2 * group["lr"] * max(step.shape) ** 0.5)


def shared_orthogonal(matrices):
    """`orthogonal` of all matrices, of which each process computes a part."""
    count = distributed.get_world_size() if distributed.is_initialized() else 1
    if count == 1:
        return [orthogonal(matrix) for matrix in matrices]
    # The largest first, each to the process with the least work so far.
    sizes = [matrix.numel() for matrix in matrices]
    work = lambda k: sizes[k] * min(matrices[k].shape)
    loads, parts = [0] * count, [[] for _ in range(count)]
    for k in sorted(range(len(matrices)), key=work, reverse=True):
        least = loads.index(min(loads))
        loads[least] += work(k)
        parts[least].append(k)
    mine = parts[distributed.get_rank()]
    # Before any waits for another.
    computed = [orthogonal(matrices[k]).flatten() for k in mine]
    result = [None] * len(matrices)
    for owner, part in enumerate(parts):
        if not part:
            continue
        if part is mine:
            together = torch.cat(computed)
        else:
            together = torch.empty(sum(sizes[k] for k in part), device=matrices[0].device)
        distributed.broadcast(together, owner)
        for k, values in zip(part, together.split([sizes[k] for k in part])):
            result[k] = values.reshape(matrices[k].shape)
    return result


def optimizers(model, rate, weight_decay, shares):
    """Muon for the inner convolutions of U-Nets, AdamW for stems, heads, positions, sharpness and biases.

    `shares` has the share of `rate` for the parameters of a part of the model, by the beginning of their names; 1 elsewhere.
    """
    muon, adam = {}, {}
    for name, parameter in model.named_parameters():
        share = next((value for start, value in shares.items() if name.startswith(start)), 1.0)
        inner = parameter.ndim == 4 and not {"stem", "head", "position", "sharpness"} & set(name.split("."))
        (muon if inner else adam).setdefault(share, []).append(parameter)
    groups = lambda parts: [{"params": parameters, "share": share, "lr": rate * share} for share, parameters in parts.items()]
    return [Muon(groups(muon), rate, weight_decay=weight_decay), torch.optim.AdamW(groups(adam), rate, weight_decay=weight_decay, fused=True)]
