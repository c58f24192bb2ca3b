"""What each network sees, answers and is scored by."""

import math

import torch
from torch import nn
from torch.nn import functional as F

import geometry
import losses
import nets
import precision
from geometry import MAP, POSITIONS

SLOTS = 6
# Depth samples of a sketch: any number is scored alike; three and more, which say the most of depth, are trained on twice as often.
SCORED, TRAINED = torch.arange(SLOTS + 1), torch.tensor([0, 1, 2, 3, 3, 4, 4, 5, 5, 6, 6])


def draw_depth_samples(batch, generator, counts):
    """Random depth samples on either layer: points (B, 6, 2), values, and the mask of each layer's samples.

    `counts` are equally likely numbers of samples.
    """
    valid = (batch["valid"] > 0).flatten(1).float()
    count = len(valid)
    slots = torch.multinomial(valid, SLOTS, replacement=True, generator=generator)
    given = torch.arange(SLOTS)[None] < counts[torch.randint(len(counts), (count, 1), generator=generator)]
    points = POSITIONS[slots % (MAP * MAP)]
    values = batch["depth"].flatten(1).gather(1, slots)
    occluded = slots >= MAP * MAP
    return points, values, given & ~occluded, given & occluded


def with_reference(batch, generator, training):
    """Draws depth samples and moves h so that the reference is 0, as inference does. Returns the batch and the samples.

    The reference is the mean of the visible samples; without any, the mean over the visible pixels.
    """
    points, values, on_visible, on_occluded = draw_depth_samples(batch, generator, TRAINED if training else SCORED)
    average = lambda mask: (values * mask).sum(1) / mask.sum(1).clamp_min(1)
    valid = (batch["valid"] > 0).float()
    level = (batch["depth"][:, 0] * valid[:, 0]).sum((1, 2)) / valid[:, 0].sum((1, 2)).clamp_min(1)
    reference = torch.where(on_visible.any(1), average(on_visible), level)
    depth = (batch["depth"] - reference[:, None, None, None]) * valid
    control = batch["control"] - torch.stack([torch.zeros_like(reference)] * 2 + [reference], -1)[:, None, None]
    samples = (points, values - reference[:, None], on_visible, on_occluded)
    return {**batch, "depth": depth, "control": control}, samples


def view(batch):
    """The channel that tells the view: its slope less that of 45 degrees, constant over the map (B, 1, 64, 64)."""
    return (batch["slope"] - 1)[:, None, None, None].expand(-1, 1, MAP, MAP)


def split_sides(output, side):
    """g and unit normal of the side (front or back) that each pixel shows."""
    front = (side != 2)[:, None]
    g = torch.where(front[:, 0], output[:, 0], output[:, 1])
    normal = torch.where(front, output[:, 2:5], output[:, 5:8])
    # F.normalize takes half of a loss's time over channels.
    return g, normal / normal.square().sum(1, keepdim=True).clamp_min(1e-6).sqrt()


def answer(network, inputs, fast):
    """What a network answers, on the CPU, where the data and the losses are; `fast` computes in `precision.fast`."""
    device = next(network.parameters()).device
    lower = fast and precision.fast(device.type) == torch.bfloat16
    with torch.autocast(device.type, torch.bfloat16, enabled=lower):
        return network(inputs.to(device, memory_format=torch.channels_last)).float().cpu()


def predict(network, inputs, fast=False):
    """`answer` without gradients."""
    with torch.no_grad():
        return answer(network, inputs, fast)


class Task:
    """A network by `name`, the networks that it builds on, and whether it sees sketches with an occluded layer only."""

    needs = ()
    occluded_only = False

    def network(self):
        return nets.make(self.name)

    def answer(self, network, prepared, fast):
        return answer(network, prepared["input"], fast)


