"""Settings of a training run: frozen dataclasses, presets as functions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from drape.body.features import DYNAMIC_PER_JOINT, STATIC_PER_JOINT
from drape.body.skeleton import JOINT_COUNT
from drape.garment.fabric_features import FABRIC_COUNT
from drape.graph.inputs import AGREES, BETA_COUNT, DYNAMIC, FEELS, PAPER, PARTS, SURROUNDINGS

PAPER_DECODER, PAPER_HEADS = (512, 512, 512, 256), (128, 64)  # appendix A.3


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the network and what its output means.

    The decoder is smaller than that of OneFit (appendix A.3), whose size makes it learn more slowly (docs/log.md).

    ``variant`` "vector": vector jets in rigidly skinned patch frames; "paper": height jet,
    translation and scale in the rest pose, vertices skinned after (the published method).
    ``output_gain`` keeps the untrained drape near plain skinning.

    A network of vector jets has more than the published one (docs/decisions/0008-representation.md). The decoder also
    sees the posed joints and gravity in each patch's own frame. Jets start from the blend of the rigid charts, to which
    every chart is fitted. In each of ``corrections`` passes charts are fitted to their blend again; a network of
    ``correction_hidden`` units sees their strain and the body's proximity (drape.contact.proximity) and changes them.
    At the end charts are fitted to their blend once more, with the height's order in the plane as well.
    ``fabric``: patches are also described by what they are made of (drape.garment.fabric_features).
    ``state_decay_s`` is the time constant of the recurrent state, ``state_rest_s`` the time after which
    a still body's is zero (training.recurrent).
    """

    patch_feature_count: int = 154
    body_feature_count: int = JOINT_COUNT * STATIC_PER_JOINT + BETA_COUNT
    dynamic_feature_count: int = DYNAMIC_PER_JOINT
    garment_hidden: int = 256
    embedding_size: int = 128
    body_hidden: int = 256
    body_code_size: int = 256
    decoder_sizes: tuple[int, ...] = (512, 192)
    head_sizes: tuple[int, ...] = (64,)
    variant: str = "vector"
    dynamic: bool = False
    motion_hidden: int = 256
    state_size: int = 256
    state_decay_s: float = 0.5
    state_rest_s: float = 1.8
    output_gain: float = 0.1
    corrections: int = 4
    correction_hidden: int = 256
    fabric: bool = True

    @property
    def vector(self) -> bool:
        """Whether the network predicts vector jets in posed frames; it has variant "paper" otherwise."""
        return self.variant == "vector"

    @property
    def encoder_feature_count(self) -> int:
        """How many numbers the garment encoder takes of each patch."""
        return self.patch_feature_count + (FABRIC_COUNT if self.fabric else 0)

    @property
    def parts(self) -> tuple[str, ...]:
        """The names in ``drape.graph.inputs.PARTS`` of the parts that the network has."""
        there = {
            PAPER: not self.vector,
            SURROUNDINGS: self.vector,
            DYNAMIC: self.dynamic,
            AGREES: self.vector,
            FEELS: self.vector,
        }
        return tuple(part for part in PARTS if there[part])

    @property
    def axes(self) -> dict[str, int]:
        """The lengths of those named axes of the graphs' inputs that depend on the sizes of the network, by name."""
        return {
            "embedding": self.embedding_size,
            "code": self.body_code_size,
            "width": self.decoder_sizes[0],
            "state": self.state_size,
        }


@dataclass(frozen=True)
class DataConfig:
    """Data of a run.

    ``garments``: names of designs, or files; ``own_share``: chance that one of these is drawn, otherwise it is any
    garment, neighbours included; ``variants``: random neighbours of each design, drawn anew in every process;
    ``bias_share``: share of the neighbours that are cut with another grain than vertical; ``held_out_fabrics``: never
    drawn, nor what is like them.

    ``partitions``: random partitions kept of each of ``garments``, ``variant_partitions`` of each neighbour;
    ``patch_range``: between which factors the number of patches is drawn, times that of intake; ``fresh_steps``: steps
    after which one partition is replaced by one never seen.

    ``even_share``: share of poses drawn evenly over kinds of poses instead of as often as they occur; ``mix_share``:
    share of poses with the legs of another; ``mirror_share``: share of poses and of windows that are mirrored;
    ``held_out``: clips never trained on. ``shape_share``: share of bodies with a random shape, whose coefficients have
    the deviation ``shape_deviation``. ``contact_share``: share of the vertices at which a step computes contact.
    """

    garments: tuple[str, ...] = ("tshirt", "longsleeve", "tank", "trousers", "shorts", "dress", "skirt")
    partitions: int = 6
    variants: int = 7
    variant_partitions: int = 2
    own_share: float = 0.5
    fresh_steps: int = 300
    patch_range: tuple[float, float] = (0.75, 2.2)
    mix_share: float = 0.35
    mirror_share: float = 0.5
    shape_share: float = 0.3
    shape_deviation: float = 0.6
    held_out: tuple[str, ...] = ("cmu_01_09", "cmu_02_06", "cmu_03_02")
    contact_share: float = 0.4
    even_share: float = 0.5
    held_out_fabrics: tuple[str, ...] = ("twill",)
    bias_share: float = 0.15


