"""Writes tests/golden/contract/training.json: what training feeds the networks, for the Rust tests to compare with.

Inputs are closed formulas, so that both sides can make them: see the fields of the file and `src/infer`.
"""

import json
import pathlib

import torch

import geometry
import tasks

TARGET = pathlib.Path(__file__).parent.parent / "tests" / "golden" / "contract" / "training.json"


def sample_base_cases():
    cases = []
    for points in ([], [(1.0, -2.0, 0.4)], [(-2.5, 1.0, -0.3), (0.5, 0.25, 0.6), (3.0, -3.0, 0.1)]):
        slots = torch.zeros(1, 6, 2)
        values, given = torch.zeros(1, 6), torch.zeros(1, 6, dtype=torch.bool)
        for i, (x, y, h) in enumerate(points):
            slots[0, i] = torch.tensor([x, y])
            values[0, i], given[0, i] = h, True
        base, std = geometry.sample_base(slots, values, given)
        at = [(3, 5), (31, 32), (50, 10), (63, 63)]
        cases.append(
            {
                "samples": points, "pixels": at,
                "base": [base[0, 0, r, c].item() for r, c in at], "std": [std[0, 0, r, c].item() for r, c in at],
            }
        )
    return cases


def bsr_case():
    """Control net x = 3 (2s - 1) + 0.4 sin(5t), y = 2.5 (2t - 1) + 0.3 cos(4s), h = 0.8 s t + 0.2 sin(6s); s, t = i/29, j/29;
    map channel c at (row, column) = sin(0.3 c + 0.11 row + 0.07 column)."""
    s = (torch.arange(30) / 29)[:, None].expand(30, 30)
    t = s.T
    net = torch.stack(
        [3 * (2 * s - 1) + 0.4 * torch.sin(5 * t), 2.5 * (2 * t - 1) + 0.3 * torch.cos(4 * s), 0.8 * s * t + 0.2 * torch.sin(6 * s)],
        -1,
    )[None]
    c, row, column = torch.meshgrid(torch.arange(13), torch.arange(64), torch.arange(64), indexing="ij")
    maps = torch.sin(0.3 * c + 0.11 * row + 0.07 * column)[None]
    coons = geometry.coons(net)
    inputs = tasks.BsrNet.assemble(coons, maps)[0]
    places = [(channel, (7 * channel + 3) % 30, (11 * channel + 5) % 30) for channel in range(17)]
    places += [(0, 0, 0), (1, 29, 0), (2, 15, 15), (16, 0, 4), (16, 4, 4)]
    return {"places": places, "values": [inputs[p].item() for p in places]}


def depth_case():
    """Inputs of VD-Net and OD-Net: stroke channel c at (row, column) = sin(0.3 c + 0.11 row + 0.07 column); visible h and normal
    likewise with c = 20 to 23; two visible samples and one occluded; slope 1.7."""
    wave = lambda channels: torch.sin(
        0.3 * torch.tensor(channels, dtype=torch.float32)[:, None, None]
        + 0.11 * torch.arange(64)[None, :, None] + 0.07 * torch.arange(64)[None, None, :]
    )[None]
    points = [(1.0, -2.0, 0.4), (-2.5, 1.0, -0.3), (0.5, 0.25, 0.6)]
    slots, values = torch.zeros(1, 6, 2), torch.zeros(1, 6)
    for i, (x, y, h) in enumerate(points):
        slots[0, i], values[0, i] = torch.tensor([x, y]), h
    slot = torch.arange(6)[None]
    samples = (slots, values, slot < 2, slot == 2)
    batch = {"strokes": wave(list(range(10))), "slope": torch.tensor([1.7])}
    _, _, vd = tasks.VdNet.assemble(batch, samples)
    _, _, od = tasks.OdNet.assemble(batch, samples, wave([20])[:, 0], wave([21, 22, 23]))
    case = {"samples": points}
    for name, inputs in (("vd", vd[0]), ("od", od[0])):
        places = [(channel, (7 * channel + 3) % 64, (11 * channel + 5) % 64) for channel in range(len(inputs))]
        case[name] = {"places": places, "values": [inputs[p].item() for p in places]}
    return case


def polyvector_case():
    coefficients = torch.tensor([[0.3, 1.2, -0.5, 0.4], [2.0, 0.0, 1.0, 0.0], [-0.1, 0.2, 0.9, -0.3]])
    return {"coefficients": coefficients.tolist(), "angles_deg": tasks.angles(coefficients).tolist()}


if __name__ == "__main__":
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    content = {"sample_base": sample_base_cases(), "bsr_input": bsr_case(), "depth_inputs": depth_case(), "polyvector": polyvector_case()}
    TARGET.write_text(json.dumps(content, indent=1) + "\n")
