"""Training of the recurrent encoder: windows of motion, and the incremental potential of the cloth along them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from drape.cloth import energies
from training.batches import TrainingGarment
from training.config import TrainConfig
from training.poses import draw_betas
from training.recurrent import DynamicEncoder
from training.trainer import BaseTrainer, BatchLoss
from training.windows import HISTORY, WindowBank, Windows

STATISTICS_WINDOWS = 128
CALM_M_S2 = 2.0  # frames with more acceleration than this count less: few windows would own the gradient


class DynamicTrainer(BaseTrainer):
    """The trainer of the recurrent encoder: it learns what motion adds to the drape of the static ``weights``.

    A frame's loss is its incremental potential (Santesteban et al. 2022; Bertiche et al. 2022): the cloth's energy and
    m / (2 dt^2) |x - (x1 + dt v)|^2. The place x1 and the velocity v of the frame before are those of the network's own
    two earlier frames, taken as given. Places x are those in the world: the root's way is added to the drape, which is
    relative to the root.

    Cloth must come to rest in the static drape s of the same poses, but no network hangs it so well that no force is
    left. So the energy is E(x) - E(s) - E'(s) (x - s), as if something balanced the force that is left. Otherwise that
    force would rule the gradient, and motion would be used to mend the static drape.
    """

    def __init__(
        self,
        config: TrainConfig,
        bank: WindowBank,
        *,
        device: torch.device,
        weights: Mapping[str, Tensor] | None = None,
    ) -> None:
        self.bank = bank
        super().__init__(config, device=device, weights=weights)

    @property
    def encoder(self) -> DynamicEncoder:
        """The recurrent encoder of the model, which is a dynamic one."""
        assert self.model.dynamic is not None
        return self.model.dynamic

    def _set_statistics(self) -> None:
        """Sets the scales of motion features and codes; statistics of the static encoders came with their weights."""
        config = self.config
        windows = self.bank.draw(STATISTICS_WINDOWS, HISTORY + 4, np.random.default_rng(config.seed + 1))
        betas = np.zeros((STATISTICS_WINDOWS, self.body.shape_count))
        self.encoder.scale.set_from(self._tensor(windows.features(self.body, betas)).flatten(0, 1))
        with torch.no_grad():
            batch = self.source.pose(windows.poses[:, 0], betas)
            self.encoder.set_code_scale(self.model.body(batch.tensors.features))

    def _learning(self) -> list[nn.Parameter]:
        """The recurrent encoder's alone: the static drape stays what it is, bit for bit."""
        self.model.requires_grad_(False)
        self.encoder.requires_grad_(True)
        return list(self.encoder.parameters())

    def objective(self) -> BatchLoss:
        """Draws a garment and windows of motion, and returns the loss over them: a weighted mean of how far the
        incremental potential is above that of the static drape."""
        config, count = self.config, self.config.batch_size
        garment, partition = self.wardrobe.draw(self.rng)
        warm_up = int(self.rng.integers(0, config.motion.warm_up_frames + 1))
        shown = HISTORY + config.motion.window_frames  # frames that are draped
        windows = self.bank.draw(count, HISTORY + warm_up + shown, self.rng)
        betas = draw_betas(count, self.body.shape_count, config.data, self.rng)
        codes = self.codes(windows, betas, shown)
        poses, shapes = windows.poses[:, -shown:], np.repeat(betas[:, None], shown, axis=1)
        earlier, frames = (
            self.source.pose(_flat(poses[:, part]), _flat(shapes[:, part]))
            for part in (slice(0, HISTORY), slice(HISTORY, None))
        )
        with torch.no_grad():
            history = self.drape(earlier, garment, partition, codes[:, :HISTORY].flatten(0, 1)).vertices
            static_history = self.drape(earlier, garment, partition).vertices
            still = self.drape(frames, garment, partition)
            static = still.vertices
        draped = self.drape(frames, garment, partition, codes[:, HISTORY:].flatten(0, 1))
        vertices = draped.vertices

        # Both drapes meet the same planes: which body vertex is nearest must not tell their energies apart.
        planes = self._planes(vertices, frames)
        with torch.enable_grad():
            static.requires_grad_()
            rest = self._energy(static, garment, planes)
            # Contact that cannot be avoided counts less, as in static training; its size at rest decides.
            share = 1.0 / (1.0 + rest["contact"].detach() / config.contact_knee_j_m2)
            (force,) = torch.autograd.grad(_total(rest, share).sum(), static)
        parts = self._energy(vertices, garment, planes)
        balanced = (force * (vertices - static.detach())).sum(dim=(1, 2))
        above = _total(parts, share) - _total(rest, share).detach() - balanced
        inertia = self._inertia(history, vertices, windows, garment).flatten()
        with torch.no_grad():
            unmoved = self._inertia(static_history, static, windows, garment)
            at_rest = self._inertia(history, vertices, windows, garment, candidate=static)
            weight = self._weight(unmoved, windows).flatten()
        # All charts must say the same of the change that motion makes.
        charts = self._disagreement(draped.coefficients - still.coefficients, partition)
        loss = (weight * (above + inertia)).mean() + config.disagreement_weight * weight.mean() * charts
        parts |= {"above": above, "inertia": inertia, "inertia_at_rest": at_rest}
        return BatchLoss(loss, {name: value.mean() for name, value in parts.items()}, charts)

    def _weight(self, inertia: Tensor, windows: Windows) -> Tensor:
        """Weights (B, T) of frames whose static drape has the ``inertia`` [J/m^2]: less where that is jerked."""
        dt_s = self._tensor(windows.dt_s[:, -inertia.shape[1] :])
        squared = (
            2.0 * self._stretch_share * inertia / (self.material.density_kg_m2 * dt_s.square())
        )  # mean acceleration [m^2/s^4]
        return torch.rsqrt(1.0 + squared / CALM_M_S2**2)

    def _inertia(
        self,
        history: Tensor,
        vertices: Tensor,
        windows: Windows,
        garment: TrainingGarment,
        *,
        candidate: Tensor | None = None,
    ) -> Tensor:
        """Inertia, in units of ``_unit``, (B, T) of ``vertices`` (B T, V, 3) after ``history`` (B 2, V, 3).

        With a ``candidate`` (B T, V, 3) its own, had the cloth gone there in one frame instead.
        """
        parts = [x.unflatten(0, (self.config.batch_size, -1)) for x in (history, vertices)]
        shown = sum(part.shape[1] for part in parts)
        # Relative to where the root was first, so that float32 stays precise.
        way = self._tensor(windows.trans[:, -shown:] - windows.trans[:, -shown : -shown + 1])[:, :, None]
        world = torch.cat(parts, dim=1) + way
        there = world if candidate is None else candidate.unflatten(0, (self.config.batch_size, -1)) + way[:, HISTORY:]
        dt_s = self._tensor(windows.dt_s[:, -shown + 1 :])
        energy = energies.inertia(
            there[:, -world.shape[1] + HISTORY :],
            world[:, 1:-1].detach(),
            world[:, :-2].detach(),
            garment.cloth,
            self.material,
            dt_s=dt_s[:, 1:],
            dt_before_s=dt_s[:, :-1],
        )
        return energy / self._unit(garment)

    def codes(self, windows: Windows, betas: np.ndarray, shown: int) -> Tensor:
        """Returns the dynamic codes (B, shown, 256) of the last ``shown`` frames of ``windows``, whose bodies have the
        shapes ``betas`` (B, S).

        The frames before them, and a first state that may be random, bring the recurrence to where a stream would be;
        gradients run through the last ``memory_frames`` of these.
        """
        features = self._tensor(windows.features(self.body, betas))
        dt_s = self._tensor(windows.dt_s[:, 1:])
        state, codes = self._first_state(len(betas)), []
        frames = features.shape[1]
        first = frames - shown - self.config.motion.memory_frames
        for frame in range(frames):
            with torch.set_grad_enabled(torch.is_grad_enabled() and frame >= first):
                code, state = self.encoder(features[:, frame], state, dt_s[:, frame])
            if frame >= frames - shown:
                codes.append(code)
        return torch.stack(codes, dim=1)

    def _first_state(self, count: int) -> Tensor:
        """States (count, H): zero, or of a random direction and a random size below 1."""
        share = self.config.motion.random_state_share
        draw = torch.rand(count, 2, generator=self.generator)
        direction = torch.randn(count, self.config.model.state_size, generator=self.generator)
        size = torch.where(draw[:, :1] < share, draw[:, 1:].square(), 0.0)
        return torch.clamp(size * direction, -1.0, 1.0).to(self.device)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(self.device)


def _total(parts: dict[str, Tensor], contact_share: Tensor) -> Tensor:
    """Energy (F,) of frames whose contact counts by ``contact_share`` (F,)."""
    return parts["membrane"] + parts["bending"] + parts["gravity"] + contact_share * parts["contact"]


def _flat(array: np.ndarray) -> np.ndarray:
    """(B, F, ...) as (B F, ...)."""
    return array.reshape(-1, *array.shape[2:])
