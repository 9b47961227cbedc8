"""Training of the recurrent encoder: windows of motion, and the incremental potential of the cloth along them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from drape.cloth import energies
from training.config import TrainConfig
from training.poses import draw_betas
from training.recurrent import DynamicEncoder
from training.trainer import BaseTrainer, Objective
from training.windows import HISTORY, WindowBank, Windows

STATISTICS_WINDOWS = 128


class DynamicTrainer(BaseTrainer):
    """Learns what motion adds to the drape, on top of the static ``weights``.

    A frame's loss is its incremental potential (Santesteban et al. 2022; Bertiche et al. 2022): the cloth's energy and
    m / (2 dt^2) |x - (x1 + dt v)|^2, with the network's own two earlier frames taken as given. Where x lies in the
    world counts: the root's way is added to what the network drapes relative to the root.
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
        """The recurrent encoder."""
        assert self.model.dynamic is not None
        return self.model.dynamic

    def _set_statistics(self) -> None:
        """Of the motion features only; those of the static encoders came with their weights."""
        config = self.config
        windows = self.bank.draw(STATISTICS_WINDOWS, HISTORY + 4, np.random.default_rng(config.seed + 1))
        betas = np.zeros((STATISTICS_WINDOWS, self.body.shape_count))
        self.encoder.scale.set_from(self._tensor(windows.features(self.body, betas)).flatten(0, 1))

    def _parameter_groups(self) -> list[dict[str, Any]]:
        recurrent = set(self.encoder.parameters())
        static = [p for p in self.model.parameters() if p not in recurrent]
        groups: list[dict[str, Any]] = [{"params": list(self.encoder.parameters()), "share": 1.0}]
        rate = self.config.motion.static_rate
        if rate > 0.0:
            return [*groups, {"params": static, "share": rate}]
        for parameter in static:
            parameter.requires_grad_(False)
        return groups

    def _agreement(self) -> float:
        return 1.0  # the charts agree already, and shall go on to

    def objective(self) -> Objective:
        """The mean incremental potential of the last frames of windows drawn now."""
        config = self.config
        garment, partition = self.wardrobe.draw(self.rng)
        warm_up = int(self.rng.integers(0, config.motion.warm_up_frames + 1))
        shown = HISTORY + config.motion.window_frames  # frames that are draped
        windows = self.bank.draw(config.batch_size, HISTORY + warm_up + shown, self.rng)
        betas = draw_betas(config.batch_size, self.body.shape_count, config.data, self.rng)
        codes = self.codes(windows, betas, shown)
        poses = windows.poses[:, -shown:]
        per_frame = np.repeat(betas[:, None], shown, axis=1)

        def drape(part: slice) -> tuple[Any, ...]:
            """Bodies, posed patches and vertices (B, frames, V, 3) of the draped frames ``part``."""
            batch = self.source.pose(_flat(poses[:, part]), _flat(per_frame[:, part]))
            posed, vertices = self._drape(batch, garment, partition, codes[:, part].flatten(0, 1))
            return batch, posed, vertices.unflatten(0, (config.batch_size, -1))

        with torch.no_grad():
            _, _, history = drape(slice(0, HISTORY))
        batch, posed, vertices = drape(slice(HISTORY, None))
        # Relative to where the root was first, so that float32 stays precise.
        way = windows.trans[:, -shown:] - windows.trans[:, -shown : -shown + 1]
        world = torch.cat([history, vertices], dim=1) + self._tensor(way)[:, :, None]
        dt_s = self._tensor(windows.dt_s[:, -shown + 1 :])
        inertia = energies.inertia(
            world[:, 2:],
            world[:, 1:-1].detach(),
            world[:, :-2].detach(),
            garment.cloth,
            self.material,
            dt_s=dt_s[:, 1:],
            dt_before_s=dt_s[:, :-1],
        )
        flat = vertices.flatten(0, 1)
        return self._energy(posed, flat, garment, partition, batch, {"inertia": inertia.flatten()})

    def codes(self, windows: Windows, betas: np.ndarray, shown: int) -> Tensor:
        """Dynamic codes (B, shown, 256) of the last ``shown`` frames; gradients run through all but the first two.

        The frames before, and a random state, bring the recurrence to where a stream would be.
        """
        features = self._tensor(windows.features(self.body, betas))
        dt_s = self._tensor(windows.dt_s[:, 1:])
        state, codes = self._first_state(len(betas)), []
        frames = features.shape[1]
        for frame in range(frames):
            with torch.set_grad_enabled(torch.is_grad_enabled() and frame >= frames - shown + HISTORY):
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


def _flat(array: np.ndarray) -> np.ndarray:
    """(B, F, ...) as (B F, ...)."""
    return array.reshape(-1, *array.shape[2:])
