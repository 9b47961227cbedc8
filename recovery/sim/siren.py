"""The signed distance of a closed mesh as a network of sines (Sitzmann et al. 2020), trained on that mesh.

Yu, Cordier and Seo (2024, section 3.4.4) use one, and leave its size and training open. It serves the comparison with
their paper: ``GridDistance`` is more exact and ready in seconds (docs/explanation/recovery.md).

With u the point scaled to the body's box, h_0 = u and h_k = sin(W_k h_(k-1) + b_k), the distance is w . h_L + b.
Sitzmann's factor omega is part of W_k. The gradient, w diag(cos) W_L ... diag(cos) W_1, is written out, so that
autograd can differentiate it like the distance.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.errors import ArtifactError, InputError
from drape.files.atomic import whole_file
from drape.geometry import closest
from drape.geometry.drawing import drawn
from recovery import progress
from recovery.sim.sdf import check_closed, extended

FORMAT_VERSION = 2
LARGEST_WIDTH, LARGEST_DEPTH = 1024, 16
OMEGA = 20.0  # highest frequency [rad] that the first layer starts with, across half the body's box
BATCH = 1024  # points of a step
RATE = 3e-3  # of Adam, falling to zero
MARGIN_M = 0.05  # of the box around the body
SEED = 0  # of points, batches and first weights
AT_SKIN, NEAR = 0.45, 0.40  # of the training points; the others lie anywhere in the box
AT_SKIN_M, NEAR_M = 0.006, 0.025  # standard deviations of their distance from the surface
WEIGHT_M, FAR_WEIGHT = 0.05, 0.2  # the loss weighs exp(-|d| / WEIGHT_M) + FAR_WEIGHT
LOSS_M = 0.01  # an error of the distance by this counts as one
SLOPE_WEIGHT = 0.1  # of the gradient's error in the loss
WARM_STEPS = 50
ADAM_BETAS = (0.9, 0.99)
HELD_OUT = 20_000
BAND_M = 0.03  # the error is measured at points this near to the skin

Say = Callable[[str], None]


@dataclass(frozen=True)
class SirenOptions:
    """Size and training of the network; the defaults take about five minutes of one core.

    ``width`` and ``layers`` of sines; ``points`` are drawn once, and a batch of them enters each of ``steps``.
    """

    width: int = 128
    layers: int = 4
    points: int = 400_000
    steps: int = 14_000

    def __post_init__(self) -> None:
        if min(astuple(self)) <= 0 or self.width > LARGEST_WIDTH or self.layers > LARGEST_DEPTH:
            raise InputError(
                "siren options",
                expected=f"positive numbers, at most {LARGEST_DEPTH} layers of {LARGEST_WIDTH}",
                got=", ".join(f"{name} {value}" for name, value in asdict(self).items()),
                cure="Leave them at their defaults.",
            )


DEFAULT_SIREN = SirenOptions()


class SirenError(NamedTuple):
    """Error [mm] of the distance at points within 3 cm of the skin, mean and 99 %; mean angle of the gradient [deg]."""

    mean_mm: float
    p99_mm: float
    angle_deg: float


UNKNOWN = SirenError(math.nan, math.nan, math.nan)


class SirenDistance:
    """A signed distance by the weights (H, I), ..., (1, H) and biases (H,), ..., (1,) of layers, used in float64.

    ``low`` and ``high`` [m] (3,) are the corners of the box that it was trained in; outside it the distance to the box
    is added. ``error`` was measured after the training, at points held out; both took ``trained_s`` [s] of the
    processor.
    """

    def __init__(
        self,
        weights: Sequence[np.ndarray],
        biases: Sequence[np.ndarray],
        low: np.ndarray,
        high: np.ndarray,
        error: SirenError,
        trained_s: float = 0.0,
    ) -> None:
        self.weights, self.biases = list(weights), list(biases)
        self.low, self.high, self.error, self.trained_s = low, high, error, trained_s
        self._layers = [(_double(w), _double(b)) for w, b in zip(weights, biases, strict=True)]
        self._box = _double(low), _double(high)

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        (low, high), half = self._box, _half(self.low, self.high)
        inside = torch.minimum(torch.maximum(points, low), high)
        value, gradient = _network((inside - 0.5 * (low + high)) / half, self._layers)
        return extended(value * half, gradient, points - inside)

    @classmethod
    def from_mesh(
        cls,
        vertices: np.ndarray,
        faces: np.ndarray,
        options: SirenOptions = DEFAULT_SIREN,
        *,
        report: Say | None = None,
    ) -> SirenDistance:
        """Trained on a closed mesh, ``vertices`` [m] (V, 3) and ``faces`` (F, 3); the same again on one machine.

        The loss is the mean of |f - d| / 1 cm + 0.1 |grad f - n|, weighted towards the skin; d and n are the exact
        distance and its gradient. Raises ``MeshError`` for an open mesh.
        """
        say, started = report or (lambda line: None), time.process_time()
        faces = check_closed(vertices, faces)
        low, high = vertices.min(axis=0) - MARGIN_M, vertices.max(axis=0) + MARGIN_M
        rng = np.random.default_rng(SEED)
        samples = _samples(vertices, faces, low, high, options.points, rng)
        held_out = _samples(vertices, faces, low, high, min(HELD_OUT, options.points), rng)
        layers = _trained(samples, low, high, options, say)
        weights, biases = ([part.numpy() for part in parts] for parts in zip(*layers, strict=True))
        error = siren_error(cls(weights, biases, low, high, UNKNOWN), *held_out)
        say(
            f"siren     {error.mean_mm:.2f} mm off within 3 cm of the skin (99th percentile {error.p99_mm:.1f} mm), "
            f"gradients {error.angle_deg:.1f} deg"
        )
        return cls(weights, biases, low, high, error, time.process_time() - started)

    def save(self, path: Path, digest: str) -> None:
        """Writes the network to ``path`` (npz) with the ``siren_digest`` of what it was trained on."""
        arrays = {f"weight_{k}": part for k, part in enumerate(self.weights)}
        arrays |= {f"bias_{k}": part for k, part in enumerate(self.biases)}
        arrays |= {"low": self.low, "high": self.high, "error": self.error, "trained_s": self.trained_s}
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            np.savez(file, allow_pickle=False, digest=digest, **arrays)


def load_siren(path: Path, digest: str) -> SirenDistance:
    """The network that ``save`` wrote to ``path``. Raises ``ArtifactError`` if damaged or of another ``digest``."""
    try:
        with np.load(path, allow_pickle=False) as data:
            held = {name: data[name] for name in data.files}
        count = sum(name.startswith("weight_") for name in held)
        weights, biases = ([held[f"{part}_{k}"] for k in range(count)] for part in ("weight", "bias"))
        _check_layers(weights, biases, held["low"], held["high"])
        found = SirenDistance(
            weights, biases, held["low"], held["high"], SirenError(*map(float, held["error"])), float(held["trained_s"])
        )
        of = str(held["digest"])
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ArtifactError(
            path.name, expected="a trained distance", got=f"{error}", cure="Delete the file; it is trained again."
        ) from error
    if of != digest:
        raise ArtifactError(
            path.name,
            expected="the distance of this body",
            got="that of another body or other options",
            cure="Delete the file; it is trained again.",
        )
    return found


def siren_digest(vertices: np.ndarray, faces: np.ndarray, options: SirenOptions = DEFAULT_SIREN) -> str:
    """sha256, hexadecimal, of a body and of the options of a training on it."""
    found = hashlib.sha256(repr((FORMAT_VERSION, asdict(options), np.shape(vertices), np.shape(faces))).encode())
    found.update(np.ascontiguousarray(vertices, dtype=np.float64).tobytes())
    found.update(np.ascontiguousarray(faces, dtype=np.int64).tobytes())
    return found.hexdigest()


def stored_siren(
    vertices: np.ndarray,
    faces: np.ndarray,
    folder: Path,
    options: SirenOptions = DEFAULT_SIREN,
    *,
    report: Say | None = None,
) -> SirenDistance:
    """The network of a closed mesh from ``folder``; trained and written there if it is not there yet."""
    digest = siren_digest(vertices, faces, options)
    path = folder / f"siren-{digest[:16]}.npz"
    if path.is_file():
        return load_siren(path, digest)
    found = SirenDistance.from_mesh(vertices, faces, options, report=report)
    found.save(path, digest)
    return found


def siren_error(
    found: Callable[[Tensor], tuple[Tensor, Tensor]], points: np.ndarray, distance: np.ndarray, normal: np.ndarray
) -> SirenError:
    """The error of a distance at those of ``points`` [m] (N, 3) near the skin.

    ``distance`` (N,) and ``normal`` (N, 3) are what ``exact_distance`` gives there.
    """
    near = np.abs(distance) < BAND_M
    with torch.no_grad():
        value, gradient = (part.numpy() for part in found(torch.from_numpy(points[near])))
    off = 1e3 * np.abs(value - distance[near])
    cosine = (gradient * normal[near]).sum(axis=1) / np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return SirenError(float(off.mean()), float(np.quantile(off, 0.99)), float(angle.mean()))


def exact_distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact signed distances [m] (N,) of ``points`` to a closed mesh and their gradients (N, 3).

    On the surface itself, where the direction to the nearest point is lost, the gradient is the triangle's normal.
    """
    distance = closest.signed_distance(points, vertices, faces)
    nearest = closest.closest_point(points, vertices, faces)
    corners = vertices[faces[nearest.face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    on = nearest.distance < 1e-9
    arm = np.where(on[:, None], normal, np.sign(distance)[:, None] * (points - nearest.point))
    return distance, arm / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1e-30)


def _network(u: Tensor, layers: Sequence[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    """Value (N,) and gradient (N, 3) of the network at ``u`` (N, 3)."""
    h, slopes = u, []
    for weight, bias in layers[:-1]:
        z = torch.addmm(bias, h, weight.T)
        h = torch.sin(z)
        slopes.append(torch.cos(z))
    weight, bias = layers[-1]
    value = (h @ weight.T + bias)[:, 0]
    gradient = weight.expand(len(u), -1)
    for (weight, _), slope in zip(reversed(layers[:-1]), reversed(slopes), strict=True):
        gradient = (gradient * slope) @ weight
    return value, gradient


def _double(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(array, dtype=np.float64))


def _half(low: np.ndarray, high: np.ndarray) -> float:
    return 0.5 * float((high - low).max())


def _samples(
    vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, high: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [m] (N, 3) about the surface and in the box, their exact distances (N,) and gradients (N, 3)."""
    skin, near = int(AT_SKIN * count), int(NEAR * count)
    spread = np.repeat([AT_SKIN_M, NEAR_M], [skin, near])[:, None]
    around = drawn(vertices, faces, skin + near, rng) + spread * rng.normal(size=(skin + near, 3))
    anywhere = rng.uniform(low, high, size=(count - skin - near, 3))
    points = np.clip(np.concatenate([around, anywhere]), low, high)
    return points, *exact_distance(points, vertices, faces)


def _first_layers(options: SirenOptions, generator: torch.Generator) -> list[tuple[Tensor, Tensor]]:
    """Sitzmann's initial weights, omega folded in: hidden ones keep the sines' arguments normally distributed."""
    sizes = [3, *[options.width] * options.layers, 1]
    layers = []
    for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        last = number == options.layers
        bound = OMEGA if number == 0 else math.sqrt(6.0 / inputs) / (30.0 if last else 1.0)
        weight = bound * (2.0 * torch.rand(outputs, inputs, generator=generator) - 1.0)
        bias = (0.0 if last else math.pi) * (2.0 * torch.rand(outputs, generator=generator) - 1.0)
        layers.append((weight.requires_grad_(), bias.requires_grad_()))
    return layers


def _trained(
    samples: tuple[np.ndarray, np.ndarray, np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    options: SirenOptions,
    say: Say,
) -> list[tuple[Tensor, Tensor]]:
    """Layers after ``options.steps`` of Adam in float32."""
    half = _half(low, high)
    points, distance, normal = samples
    u, d, n = (
        torch.from_numpy(part).to(torch.float32)
        for part in ((points - 0.5 * (low + high)) / half, distance / half, normal)
    )
    weight = torch.exp(-d.abs() * (half / WEIGHT_M)) + FAR_WEIGHT
    generator = torch.Generator().manual_seed(SEED)
    layers = _first_layers(options, generator)
    flat = [part for layer in layers for part in layer]
    adam = torch.optim.Adam(flat, lr=RATE, betas=ADAM_BETAS)
    for step in range(options.steps):
        progress.tick(f"the network's step {step} of {options.steps}")
        for group in adam.param_groups:
            group["lr"] = RATE * min(1.0, (step + 1) / WARM_STEPS) * (1.0 - step / options.steps)
        chosen = torch.randint(len(u), (BATCH,), generator=generator)
        value, gradient = _network(u[chosen], layers)
        off = (value - d[chosen]).abs() * (half / LOSS_M)
        slope = torch.sqrt(((gradient - n[chosen]) ** 2).sum(dim=1) + 1e-12)
        loss = (weight[chosen] * (off + SLOPE_WEIGHT * slope)).mean()
        adam.zero_grad(set_to_none=True)
        torch.autograd.backward(loss, inputs=flat)
        adam.step()
        if (step + 1) % max(1, options.steps // 8) == 0:
            say(f"siren     step {step + 1} of {options.steps}, loss {loss.item():.4f}")
    return [(weight.detach(), bias.detach()) for weight, bias in layers]


def _check_layers(
    weights: Sequence[np.ndarray], biases: Sequence[np.ndarray], low: np.ndarray, high: np.ndarray
) -> None:
    """Raises ``ValueError`` for arrays that are no network from three numbers to one in a box."""
    if len(weights) < 2 or low.shape != (3,) or high.shape != (3,) or not (high > low).all():
        raise ValueError("no layers or no box")
    inputs = 3
    for weight, bias in zip(weights, biases, strict=True):
        if weight.ndim != 2 or weight.shape[1] != inputs or bias.shape != weight.shape[:1]:
            raise ValueError(f"a layer of shape {weight.shape} after {inputs} numbers")
        inputs = len(weight)
    if inputs != 1 or not all(np.isfinite(part).all() for part in [*weights, *biases]):
        raise ValueError("not one finite distance")