class VdNet(Task):
    name = "vd_net"

    def prepare(self, batch, generator, helpers, training=True):
        batch, samples = with_reference(batch, generator, training)
        base, std, inputs = self.assemble(batch, samples)
        return {**batch, "samples": samples, "base": base, "std": std, "input": inputs}

    @staticmethod
    def assemble(batch, samples):
        """Base and deviation of the visible layer, and the input (B, 15, 64, 64)."""
        points, values, on_visible, on_occluded = samples
        base, std = geometry.sample_base(points, values, on_visible)
        # Samples behind tell of the free parameters too, which both layers share. Alone they come too seldom to learn from;
        # inference then lets OD-Net find the level.
        behind = geometry.sample_base(points, values, on_occluded & on_visible.any(1, keepdim=True))
        return base, std, torch.cat([batch["strokes"], base, std, *behind, view(batch)], 1)

    def decode(self, output, prepared):
        side = prepared["valid"][:, 0]
        g, normal = split_sides(output, side)
        h = prepared["base"][:, 0] + prepared["std"][:, 0] * g
        seen = (side > 0).float()
        return h * seen, normal * seen[:, None]

    def loss(self, output, prepared, weights):
        side = prepared["valid"][:, 0]
        h, normal = self.decode(output, prepared)
        trust = losses.certainty(prepared["std"], side)[:, None, None]
        data, smooth, compatible = losses.layer_terms(
            h, normal, prepared["depth"][:, 0], prepared["normal"][:, 0], side, prepared["slope"], weights, trust
        )
        points, values, given, _ = prepared["samples"]
        depth = losses.mean((geometry.lookup(h[:, None], points)[:, 0] - values).square(), given)
        total = data + weights["w_smo"] * smooth + weights["w_comp"] * compatible + weights["w_dep"] * depth
        return total, {"dat": data, "smo": smooth, "comp": compatible, "dep": depth}

    def scores(self, output, prepared):
        h, normal = self.decode(output, prepared)
        return layer_scores(h, normal, prepared["depth"][:, 0], prepared["normal"][:, 0], prepared["valid"][:, 0] > 0, prepared)

    def headline(self, scores):
        return scores["d"] / max(scores["d_plane"], 1e-9)


class OdNet(Task):
    name = "od_net"
    needs = ("vd_net",)
    occluded_only = True

    def prepare(self, batch, generator, helpers, training=True):
        vd = VdNet().prepare(batch, generator, helpers, training)
        h, normal = VdNet().decode(predict(helpers["vd_net"], vd["input"], fast=training), vd)
        base, std, inputs = self.assemble(vd, vd["samples"], h, normal)
        return {**vd, "visible_h": h, "visible_normal": normal, "base": base, "std": std, "input": inputs}

    @staticmethod
    def assemble(batch, samples, h, normal):
        """Base and deviation of the distance between the layers, and the input (B, 17, 64, 64)."""
        points, values, _, on_occluded = samples
        difference = values - geometry.lookup(h[:, None], points)[:, 0]
        base, std = geometry.sample_base(points, difference, on_occluded)
        return base, std, torch.cat([batch["strokes"], base, std, h[:, None], normal, view(batch)], 1)

    def decode(self, output, prepared):
        side = prepared["valid"][:, 1]
        g, normal = split_sides(output, side)
        h = prepared["visible_h"] + prepared["base"][:, 0] + prepared["std"][:, 0] * g
        seen = (side > 0).float()
        return h * seen, normal * seen[:, None]

    def loss(self, output, prepared, weights):
        side = prepared["valid"][:, 1]
        h, normal = self.decode(output, prepared)
        data, smooth, compatible = losses.layer_terms(
            h, normal, prepared["depth"][:, 1], prepared["normal"][:, 1], side, prepared["slope"], weights
        )
        points, values, _, given = prepared["samples"]
        depth = losses.mean((geometry.lookup(h[:, None], points)[:, 0] - values).square(), given)
        pairs = losses.contour_pairs(prepared["strokes"][:, 2], prepared["valid"][:, 0], side)
        both = lambda h, n: torch.cat([h[:, None] * weights["gamma_d"] ** 0.5, n * weights["gamma_n"] ** 0.5], 1)
        consistent = losses.consistency(pairs, both(prepared["visible_h"], prepared["visible_normal"]), both(h, normal))
        total = data + weights["w_smo"] * smooth + weights["w_comp"] * compatible
        total = total + weights["w_dep"] * depth + weights["w_cons"] * consistent
        return total, {"dat": data, "smo": smooth, "comp": compatible, "dep": depth, "cons": consistent}

    def scores(self, output, prepared):
        h, normal = self.decode(output, prepared)
        return layer_scores(h, normal, prepared["depth"][:, 1], prepared["normal"][:, 1], prepared["valid"][:, 1] > 0, prepared)

    headline = VdNet.headline


