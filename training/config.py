"""Settings of a training run: frozen dataclasses, presets as functions."""

from __future__ import annotations

from dataclasses import dataclass, field

from drape.body.features import DYNAMIC_PER_JOINT, STATIC_PER_JOINT
from drape.body.skeleton import JOINT_COUNT
from drape.feeds import BETA_COUNT


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the network (OneFit, appendix A.3) and what its output means.

    ``variant`` "vector": vector jets in rigidly skinned patch frames; "paper": height jet,
    translation and scale in the rest pose, vertices skinned after (the published method).
    ``output_gain`` keeps the untrained drape near plain skinning.
    """

    patch_feature_count: int = 154
    body_feature_count: int = JOINT_COUNT * STATIC_PER_JOINT + BETA_COUNT
    dynamic_feature_count: int = DYNAMIC_PER_JOINT
    garment_hidden: int = 256
    embedding_size: int = 128
    body_hidden: int = 256
    body_code_size: int = 256
    decoder_sizes: tuple[int, ...] = (512, 512, 512, 256)
    head_sizes: tuple[int, ...] = (128, 64)
    variant: str = "vector"
    dynamic: bool = False
    state_size: int = 512
    state_decay_s: float = 0.5
    output_gain: float = 0.1


@dataclass(frozen=True)
class DataConfig:
    """What is trained on. ``garments``: shipped names; ``partitions``: random partitions kept per garment,
    ``variants``: random neighbours of each garment's design, with a third as many partitions;
    ``patch_jitter``: patch counts vary by this share; ``held_out``: clips never trained on."""

    garments: tuple[str, ...] = ("tshirt", "longsleeve", "tank", "trousers", "shorts", "dress")
    partitions: int = 12
    variants: int = 2
    patch_jitter: float = 0.25
    mix_share: float = 0.35
    mirror_share: float = 0.5
    shape_share: float = 0.3
    shape_deviation: float = 0.6
    held_out: tuple[str, ...] = ("cmu_01_09", "cmu_02_06", "cmu_03_02")
    contact_share: float = 0.5


@dataclass(frozen=True)
class TrainConfig:
    """The run: batch of frames per step, steps, rates, and where things go.

    ``contact_knee_j_m2``: contact energy per area of a frame above which it counts by its logarithm.
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    batch_size: int = 8
    minutes: float = 60.0
    learning_rate: float = 1e-3
    final_rate: float = 1e-5
    warmup_steps: int = 200
    gradient_clip: float = 1.0
    disagreement_weight: float = 50.0
    contact_knee_j_m2: float = 0.5
    checkpoint_minutes: float = 4.0
    seed: int = 0
    threads: int = 2
    autocast: bool = False
    compile: bool = False


def first() -> TrainConfig:
    """The first shipped model: static, six garments, an hour or two on two cores."""
    return TrainConfig(minutes=75.0)


def smoke() -> TrainConfig:
    """Two minutes on two cores, for tests and for a look at the loop."""
    return TrainConfig(minutes=2.0, data=DataConfig(garments=("tshirt",), partitions=2, variants=0), warmup_steps=20)


def paper() -> TrainConfig:
    """The published representation, for its tables and as the baseline."""
    return TrainConfig(model=ModelConfig(variant="paper"))


PRESETS = {"first": first, "smoke": smoke, "paper": paper}
