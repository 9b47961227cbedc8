"""Tiers: names for how much of a frame is computed, and the values of options that nobody named.

A tier is two numbers, corrections of the network and steps of folds, and whether a coarse cloth takes these. The
model's manifest says which, chosen from measurements (``benchmarks.tradeoff``); ``TIERS`` hold for a model that does
not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Protocol, get_args

from drape.errors import ArtifactError, InputError
from drape.wire.options import Advanced, DrapeOptions, TierName

FAR_PIXELS_PER_M = 100.0  # below it a pixel is more than a centimetre
NAMES: tuple[str, ...] = get_args(TierName)  # the least first
EXACT = "exact"  # the tier that is a job of the service


class TierSettings(Protocol):
    """The service's settings, which hold where a client names neither a tier nor a number of steps of folds."""

    @property
    def tier(self) -> TierName: ...
    @property
    def folds(self) -> int | None: ...


@dataclass(frozen=True)
class Tier:
    """How much a frame computes: ``passes`` corrections of the network and then ``folds`` steps of folds.

    Where nothing folds, as with jets, the network makes ``alone`` passes. None stands for all passes. ``coarse``: a
    coarse cloth takes the steps (``drape.live.two_level``), and without steps the cloth is only lifted off the skin.
    ``figures`` are what ``benchmarks.tradeoff`` measured of the tier, by name, such as "gain" and "cpu_ms"; its
    ``manifest_tiers`` has the names.
    """

    name: str
    passes: int | None
    folds: int
    alone: int | None
    figures: Mapping[str, Any] = field(default_factory=dict, hash=False, compare=False)
    coarse: bool = False


TIERS = (
    Tier("instant", 0, 0, 0, coarse=True),
    Tier("fast", 0, 1, 0, coarse=True),
    Tier("balanced", 0, 2, None, coarse=True),
    Tier("accurate", 0, 4, None),
)


def read_tiers(rows: Sequence[Mapping[str, Any]]) -> tuple[Tier, ...]:
    """Returns the tiers in the ``rows`` of a manifest, the one that computes least first; ``TIERS`` if there are none.

    Raises ``ArtifactError`` where their names are not ``NAMES``, or a tier computes less than the one before it.
    """
    if not rows:
        return TIERS
    try:
        tiers = tuple(Tier(**row) for row in rows)
        named = tuple(tier.name for tier in tiers)
        rising = all(
            low.folds <= high.folds and _at_most(low.passes, high.passes) and low.coarse >= high.coarse
            for low, high in pairwise(tiers)
        )
    except TypeError as error:
        raise _unreadable(str(error)) from error
    if named != NAMES or not rising or tiers[0].folds or not tiers[0].coarse or tiers[1].folds < 1:
        raise _unreadable(", ".join(f"{tier.name} (passes {tier.passes}, folds {tier.folds})" for tier in tiers))
    return tiers


