"""Linear blend skinning of points, and rigid blending of patch frames."""

from __future__ import annotations

from drape.arrays import Array, namespace
from drape.geometry.rotations import quaternion_to_matrix


def skin_points(points: Array, weights: Array, rotations: Array, translations: Array) -> Array:
    """Returns posed points [m] (..., n, 3): ``sum_j w_j (R_j x + t_j)``. ``points`` x [m] (..., n, 3) are in the rest
    pose, ``weights`` w (n, J); rotations R (..., J, 3, 3) and translations t [m] (..., J, 3) are those of
    ``rigid.bone_transforms``."""
    xp = namespace(points)
    flat = xp.reshape(rotations, (*rotations.shape[:-2], 9))
    matrices = xp.reshape(weights @ flat, (*rotations.shape[:-3], weights.shape[0], 3, 3))
    return (matrices @ points[..., None])[..., 0] + weights @ translations


def blend_frames(
    centres: Array, weights: Array, heaviest: Array, rotations: Array, translations: Array, bone_quaternions: Array
) -> tuple[Array, Array]:
    """Returns the rotations (..., K, 3, 3) and the centres [m] (..., K, 3) of K frames that follow the posed bones.

    A frame's centre moves by linear blend skinning. Its rotation is the normalised blend of the bones' quaternions
    (wxyz, (..., J, 4)), each with the sign that agrees with the frame's ``heaviest`` bone (K,), so that the double
    cover never cancels. ``weights`` (K, J); ``centres`` [m] (..., K, 3) in the rest pose. The norm is guarded: opposite
    quaternions of equal weight stay finite.
    """
    xp = namespace(centres)
    centre = skin_points(centres, weights, rotations, translations)
    reference = xp.take(bone_quaternions, heaviest, axis=-2)  # (..., K, 4)
    agreement = reference @ xp.matrix_transpose(bone_quaternions)  # (..., K, J)
    sign = xp.where(agreement < 0.0, -xp.ones_like(agreement), xp.ones_like(agreement))
    # The small share of the reference keeps the blend away from zero when the
    # others cancel it exactly; it is exact to rounding wherever bones agree.
    mixed = (weights * sign) @ bone_quaternions + 1e-6 * reference
    norm = xp.sqrt(xp.sum(mixed * mixed, axis=-1, keepdims=True))
    return quaternion_to_matrix(mixed / norm), centre
