"""Blocks of the network: garment encoder, body encoders, decoder (OneFit, section 3 and appendix A.3)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from drape.body.skeleton import JOINT_COUNT
from drape.garment.consensus import STRAIN_POINTS
from drape.geometry import jets
from drape.graph.inputs import SLOPE
from training.chart_consensus import softened
from training.config import ModelConfig

STRAIN_COUNT = 3 * STRAIN_POINTS
CLOSENESS_COUNT = 2 * STRAIN_POINTS  # one for the patch's own part of the body, one for others
SURROUNDINGS_COUNT = 3 * JOINT_COUNT + 3  # of onefit.patch_surroundings


def mlp(sizes: list[int], *, last_activation: bool = False, bias: bool = True) -> nn.Sequential:
    """Returns linear layers of the widths ``sizes`` with LeakyReLU between them, with ``last_activation`` also after
    the last one."""
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(pairwise(sizes)):
        layers.append(nn.Linear(inputs, outputs, bias=bias))
        if index < len(sizes) - 2 or last_activation:
            layers.append(nn.LeakyReLU(SLOPE))
    return nn.Sequential(*layers)


class Standardise(nn.Module):
    """A layer that shifts and scales ``count`` features (..., count) and cuts them off at -5 and 5. Mean and deviation
    are set once and are part of the model's state."""

    mean: Tensor
    inverse_deviation: Tensor

    def __init__(self, count: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("inverse_deviation", torch.ones(count))

    def set_from(self, samples: Tensor) -> None:
        """Sets the mean and the deviation of the first m features to those of ``samples`` (n, m).

        A feature that hardly varies is shifted and not scaled; the features after the first m pass as they are.
        """
        deviation, count = samples.std(dim=0), samples.shape[1]
        self.mean[:count] = samples.mean(dim=0)
        self.inverse_deviation[:count] = 1.0 / torch.where(deviation < 1e-3, torch.ones_like(deviation), deviation)

    def forward(self, x: Tensor) -> Tensor:
        # A garment unlike any seen must not drive the network to places it never was.
        return torch.clamp((x - self.mean) * self.inverse_deviation, -5.0, 5.0)


class GarmentEncoder(nn.Module):
    """A network that computes embeddings (K, E) of patches from features (K, D): an MLP with a skip connection."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        count = config.encoder_feature_count
        self.standardise = Standardise(count)
        self.first = mlp([count, config.garment_hidden, config.garment_hidden], last_activation=True)
        self.second = mlp(
            [config.garment_hidden + count, config.garment_hidden, config.garment_hidden, config.embedding_size]
        )

    def forward(self, features: Tensor) -> Tensor:
        x = self.standardise(features)
        return self.second(torch.cat([self.first(x), x], dim=-1))


class StaticEncoder(nn.Module):
    """A network that computes the codes (F, 256) of poses from body features (F, 226): a five-layer MLP."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.standardise = Standardise(config.body_feature_count)
        self.layers = mlp([config.body_feature_count, *[config.body_hidden] * 4, config.body_code_size])

    def forward(self, features: Tensor) -> Tensor:
        return self.layers(self.standardise(features))


class Decoder(nn.Module):
    """A network that computes outputs (F, K, n) of K patches on F bodies, one head per kind of output, from body codes
    (F, 256) and patch embeddings (K, E).

    The first layer acts on the concatenation of both and of the surroundings of the posed patch;
    written as a sum of products, its garment half is computed once per garment and its body half
    once per frame.
    """

    def __init__(self, config: ModelConfig, heads: dict[str, int]) -> None:
        super().__init__()
        width = config.decoder_sizes[0]
        self.from_patch = nn.Linear(config.embedding_size, width)
        self.from_body = nn.Linear(config.body_code_size, width, bias=False)
        around = SURROUNDINGS_COUNT + jets.JET_COUNT
        self.from_surroundings = nn.Linear(around, width, bias=False) if config.vector else None
        self.trunk = mlp(list(config.decoder_sizes), last_activation=True)
        self.heads = nn.ModuleDict(
            {name: mlp([config.decoder_sizes[-1], *config.head_sizes, size]) for name, size in heads.items()}
        )
        self.activation = nn.LeakyReLU(SLOPE)
        for head in self.heads.values():
            last = list(head.children())[-1]
            assert isinstance(last, nn.Linear)
            # Small first outputs: training starts from plain skinning, not from crumpled cloth.
            nn.init.normal_(last.weight, std=1e-3)
            nn.init.zeros_(last.bias)

    def forward(
        self, body_code: Tensor, embedding: Tensor, surroundings: Tensor | None = None
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Returns the outputs (F, K, n) of each head by name, and those of the trunk (F, K, W), which corrections read.

        ``surroundings`` (F, K, 102) are needed for vector jets: ``onefit.patch_surroundings`` (75), then the
        changes (27) of the rest jets with which rigid patches fit their blend (``agreed_jets``).
        """
        x = self.from_body(body_code)[:, None] + self.from_patch(embedding)[None]
        if self.from_surroundings is not None:
            assert surroundings is not None
            x = x + self.from_surroundings(surroundings)
        x = self.trunk(self.activation(x))
        return {name: head(x) for name, head in self.heads.items()}, x


class Correction(nn.Sequential):
    """A network that computes changes (F, K, 27) of the jets of patches from their code, strain and body proximity.

    Inputs: the decoder's code of the patch, strain and force of ``training.chart_consensus``, the jets themselves, and
    closeness and force of the body proximity.
    """

    def __init__(self, config: ModelConfig) -> None:
        inputs = config.decoder_sizes[-1] + STRAIN_COUNT + 2 * jets.JET_COUNT
        inputs += CLOSENESS_COUNT + jets.JET_COUNT
        super().__init__(*mlp([inputs, config.correction_hidden, jets.JET_COUNT]))
        last = self[-1]
        assert isinstance(last, nn.Linear)
        nn.init.normal_(last.weight, std=1e-3)
        nn.init.zeros_(last.bias)

    def forward(self, hidden: Tensor, strain: Tensor, force: Tensor, jet: Tensor, body: list[Tensor]) -> Tensor:
        return super().forward(torch.cat([hidden, softened(strain), softened(force), jet, *body], dim=-1))
