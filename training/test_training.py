"""Checks of the training program itself: `python -m unittest discover -s training` (five to twenty minutes on two cores).

Needs the release build of `sketch2pq`, which makes the few samples.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import torch

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE))

import export
import nets
import tasks
import train
import winograd

BINARY = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", HERE.parent / "target")) / "release" / "sketch2pq"


class Training(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.work = pathlib.Path(cls.folder.name)
        for name, seeds in (("train", "0..96"), ("validation", "9000000..9000024")):
            subprocess.run([BINARY, "generate", "--seeds", seeds, "--out", cls.work / name, "--shard-size", "24"], check=True)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def train(self, out, *more, launcher=(sys.executable,), network="bsr_net", threads=1):
        command = [
            *launcher, HERE / "train.py", network, "--data", self.work / "train", "--validation", self.work / "validation",
            "--threads", threads, "--out", self.work / out, *more,
        ]
        for needed in tasks.TASKS[network].needs:
            command += ["--helper", f"{needed}={HERE.parent / 'models' / needed}.onnx"]
        subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
        entries = [json.loads(line) for line in (self.work / out / "log.jsonl").read_text().splitlines()]
        return torch.load(self.work / out / "weights.pt", weights_only=True), entries

    def test_a_stopped_run_resumes_exactly(self):
        whole, _ = self.train("whole", "--samples", "640")
        self.train("parts", "--samples", "640", "--stop-at", "320")
        parts, _ = self.train("parts", "--samples", "640")
        for name, values in whole.items():
            self.assertTrue(torch.equal(values, parts[name]), name)

    def test_a_run_goes_on_from_the_file_it_carries(self):
        carried = self.work / "carried.pt"
        self.train("first", "--samples", "640", "--stop-at", "320", "--carry", carried)
        weights, entries = self.train("second", "--samples", "640", "--stop-at", "320", "--carry", carried)
        before = torch.load(self.work / "first" / "checkpoint.pt", weights_only=True)
        for name, values in before["model"].items():
            self.assertTrue(torch.allclose(weights[name], values, rtol=1e-3, atol=1e-6), name)
        self.assertEqual(torch.load(self.work / "second" / "checkpoint.pt", weights_only=True)["order"], before["order"])
        self.assertEqual([entry["samples"] for entry in entries], [320, 320])
        _, entries = self.train("second", "--samples", "640", "--carry", carried)
        self.assertEqual(entries[-1]["samples"], 640)

    def test_two_processes_learn_as_one_does(self):
        launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
        _, alone = self.train("alone", "--samples", "2560", threads=2)
        _, together = self.train("together", "--samples", "2560", launcher=launcher)
        self.assertEqual(alone[-1]["samples"], together[-1]["samples"])
        scores = [entries[-1]["validation"]["d"] for entries in (alone, together)]
        self.assertLess(abs(scores[0] / scores[1] - 1), 0.2, scores)
        self.assertLess(max(scores), 0.7 * alone[-1]["validation"]["d_coons"])

    def test_32_samples_can_be_learned_by_heart(self):
        _, entries = self.train("overfit", "--samples", "6400", "--overfit", "32", threads=2)
        _, begin = self.train("begin", "--samples", "32", "--overfit", "32")
        self.assertLess(entries[-1]["loss"], 0.2 * begin[-1]["loss"])

    def test_earlier_weights_start_a_wider_network(self):
        inputs, outputs, *rest = nets.SHAPES["vd_net"]
        earlier = nets.UNet(inputs - 3, outputs, *rest[:-1], False)
        torch.nn.init.normal_(earlier.head.weight)
        torch.save(earlier.state_dict(), self.work / "earlier.pt")
        later = nets.make("vd_net")
        later.load_state_dict(train.initial_weights(self.work / "earlier.pt", "vd_net"))
        maps = torch.randn(2, inputs, nets.MAP, nets.MAP)
        self.assertTrue(torch.allclose(later(maps), earlier(maps[:, :-3]), atol=1e-4))

    def test_what_is_exported_is_symmetric_and_can_go_on(self):
        torch.manual_seed(5)
        for name, (seen, told) in nets.MIRRORED.items():
            network = nets.make_symmetric(name).eval()
            for parameter in network.parameters():
                torch.nn.init.normal_(parameter, std=0.05)
            maps = torch.randn(1, nets.SHAPES[name][0], nets.MAP, nets.MAP)
            column = lambda signs: torch.tensor(signs)[None, :, None, None]
            with torch.no_grad():
                mirrored = network(maps.flip(-1) * column(seen)).flip(-1) * column(told)
                self.assertTrue(torch.allclose(network(maps), mirrored, atol=1e-3), name)
            torch.save(network.state_dict(), self.work / "symmetric.pt")
            export.export(name, self.work / "symmetric.pt", self.work / "exported" / f"{name}.onnx", None)
            stored = train.initial_weights(self.work / "exported" / f"{name}.onnx", name)
            for key, values in network.state_dict().items():
                self.assertTrue(torch.allclose(stored[key], values, rtol=1e-3, atol=1e-4), key)


class Filtering(unittest.TestCase):
    def test_minimal_filtering_is_convolution(self):
        """Values and all gradients agree with PyTorch's convolution, on tiles at all sides of maps and with several samples a block."""
        for inputs, outputs, size, samples in ((64, 32, 32, 3), (32, 96, 8, 19), (64, 64, 4, 1)):
            torch.manual_seed(inputs)
            stored = {"memory_format": torch.channels_last}
            layer = torch.nn.Conv2d(inputs, outputs, 3, padding=1).to(**stored)
            maps = torch.randn(samples, inputs, size, size).to(**stored).requires_grad_()
            rest = torch.randn(samples, outputs, size, size).to(**stored).requires_grad_()
            weighing = torch.randn(samples, outputs, size, size)
            results = []
            for winograd.kernels in (None, winograd.compiled()):
                answer = winograd.after_relu(layer, maps, rest)
                results.append([answer, *torch.autograd.grad(answer, [maps, layer.weight, layer.bias, rest], weighing)])
            winograd.kernels = None
            for expected, found in zip(*results):
                self.assertEqual(expected.shape, found.shape)
                self.assertLess((found - expected).norm(), 2e-5 * expected.norm())


if __name__ == "__main__":
    unittest.main()
