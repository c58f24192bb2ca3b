"""Trains one network: `python training/train.py vd_net --data work/train --validation work/validation --minutes 60`.

Everything lands in `--out` (default work/runs/NAME): `checkpoint.pt` (resumes by itself), `log.jsonl`, `curves.png`, `run.json`.
The learning rate (warm-up, then cosine to zero) follows the time spent, so that a slow machine still finishes its schedule,
or with `--samples` the samples seen; then a run that was stopped and resumed gives the same weights as one that was not.
`--carry FILE` keeps a small file of a long run's state beside it, from which the run goes on where its folder is gone.

On several machines or GPUs: `torchrun --nproc-per-node 2 training/train.py ...`. The batch of the configuration is that of all
processes together; each draws its part of it.
"""

import argparse
import copy
import ctypes
import json
import os
import pathlib
import subprocess
import time

import numpy
import torch
from torch import distributed
from torch.nn.parallel import DistributedDataParallel

import data
import muon
import nets
import tasks
import winograd

HERE = pathlib.Path(__file__).parent


def rate_factor(progress):
    warm = min(1.0, progress / 0.02 + 0.01)
    return warm * (0.5 + 0.5 * float(numpy.cos(numpy.pi * min(progress, 1.0)))) + 1e-3


def average(values):
    return float(numpy.mean(values)) if len(values) else float("nan")


def stored_weights(path, name):
    """The parameters of a network in a weights.pt or, in fp16 precision, an exported .onnx file."""
    if str(path).endswith(".onnx"):
        import onnx

        tensors = onnx.load(path).graph.initializer
        return {t.name.removesuffix("_fp16"): torch.from_numpy(onnx.numpy_helper.to_array(t).astype("float32")) for t in tensors}
    return part_of(torch.load(path, weights_only=True), name)


def initial_weights(path, name):
    """The `stored_weights` of a file or, for `joint`, of a folder of them, for the network as it is now.

    What the file lacks starts afresh; channels that the stem did not read then, before the position's two, count nothing yet.
    """
    if pathlib.Path(path).is_dir():
        parts = {part: initial_weights(pathlib.Path(path) / f"{part}.onnx", part) for part in tasks.TASKS[name].networks}
        return {f"{part}.{key}": value for part, weights in parts.items() for key, value in weights.items()}
    stored = stored_weights(path, name)
    wanted = tasks.TASKS[name].network().state_dict()
    weights = {key: stored.get(key, value) for key, value in wanted.items()}
    for stem in (key for key in wanted if key.endswith("stem.weight")):
        old, new = weights[stem], wanted[stem].shape[1] - weights[stem].shape[1]
        if new:
            weights[stem] = torch.cat([old[:, :-2], torch.zeros_like(old[:, :1]).repeat(1, new, 1, 1), old[:, -2:]], 1)
    return weights


def exported(path, name):
    """The network as inference runs it, with the `stored_weights`: every parameter must be there."""
    network = nets.make_symmetric(name).eval()
    stored = stored_weights(path, name)
    network.load_state_dict({**network.state_dict(), **{key: stored[key] for key, _ in network.named_parameters()}})
    return network


def part_of(weights, name):
    """The parameters of one network among those of a joint run."""
    own = {key.removeprefix(f"{name}."): value for key, value in weights.items() if key.startswith(f"{name}.")}
    return own or weights


def keep_memory():
    """Makes the C library keep freed memory: page faults of every step's tensors cost a fifth of the time on a CPU."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        m_trim_threshold, m_top_pad, m_mmap_max = -1, -2, -4
        for parameter, value in ((m_mmap_max, 0), (m_trim_threshold, 2**31 - 1), (m_top_pad, 2**28)):
            libc.mallopt(parameter, value)


class Processes:
    """This process among those of `torchrun`; alone without it."""

    def __init__(self):
        self.rank, self.count = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        self.device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if torch.cuda.is_available() else torch.device("cpu")
        if self.count > 1:
            distributed.init_process_group("nccl" if self.device.type == "cuda" else "gloo")

    def wrapped(self, model):
        return DistributedDataParallel(model) if self.count > 1 else model

    def agreed(self, value):
        """The value of the first process."""
        if self.count == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64, device=self.device)
        distributed.broadcast(shared, 0)
        return shared.item()


def store(state, path):
    """Writes a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(state, path.with_suffix(".tmp"))
    path.with_suffix(".tmp").replace(path)