def chosen(options: DrapeOptions, tiers: Sequence[Tier], settings: TierSettings, pass_count: int) -> DrapeOptions:
    """Returns ``options`` with the tier replaced by what it stands for: ``tier`` is None, and ``passes``, ``folds``,
    ``safe_folds`` and ``coarse`` are filled in. ``passes`` is None for all passes.

    A number that the client named wins, then its tier, then the service's ``settings``. ``pass_count`` is
    ``Engine.pass_count``; a tier gets no more passes. Refuses (``InputError``) the tier exact, which is a job.
    """
    if options.tier == EXACT:
        cure = "POST /drape with tier exact: the answer is a job. Or ask for accurate here."
        raise InputError("tier", expected=f"one of {', '.join(NAMES)}", got=EXACT, cure=cure)
    asked, own = options.advanced, None if options.tier else settings.folds
    folds, passes = asked.folds, asked.passes
    far = options.pixels_per_m is not None and options.pixels_per_m < FAR_PIXELS_PER_M
    tier = tiers[0 if far and folds is None else NAMES.index(options.tier or settings.tier)]
    folding = options.geometry == "vertices" or options.folds_by == "client"
    lifts = folds is None and own is None and not tier.folds and folding
    if far:
        # The lift costs less than the projection, in whose place it is; without push-out neither is needed.
        lifts = folds is None and folding and asked.push_out is not False
        folds = 0 if folds is None else folds
        if passes is None and not folds:
            passes = _of_model(tiers[0].alone, pass_count)
    if folds is None:
        folds = 0 if not folding else tier.folds if own is None else own
    if passes is None:
        passes = _of_model(tier.passes if folds else tier.alone, pass_count)
    coarse = (tier.coarse if asked.coarse is None else asked.coarse) and (bool(folds) or lifts)
    seen = FAR_PIXELS_PER_M if far and options.geometry == "vertices" else None  # one plan for all that is far away
    safe = _safe_folds(asked, folds, tiers)
    return options.updated(tier=None, pixels_per_m=seen, folds=folds, passes=passes, coarse=coarse, safe_folds=safe)


def capped(options: DrapeOptions, tier: Tier) -> DrapeOptions:
    """Returns ``options``, as ``chosen`` returns them, with every number that is above that of ``tier`` lowered to
    it."""
    asked = options.advanced
    most = tier.passes if asked.folds else tier.alone
    passes = asked.passes if _at_most(asked.passes, most) else most
    folds = asked.folds or 0
    safe = asked.safe_folds if folds <= tier.folds else tier.folds  # steps that are not lowered keep their safe number
    coarse = asked.coarse or (tier.coarse and bool(folds))
    return options.updated(passes=passes, folds=min(folds, tier.folds), safe_folds=safe, coarse=coarse)


def spared(options: DrapeOptions) -> DrapeOptions:
    """Returns ``options`` of one garment, as ``chosen`` returns them, without cloth contact if there are steps of
    folds: folds do without it for a while.

    The push-out stays: without it stiff shorts show skin in a squat.
    """
    return options.updated(cloth_contact=False) if options.advanced.folds else options


def _safe_folds(asked: Advanced, folds: int, tiers: Sequence[Tier]) -> int:
    """The steps of folds for a pose unlike training: those of the last tier, unless the client names a number."""
    if not folds:
        return 0
    free = tiers[-1].folds if asked.folds is None else 0
    return max(folds, free if asked.safe_folds is None else asked.safe_folds)


def tier_of(options: DrapeOptions, tiers: Sequence[Tier], pass_count: int) -> str:
    """Returns the name of the tier that has the numbers of ``options``, as ``chosen`` returns them; "custom" if none
    has."""
    asked = options.advanced
    folding = options.geometry == "vertices" or options.folds_by == "client"
    for tier in tiers:
        if not tier.folds and not folding:  # jets have the next tier's passes too
            continue
        folds = tier.folds if folding else 0
        passes, coarse = tier.passes if folds else tier.alone, tier.coarse and folding
        same = asked.folds == folds and bool(asked.coarse) == coarse
        if same and asked.passes == _of_model(passes, pass_count):
            return tier.name
    return "custom"


def _of_model(passes: int | None, pass_count: int) -> int | None:
    """``passes``, or None if these are all ``pass_count`` of the model."""
    return None if passes is None or passes >= pass_count else passes


def _at_most(passes: int | None, most: int | None) -> bool:
    """Whether ``passes`` are no more than ``most``; None is all of them."""
    return most is None or (passes is not None and passes <= most)


def _unreadable(got: str) -> ArtifactError:
    return ArtifactError(
        "tiers of the manifest",
        expected=f"{', '.join(NAMES)}, each with passes, folds (0 in the first, then 1 at least), alone and "
        "coarse (true in the first), none less than the one before",
        got=got,
        cure="Empty its list of tiers; benchmarks.tradeoff --save --write then measures new ones.",
    )
