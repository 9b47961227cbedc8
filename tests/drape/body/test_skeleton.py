"""The joint tables hold together."""

from drape.body import skeleton


def test_every_joint_has_one_name_and_an_earlier_parent():
    assert len(set(skeleton.JOINT_NAMES)) == len(skeleton.PARENTS) == len(skeleton.BONE_ENDS) == skeleton.JOINT_COUNT
    assert skeleton.PARENTS[0] == -1
    assert all(0 <= parent < joint for joint, parent in enumerate(skeleton.PARENTS) if joint)


def test_bones_end_at_a_child_and_only_leaves_have_none():
    for joint, end in enumerate(skeleton.BONE_ENDS):
        if end < 0:
            assert joint not in skeleton.PARENTS
        else:
            assert skeleton.PARENTS[end] == joint


def test_left_and_right_mirror_each_other():
    names = skeleton.JOINT_NAMES
    for joint, name in enumerate(names):
        if name.startswith("left_"):
            twin = names.index(name.replace("left_", "right_"))
            parents = [names[skeleton.PARENTS[j]] for j in (joint, twin)]
            assert parents[1] == parents[0].replace("left_", "right_")