def layer_scores(h, normal, true_h, true_normal, valid, prepared):
    """Per-sample errors of one layer: D, with the four free parameters removed, of the best plane, and angles."""
    results = {"d": [], "d_shear": [], "d_plane": [], "normal_deg": [], "samples": []}
    count = prepared["samples"][2].sum(1) + prepared["samples"][3].sum(1)
    for i in range(len(h)):
        mask = valid[i].flatten()
        if mask.sum() < 12:
            continue
        truth, guess = true_h[i].flatten()[mask].double(), h[i].flatten()[mask].double()
        plane = torch.cat([POSITIONS[mask], torch.ones(int(mask.sum()), 1)], 1).double()
        fit = lambda basis: (truth - basis @ torch.linalg.lstsq(basis, truth[:, None]).solution[:, 0]).square().mean().item()
        results["d"].append((truth - guess).square().mean().item())
        results["d_plane"].append(fit(plane))
        results["d_shear"].append(fit(torch.cat([plane, guess[:, None]], 1)))
        cosine = (normal[i] * true_normal[i]).sum(0).flatten()[mask].clamp(-1, 1)
        results["normal_deg"].append(math.degrees(torch.arccos(cosine).mean().item()))
        results["samples"].append(int(count[i]))
    return results


class BsrNet(Task):
    name = "bsr_net"
    needs = ("vd_net", "od_net")
    basis = geometry.basis_matrix(100)

    def prepare(self, batch, generator, helpers, training=True):
        batch = geometry.shear(batch, generator) if training else batch
        od = OdNet().prepare(batch, generator, helpers, training)
        hidden = OdNet().decode(predict(helpers["od_net"], od["input"], fast=training), od)
        valid = od["valid"]
        seen = (valid > 0).float()
        # What the depth networks get wrong, the surface follows: its task is the net of what they see, not another guess.
        error = (torch.stack([od["visible_h"], hidden[0]], 1) - od["depth"]) * seen
        normal = torch.stack([od["visible_normal"], hidden[1]], 1)
        if training:
            # A quarter of the samples have a smooth random error and true normals instead, so that the network stays right
            # when those networks get better.
            coarse = torch.randn(len(seen), 1, 5, 5, generator=generator)
            level = 0.15 * torch.rand(len(seen), 1, 1, 1, generator=generator)
            smooth = F.interpolate(coarse, size=(MAP, MAP), mode="bicubic", align_corners=True) * level
            chosen = torch.rand(len(seen), 1, 1, 1, generator=generator) < 0.25
            error = torch.where(chosen, smooth * seen, error)
            normal = torch.where(chosen[..., None], od["normal"], normal)
        control = follow(od["control"], od["depth"], error, seen)
        if training:
            control = dihedral(control, int(torch.randint(0, 4, (1,), generator=generator)))
        net = geometry.coons(control)
        maps = self.maps(valid, od["depth"] + error, normal, od["strokes"])
        return {**od, "control": control, "coons": net, "input": self.assemble(net, maps)}

    @staticmethod
    def maps(valid, depth, normal, strokes):
        """The 13 maps that `assemble` looks up, of both layers' validity, depth (B, 2, 64, 64) and normals (B, 2, 3, 64, 64)."""
        seen = (valid > 0).float()
        return torch.cat(
            [
                seen[:, :1], depth[:, :1], (valid[:, :1] == 1).float(), (valid[:, :1] == 2).float(), normal[:, 0],
                seen[:, 1:], depth[:, 1:], normal[:, 1], strokes[:, 2:3],
            ], 1,
        )

    @staticmethod
    def assemble(net, maps):
        """Input (B, 17, 30, 30) from the Coons net and the 13 maps: coverage, h, front, back, normal; coverage, h, normal; contour."""
        count = net.shape[1]
        at = geometry.lookup(maps, net[..., :2].flatten(1, 2)).unflatten(2, (count, count))
        h = net[..., 2][:, None]
        rim = torch.zeros(count, count)
        rim[0], rim[-1], rim[:, 0], rim[:, -1] = 1, 1, 1, 1
        rim = rim.expand(len(net), 1, -1, -1)
        return torch.cat(
            [
                net.permute(0, 3, 1, 2), at[:, 0:1], at[:, 1:2] - at[:, 0:1] * h, at[:, 2:4], at[:, 4:7],
                at[:, 7:8], at[:, 8:9] - at[:, 7:8] * h, at[:, 9:12], at[:, 12:13], rim,
            ], 1,
        )

    def points(self, control):
        return torch.einsum("ki,bijc,lj->bklc", self.basis, control, self.basis)

    def loss(self, output, prepared, weights):
        control = prepared["coons"] + output.permute(0, 2, 3, 1)
        data = (self.points(control) - self.points(prepared["control"])).square().sum(-1).mean()
        fair = losses.fairness(control)
        # The paper sums E_fair over the net while E_dat is a mean; the mean keeps w_fair's meaning for any net size.
        fair = fair / (28 * 28)
        return data + weights["w_fair"] * fair, {"dat": data, "fair": fair}

    def scores(self, output, prepared):
        truth = self.points(prepared["control"])
        error = lambda control: (self.points(control) - truth).square().sum(-1).mean((1, 2)).tolist()
        constant = prepared["control"].mean(0, keepdim=True).expand_as(prepared["control"])
        return {
            "d": error(prepared["coons"] + output.permute(0, 2, 3, 1)),
            "d_coons": error(prepared["coons"]),
            "d_constant": error(constant),
        }

    def headline(self, scores):
        return scores["d"] / max(scores["d_coons"], 1e-9)


