"""Data parallel training under torchrun: every process draws its own batches, gradients are averaged.

    torchrun --nproc-per-node 2 -m training.run --preset shipped --threads 1 --out runs/first

gloo on CPU, nccl on GPUs. Without torchrun there is one process and nothing here costs anything.
"""

from __future__ import annotations

import os

import torch
import torch.distributed as dist
from torch import Tensor, nn


def start_rank(device: torch.device) -> None:
    """Joins the process group if torchrun has started this process; does nothing otherwise."""
    if "RANK" in os.environ and not dist.is_initialized():
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo")


def stop() -> None:
    """Leaves the process group after all processes have come here: the first to leave would take the others' store
    with it."""
    if dist.is_initialized():
        dist.barrier()
        dist.destroy_process_group()


def rank() -> int:
    """Returns the number of this process: 0 for the one that writes files, and without torchrun."""
    return dist.get_rank() if dist.is_initialized() else 0


def world_size() -> int:
    """Returns how many processes train together, 1 without torchrun."""
    return dist.get_world_size() if dist.is_initialized() else 1


def share(module: nn.Module) -> None:
    """Replaces the parameters and buffers of ``module`` in every process by those of process 0."""
    if dist.is_initialized():
        for tensor in module.state_dict().values():
            dist.broadcast(tensor, src=0)


def average_gradients(module: nn.Module, clock_s: float) -> float:
    """Replaces the gradients of ``module`` by their means over all processes, in one message; returns ``clock_s`` of
    process 0.

    The clock rides along because the rate and the end of a run follow it, and both must
    be the same everywhere.
    """
    if not dist.is_initialized():
        return clock_s
    gradients = [p.grad for p in module.parameters() if p.grad is not None]
    share = 1.0 / dist.get_world_size()
    clock = torch.tensor([clock_s if dist.get_rank() == 0 else 0.0], device=gradients[0].device)
    flat = torch.cat([clock, *[g.flatten() for g in gradients]])
    dist.all_reduce(flat)
    place = 1
    for gradient in gradients:
        gradient.copy_(_part(flat, place, gradient) * share)
        place += gradient.numel()
    return float(flat[0])


def _part(flat: Tensor, place: int, like: Tensor) -> Tensor:
    return flat[place : place + like.numel()].view_as(like)