@dataclass(frozen=True)
class MotionConfig:
    """Windows of clips that the recurrent encoder is trained on (training.windows).

    ``window_frames``: frames whose potential is lowered; up to ``warm_up_frames`` pass through the recurrent state
    before them, the last ``memory_frames`` of them with gradients, so that what lasts is learned. ``intervals_s``:
    time between frames, one drawn per window; ``drop_share``: chance that a frame is left out; ``speeds``: clips are
    played slower and faster between these. ``stop_share``: share of windows in which the body stops dead;
    ``sway_share``: of those in which the ground sways besides, with accelerations up to ``sway_m_s2``;
    ``random_state_share``: of those that begin with a random state.
    """

    window_frames: int = 2
    warm_up_frames: int = 24
    memory_frames: int = 16
    intervals_s: tuple[float, ...] = (1.0 / 60.0, 1.0 / 30.0, 1.0 / 30.0, 1.0 / 20.0)
    drop_share: float = 0.1
    speeds: tuple[float, float] = (0.7, 1.4)
    stop_share: float = 0.35
    sway_share: float = 0.35
    sway_m_s2: float = 4.0
    random_state_share: float = 0.3


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a run: network, data, time, rates, and the weights of the parts of the loss.

    ``batch_size``: frames, of a dynamic model windows, per step of each process. ``disagreement_weight`` [J/m^4] grows
    linearly from the share ``early_agreement`` to all of it over a static run: charts that must agree from the start
    learn slower. Steps toward settled drapes take all of it from the start. ``contact_knee_j_m2``: contact energy per
    area of a frame above which it counts by its logarithm. ``full_share``: steps that take all passes of corrections,
    ``bare_share`` those that take none; the others take any number, so that the model drapes with fewer as well.
    ``autocast``: the matrices of the network in bfloat16. In ``smooth_share`` of the steps poses come as three in a
    row, a random step apart that has the standard deviation ``smooth_step_rad`` in every component of every joint but
    the root, and ``smooth_weight`` [J/m^4] times the mean squared second difference of the vertices joins the loss: a
    drape that minimises energy frame by frame jumps from one way out of the body to another. With settled drapes at
    hand (training.settled) steps that take no pass lower ``settled_weight`` [J/m^4] times the mean squared distance to
    those, contact, the share ``settled_energy`` of the rest of the energy, and disagreement. ``area_weight`` [J/m^2]
    times ``losses.lost_area`` joins every loss of a static run: a network that leaves folds their room.
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    batch_size: int = 4
    minutes: float = 60.0
    learning_rate: float = 1e-3
    final_rate: float = 1e-5
    warmup_steps: int = 200
    gradient_clip: float = 1.0
    disagreement_weight: float = 15000.0
    early_agreement: float = 0.02
    contact_knee_j_m2: float = 0.5
    full_share: float = 0.7
    bare_share: float = 0.0
    smooth_share: float = 0.0
    smooth_step_rad: float = 0.01
    smooth_weight: float = 1e4
    settled_weight: float = 1e4
    settled_energy: float = 0.2
    area_weight: float = 0.0
    checkpoint_minutes: float = 4.0
    seed: int = 0
    threads: int = 2
    autocast: bool = False

    @property
    def frames_per_step(self) -> int:
        """How many draped frames of one process a step lowers the energy of."""
        return self.batch_size * (self.motion.window_frames if self.model.dynamic else 1)


def as_published(model: ModelConfig) -> ModelConfig:
    """Returns ``model`` as a network of variant "paper", without corrections and without fabrics."""
    return replace(model, variant="paper", corrections=0, fabric=False)


def shipped() -> TrainConfig:
    """Returns the settings of the run with which the shipped model began: the static drape of seven designs and
    neighbours of theirs, 95 minutes on two cores."""
    return TrainConfig(minutes=95.0)


def smoke() -> TrainConfig:
    """Returns the settings of a run of two minutes on two cores, for tests and for a look at the loop."""
    return TrainConfig(minutes=2.0, data=DataConfig(garments=("tshirt",), partitions=2, variants=0), warmup_steps=20)


def paper() -> TrainConfig:
    """Returns the settings of a run of the published network, which is a baseline."""
    return TrainConfig(model=as_published(ModelConfig(decoder_sizes=PAPER_DECODER, head_sizes=PAPER_HEADS)))


def dynamic() -> TrainConfig:
    """Returns the settings of a run that trains the recurrent encoder on top of a static model, whose weights stay as
    they are."""
    return TrainConfig(model=ModelConfig(dynamic=True), batch_size=6, minutes=45.0, warmup_steps=100)


def finetune() -> TrainConfig:
    """Returns the settings of a run that trains a static model further on one garment: its charts agree already, and
    rates are low."""
    data = DataConfig(variants=0, own_share=1.0)
    return TrainConfig(data=data, minutes=10.0, learning_rate=3e-4, warmup_steps=50, early_agreement=1.0)


def continuation() -> TrainConfig:
    """Returns the settings of a run that trains a static model further on the shipped preset's garments, for smoother
    motion and more area.

    Half of the steps take no pass of corrections: folds on the vertices need none of them.
    """
    smooth = replace(shipped(), smooth_share=0.4, smooth_weight=2e5, area_weight=15.0)
    return replace(smooth, learning_rate=3e-4, early_agreement=1.0, full_share=0.3, bare_share=0.5)


PRESETS = {"shipped": shipped, "smoke": smoke, "paper": paper, "dynamic": dynamic}
