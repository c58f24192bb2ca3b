"""Shards of `sketch2pq generate`, memory-mapped, as batches of float tensors."""

import concurrent.futures
import json
import math
import pathlib

import numpy
import torch

NAMES = ("strokes", "valid", "depth", "normal", "control", "cdf")


def merged(ranges):
    """Ranges [first, end) in order, those joined that a few seeds without a sample part."""
    result = []
    for first, end in sorted(ranges):
        if result and first <= result[-1][1] + 8:
            result[-1][1] = max(result[-1][1], end)
        else:
            result.append([first, end])
    return result


class Shards:
    """All finished shards of a folder; more may be added while training runs (call `refresh`)."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.arrays = []
        self.starts = [0]
        self.occluded = []
        self.meta = []
        self.slopes = []
        self.seen = set()
        self.refresh()

    def refresh(self):
        """Takes in the shards that were finished since."""
        for shard in sorted(self.folder.glob("shard_*")):
            if shard.name in self.seen or not (shard / "meta.jsonl").exists():
                continue
            self.seen.add(shard.name)
            arrays = {name: numpy.load(shard / f"{name}.npy", mmap_mode="r") for name in NAMES}
            self.arrays.append(arrays)
            base = self.starts[-1]
            lines = [json.loads(line) for line in (shard / "meta.jsonl").read_text().splitlines()]
            self.meta.extend(lines)
            self.slopes.extend(1 / math.tan(math.radians(line["elevation"])) for line in lines)
            self.occluded.extend(base + i for i, line in enumerate(lines) if line["occluded"])
            self.starts.append(base + len(arrays["valid"]))

    def __len__(self):
        return self.starts[-1]

    def seeds(self):
        """Ranges [first, end) of the samples' seeds."""
        return merged([line["seed"], line["seed"] + 1] for line in self.meta)

    def batch(self, indices):
        """The samples with these numbers, as float32 tensors in their natural units."""
        rows = {name: [] for name in NAMES}
        for index in sorted(indices):
            shard = numpy.searchsorted(self.starts, index, side="right") - 1
            for name in NAMES:
                rows[name].append(self.arrays[shard][name][index - self.starts[shard]])
        raw = {name: torch.from_numpy(numpy.stack(values)) for name, values in rows.items()}
        strokes = raw["strokes"].float()
        strokes[:, :8] /= 255
        strokes[:, 8:] = (strokes[:, 8:] - 128) / 127
        return {
            "strokes": strokes,
            "valid": raw["valid"],
            "depth": raw["depth"].float(),
            "normal": raw["normal"].float() / 127,
            "control": raw["control"].float(),
            "cdf": raw["cdf"].float() / 127,
            "slope": torch.tensor([self.slopes[index] for index in sorted(indices)]),
        }


class Reader:
    """Batches of `Shards`: the one that follows is read from the disk while the current one is learned."""

    def __init__(self, shards):
        self.shards = shards
        self.thread = concurrent.futures.ThreadPoolExecutor(1)
        self.coming = None, None

    def batch(self, indices, following):
        """The samples of this step; those of the next are asked for, and awaited only if they are what it then wants."""
        promised, pending = self.coming
        current = pending.result() if promised == indices else self.shards.batch(indices)
        self.coming = following, self.thread.submit(self.shards.batch, following)
        return current