class Order:
    """Which samples come next: each epoch once all of the pool, shuffled by its number alone."""

    def __init__(self, epoch=0, position=0, size=0):
        self.epoch, self.position, self.size = epoch, position, size
        self.shuffled = self.shuffle()

    def shuffle(self):
        return numpy.random.default_rng([13, self.epoch]).permutation(self.size)

    def take(self, pool, count):
        """The next `count` of the pool; samples that joined it since take part from the next epoch on, which a smaller pool begins."""
        if self.position + count > self.size or self.size > len(pool):
            self.epoch, self.position, self.size = self.epoch + 1, 0, len(pool)
            self.shuffled = self.shuffle()
        chosen = self.shuffled[self.position : self.position + count]
        self.position += count
        return [pool[i] for i in chosen]

    def state(self):
        return [self.epoch, self.position, self.size]


class Run:
    """A network, its moving average, the optimizers, and where they are stored.

    `carried` is the file that takes a run from one working folder to another: weights in half precision, no momentum, no average.
    """

    def __init__(self, name, out, settings, initial, carried, ema, processes):
        self.task = tasks.TASKS[name]
        self.out = pathlib.Path(out)
        self.out.mkdir(parents=True, exist_ok=True)
        self.settings = settings
        self.carried = carried and pathlib.Path(carried)
        self.decay = ema
        self.processes = processes
        self.device = processes.device
        self.model = self.task.network().to(self.device, memory_format=torch.channels_last)
        self.optimizers = muon.optimizers(self.model, settings["rate"], settings["weight_decay"], settings.get("rate_shares", {}))
        self.steps, self.samples, self.seconds, self.log, self.order, self.seeds = 0, 0, 0.0, [], Order(), []
        kept = [path for path in (self.out / "checkpoint.pt", self.carried) if path and path.exists()]
        if kept:
            stored = torch.load(kept[0], weights_only=True, map_location=self.device)
            self.model.load_state_dict(stored["model"])
            for optimizer, state in zip(self.optimizers, stored.get("optimizers", [])):
                optimizer.load_state_dict(state)
            self.steps, self.samples, self.seconds = (stored[key] for key in ("steps", "samples", "seconds"))
            self.log, self.seeds = stored["log"], stored["seeds"]
            self.order = Order(*stored["order"])
        elif initial:
            self.model.load_state_dict(initial_weights(initial, name))
        self.average = copy.deepcopy(self.model)
        if kept and "average" in stored:
            self.average.load_state_dict(stored["average"])
        self.parallel = processes.wrapped(self.model)

    def save(self):
        place = {
            "steps": self.steps, "samples": self.samples, "seconds": self.seconds, "log": self.log, "seeds": self.seeds,
            "order": self.order.state(),
        }
        model = self.model.state_dict()
        optimizers = [optimizer.state_dict() for optimizer in self.optimizers]
        store({"model": model, "average": self.average.state_dict(), "optimizers": optimizers, **place}, self.out / "checkpoint.pt")
        store(self.average.state_dict(), self.out / "weights.pt")
        if self.carried:
            store({"model": {key: value.half() for key, value in model.items()}, **place}, self.carried)

    def step(self, prepared):
        loss, terms = self.task.loss(self.task.answer(self.parallel, prepared, fast=True), prepared, self.settings["loss"])
        if not torch.isfinite(loss):
            raise RuntimeError(f"the loss is {loss.item()} after {self.samples} samples")
        self.model.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        for optimizer in self.optimizers:
            optimizer.step()
        self.steps += 1
        self.samples += len(prepared["input"]) * self.processes.count
        # The average forgets the start quickly.
        decay = min(self.decay, (1 + self.steps) / (10 + self.steps))
        with torch.no_grad():
            for kept, fresh in zip(self.average.parameters(), self.model.parameters()):
                kept.lerp_(fresh, 1 - decay)
        return {"loss": loss.item(), **{name: float(torch.as_tensor(value).detach()) for name, value in terms.items()}}

    def validate(self, batches):
        """Scores of the moving average over prepared batches."""
        merged = {}
        for prepared in batches:
            with torch.no_grad():
                output = self.task.answer(self.average, prepared, fast=False)
            for name, values in self.task.scores(output, prepared).items():
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
    length = parser.add_mutually_exclusive_group(required=True)
    length.add_argument("--minutes", type=float, help="length of the whole schedule as time")
    length.add_argument("--samples", type=int, help="length of the whole schedule as samples seen")
    parser.add_argument("--stop-at", type=int, help="stop there, in samples seen; the same command without it goes on")
    parser.add_argument("--out", help="working folder, default work/runs/NAME")
    parser.add_argument("--initial", help="weights to start from when there is no checkpoint")
    parser.add_argument("--carry", help="small file of the run's state: written too, and read where there is no checkpoint")
    parser.add_argument("--seen-before", type=int, default=0, help="samples that those weights had seen, for the record")
    parser.add_argument("--helper", action="append", default=[], help="NAME=weights.pt of a network this one builds on")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--overfit", type=int, default=0, help="train on the first N samples only, as a check")
    arguments = parser.parse_args()

    keep_memory()
    torch.set_num_threads(arguments.threads)
    # Momentum of what no longer learns fades into denormal numbers, which halve the speed within an hour.
    torch.set_flush_denormal(True)
    torch.manual_seed(1)
    processes = Processes()
    winograd.load()
    config = json.loads((HERE / "config.json").read_text())
    settings = config[arguments.name]
    parts = getattr(tasks.TASKS[arguments.name], "networks", ())
    if parts:
        settings["loss"] = {part: config[part]["loss"] for part in parts}
    if settings["batch"] % processes.count:
        parser.error(f"the batch of {settings['batch']} cannot be shared by {processes.count} processes")
    out = arguments.out or f"work/runs/{arguments.name}"
    run = Run(arguments.name, out, settings, arguments.initial, arguments.carry, config["ema"], processes)
    helpers = {}
    for entry in arguments.helper:
        name, path = entry.split("=", 1)
        helpers[name] = exported(path, name).to(processes.device, memory_format=torch.channels_last)
    missing = [name for name in run.task.needs if name not in helpers]
    if missing:
        parser.error(f"{arguments.name} needs --helper {missing[0]}=weights.pt")

    train, held_out = data.Shards(arguments.data), data.Shards(arguments.validation)
    fixed = torch.Generator().manual_seed(7)
    chosen = (held_out.occluded if run.task.occluded_only else list(range(len(held_out))))[: config["validation_samples"]]
    validation = [run.task.prepare(held_out.batch(chosen[i : i + 50]), fixed, helpers, training=False) for i in range(0, len(chosen), 50)]
    last_validation, recent = time.monotonic(), []

    def report():
        scores = run.validate(validation)
        entry = {"samples": run.samples, "seconds": round(run.seconds), "validation": scores}
        if recent:
            entry.update({key: average([r[key] for r in recent]) for key in recent[0]})
            recent.clear()
        run.log.append(entry)
        (run.out / "log.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in run.log))
        print(json.dumps(entry), flush=True)
        run.seeds = data.merged(run.seeds + train.seeds())
        run.save()
        curves(run)

    reader = data.Reader(train)
    while True:
        start = time.monotonic()
        progress = processes.agreed(run.samples / arguments.samples if arguments.samples else run.seconds / (60 * arguments.minutes))
        if progress >= 1 or (arguments.stop_at and run.samples >= arguments.stop_at):
            break
        train.refresh()
        pool = train.occluded if run.task.occluded_only else range(len(train))
        pool = pool[: arguments.overfit] if arguments.overfit else pool
        mine = lambda order: order.take(pool, settings["batch"])[processes.rank :: processes.count]
        batch = reader.batch(mine(run.order), mine(copy.copy(run.order)))
        # All dice of a step come from its number, so that a resumed run throws the same.
        generator = torch.Generator().manual_seed(run.steps * processes.count + processes.rank + 11)
        if torch.rand(1, generator=generator) < 0.5 and not arguments.overfit:
            batch = tasks.geometry.mirror(batch)
        for optimizer in run.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = settings["rate"] * group["share"] * rate_factor(progress)
        recent.append(run.step(run.task.prepare(batch, generator, helpers)))
        run.seconds += time.monotonic() - start
        if processes.rank == 0 and time.monotonic() - last_validation > 300:
            report()
            last_validation = time.monotonic()
    if processes.rank == 0:
        report()
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True).stdout.strip()
        record = {
            "network": arguments.name, "commit": commit, "config": settings, "samples_seen": arguments.seen_before + run.samples, "seen_before": arguments.seen_before,
            "seconds": round(run.seconds), "training_samples": sum(end - first for first, end in run.seeds),
            "training_seeds": run.seeds, "initial": arguments.initial, "scores": run.log[-1]["validation"],
        }
        (run.out / "run.json").write_text(json.dumps(record, indent=2) + "\n")
    if processes.count > 1:
        distributed.destroy_process_group()


if __name__ == "__main__":
    main()
