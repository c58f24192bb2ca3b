"""Muon for convolutions: momentum whose matrix is made orthogonal before the step (Jordan et al., 2024); AdamW for the rest.

Here a convolution is the matrix (outputs, inputs * k * k). The step has the root mean square of AdamW's, so that one learning rate
serves both.
"""

import torch


def orthogonal(matrix):
    """Nearly the nearest matrix with orthonormal rows or columns, by five quintic Newton-Schulz steps."""
    wide = matrix.shape[0] <= matrix.shape[1]
    x = (matrix if wide else matrix.T).bfloat16()
    x = x / (x.norm() + 1e-7)
    for _ in range(5):
        gram = x @ x.T
        x = 3.4445 * x + (-4.7750 * gram + 2.0315 * gram @ gram) @ x
    return (x if wide else x.T).float()


class Muon(torch.optim.Optimizer):
    """Parameters of two and more dimensions only."""

    def __init__(self, parameters, lr, momentum=0.95, weight_decay=0.01):
        super().__init__(parameters, {"lr": lr, "momentum": momentum, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self):
        for group in self.param_groups:
            for weight in group["params"]:
                state = self.state[weight]
                momentum = state.setdefault("momentum", torch.zeros_like(weight))
                momentum.lerp_(weight.grad, 1 - group["momentum"])
                ahead = weight.grad.lerp(momentum, group["momentum"])
                step = orthogonal(ahead.flatten(1))
                weight.mul_(1 - group["lr"] * group["weight_decay"])
                weight.add_(step.reshape(weight.shape), alpha=-0.2 * group["lr"] * max(step.shape) ** 0.5)


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
