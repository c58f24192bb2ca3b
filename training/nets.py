"""The four networks: small residual U-Nets on 64 x 64 maps (BSR-Net: on the 30 x 30 control net).

Everything that the paper draws at 256 x 256 happens here at 64 x 64: the surfaces are smooth, and the strokes come in as
distance maps that keep their sub-pixel position. The trunk works at half of that: 2 x 2 pixels are folded into channels on
the way in and unfolded on the way out, which keeps every bit of the input and trains about twice as fast. No
normalization layers: each residual branch starts at zero instead.
"""

import torch
from torch import nn
from torch.nn import functional as F

import winograd

MAP = 64
NET = 30

# name: (input channels, output channels, widths per level, residual blocks per level, map size, folding, attention)
SHAPES = {
    "vd_net": (15, 8, (64, 128, 256), 2, MAP, 2, True),
    "od_net": (17, 8, (64, 128, 192), 2, MAP, 2, False),
    "bsr_net": (17, 3, (64, 96, 128), 2, NET, 1, False),
    "cdf_net": (16, 8, (64, 128, 160), 2, MAP, 2, False),
}

# Signs of the channels, in and out, in a sketch that is mirrored left to right: of the networks that are exported as the mean over
# both. CDF-Net gains 2 % in angle by that, and its fields get more singularities.
STROKES, NORMAL = (1,) * 9 + (-1,), (-1, 1, 1)
MIRRORED = {
    "vd_net": (STROKES + (1,) * 5, (1, 1) + 2 * NORMAL),
    "od_net": (STROKES + (1,) * 3 + NORMAL + (1,), (1, 1) + 2 * NORMAL),
}


class Residual(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)

    def forward(self, x):
        return winograd.after_relu(self.second, winograd.after_relu(self.first, x), rest=x)


class Attention(nn.Module):
    """Every pixel looks at all others (multi-head self-attention): shape is integrated across the whole canvas in one step.

    Queries and keys are unit vectors, times a sharpness that each head learns: without that their products grow without bound
    under Muon, until every pixel looks at one other and training diverges.
    """

    HEAD = 32

    def __init__(self, width, size):
        super().__init__()
        self.heads = width // self.HEAD
        self.sharpness = nn.Parameter(torch.full((1, self.heads, 1, 1), 20.0))
        self.position = nn.Parameter(torch.zeros(1, width, size, size))
        self.ask = nn.Conv2d(width, 3 * width, 1)
        self.answer = nn.Conv2d(width, width, 1)
        nn.init.normal_(self.position, std=0.02)
        nn.init.zeros_(self.answer.weight)
        nn.init.zeros_(self.answer.bias)

    def forward(self, x):
        _, width, height, length = x.shape
        # A cast that changes nothing would be folded into the exported parameter, which loses its name.
        alike = lambda parameter: parameter if parameter.dtype == x.dtype else parameter.to(x.dtype)
        asked = self.ask(F.relu(x) + alike(self.position))
        asked = asked.reshape(-1, 3, self.heads, self.HEAD, height * length)
        query, key, value = asked[:, 0], asked[:, 1], asked[:, 2]
        # In operators of models/README.md, which F.normalize is not.
        unit = lambda vectors: vectors / (vectors.square().mean(2, keepdim=True) * self.HEAD + 1e-12).sqrt()
        weights = ((unit(query) * alike(self.sharpness)).transpose(-1, -2) @ unit(key)).softmax(-1)
        seen = (value @ weights.transpose(-1, -2)).reshape(-1, width, height, length)
        return x + self.answer(seen)


class UNet(nn.Module):
    """Encoder and decoder with skip connections; the position in the map is an extra input.

    With `attention`, one follows each residual block of the coarsest level.
    """

    def __init__(self, inputs, outputs, widths, blocks, size, folding, attention):
        super().__init__()
        coarsest = folding * 2 ** (len(widths) - 1)
        self.padded = -(-size // coarsest) * coarsest
        self.size = size
        self.folding = folding
        axis = torch.linspace(-1, 1, size)
        position = torch.stack([axis[None, :].expand(size, size), -axis[:, None].expand(size, size)])
        self.register_buffer("position", position[None].contiguous())
        self.stem = nn.Conv2d(inputs + 2, widths[0], folding + 2, padding=1, stride=folding)
        level = lambda width: nn.Sequential(*[Residual(width) for _ in range(blocks)])
        self.encoder = nn.ModuleList(level(width) for width in widths)
        coarse = self.padded // coarsest
        self.attention = nn.ModuleList(Attention(widths[-1], coarse) for _ in range(blocks if attention else 0))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in zip(widths, widths[1:]))
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(widths, widths[1:]))
        self.decoder = nn.ModuleList(level(width) for width in widths[:-1])
        self.head = nn.Conv2d(widths[0], outputs * folding**2, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def placed(self, x):
        # A single sample needs no expansion, which keeps the exported graph plain.
        position = self.position if len(x) == 1 else self.position.expand(len(x), -1, -1, -1)
        return torch.cat([x, position], 1)

    def forward(self, x):
        return self.through(self.placed(x))

    def through(self, x):
        extra = self.padded - self.size
        if extra:
            x = F.pad(x, (0, extra, 0, extra), mode="replicate")
        x = self.stem(x)
        skips = []
        for encode, down in zip(self.encoder, self.down):
            x = encode(x)
            skips.append(x)
            x = down(x)
        for k, encode in enumerate(self.encoder[-1]):
            x = encode(x)
            if len(self.attention):
                x = self.attention[k](x)
        for skip, up, decode in reversed(list(zip(skips, self.up, self.decoder))):
            x = decode(skip + F.interpolate(up(x), scale_factor=2, mode="nearest"))
        x = winograd.after_relu(self.head, x)
        if self.folding > 1:
            x = F.pixel_shuffle(x, self.folding)
        return x[:, :, : self.size, : self.size] if extra else x


class Symmetric(UNet):
    """The mean of what a U-Net answers to a sketch and to its mirror image, mirrored back.

    Left and right mean nothing in a sketch, so half of the difference of the two answers is error. This is what is exported;
    a single answer is what is trained.
    """

    def __init__(self, shape, signs):
        super().__init__(*shape)
        column = lambda values: torch.tensor(values, dtype=torch.float32)[None, :, None, None]
        self.seen, self.told = column(signs[0]), column(signs[1])

    def forward(self, x):
        both = torch.cat([self.placed(x), self.placed(x.flip(-1) * self.seen.to(x))])
        answer, mirrored = self.through(both).chunk(2)
        return (answer + mirrored.flip(-1) * self.told.to(x)) / 2


def make(name):
    """A fresh network by its name, to be trained."""
    return UNet(*SHAPES[name])


def make_symmetric(name):
    """The network as it is exported: the same parameters, and symmetric where a mirror image means something to it."""
    return Symmetric(SHAPES[name], MIRRORED[name]) if name in MIRRORED else make(name)
