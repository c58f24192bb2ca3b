"""Trains one network: `python training/train.py vd_net --data work/train --validation work/validation --minutes 60`.

Everything lands in `--out` (default work/runs/NAME): `checkpoint.pt` (resumes by itself), `log.jsonl`, `curves.png`, `run.json`.
The learning rate follows elapsed training time (warm-up, then cosine to zero at `--minutes`), so that a slow machine
still finishes its schedule.
"""

import argparse
import copy
import json
import pathlib
import subprocess
import time

import numpy
import torch

import data
import muon
import nets
import tasks

HERE = pathlib.Path(__file__).parent


def rate_factor(progress):
    warm = min(1.0, progress / 0.02 + 0.01)
    return warm * (0.5 + 0.5 * float(numpy.cos(numpy.pi * min(progress, 1.0)))) + 1e-3


def average(values):
    return float(numpy.mean(values)) if len(values) else float("nan")


def initial_weights(path):
    """The parameters in a weights.pt, or in an exported .onnx file (fp16 precision)."""
    if not str(path).endswith(".onnx"):
        return torch.load(path, weights_only=True)
    import onnx

    tensors = {t.name.removesuffix("_fp16"): onnx.numpy_helper.to_array(t) for t in onnx.load(path).graph.initializer}
    wanted = nets.make(pathlib.Path(path).stem).state_dict()
    return {name: torch.from_numpy(tensors[name].astype("float32")) if name in tensors else value for name, value in wanted.items()}


class Run:
    """A network, its moving average, the optimizer, and where they are stored."""

    def __init__(self, name, out, settings, initial, ema):
        self.task = tasks.TASKS[name]
        self.out = pathlib.Path(out)
        self.out.mkdir(parents=True, exist_ok=True)
        self.settings = settings
        self.decay = ema
        self.model = nets.make(name).to(memory_format=torch.channels_last)
        self.optimizers = muon.optimizers(self.model, settings["rate"], settings["weight_decay"])
        self.samples, self.seconds, self.log = 0, 0.0, []
        if (self.out / "checkpoint.pt").exists():
            stored = torch.load(self.out / "checkpoint.pt", weights_only=False)
            self.model.load_state_dict(stored["model"])
            for optimizer, state in zip(self.optimizers, stored["optimizers"]):
                optimizer.load_state_dict(state)
            self.samples, self.seconds, self.log = stored["samples"], stored["seconds"], stored["log"]
            self.average = copy.deepcopy(self.model)
            self.average.load_state_dict(stored["average"])
        else:
            if initial:
                self.model.load_state_dict(initial_weights(initial))
            self.average = copy.deepcopy(self.model)

    def save(self):
        state = {
            "model": self.model.state_dict(), "average": self.average.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers], "samples": self.samples, "seconds": self.seconds, "log": self.log,
        }
        torch.save(state, self.out / "checkpoint.tmp")
        (self.out / "checkpoint.tmp").replace(self.out / "checkpoint.pt")
        torch.save(self.average.state_dict(), self.out / "weights.pt")

    def step(self, prepared):
        with torch.autocast("cpu", torch.bfloat16):
            output = self.model(prepared["input"].contiguous(memory_format=torch.channels_last))
        loss, terms = self.task.loss(output.float(), prepared, self.settings["loss"])
        if not torch.isfinite(loss):
            raise RuntimeError(f"the loss is {loss.item()} after {self.samples} samples")
        self.model.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        for optimizer in self.optimizers:
            optimizer.step()
        self.samples += len(output)
        # The average forgets the start quickly.
        decay = min(self.decay, (1 + self.samples / len(output)) / (10 + self.samples / len(output)))
        with torch.no_grad():
            for kept, fresh in zip(self.average.parameters(), self.model.parameters()):
                kept.lerp_(fresh, 1 - decay)
        return {"loss": loss.item(), **{name: float(torch.as_tensor(value).detach()) for name, value in terms.items()}}

    def validate(self, batches):
        """Scores of the moving average over prepared batches."""
        merged = {}
        with torch.no_grad():
            for prepared in batches:
                for name, values in self.task.scores(self.average(prepared["input"]).float(), prepared).items():
                    merged.setdefault(name, []).extend(values)
        result = {name: average(values) for name, values in merged.items()}
        result["ratio"] = self.task.headline(result)
        if "samples" in merged:
            for label, low, high in (("0", 0, 0), ("1-2", 1, 2), ("3+", 3, 9)):
                chosen = [i for i, n in enumerate(merged["samples"]) if low <= n <= high]
                for key in ("d", "d_shear", "d_plane"):
                    result[f"{key}[{label}]"] = average([merged[key][i] for i in chosen])
        return result


