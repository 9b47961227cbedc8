"""The network's drape of one garment on one body, compiled: posed jets of its patches.

It computes what ``training.model.OneFit`` does, by the constants that ``drape.graph.packing`` lays out.
"""

from __future__ import annotations

import numpy as np

from drape.garment.consensus import MEMBERS, STRAIN_POINTS
from drape.geometry import jets
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import are_finite
from drape.kernels.lanes import LANES, put, row_at
from drape.network.charts import fit, place_anchors, say
from drape.network.dense import Layer, Rows, run_layer
from drape.network.felt import PLANES, feel_body, find_planes
from drape.network.frames import CENTRE, FRAME, GRAVITY, ROTATION, SCALE, pose_frames, see_surroundings
from drape.network.strain import feel_strain

JETS = jets.JET_COUNT
FORCE = 3 * STRAIN_POINTS  # rows of the strain, of what corrections read; behind them the force, jets, closeness, push


@kernel
def checked_jets(weights, rows, body, passes, patches):
    """``posed_jets``, the rotations as (K, 3, 3), and whether all numbers are finite."""
    jet, rotation, centre = posed_jets(weights, rows, body, passes, patches)
    finite = are_finite(jet.reshape(-1)) and are_finite(rotation.reshape(-1)) and are_finite(centre.reshape(-1))
    return (jet, rotation.reshape(-1, 3, 3), centre), finite


@part
def posed_jets(weights, rows, body, passes, patches):
    """Full jets [patch scales] (K, 45), rotations (K, 9) and centres [m] (K, 3) of K ``patches`` on ``body``, after
    ``passes`` corrections. Patches that fill the last row of ``rows`` up are left out."""
    blocks = len(rows.scale) // LANES
    frames = np.empty(LANES * FRAME * blocks, rows.scale.dtype)
    pose_frames(body, rows, frames)
    members = LANES * MEMBERS * blocks
    said, off = np.empty((members, 3), frames.dtype), np.empty(3 * LANES * MEMBERS, frames.dtype)
    anchors = np.empty((len(rows.anchor), 3), frames.dtype)
    nothing = Rows(np.empty(0, frames.dtype), 1, 0)
    say(nothing, frames, rows, said)
    place_anchors(said, rows.anchor, anchors)

    seen = Rows(np.empty(LANES * (GRAVITY + 3 + JETS) * blocks, frames.dtype), GRAVITY + 3 + JETS, 0)
    see_surroundings(body, frames, seen)
    fit(anchors, frames, rows, off, False, Rows(seen.values, seen.count, GRAVITY + 3))

    width = len(weights.surroundings.bias)
    near = weights.surroundings
    own = Layer(near.weight, near.bias + body.code[:width], near.slope, near.tiles)
    x = Rows(np.empty(LANES * width * blocks, frames.dtype), width, 0)
    run_layer(own, seen, Rows(rows.first, width, 0), x)
    for number in range(len(weights.trunk) - 1):
        width = len(weights.trunk[number].bias)
        after = Rows(np.empty(LANES * width * blocks, frames.dtype), width, 0)
        run_layer(weights.trunk[number], x, nothing, after)
        x = after
    last = weights.trunk[len(weights.trunk) - 1]
    code = len(last.bias)
    count = code + FORCE + 2 * JETS + 2 * STRAIN_POINTS + JETS  # of what corrections read
    felt = Rows(np.empty(LANES * count * blocks, frames.dtype), count, 0)
    run_layer(last, x, nothing, felt)
    jet = _heads(weights, felt, nothing, blocks)
    _add_base(seen, jet, blocks)

    planes, force = np.empty(LANES * PLANES * blocks, frames.dtype), np.empty(LANES * JETS, frames.dtype)
    for number in range(passes):
        say(jet, frames, rows, said)
        place_anchors(said, rows.anchor, anchors)
        fit(anchors, frames, rows, off, False, jet)
        feel_strain(jet, rows, force, Rows(felt.values, count, code))
        if number == 0:
            find_planes(jet, body, frames, rows, planes)
        feel_body(jet, rows, planes, force, Rows(felt.values, count, code + FORCE + 2 * JETS))
        for block in range(blocks):
            for i in range(JETS):
                place = LANES * (count * block + code + FORCE + JETS + i)
                put(felt.values, place, row_at(jet.values, LANES * (jet.count * block + i)))
        first, second = _correction(weights.corrections[0], number), _correction(weights.corrections[1], number)
        hidden = Rows(np.empty(LANES * len(first.bias) * blocks, frames.dtype), len(first.bias), 0)
        run_layer(first, felt, nothing, hidden)
        run_layer(second, hidden, jet, jet)
    say(jet, frames, rows, said)
    place_anchors(said, rows.anchor, anchors)
    closed = np.empty(LANES * jets.FULL_COUNT * blocks, frames.dtype)
    fit(anchors, frames, rows, off, True, Rows(closed, jets.FULL_COUNT, 0))
    return (
        _apart(closed, jets.FULL_COUNT, 0, jets.FULL_COUNT, patches),
        _apart(frames, FRAME, ROTATION, CENTRE - ROTATION, patches),
        _apart(frames, FRAME, CENTRE, SCALE - CENTRE, patches),
    )


@part
def _correction(layers, number):
    return Layer(layers.weight[number], layers.bias[number], layers.slope, layers.tiles[number])


@kernel
def _heads(weights, felt, nothing, blocks):
    """The jets, 32 rows a block: the last five are zero."""
    x = felt
    for number in range(len(weights.heads)):
        layer = weights.heads[number]
        after = Rows(np.empty(LANES * len(layer.bias) * blocks, felt.values.dtype), len(layer.bias), 0)
        run_layer(layer, x, nothing, after)
        x = after
    return x


@kernel
def _add_base(seen, jet, blocks):
    """Adds the jets of the agreed base."""
    for block in range(blocks):
        for i in range(JETS):
            place, base = LANES * (jet.count * block + i), LANES * (seen.count * block + GRAVITY + 3 + i)
            put(jet.values, place, row_at(jet.values, place) + row_at(seen.values, base))


@kernel
def _apart(values, count, first, width, patches):
    """Of ``values``, ``count`` rows a block, ``width`` rows from ``first`` on as numbers (K, ``width``) of patches."""
    found = np.empty((patches, width), values.dtype)
    for patch in range(patches):
        begin = LANES * (count * (patch // LANES) + first) + patch % LANES
        for i in range(width):
            found[patch, i] = values[begin + LANES * i]
    return found
