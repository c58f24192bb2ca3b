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


def optimizers(model, rate, weight_decay):
    """Muon for the inner convolutions of a U-Net, AdamW for its stem, head and biases."""
    inner = [p for name, p in model.named_parameters() if p.ndim == 4 and not name.startswith(("stem", "head"))]
    chosen = {id(p) for p in inner}
    others = [p for p in model.parameters() if id(p) not in chosen]
    return [Muon(inner, rate, weight_decay=weight_decay), torch.optim.AdamW(others, rate, weight_decay=weight_decay, fused=True)]