def curves(run):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    points = [entry for entry in run.log if "validation" in entry]
    if len(points) < 2:
        return
    figure, axes = pyplot.subplots(1, 2, figsize=(11, 4))
    axes[0].plot([e["samples"] for e in run.log if "loss" in e], [e["loss"] for e in run.log if "loss" in e])
    axes[0].set(title=f"{run.task.name}: training loss", xlabel="samples seen", yscale="log")
    for key in points[-1]["validation"]:
        if key.startswith(("d", "angle", "constant")) and "[" not in key:
            axes[1].plot([e["samples"] for e in points], [e["validation"].get(key) for e in points], label=key)
    axes[1].set(title="held-out scores", xlabel="samples seen", yscale="log")
    axes[1].legend()
    figure.tight_layout()
    figure.savefig(run.out / "curves.png")
    pyplot.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=sorted(tasks.TASKS))
    parser.add_argument("--data", required=True, help="folder of shards")
    parser.add_argument("--validation", required=True, help="folder of shards with held-out surfaces")
    parser.add_argument("--minutes", type=float, required=True, help="length of the whole schedule")
    parser.add_argument("--out", help="working folder, default work/runs/NAME")
    parser.add_argument("--initial", help="weights to start from when there is no checkpoint")
    parser.add_argument("--helper", action="append", default=[], help="NAME=weights.pt of a network this one builds on")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--overfit", type=int, default=0, help="train on the first N samples only, as a check")
    arguments = parser.parse_args()

    torch.set_num_threads(arguments.threads)
    torch.manual_seed(1)
    config = json.loads((HERE / "config.json").read_text())
    out = arguments.out or f"work/runs/{arguments.name}"
    run = Run(arguments.name, out, config[arguments.name], arguments.initial, config["ema"])
    helpers = {}
    for entry in arguments.helper:
        name, path = entry.split("=", 1)
        helpers[name] = nets.make(name).to(memory_format=torch.channels_last).eval()
        helpers[name].load_state_dict(torch.load(path, weights_only=True))
    missing = [name for name in run.task.needs if name not in helpers]
    if missing:
        parser.error(f"{arguments.name} needs --helper {missing[0]}=weights.pt")

    train, held_out = data.Shards(arguments.data), data.Shards(arguments.validation)
    fixed = torch.Generator().manual_seed(7)
    chosen = (held_out.occluded if run.task.occluded_only else list(range(len(held_out))))[: config["validation_samples"]]
    validation = [
        run.task.prepare(held_out.batch(chosen[i : i + 50]), fixed, helpers) for i in range(0, len(chosen), 50)
    ]
    generator = torch.Generator().manual_seed(run.samples + 11)
    shuffle = numpy.random.default_rng(run.samples + 13)
    batch_size = run.settings["batch"]
    budget = arguments.minutes * 60
    last_validation, recent = time.monotonic(), []

    def report():
        scores = run.validate(validation)
        entry = {"samples": run.samples, "seconds": round(run.seconds), "validation": scores}
        if recent:
            entry.update({key: average([r[key] for r in recent]) for key in recent[0]})
            recent.clear()
        run.log.append(entry)
        with open(run.out / "log.jsonl", "a") as file:
            file.write(json.dumps(entry) + "\n")
        print(json.dumps(entry), flush=True)
        run.save()
        curves(run)

    order = []
    while run.seconds < budget:
        start = time.monotonic()
        if len(order) < batch_size:
            train.refresh()
            pool = train.occluded if run.task.occluded_only else range(len(train))
            pool = list(pool)[: arguments.overfit] if arguments.overfit else pool
            order = shuffle.permutation(numpy.asarray(pool)).tolist()
            while len(order) < batch_size:
                order = order + order
        batch = train.batch(order[:batch_size])
        order = order[batch_size:]
        if torch.rand(1, generator=generator) < 0.5 and not arguments.overfit:
            batch = tasks.geometry.mirror(batch)
        for optimizer in run.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = run.settings["rate"] * rate_factor(run.seconds / budget)
        prepared = run.task.prepare(batch, generator, helpers)
        recent.append(run.step(prepared))
        run.seconds += time.monotonic() - start
        if time.monotonic() - last_validation > 150:
            report()
            last_validation = time.monotonic()
    report()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True).stdout.strip()
    record = {
        "network": arguments.name, "commit": commit, "config": run.settings, "samples_seen": run.samples,
        "seconds": round(run.seconds), "training_samples": len(train), "scores": run.log[-1]["validation"],
    }
    (run.out / "run.json").write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