def spread(maps, seen):
    """Maps (B, C, 64, 64) continued smoothly from where `seen` is 1 over the whole canvas, by averages over growing windows."""
    result, reach = maps * seen, seen
    for width in (3, 5, 9, 17, 33, 65):
        average = lambda x: F.avg_pool2d(x, width, 1, width // 2)
        weight = average(seen)
        fresh = average(maps * seen) / weight.clamp_min(1e-6)
        result = torch.where(reach > 0, result, fresh)
        reach = torch.where(weight > 1e-6, torch.ones_like(reach), reach)
    return result


def follow(control, depth, error, seen):
    """The net (B, 30, 30, 3) moved in depth by the error of the layer that each point lies on, evened out over the net."""
    xy = control[..., :2].flatten(1, 2)
    at = lambda maps: geometry.lookup(maps, xy)
    coverage = at(seen)
    apart = (at(depth * seen) / coverage.clamp_min(1e-3) - control[..., 2].flatten(1)[:, None]).abs()
    apart = torch.where(coverage > 0.3, apart, torch.full((), 1e3))
    own = at(spread(error, seen)).gather(1, apart.argmin(1, keepdim=True))
    own = own.reshape(-1, 1, control.shape[1], control.shape[2])
    # Binomial, five wide: where the layers meet at a contour their errors differ.
    for _ in range(2):
        own = F.avg_pool2d(F.pad(own, (1, 1, 1, 1), mode="replicate"), 3, 1)
    return torch.cat([control[..., :2], control[..., 2:] + own[:, 0, :, :, None]], -1)


def dihedral(control, turns):
    """The same surfaces with the parameter square turned by `turns` quarter turns; keeps S_u x S_v."""
    for _ in range(turns):
        control = control.transpose(1, 2).flip(2)
    return control.contiguous()


class CdfNet(Task):
    name = "cdf_net"
    needs = ("vd_net", "od_net")

    def prepare(self, batch, generator, helpers, training=True):
        batch = geometry.shear(batch, generator) if training else batch
        seen = (batch["valid"] > 0).float()
        # It will see the normals that the depth networks predict. A quarter of the samples have true ones with smooth noise
        # instead, so that it stays right when those networks get better.
        od = OdNet().prepare(batch, generator, helpers, training)
        _, hidden = OdNet().decode(predict(helpers["od_net"], od["input"], fast=training), od)
        normal = torch.stack([od["visible_normal"], hidden], 1)
        if training:
            coarse = torch.randn(len(seen), 6, 7, 7, generator=generator)
            noise = F.interpolate(coarse, size=(MAP, MAP), mode="bilinear", align_corners=True) * 0.08
            exact = F.normalize(batch["normal"] + noise.unflatten(1, (2, 3)), dim=2) * seen[:, :, None]
            chosen = torch.rand(len(seen), generator=generator) < 0.25
            normal = torch.where(chosen[:, None, None, None, None], exact, normal)
        known = batch["cdf"].abs().sum(2) > 0.5
        truth = losses.polyvector(batch["cdf"].permute(0, 2, 1, 3, 4)).permute(0, 2, 1, 3, 4)
        inputs = torch.cat([batch["strokes"], normal[:, 0], normal[:, 1]], 1)
        return {**batch, "known": known, "truth": truth, "input": inputs}

    def loss(self, output, prepared, weights):
        c = output.unflatten(1, (2, 4))
        data, smooth = 0.0, 0.0
        for layer in range(2):
            data = data + losses.mean((c[:, layer] - prepared["truth"][:, layer]).square().sum(1), prepared["known"][:, layer])
            right, up = losses.neighbours(prepared["valid"][:, layer])
            for mask, shift in ((right, losses.to_right), (up, losses.to_up)):
                smooth = smooth + losses.mean((c[:, layer] - shift(c[:, layer])).square().sum(1), mask)
        pairs = losses.contour_pairs(prepared["strokes"][:, 2], prepared["valid"][:, 0], prepared["valid"][:, 1])
        consistent = losses.consistency(pairs, c[:, 0], c[:, 1])
        total = data + weights["w_smo"] * smooth + weights["w_cons"] * consistent
        return total, {"dat": data, "smo": smooth, "cons": consistent}

    def scores(self, output, prepared):
        known = prepared["known"]
        guess = angles(output.unflatten(1, (2, 4)).permute(0, 1, 3, 4, 2)[known])
        truth = angles(prepared["truth"].permute(0, 1, 3, 4, 2)[known])
        grid = torch.arange(0, 180, 7.5)
        best = min(
            pair_error(torch.tensor([a, b]).expand(len(truth), 2), truth).mean().item() for a in grid for b in grid if a < b
        )
        return {"angle_deg": pair_error(guess, truth).tolist(), "constant_deg": [best]}

    def headline(self, scores):
        return scores["angle_deg"] / max(scores["constant_deg"], 1e-9)


def angles(coefficients):
    """Directions (degrees, modulo 180) of the two roots u^2, v^2 of z^2 - s z + p; coefficients (..., 4)."""
    s = torch.complex(coefficients[..., 0], coefficients[..., 1])
    p = torch.complex(coefficients[..., 2], coefficients[..., 3])
    root = torch.sqrt(s * s - 4 * p)
    pair = torch.stack([(s + root) / 2, (s - root) / 2], -1)
    return torch.rad2deg(torch.angle(pair)) / 2


def pair_error(first, second):
    """Mean angle (degrees) between two pairs of lines, better of the two assignments."""
    difference = lambda a, b: 90 - (((a - b) % 180) - 90).abs()
    straight = difference(first[..., 0], second[..., 0]) + difference(first[..., 1], second[..., 1])
    crossed = difference(first[..., 0], second[..., 1]) + difference(first[..., 1], second[..., 0])
    return torch.minimum(straight, crossed) / 2


class JointNetwork(nn.Module):
    """VD-Net, OD-Net on its answer, BSR-Net on both."""

    def __init__(self):
        super().__init__()
        self.vd_net, self.od_net, self.bsr_net = (nets.make(name) for name in Joint.networks)

    def forward(self, prepared, fast):
        """Answers of the three, and what OdNet.prepare and BsrNet.prepare make on the way."""
        vd = answer(self.vd_net, prepared["input"], fast)
        h, normal = VdNet().decode(vd, prepared)
        base, std, inputs = OdNet.assemble(prepared, prepared["samples"], h, normal)
        od_prepared = {**prepared, "visible_h": h, "visible_normal": normal, "base": base, "std": std}
        od = answer(self.od_net, inputs, fast)
        hidden_h, hidden_normal = OdNet().decode(od, od_prepared)
        net = geometry.coons(prepared["control"])
        layers = torch.stack([h, hidden_h], 1), torch.stack([normal, hidden_normal], 1)
        bsr = answer(self.bsr_net, BsrNet.assemble(net, BsrNet.maps(prepared["valid"], *layers, prepared["strokes"])), fast)
        return vd, od, bsr, {**od_prepared, "coons": net}


class Joint(Task):
    """The paper's last stage: the three networks of the surface together, on the sum of their losses (Sec. 3.2.4).

    Unlike BSR-Net alone, which learns the net of what the depth networks see, its target here is the true one.
    """

    name = "joint"
    networks = ("vd_net", "od_net", "bsr_net")

    def network(self):
        return JointNetwork()

    def prepare(self, batch, generator, helpers, training=True):
        return VdNet().prepare(batch, generator, helpers, training)

    def answer(self, network, prepared, fast):
        return network(prepared, fast)

    def loss(self, output, prepared, weights):
        vd, od, bsr, built = output
        total, terms = 0.0, {}
        for task, values, given in ((VdNet(), vd, prepared), (OdNet(), od, built), (BsrNet(), bsr, built)):
            loss, parts = task.loss(values, given, weights[task.name])
            total = total + loss
            terms.update({f"{task.name}.{name}": value for name, value in parts.items()})
        return total, terms

    def scores(self, output, prepared):
        vd, _, bsr, built = output
        surface = BsrNet().scores(bsr, built)
        return {**VdNet().scores(vd, prepared), "d_net": surface["d"], "d_net_coons": surface["d_coons"]}

    def headline(self, scores):
        return scores["d_net"] / max(scores["d_net_coons"], 1e-9)


TASKS = {task.name: task for task in (VdNet(), OdNet(), BsrNet(), CdfNet(), Joint())}
